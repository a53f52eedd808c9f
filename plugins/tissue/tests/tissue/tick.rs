//! The plugin in an app, tick by tick.

use crate::common::separate;
use bevy_app::App;
use bevy_ecs::prelude::*;
use bevy_math::{Isometry3d, Quat, Vec3};
use bevy_time::{Fixed, Time, TimePlugin, TimeUpdateStrategy};
use keyhole_tetmesh::{NodeId, TetMesh};
use keyhole_tissue::beam::{GRAVITY, beam, beam_material, block};
use keyhole_tissue::reference::unloaded;
use keyhole_tissue::{Quarantined, TissueBody, TissuePlugin, TissueReport, TissueSettings};
use keyhole_whiteboard::{
    Anchor, Attachment, Attachments, FragmentDetached, FreedFrom, Gravity, InstrumentPose, Organ, SceneRequirements, TissueMesh,
    TissueState, TopologyChanged, WhiteboardPlugin,
};
use smallvec::smallvec;

fn app() -> App {
    let mut app = App::new();
    app.add_plugins((TimePlugin, WhiteboardPlugin, TissuePlugin));
    app.insert_resource(TimeUpdateStrategy::FixedTimesteps(1));
    app.insert_resource(Time::<Fixed>::from_hz(60.0));
    app.insert_resource(SceneRequirements { tissue: true, ..Default::default() });
    // The first update only starts the clocks.
    app.update();
    app
}

fn organ(app: &mut App, mesh: TetMesh) -> Entity {
    app.world_mut().spawn((Organ { name: "beam".into() }, beam_material(), TissueMesh(mesh))).id()
}

fn positions(app: &App, organ: Entity) -> Vec<Vec3> {
    app.world().get::<TissueState>(organ).unwrap().positions.clone()
}

/// An organ that has only a mesh is stepped in its first tick; without tissue in the scene nothing is allocated.
#[test]
fn an_organ_gets_its_body_before_its_first_tick() {
    let mut app = app();
    let mesh = block([2, 2, 2], [0.02, 0.02, 0.02]);
    let organ = organ(&mut app, mesh.clone());
    app.insert_resource(SceneRequirements::default());
    app.update();
    assert!(app.world().get::<TissueBody>(organ).is_none());
    app.insert_resource(SceneRequirements { tissue: true, ..Default::default() });
    app.update();
    let fallen = positions(&app, organ)[0].y;
    assert!(fallen < 0.0 && fallen > -0.01, "{fallen} m after one tick");
}

/// A node held to an instrument without compliance goes where the instrument goes.
#[test]
fn an_instrument_takes_its_node_along() {
    let mut app = app();
    let organ = organ(&mut app, block([2, 2, 2], [0.02, 0.02, 0.02]));
    let from = Isometry3d::from_translation(Vec3::new(0.0, 0.0, 0.01));
    let to = Isometry3d::new(Vec3::new(0.0, 0.005, 0.01), Quat::from_rotation_y(0.3));
    let tool = app.world_mut().spawn(InstrumentPose { now: to, before: from }).id();
    let local = Vec3::new(0.0, 0.0, -0.01);
    let attachment = Attachment {
        point: smallvec![(NodeId(0), 1.0)],
        anchor: Anchor::Tool { instrument: tool, local },
        compliance_m_n: 0.0,
        until_s: f64::INFINITY,
    };
    app.world_mut().entity_mut(organ).insert(Attachments(vec![attachment]));
    app.update();
    let expected = Vec3::from(to.transform_point(local));
    assert!((positions(&app, organ)[0] - expected).length() < 1e-6, "{}", positions(&app, organ)[0]);
}

