//! From a theatre onto the whiteboard, and off it again.

use crate::quality::Quality;
use crate::task::task;
use crate::theatre::Theatre;
use bevy::math::Isometry3d;
use bevy::prelude::*;
use keyhole_assessment::TaskStatus;
use keyhole_collision::{CollisionReport, CollisionSettings, SelfCollision};
use keyhole_instruments::{PortFrame, Script, TrocarState, tools};
use keyhole_scene::surface;
use keyhole_scene::{Scene, SceneSelfCollision, SceneTimeStepping, SceneTissue, SceneTissueModel};
use keyhole_tetmesh::TetMesh;
use keyhole_tissue::reference::{ReferenceError, unloaded};
use keyhole_tissue::{
    Capsule, Constraints, TeschnerSettings, TimeStepping, TissueModel, TissueReport, TissueSettings, VbdSettings, XpbdSettings,
};
use keyhole_whiteboard::{
    Anatomy, Attachments, BleedReport, ClipReport, ClipShape, CutSettings, CutStatus, Endoscope, GlobalView, GraspReport, Gravity, Hand,
    Instrument, InstrumentKind, NeedleGrip, Organ, OrganMaterials, PinchLimit, Port, RigidBody, RigidReport, SceneCleared, ScopeOptics,
    ScriptClock, SimulationControl, SimulationIds, SurfaceFriction, SutureReport, TearResistance, Thread, TickCost, TissueMesh,
    TissueState, TopologyChanged, Tray,
};

/// Part of the sag within which a rest shape hangs as the scan.
const PRESTRESS_TOLERANCE: f64 = 1e-3;
/// Most equilibria that are computed for a rest shape.
const PRESTRESS_ROUNDS: u32 = 30;

/// The model that a scene asks for, with the scene's substeps or, when it names none, the model's own.
fn tissue_model(tissue: &SceneTissue) -> TissueModel {
    let substeps = |own: u32| tissue.substeps.unwrap_or(own);
    let xpbd = |constraints| {
        let own = XpbdSettings::default();
        TissueModel::Xpbd(XpbdSettings { substeps: substeps(own.substeps), constraints })
    };
    match tissue.model {
        SceneTissueModel::Implicit => TissueModel::Implicit,
        SceneTissueModel::Teschner => TissueModel::Teschner(TeschnerSettings::default()),
        SceneTissueModel::Xpbd => xpbd(Constraints::NeoHookean),
        SceneTissueModel::XpbdSprings => xpbd(Constraints::DistanceVolume),
        SceneTissueModel::Vbd => {
            let own = VbdSettings::default();
            TissueModel::Vbd(VbdSettings { substeps: substeps(own.substeps), ..own })
        }
    }
}

/// Replaces the rest shape of a mesh by the one that hangs as the mesh does, with what holds it without compliance fixed. Gives the largest distance
/// that is left, m.
fn unload(mesh: &mut TetMesh, materials: &OrganMaterials, attachments: &Attachments, gravity: Vec3) -> Result<f64, ReferenceError> {
    let rigid = |n| attachments.0.iter().any(|a| a.compliance_m_n <= 0.0 && a.point.len() == 1 && a.point[0].0 == n);
    let found = unloaded(mesh, materials, rigid, gravity.as_dvec3(), PRESTRESS_TOLERANCE, PRESTRESS_ROUNDS)?;
    let nodes: Vec<_> = mesh.nodes().collect();
    for n in nodes {
        mesh.move_node(n, found.rest[n.index()], std::iter::once((n, 1.0)).collect());
    }
    // Nobody has seen the mesh yet.
    mesh.take_delta();
    Ok(found.error_m)
}

