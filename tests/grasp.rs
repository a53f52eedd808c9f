//! Graspers on tissue in the running application: what they hold, when it slips, and how it goes from one hand to the other.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy::time::{TimePlugin, TimeUpdateStrategy};
use keyhole_grasping::{GraspSettings, GraspingPlugin};
use keyhole_instruments::{HandKey, HandTrack, InstrumentsPlugin, Script, TrocarState};
use keyhole_tetmesh::{NodeId, TetMesh};
use keyhole_tissue::{TissuePlugin, TissueSettings};
use keyhole_whiteboard::{
    Anchor, Attachment, Attachments, Grasp, Gravity, Hand, Instrument, InstrumentKind, Organ, OrganMaterial, OrganMaterials, Port,
    SceneRequirements, SimulationControl, TissueMesh, TissueState, WhiteboardPlugin,
};

/// Height of the block's upper face, m.
const TOP: f32 = 0.02;

/// A block 30 x 20 x 10 mm, cubes of five tetrahedra, its middle above the origin and thin enough to be taken between jaws that come from above.
fn block() -> TetMesh {
    let (counts, edge) = ([12_usize, 8, 4], 0.0025);
    let id = |i: usize, j: usize, k: usize| (i + (counts[0] + 1) * (j + (counts[1] + 1) * k)) as u32;
    let mut nodes = Vec::new();
    for k in 0..=counts[2] {
        for j in 0..=counts[1] {
            nodes.extend((0..=counts[0]).map(|i| DVec3::new(i as f64 - 6.0, j as f64, k as f64 - 2.0) * edge));
        }
    }
    let mut tets = Vec::new();
    for (i, j, k) in (0..counts.iter().product()).map(|c: usize| (c % 12, c / 12 % 8, c / 96)) {
        for five in [[0, 1, 2, 4], [3, 1, 7, 2], [5, 1, 4, 7], [6, 2, 7, 4], [1, 2, 4, 7]] {
            let five = if (i + j + k) % 2 == 0 { five } else { five.map(|b| b ^ 1) };
            let mut tet = five.map(|b: usize| id(i + (b & 1), j + (b >> 1 & 1), k + (b >> 2 & 1)));
            let [a, b, c, d] = tet.map(|n| nodes[n as usize]);
            if (b - a).dot((c - a).cross(d - a)) < 0.0 {
                tet.swap(0, 1);
            }
            tets.push(tet);
        }
    }
    TetMesh::new(nodes, &tets, &[])
}

/// A hand's way: time (s), place of the point between its pads (m), grip.
type Way<'a> = &'a [(f64, Vec3, f32)];

