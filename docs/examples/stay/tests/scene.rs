//! The gesture in a scene: an organ on a spring in place of tissue, so that every force is known, and an instrument.

use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_math::{DVec3, Isometry3d, Vec3};
use bevy_time::{Fixed, Time, TimePlugin, TimeUpdateStrategy};
use keyhole_tetmesh::TetMesh;
use keyhole_whiteboard::{
    Anchor, Attachments, InstrumentPose, Jaws, Organ, SceneRequirements, TickSystems, TissueMesh, TissueState, WhiteboardPlugin,
};
use stay::{StayApplier, StayPlugin, StaySettings, Stays};

/// Stiffness of the spring, N/m, and where it pulls the organ to, m above its rest.
#[derive(Resource)]
struct Spring {
    stiffness: f32,
    home: f32,
}

/// The organ moves as a whole, up and down, to where its spring and its attachments are in balance.
fn settle(mut organs: Query<(&TissueMesh, &mut TissueState, &mut Attachments)>, spring: Res<Spring>, time: Res<Time<Fixed>>) {
    for (mesh, mut state, mut attachments) in &mut organs {
        attachments.expire(time.elapsed_secs_f64());
        let (mut pull, mut stiffness) = (spring.stiffness * spring.home, spring.stiffness);
        for held in &attachments.0 {
            let Anchor::Space(place) = held.anchor else { continue };
            let rest: f32 = held.point.iter().map(|(node, weight)| mesh.0.rest(*node).y as f32 * weight).sum();
            pull += (place.y - rest) / held.compliance_m_n;
            stiffness += 1.0 / held.compliance_m_n;
        }
        let moved = pull / stiffness;
        for (place, rest) in state.positions.iter_mut().zip(mesh.0.rest_positions()) {
            *place = rest.as_vec3() + moved * Vec3::Y;
        }
    }
}

/// A tetrahedron of 4 cm, an instrument with its tip in it, and one tick.
fn scene() -> (App, Entity, Entity) {
    let mut app = App::new();
    app.add_plugins((TimePlugin, WhiteboardPlugin))
        .insert_resource(Time::<Fixed>::from_hz(60.0))
        .insert_resource(TimeUpdateStrategy::FixedTimesteps(1))
        .insert_resource(SceneRequirements { tissue: true, instruments: true, ..Default::default() })
        .insert_resource(Spring { stiffness: 100.0, home: 0.0 })
        .add_systems(FixedUpdate, settle.in_set(TickSystems::Tissue));
    let corners = [[0.0, 0.0, 0.0], [0.04, 0.0, 0.0], [0.0, 0.04, 0.0], [0.0, 0.0, 0.04]].map(DVec3::from_array);
    let mesh = TetMesh::new(corners.to_vec(), &[[0, 1, 2, 3]], &[]);
    let organ = app.world_mut().spawn((Organ { name: "organ".into() }, TissueState::at_rest(&mesh), TissueMesh(mesh))).id();
    // The shaft along Z: its tip is 2 cm ahead of the pivot.
    let pose = Isometry3d::from_xyz(0.01, 0.012, 0.03);
    let applier = StayApplier { length_m: 0.02, closed_rad: 0.05, was_closed: false };
    let tool = app.world_mut().spawn((InstrumentPose { now: pose, before: pose }, Jaws { angle_rad: 0.5 }, applier)).id();
    // As in an app that is there already, with its scene.
    app.add_plugins(StayPlugin);
    app.update();
    (app, organ, tool)
}

fn close(app: &mut App, tool: Entity) {
    for angle_rad in [0.5, 0.0, 0.5] {
        app.world_mut().get_mut::<Jaws>(tool).expect("an instrument").angle_rad = angle_rad;
        app.update();
    }
}

fn lift(app: &mut App, home: f32) {
    app.world_mut().resource_mut::<Spring>().home = home;
    for _ in 0..3 {
        app.update();
    }
}

fn height(app: &App, organ: Entity) -> f32 {
    app.world().get::<TissueState>(organ).expect("an organ").positions[0].y
}

fn stays(app: &App, organ: Entity) -> usize {
    app.world().get::<Stays>(organ).expect("an organ").0.len()
}

#[test]
fn what_has_been_lifted_stays_until_it_is_taken_off() {
    let (mut app, organ, tool) = scene();
    lift(&mut app, 0.005);
    assert!((height(&app, organ) - 0.005).abs() < 1e-6);
    close(&mut app, tool);
    assert_eq!(stays(&app, organ), 1);
    // What lifted it lets go: the stay and the organ's own spring share the 5 mm.
    lift(&mut app, 0.0);
    let stiffness = 1.0 / StaySettings::default().compliance_m_n;
    let expected = 0.005 * stiffness / (stiffness + 100.0);
    assert!((height(&app, organ) - expected).abs() < 1e-6, "{} m, not {expected} m", height(&app, organ));
    let force = app.world().get::<Stays>(organ).expect("an organ").0[0].force_n;
    assert!((force.y - 100.0 * expected).abs() < 1e-3, "{force} N");
    // Closed there once more, it comes off, and the organ goes back.
    close(&mut app, tool);
    assert_eq!(stays(&app, organ), 0);
    lift(&mut app, 0.0);
    assert!(height(&app, organ).abs() < 1e-6);
}

#[test]
fn a_stay_pulls_out_beyond_its_strength() {
    let (mut app, organ, tool) = scene();
    close(&mut app, tool);
    lift(&mut app, -0.019);
    assert_eq!(stays(&app, organ), 1, "1.8 N are less than two");
    lift(&mut app, -0.023);
    assert_eq!(stays(&app, organ), 0, "2.2 N are more than two");
}

#[test]
fn jaws_that_close_on_nothing_put_on_nothing() {
    let (mut app, organ, tool) = scene();
    let away = Isometry3d::from_xyz(0.1, 0.1, 0.1);
    app.world_mut().entity_mut(tool).insert(InstrumentPose { now: away, before: away });
    close(&mut app, tool);
    assert_eq!(stays(&app, organ), 0);
}
