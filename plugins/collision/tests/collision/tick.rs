//! The plugin in an app, tick by tick.

use crate::meshes::{at_rest, block};
use bevy_app::App;
use bevy_ecs::prelude::*;
use bevy_math::{Isometry3d, Vec3};
use bevy_time::{Fixed, Time, TimePlugin, TimeUpdateStrategy};
use keyhole_collision::CollisionPlugin;
use keyhole_tetmesh::{NodeId, TetMesh};
use keyhole_whiteboard::{
    Contact, Contacts, Instrument, InstrumentKind, InstrumentPose, Obstacle, Organ, SceneRequirements, TissueMesh, TissueState, ToolModel,
    TopologyChanged, WhiteboardPlugin,
};

fn app() -> App {
    let mut app = App::new();
    app.add_plugins((TimePlugin, WhiteboardPlugin, CollisionPlugin));
    app.insert_resource(TimeUpdateStrategy::FixedTimesteps(1));
    app.insert_resource(Time::<Fixed>::from_hz(60.0));
    app.insert_resource(SceneRequirements { tissue: true, collision: true, ..Default::default() });
    // The first update only starts the clocks.
    app.update();
    app
}

fn organ(app: &mut App, mesh: TetMesh, shift: Vec3) -> Entity {
    let mut state = TissueState::at_rest(&mesh);
    state.positions.iter_mut().for_each(|x| *x += shift);
    app.world_mut().spawn((Organ { name: "block".into() }, TissueMesh(mesh), state)).id()
}

fn contacts(app: &App, organ: Entity) -> &[Contact] {
    &app.world().get::<Contacts>(organ).unwrap().0
}

#[test]
fn two_organs_list_each_contact_from_both_sides() {
    let mut app = app();
    let lower = organ(&mut app, block([4; 3], [0.04; 3]), Vec3::ZERO);
    let upper = organ(&mut app, block([3; 3], [0.025; 3]), Vec3::new(0.0071, 0.0385, 0.0083));
    app.update();
    let (from_below, from_above) = (contacts(&app, lower), contacts(&app, upper));
    assert!(from_above.len() >= 16 && from_above.len() == from_below.len(), "{} {}", from_above.len(), from_below.len());
    for c in from_above {
        let Obstacle::Organ { organ, point } = &c.against else { panic!("{c:?}") };
        let back = |d: &&Contact| d.against == (Obstacle::Organ { organ: upper, point: c.point.clone() }) && d.point == *point;
        let mirror = from_below.iter().find(back).unwrap();
        assert_eq!((*organ, mirror.normal, mirror.depth_m), (lower, -c.normal, c.depth_m));
    }
    app.insert_resource(SceneRequirements { tissue: true, ..Default::default() });
    app.world_mut().get_mut::<Contacts>(upper).unwrap().0.clear();
    app.update();
    assert!(contacts(&app, upper).is_empty(), "where a scene needs no collision nothing looks");
}

#[test]
fn an_instrument_touches_where_it_is_and_an_open_organ_nothing_else() {
    let mut app = app();
    let organ = organ(&mut app, block([6, 1, 6], [0.06, 0.01, 0.06]), Vec3::ZERO);
    let shaft = Instrument { kind: InstrumentKind::Grasper, name: "grasper".into(), shaft_length_m: 0.3, shaft_radius_m: 0.0025 };
    // The shaft lies across the organ, 0.4 mm deep in it.
    let at = Isometry3d::from_translation(Vec3::new(0.031, 0.0121, -0.1));
    let tool = app.world_mut().spawn((shaft, ToolModel::default(), InstrumentPose { now: at, before: at })).id();
    app.update();
    assert!(!contacts(&app, organ).is_empty());
    assert!(contacts(&app, organ).iter().all(|c| c.against == Obstacle::Instrument(tool) && c.normal.y < -0.7));
    let deepest = contacts(&app, organ).iter().map(|c| c.depth_m).max_by(f32::total_cmp).unwrap();
    assert!((deepest - 0.0004).abs() < 2e-5, "{deepest}");
}

/// A block is cut in two halves that stay one organ. Pressed into each other they are let be, until they have parted once.
#[test]
fn the_faces_of_a_fresh_cut_do_not_collide_until_they_have_parted() {
    let mut app = app();
    let mesh = block([4, 2, 2], [0.04, 0.02, 0.02]);
    let organ = organ(&mut app, mesh.clone(), Vec3::ZERO);
    app.update();

    let mut mesh = mesh;
    let right = |n: NodeId, x: f64| n.index() < 45 && x > 0.02 - 1e-9;
    let on_cut: Vec<NodeId> = mesh.nodes().filter(|n| (mesh.rest(*n).x - 0.02).abs() < 1e-9).collect();
    let twins: Vec<(NodeId, NodeId)> = on_cut.iter().map(|n| (*n, mesh.split_node(*n))).collect();
    let old: Vec<_> = mesh.iter().filter(|(t, _)| mesh.points(*t).iter().all(|p| p.x > 0.02 - 1e-9)).collect();
    for (tet, nodes) in old {
        let attributes = mesh.tet(tet);
        mesh.remove_tet(tet);
        mesh.add_tet(nodes.map(|n| twins.iter().find(|(a, _)| *a == n).map_or(n, |(_, b)| *b)), attributes);
    }
    let delta = mesh.take_delta();
    let rest = at_rest(&mesh);
    let is_right = |n: usize| {
        twins.iter().any(|(_, b)| b.index() == n) || (right(NodeId(n as u32), f64::from(rest[n].x)) && !on_cut.contains(&NodeId(n as u32)))
    };
    let moved = |x: f32| -> Vec<Vec3> { (0..rest.len()).map(|n| if is_right(n) { rest[n] + Vec3::X * x } else { rest[n] }).collect() };
    let mut place = |x: f32| {
        let state = TissueState { positions: moved(x), velocities: vec![Vec3::ZERO; rest.len()] };
        app.world_mut().entity_mut(organ).insert((TissueMesh(mesh.clone()), state));
        if x == 0.0 {
            app.world_mut().write_message(TopologyChanged { organ, delta: delta.clone() });
        }
        app.update();
        contacts(&app, organ).to_vec()
    };
    assert_eq!([place(0.0).len(), place(-0.0004).len(), place(0.0002).len(), place(-0.0004).len()], [0; 4], "in each other from the first");
    assert!(place(0.004).is_empty(), "apart");
    let found = place(-0.0004);
    // Shifted along the face's normal alone, nodes come to lie on edges and faces of the other half, and some of these are missed by rounding.
    assert!(found.len() >= 9, "{} contacts", found.len());
    for c in found {
        let Obstacle::Own(_) = c.against else { panic!("{c:?}") };
        assert!(c.normal.x.abs() > 0.99 && (c.depth_m - 0.0004).abs() < 2e-5, "{c:?}");
    }
}