/// A beam is cut in two while it falls, and its end becomes an organ in the same tick: positions, momentum and attachments go with it.
#[test]
fn a_fragment_inherits_its_share() {
    let mut app = app();
    app.insert_resource(Gravity(Vec3::ZERO));
    app.insert_resource(TissueSettings { drag_1_s: 0.0, ..Default::default() });
    let donor = organ(&mut app, beam(6, 3));
    app.update();
    for (i, v) in app.world_mut().get_mut::<TissueState>(donor).unwrap().velocities.iter_mut().enumerate() {
        *v = Vec3::new(0.1, 0.02 * (i % 7) as f32, -0.3);
    }
    let momentum = |app: &App, organ: Entity| {
        app.world().get::<TissueBody>(organ).unwrap().body.momentum(app.world().get::<TissueState>(organ).unwrap())
    };
    let before = momentum(&app, donor);

    let mut mesh = app.world().get::<TissueMesh>(donor).unwrap().0.clone();
    separate(&mut mesh, 0.03);
    let end: Vec<_> = mesh.iter().filter(|(t, _)| mesh.points(*t).iter().map(|p| p.x).sum::<f64>() / 4.0 > 0.03).collect();
    let mut donor_nodes: Vec<NodeId> = end.iter().flat_map(|(_, c)| *c).collect();
    donor_nodes.sort_unstable();
    donor_nodes.dedup();
    let own = |n: NodeId| donor_nodes.binary_search(&n).unwrap() as u32;
    let tets: Vec<[u32; 4]> = end.iter().map(|(_, c)| c.map(own)).collect();
    let piece = TetMesh::new(donor_nodes.iter().map(|n| mesh.rest(*n)).collect(), &tets, &[]);
    for (t, _) in &end {
        mesh.remove_tet(*t);
    }
    for n in &donor_nodes {
        mesh.remove_node(*n);
    }
    let delta = mesh.take_delta();
    // A face of the piece: what is held at less is not held.
    let held: Vec<NodeId> = end[0].1[..3].to_vec();
    let kept = NodeId(0);
    let at = |n: NodeId| Attachment::node_to_space(n, Vec3::ZERO, 1e6);
    app.world_mut().entity_mut(donor).insert((TissueMesh(mesh), Attachments([kept].into_iter().chain(held).map(at).collect())));
    let fragment = organ(&mut app, piece);
    app.world_mut().write_message(TopologyChanged { organ: donor, delta });
    // Cutting does this within the tick; the body of the fragment must not exist before.
    let cut = move |mut commands: Commands, mut done: Local<bool>| {
        if !*done {
            commands.trigger(FragmentDetached { entity: fragment, donor, donor_nodes: donor_nodes.clone() });
            *done = true;
        }
    };
    app.add_systems(bevy_app::FixedUpdate, cut.in_set(keyhole_whiteboard::TickSystems::Cut));
    app.update();

    let (rest, piece) = (momentum(&app, donor), momentum(&app, fragment));
    assert!(((rest.mass + piece.mass) / before.mass - 1.0).abs() < 1e-6);
    let after = rest.linear + piece.linear;
    // The adoption itself is exact, see below; conjugate gradients of an attached body lose a little.
    assert!((after - before.linear).length() < 1e-3 * before.scale, "{after} from {}", before.linear);
    assert_eq!(app.world().get::<Attachments>(donor).unwrap().0.len(), 1);
    let inherited = &app.world().get::<Attachments>(fragment).unwrap().0;
    assert_eq!(inherited.len(), 3);
    let rest_of = |n: NodeId| app.world().get::<TissueMesh>(fragment).unwrap().0.rest(n).as_vec3();
    for node in inherited.iter().map(|a| a.point[0].0) {
        assert!(positions(&app, fragment)[node.index()].distance(rest_of(node)) < 0.02);
    }
    let report = app.world().resource::<TissueReport>();
    assert_eq!(report.adoptions, 1);
    assert!(report.momentum_error < 1e-6, "{report:?}");
}

