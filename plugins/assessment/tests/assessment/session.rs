//! A session on the whiteboard: two tools, an endoscope, an organ with a tumour of which a piece comes free.

use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_math::{DVec3, Isometry3d, Quat, Vec3};
use bevy_time::{Fixed, Time, TimePlugin, TimeUpdateStrategy};
use keyhole_assessment::{Assessment, AssessmentPlugin, Clamped, MetricId, Outcome, outcome};
use keyhole_tetmesh::{MaterialId, TetMesh};
use keyhole_whiteboard::{
    BleedReport, Contact, Contacts, Endoscope, FreedFrom, Grasp, Hand, Instrument, InstrumentKind, InstrumentPose, JawPads, Obstacle,
    Organ, OrganMaterial, OrganMaterials, Port, SceneRequirements, SimulationControl, TissueMesh, ToolContacts, Vessel, VesselEnd,
    WhiteboardPlugin,
};

const HZ: f64 = 50.0;

/// Two tetrahedra on either side of the plane x = 0, of 1 x 1 x 1 cm corners; the one with positive x is tumour.
fn two_tets() -> (Vec<DVec3>, [[u32; 4]; 2]) {
    let nodes = [[0, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0], [-1, 0, 0]]
        .map(|[x, y, z]| DVec3::new(f64::from(x), f64::from(y), f64::from(z)) * 0.01);
    (nodes.to_vec(), [[0, 3, 1, 2], [0, 1, 4, 2]])
}

fn materials() -> OrganMaterials {
    OrganMaterials(["kidney", "tumour"].map(|name| OrganMaterial { name: name.into(), ..Default::default() }).to_vec())
}

pub fn theatre(assessed: bool) -> (App, [Entity; 3]) {
    let mut app = App::new();
    app.add_plugins((TimePlugin, WhiteboardPlugin, AssessmentPlugin))
        .insert_resource(Time::<Fixed>::from_hz(HZ))
        .insert_resource(TimeUpdateStrategy::FixedTimesteps(1))
        .insert_resource(SceneRequirements { assessment: assessed, ..Default::default() });
    let world = app.world_mut();
    let (nodes, tets) = two_tets();
    let mesh = TetMesh::new(nodes, &tets, &[MaterialId(1), MaterialId(0)]);
    assert!(mesh.total_volume() > 0.0);
    let organ = world.spawn((Organ { name: "kidney".into() }, TissueMesh(mesh), materials())).id();
    let (near, far) = (VesselEnd::default(), VesselEnd::default());
    world.spawn(Vessel { name: "artery".into(), line: vec![Vec3::ZERO, Vec3::X], radius_m: 0.001, wall_m: 0.0, near, far });
    let tool = |x: f32| {
        let told = Instrument { kind: InstrumentKind::Grasper, name: "grasper".into(), shaft_length_m: 0.33, shaft_radius_m: 0.0025 };
        let pads = JawPads { from_m: 0.005, to_m: 0.015, half_width_m: 0.002, closed_gap_m: 0.0005 };
        (told, pads, Port { position: Vec3::new(x, 0.0, 0.2), inward: Vec3::NEG_Z })
    };
    let right = world.spawn((tool(0.05), Hand::Right)).id();
    let left = world.spawn((tool(-0.05), Hand::Left)).id();
    world.spawn(Endoscope {
        pose: Isometry3d::new(Vec3::new(0.0, 0.0, 0.1), Quat::IDENTITY),
        direction_of_view_rad: 0.0,
        angle_of_view_rad: 1.2,
        roll_rad: 0.0,
        head_roll_rad: 0.0,
    });
    app.update();
    (app, [right, left, organ])
}

/// Ten ticks: the right tool moves 1 mm a tick to the left, pulls the organ with 3 N upwards while the organ is pushed with 4 N aside; in the second half it
/// grips with 7 N. The left one stands still, upright, 4.5 mm from where the right one arrives: their radii are 2.5 mm. 5 ml are lost.
fn perform(app: &mut App, [right, left, organ]: [Entity; 3]) {
    for tick in 0..10 {
        let world = app.world_mut();
        let pose = |x: f32| InstrumentPose { now: Isometry3d::from_translation(Vec3::new(x, 0.0, 0.02)), before: Isometry3d::IDENTITY };
        *world.get_mut::<InstrumentPose>(right).unwrap() = pose(0.009 - 0.001 * tick as f32);
        *world.get_mut::<InstrumentPose>(left).unwrap() = pose(-0.0045);
        world.get_mut::<Port>(right).unwrap().position.x = 0.009 - 0.001 * tick as f32;
        world.get_mut::<Port>(left).unwrap().position.x = -0.0045;
        let holds = tick >= 5;
        *world.get_mut::<Grasp>(right).unwrap() =
            Grasp { points: u32::from(holds), pinch_n: 7.0, pull_n: Vec3::new(0.0, 3.0, 0.0), ..Default::default() };
        let contact = Contact {
            point: std::iter::once((keyhole_tetmesh::NodeId(0), 1.0)).collect(),
            normal: Vec3::Z,
            depth_m: 0.0,
            surface_m: Vec3::ZERO,
            velocity_m_s: Vec3::ZERO,
            friction: 0.0,
            against: Obstacle::Instrument(right),
            force_n: Vec3::new(-4.0, 0.0, 0.0),
        };
        world.get_mut::<Contacts>(organ).unwrap().0 = if holds { vec![contact] } else { Vec::new() };
        world.resource_mut::<BleedReport>().lost_ml = 0.5 * f64::from(tick + 1);
        *world.resource_mut::<Clamped>() = Clamped(Some(tick < 3));
        app.update();
    }
}

