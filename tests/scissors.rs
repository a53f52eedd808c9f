//! Scissors in tissue: what opens is the wedge between their blades, however fast they close, and a strand between them is cut through.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod common {
    pub mod cubes;
}

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy::time::{TimePlugin, TimeUpdateStrategy};
use common::cubes;
use keyhole_cutting::CuttingPlugin;
use keyhole_instruments::tools::{SCISSORS_JAW_M, widest_angle_rad};
use keyhole_instruments::{HandKey, HandTrack, InstrumentsPlugin, Script, TrocarState};
use keyhole_tetmesh::{Boundary, TetMesh};
use keyhole_whiteboard::{
    Attachments, CutSettings, CutStatus, Hand, Instrument, InstrumentKind, Organ, OrganMaterials, Port, SceneRequirements,
    SimulationControl, TickSystems, TissueMesh, TissueState, WhiteboardPlugin,
};

/// Edge of the cubes, m.
const EDGE: f64 = 0.0015;

/// A block of cubes, the middle of its near side `ahead` m in front of the scissors' pivot, which is at the origin with the shaft along -Z.
fn block(counts: [usize; 3], ahead: f64) -> TetMesh {
    let [nx, ny, nz] = counts.map(|n| n as f64);
    // A little off the middle: the line runs through no node.
    let corner = DVec3::new(-0.5 * nx + 0.2, -0.5 * ny + 0.3, -nz) * EDGE - DVec3::Z * ahead;
    cubes::block(counts, |p| corner + p * EDGE)
}

fn boundary_area(mesh: &TetMesh) -> f64 {
    let area = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).length() / 2.0;
    Boundary::of(mesh).triangles.iter().map(|t| area(t.map(|n| mesh.rest(n)))).sum()
}

/// Tissue that stays where it is.
fn hold_still(mut organs: Query<(&TissueMesh, &mut TissueState)>) {
    for (mesh, mut state) in &mut organs {
        state.positions = mesh.0.rest_positions().iter().map(|p| p.as_vec3()).collect();
        state.velocities = vec![Vec3::ZERO; state.positions.len()];
    }
}

/// Area of one side of what opens when the scissors close in `ticks` ticks, m2, and the fragments that come free.
fn close(mesh: &TetMesh, ticks: u32) -> (f64, u64) {
    let mut app = App::new();
    app.add_plugins((TimePlugin, WhiteboardPlugin, InstrumentsPlugin, CuttingPlugin))
        .insert_resource(TimeUpdateStrategy::FixedTimesteps(1))
        .insert_resource(SceneRequirements { tissue: true, cutting: true, instruments: true, ..Default::default() })
        .insert_resource(CutSettings::default())
        .add_systems(FixedUpdate, hold_still.in_set(TickSystems::Adopt));
    let tick_s = app.world().resource::<Time<Fixed>>().timestep().as_secs_f64();
    let key = |tick: u32, grip| HandKey {
        time_s: tick_s * (f64::from(tick) + 0.5),
        tip: Vec3::new(0.0, 0.0, -SCISSORS_JAW_M),
        roll_rad: 0.0,
        grip,
        active: false,
    };
    let keys = vec![key(4, 0.0), key(4 + ticks, 1.0), key(12 + ticks, 1.0)];
    app.insert_resource(Script::new(vec![HandTrack { hand: Hand::Right, keys }], Vec::new()).unwrap());
    app.world_mut().resource_mut::<SimulationControl>().demonstration = true;
    let state = TissueState::default();
    let organ = (Organ { name: "organ".into() }, TissueMesh(mesh.clone()), OrganMaterials::default(), Attachments::default(), state);
    let world = app.world_mut();
    world.spawn(organ);
    world.run_system_cached(hold_still).unwrap();
    let scissors = Instrument { kind: InstrumentKind::Scissors, name: "scissors".into(), shaft_length_m: 0.33, shaft_radius_m: 0.0025 };
    let port = Port { position: Vec3::new(0.0, 0.0, 0.1), inward: Vec3::NEG_Z };
    world.spawn((scissors, Hand::Right, port, TrocarState { insertion_m: 0.1, ..default() }));
    for _ in 0..20 + ticks {
        app.update();
    }
    let world = app.world_mut();
    let after: f64 = world.query::<&TissueMesh>().iter(world).map(|m| boundary_area(&m.0)).sum();
    ((after - boundary_area(mesh)) / 2.0, world.resource::<CutStatus>().fragments.into())
}

/// A sheet of tissue with the crotch in front of its edge: the wedge grows until it is as high as the sheet is thick.
#[test]
fn what_opens_is_the_wedge_between_the_blades_at_any_pace() {
    let (thick, ahead) = (4.0 * EDGE, 0.004);
    let mesh = block([6, 4, 20], ahead);
    let open = f64::from(widest_angle_rad(InstrumentKind::Scissors));
    let (slope, end) = (2.0 * open.tan(), f64::from(SCISSORS_JAW_M) * open.cos());
    // The triangle up to where it is as high as the sheet, without what is before the edge, and a strip from there on.
    let full = thick / slope;
    let expected = 0.5 * slope * (full * full - ahead * ahead) + thick * (end - full);
    for ticks in [1, 12, 60] {
        let (opened, fragments) = close(&mesh, ticks);
        println!("in {ticks} ticks: {:.1} mm2 opened of {:.1}", 1e6 * opened, 1e6 * expected);
        // The last row of tetrahedra that the tips reach into opens or not.
        assert!((opened - expected).abs() < 0.75 * EDGE * thick, "{opened} against {expected} m2");
        assert_eq!(fragments, 0);
    }
}

#[test]
fn a_strand_between_the_blades_is_cut_through() {
    for ticks in [1, 12, 60] {
        let (opened, fragments) = close(&block([12, 4, 4], 0.008), ticks);
        let section = 16.0 * EDGE * EDGE;
        assert!((opened - section).abs() < 1e-6 * section, "{opened} against {section} m2 in {ticks} ticks");
        assert_eq!(fragments, 1);
    }
}
