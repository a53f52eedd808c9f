//! Glue: what is on the whiteboard touches, and its contacts are written there.

use crate::anatomy::SolidSurface;
use crate::contacts::{Party, between_tissue, exempt, part, with_anatomy, with_tool};
use crate::depth::Depths;
use crate::detect::{Body, Detector, Hit};
use crate::folds::Folds;
use crate::fresh::FreshCuts;
use crate::settings::{CollisionSettings, SelfCollision};
use crate::shape::Shape;
use crate::tool::{Motion, ToolPart};
use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_math::Vec3;
use bevy_time::{Fixed, Time};
use keyhole_whiteboard::{
    Blade, Contact, Contacts, CuttingLine, FragmentDetached, FreedFrom, Instrument, InstrumentPose, Jaws, Joint, SceneRequirements,
    StaticSurface, SurfaceFriction, TickSystems, TissueMesh, TissueState, ToolModel, TopologyChanged,
};

/// Writes the contacts of every organ, in [`TickSystems::Collide`].
pub struct CollisionPlugin;

impl Plugin for CollisionPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<CollisionSettings>().init_resource::<Workspace>().add_observer(follow_fragment).add_systems(
            FixedUpdate,
            (adopt_changes, prepare, find_contacts).chain().in_set(TickSystems::Collide).run_if(SceneRequirements::collision),
        );
    }
}

/// What is kept from tick to tick: fresh cuts, and room.
#[derive(Resource, Default)]
struct Workspace {
    fresh: FreshCuts,
    detector: Detector,
    depths: Depths,
    hits: Vec<Hit>,
}

/// The shape of an organ.
#[derive(Component)]
struct OrganShape {
    shape: Shape,
    cut: bool,
    /// What looks for the organ in itself; there once it has been needed.
    folds: Option<Folds>,
}

/// The parts of an instrument that touch tissue.
#[derive(Component)]
struct ToolParts {
    parts: Vec<MovingPart>,
    /// Angle of the jaws one tick ago, rad.
    angle_rad: f32,
}

struct MovingPart {
    part: ToolPart,
    joint: Joint,
    /// Whether tissue gives way to it by being cut, while the blade cuts.
    cuts: bool,
}

/// Solid anatomy with its tree.
#[derive(Component)]
struct SolidAnatomy(SolidSurface);

/// Anatomy whose surface has been looked at, whether it could be used or not.
#[derive(Component)]
struct Seen;

fn follow_fragment(event: On<FragmentDetached>, mut work: ResMut<Workspace>) {
    work.fresh.move_to_fragment(event.donor, event.entity, &event.donor_nodes);
}

fn adopt_changes(
    mut changes: MessageReader<TopologyChanged>,
    mut organs: Query<(&TissueMesh, &mut OrganShape)>,
    mut work: ResMut<Workspace>,
) {
    for TopologyChanged { organ, delta } in changes.read() {
        work.fresh.adopt(*organ, delta);
        if let Ok((mesh, mut known)) = organs.get_mut(*organ) {
            let OrganShape { shape, cut, folds } = &mut *known;
            let touched = shape.update(&mesh.0, delta);
            if let Some(folds) = folds {
                folds.update(&mesh.0, shape, delta, &touched);
            }
            *cut = true;
        }
    }
}

/// Gives everything that is new on the whiteboard what collision needs of it.
fn prepare(
    mut commands: Commands,
    organs: Query<(Entity, &TissueMesh, Has<FreedFrom>), Without<OrganShape>>,
    tools: Query<(Entity, &Instrument, &ToolModel, &Jaws), Without<ToolParts>>,
    surfaces: Query<(Entity, &StaticSurface), Without<Seen>>,
) {
    for (organ, mesh, cut) in &organs {
        commands.entity(organ).insert(OrganShape { shape: Shape::of(&mesh.0), cut, folds: None });
    }
    for (tool, instrument, model, jaws) in &tools {
        commands.entity(tool).insert(ToolParts { parts: tool_parts(instrument, model), angle_rad: jaws.angle_rad });
    }
    for (entity, surface) in &surfaces {
        commands.entity(entity).insert(Seen);
        match SolidSurface::new(surface) {
            Ok(solid) => {
                commands.entity(entity).insert(SolidAnatomy(solid));
            }
            Err(error) => tracing::error!("anatomy {entity} is not solid, tissue passes through it: {error}"),
        }
    }
}

