//! Graspers on tissue in the running application: what they hold, and when it slips.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod common {
    pub mod cubes;
    pub mod grasps;
}

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy::time::{TimePlugin, TimeUpdateStrategy};
use common::cubes::block;
use common::grasps::{Key, pull_up};
use keyhole_grasping::{GraspSettings, GraspingPlugin};
use keyhole_instruments::{HandKey, HandTrack, InstrumentsPlugin, Script, TrocarState};
use keyhole_tetmesh::NodeId;
use keyhole_tissue::{TissuePlugin, TissueSettings};
use keyhole_whiteboard::{
    Anchor, Attachment, Attachments, Grasp, Gravity, Hand, Instrument, InstrumentKind, Organ, OrganMaterial, OrganMaterials, Port,
    SceneRequirements, SimulationControl, TissueMesh, TissueState, WhiteboardPlugin,
};

/// A block 30 x 20 x 10 mm, its lower face held, its middle above the origin and thin enough to be taken between jaws that come from above, and a grasper in the right
/// hand, which goes this way.
fn theatre(way: &[Key]) -> (App, Entity) {
    let mut app = App::new();
    app.add_plugins((TimePlugin, WhiteboardPlugin, InstrumentsPlugin, GraspingPlugin, TissuePlugin))
        .insert_resource(Time::<Fixed>::from_hz(60.0))
        .insert_resource(TimeUpdateStrategy::FixedTimesteps(1))
        .insert_resource(SceneRequirements { tissue: true, instruments: true, ..default() })
        .insert_resource(Gravity(Vec3::ZERO));
    app.world_mut().resource_mut::<TissueSettings>().drag_1_s = 20.0;
    let key = |(time_s, tip, grip): &Key| HandKey { time_s: *time_s, tip: *tip, roll_rad: 0.0, grip: *grip, active: false };
    let track = HandTrack { hand: Hand::Right, keys: way.iter().map(key).collect() };
    app.insert_resource(Script::new(vec![track], Vec::new()).unwrap());
    app.world_mut().resource_mut::<SimulationControl>().demonstration = true;
    let mesh = block([12, 8, 4], |p| (p - DVec3::new(6.0, 0.0, 2.0)) * 0.0025);
    let floor = mesh.nodes().filter(|n| mesh.rest(*n).y == 0.0);
    let held = floor.map(|n| Attachment::node_to_space(n, mesh.rest(n).as_vec3(), 0.0)).collect();
    let stuff = OrganMaterial { young_modulus_pa: 30_000.0, ..Default::default() };
    let organ = Organ { name: "block".into() };
    app.world_mut().spawn((organ, TissueState::at_rest(&mesh), TissueMesh(mesh), OrganMaterials(vec![stuff]), Attachments(held)));
    let grasper = Instrument { kind: InstrumentKind::Grasper, name: "grasper".into(), shaft_length_m: 0.33, shaft_radius_m: 0.0025 };
    // Above the block, so that the jaws open along Z, across its 10 mm.
    let port = Port { position: Vec3::new(0.008, 0.15, 0.0), inward: Vec3::NEG_Y };
    let tool = app.world_mut().spawn((grasper, Hand::Right, port, TrocarState { insertion_m: 0.1, ..default() })).id();
    (app, tool)
}

fn grasp(app: &App, tool: Entity) -> Grasp {
    *app.world().get::<Grasp>(tool).unwrap()
}

/// Attachments of the tissue to this tool.
fn held(app: &mut App, tool: Entity) -> usize {
    let world = app.world_mut();
    let all = world.query::<&Attachments>().single(world).unwrap();
    all.0.iter().filter(|a| matches!(a.anchor, Anchor::Tool { instrument, .. } if instrument == tool)).count()
}

/// Largest distance of a node from its rest, m.
fn moved(app: &mut App) -> f32 {
    let world = app.world_mut();
    let (mesh, state) = world.query::<(&TissueMesh, &TissueState)>().single(world).unwrap();
    let away = |n: NodeId| state.position(n).distance(mesh.0.rest(n).as_vec3());
    mesh.0.nodes().map(away).fold(0.0, f32::max)
}