/// An organ that leaves the finite numbers is put back and frozen; the others go on.
#[test]
fn one_broken_organ_does_not_stop_the_others() {
    let mut app = app();
    let broken = organ(&mut app, block([2, 2, 2], [0.02, 0.02, 0.02]));
    let sound = organ(&mut app, block([2, 2, 2], [0.02, 0.02, 0.02]));
    app.update();
    let last = positions(&app, broken);
    app.world_mut().get_mut::<TissueState>(broken).unwrap().positions[3] = Vec3::NAN;
    app.update();
    let before = positions(&app, sound)[0].y;
    app.update();
    assert_eq!(positions(&app, broken), last);
    assert_eq!(app.world().get::<Quarantined>(broken).unwrap().node, NodeId(3));
    assert_eq!(app.world().resource::<TissueReport>().quarantined, vec![broken]);
    assert!(positions(&app, sound)[0].y < before);
}

/// An organ whose rest shape is the one that hangs as it was scanned stays where it is when the app starts: it moves by less than a hundredth of the sag of one whose scan is
/// taken for its rest shape.
#[test]
fn a_prestressed_organ_stays_where_it_was_scanned() {
    let scan = beam(6, 3);
    let held = |n: NodeId| scan.rest(n).x == 0.0;
    let found = unloaded(&scan, &beam_material(), held, GRAVITY.as_dvec3(), 1e-3, 30).unwrap();
    let mut unloaded = scan.clone();
    for n in scan.nodes() {
        unloaded.move_node(n, found.rest[n.index()], std::iter::once((n, 1.0)).collect());
    }
    unloaded.take_delta();
    let moved = |mesh: TetMesh| {
        let mut app = app();
        app.insert_resource(Gravity(GRAVITY));
        let clamp = scan.nodes().filter(|n| held(*n)).map(|n| Attachment::node_to_space(n, scan.rest(n).as_vec3(), 0.0)).collect();
        let start = TissueState::at_rest(&scan);
        let parts = (Organ { name: "beam".into() }, beam_material(), TissueMesh(mesh), start.clone(), Attachments(clamp));
        let organ = app.world_mut().spawn(parts).id();
        let mut furthest = 0.0_f32;
        for _ in 0..60 {
            app.update();
            let now = positions(&app, organ);
            furthest = now.iter().zip(&start.positions).map(|(x, s)| x.distance(*s)).fold(furthest, f32::max);
        }
        furthest
    };
    let (prestressed, sagging) = (moved(unloaded), moved(scan.clone()));
    assert!(sagging > 0.01 && prestressed < 0.01 * sagging, "{prestressed} m, without {sagging} m");
}

/// A fragment falls until it is ten extents of the organ away, and stays there: it would fall for ever, to where floats no longer tell its nodes apart.
#[test]
fn what_has_left_the_theatre_stays_where_it_is() {
    let mut app = app();
    app.insert_resource(Gravity(GRAVITY));
    let donor = organ(&mut app, block([2; 3], [0.02; 3]));
    let held = |node| Attachment {
        point: smallvec![(NodeId(node), 1.0)],
        anchor: Anchor::Space(Vec3::ZERO),
        compliance_m_n: 0.0,
        until_s: f64::INFINITY,
    };
    app.world_mut().entity_mut(donor).insert(Attachments(vec![held(0)]));
    let fragment = organ(&mut app, block([1; 3], [0.005; 3]));
    app.world_mut().entity_mut(fragment).insert(FreedFrom { donor, time_s: 0.0 });
    let mut last = f32::INFINITY;
    for tick in 0..120 {
        app.update();
        let now = positions(&app, fragment)[0].y;
        assert!(now < last || app.world().resource::<TissueReport>().left == 1, "tick {tick}");
        last = now;
    }
    assert!(last < -0.2 && last > -0.4, "{last} m");
    assert_eq!(app.world().resource::<TissueReport>().left, 1);
    assert!(app.world().get::<TissueState>(fragment).unwrap().velocities.iter().all(|v| *v == Vec3::ZERO));
    assert!(positions(&app, donor)[0].length() < 1e-6, "the organ stays in the theatre");
}