/// The shaft as a capsule, and the hulls of what is ahead of it.
fn tool_parts(instrument: &Instrument, model: &ToolModel) -> Vec<MovingPart> {
    let radius = instrument.shaft_radius_m;
    let shaft = ToolPart::capsule(Vec3::Z * radius, Vec3::Z * instrument.shaft_length_m, radius);
    let ahead = model.parts.iter().filter_map(|p| {
        let points: Vec<Vec3> = p.mesh.vertices.iter().map(|v| Vec3::from_array(*v)).collect();
        // What lies along the shaft is in its capsule.
        points.iter().any(|v| v.z < 0.0).then(|| ToolPart::hull(&points)).flatten().map(|part| MovingPart {
            part,
            joint: p.joint,
            cuts: true,
        })
    });
    std::iter::once(MovingPart { part: shaft, joint: Joint::Fixed, cuts: false }).chain(ahead).collect()
}

fn find_contacts(
    time: Res<Time<Fixed>>,
    settings: Res<CollisionSettings>,
    mut work: ResMut<Workspace>,
    mut organs: Query<(Entity, &TissueMesh, &TissueState, &mut OrganShape, &mut Contacts, Option<&SurfaceFriction>)>,
    mut tools: Query<(Entity, &InstrumentPose, &Jaws, &mut ToolParts, Option<&Blade>, Has<CuttingLine>, Option<&SurfaceFriction>)>,
    anatomy: Query<(Entity, &SolidAnatomy, Option<&SurfaceFriction>)>,
) {
    let dt_s = time.timestep().as_secs_f32();
    let Workspace { fresh, detector, depths, hits } = &mut *work;
    let mut ordered: Vec<_> = organs.iter_mut().collect();
    ordered.sort_unstable_by_key(|o| o.0);
    let mut parties = Vec::with_capacity(ordered.len());
    let mut contacts: Vec<&mut Vec<Contact>> = Vec::with_capacity(ordered.len());
    hits.clear();
    for (organ, mesh, state, known, list, friction) in &mut ordered {
        list.0.clear();
        // An organ whose state has not caught up with its mesh touches nothing.
        if state.positions.len().min(state.velocities.len()) < known.shape.roles().len() {
            continue;
        }
        let OrganShape { shape, cut, folds } = &mut **known;
        let meets_itself = match settings.self_collision {
            SelfCollision::OnceCut => *cut,
            SelfCollision::Always => true,
            SelfCollision::Never => false,
        };
        if meets_itself {
            let folds = folds.get_or_insert_with(|| Folds::of(&mesh.0, shape));
            hits.extend_from_slice(folds.detect(shape, &state.positions, parties.len() as u16));
        }
        parties.push(Party {
            organ: *organ,
            topology: mesh.0.topology(),
            shape,
            positions: &state.positions,
            velocities: &state.velocities,
            friction: friction.map_or(settings.tissue_friction, |f| f.0),
        });
        contacts.push(&mut list.0);
    }
    let bodies: Vec<Body> = parties.iter().map(Party::body).collect();
    hits.extend_from_slice(detector.detect(&bodies, settings.grading));
    hits.sort_unstable_by_key(Hit::key);
    let held = exempt(hits, &parties, fresh);
    part(fresh, &parties, &held);
    between_tissue(hits, &parties, depths, &mut contacts);

    let mut solid: Vec<_> = anatomy.iter().collect();
    solid.sort_unstable_by_key(|s| s.0);
    let mut tools: Vec<_> = tools.iter_mut().collect();
    tools.sort_unstable_by_key(|t| t.0);
    for (party, list) in parties.iter().zip(&mut contacts) {
        for (entity, surface, friction) in &solid {
            let friction = friction.map_or(settings.anatomy_friction, |f| f.0);
            with_anatomy(party, (*entity, &surface.0), friction, settings.anatomy_reach_m, dt_s, list);
        }
        for (entity, pose, jaws, tool, blade, has_edge, friction) in &tools {
            let cutting = *has_edge && blade.is_some_and(|b| b.active);
            let friction = friction.map_or(settings.instrument_friction, |f| f.0);
            for moving in tool.parts.iter().filter(|p| !(p.cuts && cutting)) {
                let from = pose.before * moving.joint.at(tool.angle_rad);
                let motion = Motion { from, to: pose.now * moving.joint.at(jaws.angle_rad), dt_s };
                with_tool(party, (*entity, &moving.part, &motion), friction, settings.tool_near_m, list);
            }
        }
    }
    for (_, _, jaws, tool, ..) in &mut tools {
        tool.angle_rad = jaws.angle_rad;
    }
}