/// Puts a theatre onto the whiteboard.
pub fn spawn(world: &mut World, theatre: &Theatre) {
    let scene = &theatre.scene;
    let started_s = world.get_resource::<Time<Fixed>>().map_or(0.0, Time::elapsed_secs_f64);
    world.insert_resource(Gravity(Vec3::from_array(scene.gravity)));
    world.insert_resource(scene.requirements());
    world.insert_resource(task(scene));
    world.insert_resource(TaskStatus::default());
    let global = scene.views.global.map(|camera| (Vec3::from_array(camera.eye), Vec3::from_array(camera.target)));
    world.get_resource_or_init::<GlobalView>().set_if_neq(GlobalView(global));
    world.insert_resource(theatre.script.clone());
    world.insert_resource(ScriptClock { end_s: theatre.script.end_s(), ..default() });
    {
        let mut settings = world.get_resource_or_init::<TissueSettings>();
        settings.substeps = scene.tissue.substeps.unwrap_or(TissueSettings::default().substeps);
        settings.model = tissue_model(&scene.tissue);
        settings.stepping = match scene.tissue.stepping {
            SceneTimeStepping::TwoStages => TimeStepping::TwoStages,
            SceneTimeStepping::TwoSteps => TimeStepping::TwoSteps,
        };
        settings.capsule = scene.tissue.capsule.map(|c| Capsule {
            young_modulus_pa: c.young_modulus_pa,
            poisson_ratio: c.poisson_ratio,
            thickness_m: c.thickness_mm * 1e-3,
        });
    }
    if let Some(quality) = world.get_resource::<Quality>().copied() {
        quality.apply(&mut world.resource_mut::<TissueSettings>());
    }
    world.get_resource_or_init::<CollisionSettings>().self_collision = match scene.collision.itself {
        SceneSelfCollision::OnceCut => SelfCollision::OnceCut,
        SceneSelfCollision::Always => SelfCollision::Always,
        SceneSelfCollision::Never => SelfCollision::Never,
    };
    for (organ, mesh) in scene.organs.iter().zip(&theatre.meshes) {
        let mut attachments = organ.attachments(mesh);
        for attachment in &mut attachments.0 {
            attachment.until_s += started_s;
        }
        let materials = organ.organ_materials();
        let vessel = organ.vessel.as_ref().map(|vessel| vessel.vessel(&organ.name));
        let mut mesh = mesh.clone();
        let state = TissueState::at_rest(&mesh);
        if scene.tissue.prestress {
            match unload(&mut mesh, &materials, &attachments, Vec3::from_array(scene.gravity)) {
                Ok(error_m) => {
                    info!("organ {}: its rest shape hangs within {:.3} mm of the mesh that was given", organ.name, error_m * 1e3)
                }
                Err(error) => error!(
                    "organ {}: no rest shape hangs as the mesh that was given, which is taken as the rest shape: {error}",
                    organ.name
                ),
            }
        }
        let mut entity =
            SimulationIds::spawn_in(world, (Organ { name: organ.name.clone() }, TissueMesh(mesh), state, materials, attachments));
        rub(&mut entity, organ.friction);
        if let Some(vessel) = vessel {
            entity.insert(vessel);
        }
        if let Some(force) = organ.tear_n_m {
            entity.insert(TearResistance(force));
        }
        if let Some(pressure) = organ.bruise_pa {
            entity.insert(PinchLimit(pressure));
        }
    }
    for (told, surface) in scene.anatomy.iter().zip(&theatre.surfaces) {
        let anatomy = Anatomy { name: told.name.clone(), surface: surface.clone(), colour: told.colour };
        let mut entity = SimulationIds::spawn_in(world, (anatomy, Transform::from_isometry(told.transform.isometry())));
        if told.solid {
            match surface::solid(surface, &told.transform) {
                Ok(solid) => {
                    entity.insert(solid);
                }
                Err(error) => error!("anatomy {}: nothing touches it: {error}", told.name),
            }
            rub(&mut entity, told.friction);
        }
    }
    let mut hands = Vec::new();
    for instrument in &scene.instruments {
        let Some(port) = scene.port(&instrument.port) else { continue };
        let kind = instrument.kind.kind();
        let told = Instrument {
            kind,
            name: tools::name(kind).into(),
            shaft_length_m: instrument.shaft_length_m,
            shaft_radius_m: instrument.shaft_radius_m,
        };
        let mut state = trocar_state(instrument.yaw_deg, instrument.pitch_deg, instrument.insertion_m);
        if scene.sutures.iter().any(|s| s.held_by == Some(instrument.hand)) {
            state.grip = 1.0;
        }
        // What cuts comes first: instruments equip what arrives without it.
        let mut entity = SimulationIds::spawn_in(world, ());
        if let Some(of_kind) = tools::cutting_line(kind) {
            entity.insert(instrument.cutting_line(of_kind));
        }
        if kind == InstrumentKind::ClipApplier {
            entity.insert(instrument.clips.unwrap_or_default().applier());
        }
        if kind == InstrumentKind::Suction {
            entity.insert(instrument.suction.unwrap_or_default().suction());
        }
        entity.insert((told, instrument.hand.hand(), port, state));
        rub(&mut entity, instrument.friction);
        if !instrument.exchange.is_empty() {
            entity.insert(Tray(instrument.exchange.iter().map(|kind| kind.kind()).collect()));
        }
        hands.push((instrument.hand.hand(), entity.id(), PortFrame::of(&port).pose(&state)));
    }
    spawn_sutures(world, scene, &hands);
    if let Some(scope) = &scene.endoscope
        && let Some(port) = scene.port(&scope.port)
    {
        let endoscope = Endoscope {
            pose: default(),
            direction_of_view_rad: scope.direction_of_view_deg.to_radians(),
            angle_of_view_rad: scope.angle_of_view_deg.to_radians(),
            roll_rad: 0.0,
            head_roll_rad: 0.0,
        };
        let optics = ScopeOptics {
            distortion: scope.distortion,
            fogs_in_s: scope.fogs_in_s,
            stereo_base_m: scope.stereo_base_mm.map(|base| base * 1e-3),
        };
        SimulationIds::spawn_in(world, (endoscope, optics, port, trocar_state(scope.yaw_deg, scope.pitch_deg, scope.insertion_m)));
    }
}