/// The block, its lower face held, and a grasper in each hand that is given a way.
fn theatre(right: Way, left: Option<Way>) -> (App, Vec<Entity>) {
    let mut app = App::new();
    app.add_plugins((TimePlugin, WhiteboardPlugin, InstrumentsPlugin, GraspingPlugin, TissuePlugin))
        .insert_resource(Time::<Fixed>::from_hz(60.0))
        .insert_resource(TimeUpdateStrategy::FixedTimesteps(1))
        .insert_resource(SceneRequirements { tissue: true, instruments: true, ..default() })
        .insert_resource(Gravity(Vec3::ZERO));
    app.world_mut().resource_mut::<TissueSettings>().drag_1_s = 20.0;
    let track = |hand, way: Way| {
        let key =
            |(time_s, tip, grip): &(f64, Vec3, f32)| HandKey { time_s: *time_s, tip: *tip, roll_rad: 0.0, grip: *grip, active: false };
        HandTrack { hand, keys: way.iter().map(key).collect() }
    };
    let tracks = [Some(track(Hand::Right, right)), left.map(|way| track(Hand::Left, way))];
    app.insert_resource(Script::new(tracks.into_iter().flatten().collect(), Vec::new()).unwrap());
    app.world_mut().resource_mut::<SimulationControl>().demonstration = true;
    let mesh = block();
    let floor = mesh.nodes().filter(|n| mesh.rest(*n).y == 0.0);
    let held = floor.map(|n| Attachment::node_to_space(n, mesh.rest(n).as_vec3(), 0.0)).collect();
    let stuff = OrganMaterial { young_modulus_pa: 30_000.0, ..Default::default() };
    let organ = Organ { name: "block".into() };
    app.world_mut().spawn((organ, TissueState::at_rest(&mesh), TissueMesh(mesh), OrganMaterials(vec![stuff]), Attachments(held)));
    let grasper = Instrument { kind: InstrumentKind::Grasper, name: "grasper".into(), shaft_length_m: 0.33, shaft_radius_m: 0.0025 };
    let hands = std::iter::once(Hand::Right).chain(left.map(|_| Hand::Left));
    let spawn = |hand| {
        let side = if hand == Hand::Right { 1.0 } else { -1.0 };
        // Above the block, so that the jaws open along Z, across its 10 mm.
        let port = Port { position: Vec3::new(side * 0.008, 0.15, 0.0), inward: Vec3::NEG_Y };
        app.world_mut().spawn((grasper.clone(), hand, port, TrocarState { insertion_m: 0.1, ..default() })).id()
    };
    let tools = hands.map(spawn).collect();
    (app, tools)
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

/// Down to the block with open jaws, closed, and up to a height in `seconds`.
fn pull_up(x: f32, by: f32, seconds: f64) -> [(f64, Vec3, f32); 5] {
    let at = |y: f32| Vec3::new(x, y, 0.0);
    [
        (0.0, at(TOP + 0.03), 0.0),
        (0.5, at(TOP - 0.008), 0.0),
        (1.0, at(TOP - 0.008), 1.0),
        (1.5, at(TOP - 0.008), 1.0),
        (1.5 + seconds, at(TOP - 0.008 + by), 1.0),
    ]
}

/// Closed jaws hold by as much as they pinch: the pull grows towards the coefficient times the pinch of both jaws, and then the tissue slips away.
#[test]
fn a_grasp_slips_when_it_is_pulled_harder_than_it_pinches() {
    let mu = GraspSettings::default().friction;
    let (mut app, tools) = theatre(&pull_up(0.008, 0.03, 6.0), None);
    let (mut most, mut all, mut limit): (f32, u32, f32) = (0.0, 0, 0.0);
    let mut squeezed = Grasp::default();
    for tick in 0..480 {
        app.update();
        let now = grasp(&app, tools[0]);
        assert_eq!(now.points as usize, held(&mut app, tools[0]));
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
    let end = grasp(&app, tools[0]);
    assert_eq!((end.points, held(&mut app, tools[0])), (0, 0), "the tissue has slipped away");
    assert!(moved(&mut app) < 1e-3);
}

/// A gentle pull is followed by the tissue, and opened jaws let go of it.
#[test]
fn what_is_held_follows_and_what_is_let_go_goes_back() {
    let mut way = pull_up(0.008, 0.002, 1.0).to_vec();
    let end = way[4].1;
    way.extend([(3.0, end, 1.0), (3.3, end, 0.0), (4.5, end, 0.0)]);
    let (mut app, tools) = theatre(&way, None);
    for _ in 0..175 {
        app.update();
    }
    let lifted = grasp(&app, tools[0]);
    assert!(lifted.points >= 12 && lifted.pull_n.y < -0.05, "{lifted:?}");
    for _ in 0..95 {
        app.update();
    }
    assert_eq!((grasp(&app, tools[0]).points, held(&mut app, tools[0])), (0, 0));
    assert!(moved(&mut app) < 2e-4, "{} m", moved(&mut app));
}

/// One hand takes hold beside the other, which lets go: the tissue stays up.
#[test]
fn tissue_goes_from_hand_to_hand() {
    let lifted = TOP - 0.008 + 0.002;
    let mut right = pull_up(0.008, 0.002, 0.5).to_vec();
    right.extend([
        (3.5, Vec3::new(0.008, lifted, 0.0), 1.0),
        (3.8, Vec3::new(0.008, lifted, 0.0), 0.0),
        (5.0, Vec3::new(0.008, 0.08, 0.0), 0.0),
    ]);
    let beside = |y: f32| Vec3::new(-0.008, y, 0.0);
    let left = [
        (0.0, beside(0.06), 0.0),
        (2.0, beside(0.06), 0.0),
        (2.5, beside(TOP - 0.008), 0.0),
        (3.0, beside(TOP - 0.008), 1.0),
        (5.0, beside(lifted), 1.0),
    ];
    let (mut app, tools) = theatre(&right, Some(&left));
    for _ in 0..200 {
        app.update();
    }
    assert!(tools.iter().all(|t| held(&mut app, *t) >= 12), "both hold");
    for _ in 0..110 {
        app.update();
    }
    assert_eq!(held(&mut app, tools[0]), 0);
    let kept = grasp(&app, tools[1]);
    assert!(kept.points >= 12 && kept.pull_n.y < -0.05, "{kept:?}");
}