/// Closed jaws hold by as much as they pinch: the pull grows towards the coefficient times the pinch of both jaws, and then the tissue slips away.
#[test]
fn a_grasp_slips_when_it_is_pulled_harder_than_it_pinches() {
    let mu = GraspSettings::default().friction;
    let (mut app, tool) = theatre(&pull_up(0.008, 0.03, 6.0));
    let (mut most, mut all, mut limit): (f32, u32, f32) = (0.0, 0, 0.0);
    let mut squeezed = Grasp::default();
    for tick in 0..480 {
        app.update();
        let now = grasp(&app, tool);
        assert_eq!(now.points as usize, held(&mut app, tool));
        if tick == 89 {
            squeezed = now;
        }
        // What a pad does is pressure and at most so much friction.
        assert!(now.pull_n.length() <= 2.0 * (1.0 + mu * mu).sqrt() * now.pinch_n * 1.001, "tick {tick}: {now:?}");
        // The pads lean towards each other at the tips: their pressure squeezes the tissue out.
        let (sin, cos) = squeezed.least_angle_rad.sin_cos();
        if -now.pull_n.y > most {
            (most, all, limit) = (-now.pull_n.y, now.sliding, 2.0 * (mu * cos - sin) * now.pinch_n);
        }
    }
    println!("squeezed {squeezed:?}; most pull {most} N of {limit} N, {all} points sliding");
    assert!(squeezed.points >= 12 && squeezed.pinch_n > 0.1 && squeezed.least_angle_rad > 0.0, "{squeezed:?}");
    // Soft tissue begins to slide at one end of the pads, before the rest has all the pull that it can bear.
    assert!((0.65..1.0).contains(&(most / limit)) && all > 0, "{most} N against {limit} N, {all} points sliding");
    let end = grasp(&app, tool);
    assert_eq!((end.points, held(&mut app, tool)), (0, 0), "the tissue has slipped away");
    assert!(moved(&mut app) < 1e-3);
}

/// A gentle pull is followed by the tissue, and opened jaws let go of it.
#[test]
fn what_is_held_follows_and_what_is_let_go_goes_back() {
    let mut way = pull_up(0.008, 0.002, 1.0).to_vec();
    let end = way[4].1;
    way.extend([(3.0, end, 1.0), (3.3, end, 0.0), (4.5, end, 0.0)]);
    let (mut app, tool) = theatre(&way);
    for _ in 0..175 {
        app.update();
    }
    let lifted = grasp(&app, tool);
    assert!(lifted.points >= 12 && lifted.pull_n.y < -0.05, "{lifted:?}");
    for _ in 0..95 {
        app.update();
    }
    assert_eq!((grasp(&app, tool).points, held(&mut app, tool)), (0, 0));
    assert!(moved(&mut app) < 2e-4, "{} m", moved(&mut app));
}

/// Jaws that have hold of what is nailed down and go aside, so that one of them shoves: no friction limits what a pad can press, but tissue that is drawn out gives way at
/// the points where it is.
#[test]
fn tissue_that_is_drawn_too_far_is_lost() {
    let most = GraspSettings::default().most_stretch;
    let deep = Vec3::new(0.008, 0.001, 0.0);
    let aside = deep + 0.04 * Vec3::Z;
    let way = [(0.0, deep + 0.03 * Vec3::Y, 0.0), (0.6, deep, 0.0), (1.2, deep, 0.8), (2.0, aside, 0.8), (4.0, aside, 0.8)];
    let (mut app, tool) = theatre(&way);
    let mut points = 0;
    for _ in 0..220 {
        app.update();
        points = points.max(grasp(&app, tool).points);
    }
    let world = app.world_mut();
    let (mesh, state, attachments) = world.query::<(&TissueMesh, &TissueState, &Attachments)>().single(world).unwrap();
    let edge = |a: NodeId, b: NodeId| state.position(a).distance(state.position(b)) / mesh.0.rest(a).distance(mesh.0.rest(b)) as f32;
    let drawn = |c: &[NodeId]| c.iter().flat_map(|a| c.iter().filter(move |b| a != *b).map(move |b| edge(*a, *b))).fold(0.0, f32::max);
    let nodes = |a: &Attachment| a.point.iter().map(|(n, _)| *n).collect::<Vec<_>>();
    let by_tool = attachments.0.iter().filter(|a| matches!(a.anchor, Anchor::Tool { .. }));
    let held = by_tool.map(|a| drawn(&nodes(a))).fold(0.0, f32::max);
    let anywhere = mesh.0.iter().map(|(_, corners)| drawn(&corners)).fold(0.0, f32::max);
    println!("{points} points held, then {}; drawn to {held} times where held, to {anywhere} anywhere", grasp(&app, tool).points);
    assert!(points > grasp(&app, tool).points, "none of {points} points was lost");
    assert!(held <= most, "drawn to {held} times where it is held");
    assert!(anywhere > most, "the pull draws tissue too far: {anywhere}");
}
