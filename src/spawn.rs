//! From a theatre onto the whiteboard, and off it again.

use crate::theatre::Theatre;
use bevy::prelude::*;
use keyhole_instruments::{Script, ScriptClock, TrocarState, tools};
use keyhole_tissue::{TissueReport, TissueSettings};
use keyhole_whiteboard::{
    Anatomy, CutSettings, CutStatus, Endoscope, Gravity, Instrument, Organ, Port, SimulationControl, TickCost, TissueMesh, TopologyChanged,
};

/// Puts a theatre onto the whiteboard.
pub fn spawn(world: &mut World, theatre: &Theatre) {
    let scene = &theatre.scene;
    let started_s = world.get_resource::<Time<Fixed>>().map_or(0.0, Time::elapsed_secs_f64);
    world.insert_resource(Gravity(Vec3::from_array(scene.gravity)));
    world.insert_resource(scene.requirements());
    world.insert_resource(theatre.script.clone());
    world.insert_resource(ScriptClock { end_s: theatre.script.end_s(), ..default() });
    world.resource_mut::<TissueSettings>().substeps = scene.tissue.substeps;
    for (organ, mesh) in scene.organs.iter().zip(&theatre.meshes) {
        let mut attachments = organ.attachments(mesh);
        for attachment in &mut attachments.0 {
            attachment.until_s += started_s;
        }
        world.spawn((Organ { name: organ.name.clone() }, TissueMesh(mesh.clone()), organ.organ_materials(), attachments));
    }
    for surface in &scene.anatomy {
        let anatomy = Anatomy { name: surface.name.clone(), path: (&surface.path).into(), colour: surface.colour };
        world.spawn((anatomy, Transform::from_isometry(surface.transform.isometry())));
    }
    for instrument in &scene.instruments {
        let Some(port) = scene.port(&instrument.port) else { continue };
        let kind = instrument.kind.kind();
        let told = Instrument {
            kind,
            name: format!("{:?}", instrument.kind),
            shaft_length_m: instrument.shaft_length_m,
            shaft_radius_m: instrument.shaft_radius_m,
        };
        let state = trocar_state(instrument.yaw_deg, instrument.pitch_deg, instrument.insertion_m);
        // What cuts comes first: instruments equip what arrives without it.
        let mut entity = world.spawn_empty();
        if let Some(of_kind) = tools::cutting_line(kind) {
            entity.insert(instrument.cutting_line(of_kind));
        }
        entity.insert((told, instrument.hand.hand(), port, state));
    }
    if let Some(scope) = &scene.endoscope
        && let Some(port) = scene.port(&scope.port)
    {
        let endoscope = Endoscope {
            pose: default(),
            direction_of_view_rad: scope.direction_of_view_deg.to_radians(),
            angle_of_view_rad: scope.angle_of_view_deg.to_radians(),
            roll_rad: 0.0,
        };
        world.spawn((endoscope, port, trocar_state(scope.yaw_deg, scope.pitch_deg, scope.insertion_m)));
    }
}

/// Takes everything that [`spawn`] put up, and what came of it, off the whiteboard.
pub fn clear(world: &mut World) {
    let mut scenery = world.query_filtered::<Entity, Or<(With<Organ>, With<Anatomy>, With<Port>)>>();
    let entities: Vec<Entity> = scenery.iter(world).collect();
    for entity in entities {
        world.despawn(entity);
    }
    world.resource_mut::<Messages<TopologyChanged>>().clear();
    world.insert_resource(CutStatus::default());
    world.insert_resource(TissueReport::default());
    world.insert_resource(TickCost::default());
    world.insert_resource(Script::default());
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