/// The tumour comes free.
fn resect(world: &mut World, organ: Entity) {
    let (nodes, tets) = two_tets();
    let whole = world.get::<TissueMesh>(organ).unwrap().0.clone();
    let part = |i: usize| {
        let (tet, _) = whole.iter().nth(i).unwrap();
        TetMesh::from_parts(nodes.clone(), &[(tets[i], whole.tet(tet))])
    };
    world.get_mut::<TissueMesh>(organ).unwrap().0 = part(1);
    world.spawn((Organ { name: "piece".into() }, TissueMesh(part(0)), materials(), FreedFrom { donor: organ, time_s: 0.1 }));
}

pub fn session() -> Outcome {
    let (mut app, entities) = theatre(true);
    perform(&mut app, entities);
    resect(app.world_mut(), entities[2]);
    outcome(app.world_mut()).unwrap()
}

#[test]
fn what_is_on_the_whiteboard_is_measured() {
    let Outcome { results, margin, pieces } = session();
    let near = |metric, hand, expected: f64| {
        let found = results.value(metric, hand).unwrap_or_else(|| panic!("no {metric:?}"));
        assert!((found - expected).abs() < 1e-4 * expected.abs().max(1.0), "{metric:?}: {found} against {expected}");
    };
    let right = Some(Hand::Right);
    near(MetricId::Time, None, 10.0 / HZ);
    near(MetricId::PathLength, right, 9.0);
    near(MetricId::Depth, right, 0.0);
    near(MetricId::Speed, right, 50.0);
    near(MetricId::PathLength, Some(Hand::Left), 0.0);
    near(MetricId::GripMean, right, 7.0);
    near(MetricId::Overload, right, 2.0 * 5.0 / HZ);
    // 4 N against the tool and 3 N of pull at a right angle.
    near(MetricId::TissueForceMax, right, 5.0);
    near(MetricId::TissueForceMean, right, 5.0);
    near(MetricId::ToolCollisions, None, 1.0);
    near(MetricId::BloodLoss, None, 5.0);
    near(MetricId::ClampTime, None, 3.0 / HZ);
    near(MetricId::Horizon, None, 0.0);
    near(MetricId::OutOfView, right, 0.0);
    // A tetrahedron with three edges of 1 cm at right angles is 1/6 ml; the cut goes along the tumour's own face, 50 mm2.
    near(MetricId::TumourLeft, None, 0.0);
    near(MetricId::HealthyRemoved, None, 0.0);
    near(MetricId::Preserved, None, 100.0);
    near(MetricId::CutSurface, None, 50.0);
    near(MetricId::MarginPositive, None, 100.0);
    assert_eq!(results.value(MetricId::GripMax, Some(Hand::Left)), None, "the left one held nothing");
    assert_eq!((pieces.len(), margin.unwrap().vertices.len()), (1, 3));
    assert_eq!(results.margin.unwrap().classes, [1.0]);
}

#[test]
fn a_scene_that_does_not_require_it_is_not_measured() {
    let (mut app, entities) = theatre(false);
    perform(&mut app, entities);
    assert!(outcome(app.world_mut()).is_none());
    assert!(format!("{:?}", app.world().resource::<Assessment>()).contains("None"), "nothing is kept");
}

#[test]
fn a_scene_that_is_started_over_is_a_new_session() {
    let (mut app, entities) = theatre(true);
    perform(&mut app, entities);
    let world = app.world_mut();
    world.insert_resource(keyhole_whiteboard::TickCost::default());
    world.resource_mut::<SimulationControl>().paused = true;
    app.update();
    assert_eq!(outcome(app.world_mut()).unwrap().results.value(MetricId::Time, None), Some(0.0));
    app.world_mut().resource_mut::<SimulationControl>().paused = false;
    perform(&mut app, entities);
    assert_eq!(outcome(app.world_mut()).unwrap().results, session_without_resection());
}

#[test]
fn what_collision_says_of_tools_goes_before_the_distance_of_their_shafts() {
    let count = |touching: fn(Entity, Entity) -> Entity| {
        let (mut app, entities) = theatre(true);
        let [right, left, organ] = entities;
        app.world_mut().entity_mut(right).insert(ToolContacts { touching: vec![touching(left, organ)], ..Default::default() });
        app.world_mut().entity_mut(left).insert(ToolContacts::default());
        perform(&mut app, entities);
        outcome(app.world_mut()).unwrap().results.value(MetricId::ToolCollisions, None)
    };
    assert_eq!(count(|left, _| left), Some(1.0));
    assert_eq!(count(|_, anatomy| anatomy), Some(0.0), "touching anatomy is no collision of tools");
}

fn session_without_resection() -> keyhole_assessment::Results {
    let (mut app, entities) = theatre(true);
    perform(&mut app, entities);
    outcome(app.world_mut()).unwrap().results
}
