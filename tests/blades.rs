//! Blades in the running application: a pedal that is let go again and again, two blades at once, and a hook that burns a gap.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod common {
    pub mod cubes;
}

use bevy::prelude::*;
use bevy::time::{TimePlugin, TimeUpdateStrategy};
use common::cubes;
use keyhole_cutting::CuttingPlugin;
use keyhole_tetmesh::TetMesh;
use keyhole_whiteboard::{
    Attachments, Blade, CutSettings, CutStatus, InstrumentPose, Organ, OrganMaterials, SceneRequirements, TickSystems, TissueMesh,
    TissueState, WhiteboardPlugin,
};

/// Edge of the cubes, m.
const EDGE: f32 = 0.004;
const CUBES: [usize; 3] = [6, 4, 4];
/// Ticks that a blade takes through the block.
const TICKS: u32 = 80;

/// A blade through the block along x at this height of z (cubes), which cuts in these ticks.
#[derive(Component)]
struct Way {
    z: f32,
    cuts: fn(u32) -> bool,
}

fn lead_blades(mut tick: Local<u32>, mut blades: Query<(&Way, &mut InstrumentPose, &mut Blade)>) {
    for (way, mut pose, mut blade) in &mut blades {
        let x = -1.0 + 8.0 * *tick as f32 / TICKS as f32;
        pose.before = pose.now;
        pose.now.translation = (Vec3::new(x, 0.0, way.z) * EDGE).into();
        blade.active = (way.cuts)(*tick);
    }
    *tick += 1;
}

/// Tissue that stays where it is.
fn hold_still(mut organs: Query<(&TissueMesh, &mut TissueState)>) {
    for (mesh, mut state) in &mut organs {
        state.positions = mesh.0.rest_positions().iter().map(|p| p.as_vec3()).collect();
        state.velocities = vec![Vec3::ZERO; state.positions.len()];
    }
}

/// Leads blades through the block. Returns the pieces that came free, the strokes, and the volume that is gone, m3.
fn cut(ways: Vec<Way>, kerf_m: f32) -> (u32, u32, f64) {
    let mut app = App::new();
    app.add_plugins((TimePlugin, WhiteboardPlugin, CuttingPlugin))
        .insert_resource(TimeUpdateStrategy::FixedTimesteps(1))
        .insert_resource(SceneRequirements { tissue: true, cutting: true, instruments: true, ..Default::default() })
        .insert_resource(CutSettings::default())
        .add_systems(FixedUpdate, (lead_blades.in_set(TickSystems::Sense), hold_still.in_set(TickSystems::Adopt)));
    // A corner at the origin.
    let mesh = cubes::block(CUBES, |p| p * f64::from(EDGE));
    let volume = |mesh: &TetMesh| mesh.iter().map(|(t, _)| keyhole_tetmesh::quality::volume(mesh.points(t))).sum::<f64>();
    let before = volume(&mesh);
    let world = app.world_mut();
    let organ = Organ { name: "organ".into() };
    world.spawn((organ, TissueMesh(mesh), OrganMaterials::default(), Attachments::default(), TissueState::default()));
    world.run_system_cached(hold_still).unwrap();
    for way in ways {
        let line = Blade { tip: Vec3::new(0.1, -0.5, 0.0) * EDGE, heel: Vec3::new(0.0, 4.5, 0.1) * EDGE, active: false, kerf_m };
        world.spawn((way, InstrumentPose::default(), line));
    }
    for _ in 0..TICKS + 5 {
        app.update();
    }
    let world = app.world_mut();
    let after: f64 = world.query::<&TissueMesh>().iter(world).map(|m| volume(&m.0)).sum();
    let status = world.resource::<CutStatus>();
    (status.fragments, status.strokes, before - after)
}

#[test]
fn a_pedal_that_is_let_go_again_and_again_leaves_no_bridge() {
    for z in [1.3, 2.1, 2.6] {
        let (pieces, strokes, _) = cut(vec![Way { z, cuts: |tick| tick % 9 != 4 }], 0.0);
        assert!(strokes > 4, "the pauses must end strokes, {strokes} ended");
        assert_eq!(pieces, 1, "at z {z}, in {strokes} strokes");
    }
}

#[test]
fn two_blades_at_once_free_two_pieces() {
    let always = |_: u32| true;
    let (pieces, _, gone) = cut(vec![Way { z: 1.2, cuts: always }, Way { z: 2.9, cuts: always }], 0.0);
    assert_eq!(pieces, 2);
    assert!(gone.abs() < 1e-15, "{gone} m3 are gone");
}

#[test]
fn a_hook_takes_its_thickness_along_the_cut() {
    let kerf = 0.1 * EDGE;
    let (pieces, _, gone) = cut(vec![Way { z: 2.1, cuts: |_| true }], kerf);
    let expected = f64::from(kerf) * (CUBES[0] * CUBES[1]) as f64 * f64::from(EDGE).powi(2);
    assert_eq!(pieces, 1);
    assert!((gone / expected - 1.0).abs() < 0.15, "{gone} of {expected} m3");
}
