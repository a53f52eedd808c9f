//! The plugin in an app, tick by tick.

use crate::meshes::{at_rest, block};
use bevy_app::App;
use bevy_ecs::prelude::*;
use bevy_math::{DVec3, Isometry3d, Vec3};
use bevy_time::{Fixed, Time, TimePlugin, TimeUpdateStrategy};
use keyhole_collision::{CollisionPlugin, CollisionReport, CollisionSettings, SelfCollision};
use keyhole_tetmesh::{NodeId, TetMesh};
use keyhole_whiteboard::{
    Blade, Contact, Contacts, CutTrigger, CuttingLine, Instrument, InstrumentKind, InstrumentPose, Joint, LineShape, Obstacle, Organ,
    PartMesh, Port, SceneRequirements, StaticSurface, SurfaceFriction, TissueMesh, TissueState, ToolContacts, ToolModel, ToolPart,
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

/// A scalpel in an organ: while it cuts the blade touches nothing and the shaft goes on to do so; while it does not both do.
#[test]
fn a_blade_that_cuts_makes_no_contacts_but_its_shaft_does() {
    let mut app = app();
    let organ = organ(&mut app, block([6, 4, 6], [0.06, 0.04, 0.06]), Vec3::ZERO);
    let kind = Instrument { kind: InstrumentKind::Scalpel, name: "scalpel".into(), shaft_length_m: 0.3, shaft_radius_m: 0.0025 };
    let vertices = (0..8).map(|i| [0.001 * (i & 1) as f32, 0.003 * (i >> 1 & 1) as f32, -0.014 * (i >> 2) as f32]).collect();
    let blade =
        ToolPart { name: "blade", mesh: PartMesh { vertices, ..Default::default() }, joint: Joint::Fixed, colour: [1.0; 3], metallic: 1.0 };
    let (tip, heel) = (Vec3::Z * -0.014, Vec3::ZERO);
    let line = CuttingLine { line: LineShape::Edge { tip, heel }, trigger: CutTrigger::Pedal, kerf_m: 0.0 };
    // Along X through the organ's side: the shaft's end is 5 mm inside, the blade further in.
    let at = Isometry3d::new(Vec3::new(0.055, 0.021, 0.029), bevy_math::Quat::from_rotation_y(std::f32::consts::FRAC_PI_2));
    let tool = app.world_mut().spawn((kind, ToolModel { parts: vec![blade] }, line, InstrumentPose { now: at, before: at })).id();
    let mut further_in = |active: bool| {
        app.world_mut().get_mut::<Blade>(tool).unwrap().active = active;
        app.update();
        let list = contacts(&app, organ);
        assert!(list.iter().all(|c| c.against == Obstacle::Instrument(tool)));
        (
            list.len(),
            list.iter().filter(|c| c.surface_m.x < 0.0525 && c.surface_m.x > 0.041 && c.surface_m.y > 0.0 && c.surface_m.y < 0.05).count(),
        )
    };
    let (idle, _) = further_in(false);
    let (cutting, _) = further_in(true);
    assert!(0 < cutting && cutting < idle, "{cutting} contacts while it cuts, {idle} while it does not");
}

/// An instrument comes down on another one and on anatomy: both are listed while near, and a touch that lasts is counted once.
#[test]
fn instruments_that_meet_are_listed_and_counted() {
    let mut app = app();
    organ(&mut app, block([1; 3], [0.01; 3]), Vec3::Y * -1.0);
    let spawn = |app: &mut App, at: Isometry3d| {
        let shaft = Instrument { kind: InstrumentKind::Grasper, name: "grasper".into(), shaft_length_m: 0.3, shaft_radius_m: 0.0025 };
        app.world_mut().spawn((shaft, ToolModel::default(), InstrumentPose { now: at, before: at })).id()
    };
    let high = |y: f32| Isometry3d::from_translation(Vec3::new(0.0, y, -0.15));
    let across = Isometry3d::new(Vec3::new(-0.15, 0.0, 0.0), bevy_math::Quat::from_rotation_y(std::f32::consts::FRAC_PI_2));
    let (moving, still) = (spawn(&mut app, high(0.05)), spawn(&mut app, across));
    let vertices = vec![Vec3::new(-1.0, -0.01, -1.0), Vec3::new(1.0, -0.01, -1.0), Vec3::new(0.0, -0.01, 1.0), Vec3::new(0.0, -0.5, 0.0)];
    let triangles = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
    let wall = app.world_mut().spawn(StaticSurface { vertices, triangles }).id();
    let mut place = |y: f32| {
        let mut pose = app.world_mut().get_mut::<InstrumentPose>(moving).unwrap();
        *pose = InstrumentPose { before: pose.now, now: high(y) };
        app.update();
        let [a, b] = [moving, still].map(|t| app.world().get::<ToolContacts>(t).unwrap().clone());
        assert_eq!(a.touching.contains(&still), b.touching.contains(&moving));
        (a, b.begun)
    };
    let (first, _) = place(0.05);
    assert!(first.near.is_empty() && first.touching.is_empty() && first.begun == 0);
    let (near, _) = place(0.00505);
    assert_eq!((near.touching.clone(), near.begun), (vec![still], 1));
    for _ in 0..3 {
        let (lasting, other) = place(0.00515);
        assert_eq!((lasting.begun, other), (1, 1), "a touch that lasts");
    }
    assert!(place(0.02).0.touching.is_empty());
    // Through the other shaft and into the wall within a tick: it belongs above both.
    let (both, _) = place(-0.02);
    assert_eq!(both.begun, 3);
    for against in [Obstacle::Instrument(still), Obstacle::Anatomy(wall)] {
        let deepest = both.near.iter().filter(|t| t.against == against).map(|t| (t.depth_m, t.normal.y)).max_by(|a, b| a.0.total_cmp(&b.0));
        let expected = if against == Obstacle::Anatomy(wall) { 0.0125 } else { 0.025 };
        assert!(deepest.is_some_and(|(d, up)| (d - expected).abs() < 2e-4 && up > 0.99), "{deepest:?} {against:?}");
    }
}

/// A shaft that runs through a wall touches it, unless its port is there.
#[test]
fn a_shaft_runs_through_the_wall_in_its_port() {
    let mut app = app();
    organ(&mut app, block([1; 3], [0.01; 3]), Vec3::Y * -1.0);
    let vertices = vec![Vec3::new(-1.0, 0.0, -1.0), Vec3::new(1.0, 0.0, -1.0), Vec3::new(0.0, 0.0, 1.0), Vec3::new(0.0, -0.5, 0.0)];
    app.world_mut().spawn(StaticSurface { vertices, triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]] });
    // The tip is 10 cm above the wall, the handle behind it; a little aslant.
    let at = Isometry3d::new(Vec3::Y * 0.1, bevy_math::Quat::from_rotation_x(0.45 * std::f32::consts::PI));
    let along = at.rotation * Vec3::NEG_Z;
    let port = Port { position: Vec3::from(at.translation) - along * (0.1 / along.y), inward: Vec3::Y };
    let shaft = Instrument { kind: InstrumentKind::Grasper, name: "grasper".into(), shaft_length_m: 0.3, shaft_radius_m: 0.0025 };
    let tool = app.world_mut().spawn((shaft, ToolModel::default(), InstrumentPose { now: at, before: at })).id();
    let mut near = |port: Option<Port>| {
        if let Some(port) = port {
            app.world_mut().entity_mut(tool).insert(port);
        }
        app.update();
        app.world().get::<ToolContacts>(tool).unwrap().near.len()
    };
    assert!(near(None) > 0);
    assert_eq!(near(Some(port)), 0);
}