/// Needles with their threads, in the hands that have them at first. `hands` are the instruments with their poses.
fn spawn_sutures(world: &mut World, scene: &Scene, hands: &[(Hand, Entity, Isometry3d)]) {
    for suture in &scene.sutures {
        let local = suture.transform.isometry();
        let holder = suture.held_by.and_then(|hand| hands.iter().find(|(h, ..)| *h == hand.hand()));
        let (mut needle, thread) = suture.needle(holder.map_or(local, |(.., pose)| *pose * local));
        needle.grips.extend(holder.map(|(_, instrument, _)| NeedleGrip { instrument: *instrument, local }));
        SimulationIds::spawn_in(world, (needle, thread));
    }
}

/// Gives an entity the friction that its scene says, if it says one.
fn rub(entity: &mut EntityWorldMut, friction: Option<f32>) {
    if let Some(coefficient) = friction {
        entity.insert(SurfaceFriction(coefficient));
    }
}

/// Takes everything that [`spawn`] put up, and what came of it, off the whiteboard.
pub fn clear(world: &mut World) {
    let mut scenery =
        world.query_filtered::<Entity, Or<(With<Organ>, With<Anatomy>, With<Port>, With<RigidBody>, With<ClipShape>, With<Thread>)>>();
    let entities: Vec<Entity> = scenery.iter(world).collect();
    for entity in entities {
        world.despawn(entity);
    }
    world.resource_mut::<Messages<TopologyChanged>>().clear();
    world.insert_resource(CutStatus::default());
    world.insert_resource(TissueReport::default());
    world.insert_resource(CollisionReport::default());
    world.insert_resource(RigidReport::default());
    world.insert_resource(ClipReport::default());
    world.insert_resource(BleedReport::default());
    world.insert_resource(GraspReport::default());
    world.insert_resource(SutureReport::default());
    world.insert_resource(TickCost::default());
    world.insert_resource(Script::default());
    world.trigger(SceneCleared);
}

/// Starts the scene over when that was asked for.
pub fn reset(world: &mut World) {
    if world.resource::<SimulationControl>().reset {
        world.resource_mut::<SimulationControl>().reset = false;
        clear(world);
        world.resource_scope(|world, theatre: Mut<Theatre>| spawn(world, &theatre));
    }
}

/// The settings of cutting that a scene asks for.
#[must_use]
pub fn cut_settings(theatre: &Theatre) -> CutSettings {
    theatre.scene.cut.settings()
}

fn trocar_state(yaw_deg: f32, pitch_deg: f32, insertion_m: f32) -> TrocarState {
    TrocarState { yaw_rad: yaw_deg.to_radians(), pitch_rad: pitch_deg.to_radians(), insertion_m, ..default() }
}