/// A node that was torn through its own body once came out at the far side, as a contact centimetres deep that stretched a piece to four times its length.
#[test]
fn a_node_deep_in_its_own_body_is_not_in_contact_with_it() {
    let mut app = app();
    app.insert_resource(CollisionSettings { self_collision: SelfCollision::Always, ..Default::default() });
    let mesh = block([8; 3], [0.04; 3]);
    let on_face = mesh.nodes().find(|n| mesh.rest(*n).distance(DVec3::new(0.02, 0.02, 0.0)) < 1e-6).unwrap();
    let body = organ(&mut app, mesh, Vec3::ZERO);
    let mut own = |depth_m: f32| {
        app.world_mut().get_mut::<TissueState>(body).unwrap().positions[on_face.index()].z = depth_m;
        app.update();
        contacts(&app, body).iter().filter(|c| matches!(c.against, Obstacle::Own(_))).map(|c| c.depth_m).fold(0.0, f32::max)
    };
    let deepest = (1..40).map(|mm| own(mm as f32 * 1e-3)).fold(0.0, f32::max);
    assert!(deepest > 0.0 && deepest < 0.0125, "{deepest} m of a mesh with edges of 6 mm");
}

/// Three organs of which one moves, on a bed and with a shaft that comes and goes. Each tick all organs are said to have moved in one app, and only the one that
/// has in the other: the contacts are the same to the bit and in the same order, and less was looked at.
#[test]
fn what_has_not_moved_touches_what_it_did_and_is_not_looked_at() {
    let scene = || {
        let mut app = app();
        app.world_mut().resource_mut::<CollisionSettings>().self_collision = SelfCollision::Always;
        let sizes = [([4; 3], 0.04, Vec3::ZERO), ([3; 3], 0.025, Vec3::new(0.0071, 0.0385, 0.0083)), ([2; 3], 0.02, Vec3::X * 0.2)];
        let organs = sizes.map(|(cells, side, shift)| organ(&mut app, block(cells, [side; 3]), shift));
        // One corner of the lower block is folded into it.
        let mut folded = app.world_mut().get_mut::<TissueState>(organs[0]).unwrap();
        let last = folded.positions.len() - 1;
        folded.positions[last] = Vec3::new(0.024, 0.027, 0.025);
        let [low, high] = [Vec3::new(-0.1, -0.02, -0.1), Vec3::new(0.3, 0.0005, 0.1)];
        let vertices = (0..8).map(|i| Vec3::new([low.x, high.x][i & 1], [low.y, high.y][i >> 1 & 1], [low.z, high.z][i >> 2])).collect();
        let triangles = [
            [0, 2, 3],
            [0, 3, 1],
            [4, 5, 7],
            [4, 7, 6],
            [0, 1, 5],
            [0, 5, 4],
            [2, 6, 7],
            [2, 7, 3],
            [0, 4, 6],
            [0, 6, 2],
            [1, 3, 7],
            [1, 7, 5],
        ];
        app.world_mut().spawn(StaticSurface { vertices, triangles: triangles.into() });
        let shaft = Instrument { kind: InstrumentKind::Grasper, name: "grasper".into(), shaft_length_m: 0.3, shaft_radius_m: 0.0025 };
        let tool = app.world_mut().spawn((shaft, ToolModel::default(), InstrumentPose::default())).id();
        (app, organs, tool)
    };
    let run = |all_move: bool| {
        let (mut app, organs, tool) = scene();
        let mut lists = Vec::new();
        for tick in 0..12_u8 {
            let at = |tick: u8| Isometry3d::from_translation(Vec3::new(0.02, 0.09 - 0.006 * f32::from(tick), -0.1));
            *app.world_mut().get_mut::<InstrumentPose>(tool).unwrap() = InstrumentPose { now: at(tick + 1), before: at(tick) };
            for (i, organ) in organs.into_iter().enumerate() {
                let mut state = app.world_mut().get_mut::<TissueState>(organ).unwrap();
                if i == 1 {
                    state.positions.iter_mut().for_each(|x| x.y -= 1e-4);
                } else if all_move {
                    state.set_changed();
                }
            }
            if tick == 8 {
                app.world_mut().entity_mut(organs[2]).insert(SurfaceFriction(0.7));
            }
            app.update();
            lists.push(organs.map(|organ| contacts(&app, organ).to_vec()));
        }
        (lists, *app.world().resource::<CollisionReport>())
    };
    let ((lists, all), (others, few)) = (run(true), run(false));
    assert_eq!(lists, others);
    let against = |of: fn(&Obstacle) -> bool| lists.iter().flatten().flatten().any(|c| of(&c.against));
    assert!(against(|o| matches!(o, Obstacle::Own(_))) && against(|o| matches!(o, Obstacle::Anatomy(_))));
    assert!(against(|o| matches!(o, Obstacle::Instrument(_))) && against(|o| matches!(o, Obstacle::Organ { .. })));
    assert!(lists[7][2] != lists[8][2], "another friction");
    assert!(all.at_rest == 0 && few.at_rest >= 16 && few.nodes < all.nodes / 2 && 3 * few.faces < 2 * all.faces, "{all:?} {few:?}");
}
