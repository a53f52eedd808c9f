//! Both hands in a device that is not there, through the code of real ones, on soft tissue: what is grasped, when it slips, how it goes from hand to
//! hand, and what a device at fault does to it. How instruments follow a handle is in `devices.rs`.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod common {
    pub mod grasps;
    pub mod handles;
}

use bevy::prelude::*;
use bevy::time::{TimePlugin, TimeUpdateStrategy};
use common::grasps::{DEEP, Key, TOP, pull_up};
use common::handles::{device, report};
use keyhole_grasping::{GraspSettings, GraspingPlugin};
use keyhole_instruments::{InstrumentsPlugin, PortFrame, TrocarState, working_reach};
use keyhole_scene::SceneSolid;
use keyhole_tetmesh::NodeId;
use keyhole_tissue::{TissuePlugin, TissueSettings};
use keyhole_whiteboard::{
    Anchor, Attachment, Attachments, Bruises, CuttingLine, DeviceCondition, DeviceStatus, Exchange, ExchangeStage, Grasp, GraspReport,
    Gravity, Hand, HandInput, Instrument, InstrumentKind, InstrumentPose, JawPads, Jaws, Organ, OrganMaterial, OrganMaterials, PinchLimit,
    Port, SceneRequirements, TissueMesh, TissueState, Tray, WhiteboardPlugin,
};
use std::ops::Range;

/// Modulus of soft tissue, and of stuff that hardly gives, Pa.
const SOFT_PA: f32 = 30_000.0;
const STIFF_PA: f32 = 1_000_000.0;

fn at(way: &[Key], at_s: f64) -> (Vec3, f32) {
    let next = way.iter().position(|k| k.0 > at_s).unwrap_or(way.len());
    let (a, b) = (way[next.max(1) - 1], way[next.min(way.len() - 1)]);
    let part = if b.0 > a.0 { ((at_s - a.0) / (b.0 - a.0)).clamp(0.0, 1.0) as f32 } else { 0.0 };
    (a.1.lerp(b.1, part), a.2 + part * (b.2 - a.2))
}

fn port(hand: usize) -> Port {
    let side = if hand == 0 { 1.0 } else { -1.0 };
    // Above the tissue, so that the jaws open along Z, across its 10 mm.
    Port { position: Vec3::new(side * 0.008, 0.15, 0.0), inward: Vec3::NEG_Y }
}

fn reached(hand: usize, tip: Vec3, grip: f32) -> TrocarState {
    let reach = working_reach(InstrumentKind::Grasper, None);
    PortFrame::of(&port(hand)).reach(tip, reach, &TrocarState { grip, ..default() }).unwrap()
}

/// What the device does besides telling where its handles are.
enum Fault {
    None,
    /// Its plug is out.
    Unplugged(Range<f64>),
    /// It sends something else.
    Sends(Range<f64>, fn(Vec<u8>) -> Vec<u8>),
}

struct Theatre {
    app: App,
    tools: [Entity; 2],
}

impl Theatre {
    /// A piece of soft tissue 30 x 20 x 10 mm on its held lower face, and a grasper in each hand of a device at 1000 Hz.
    fn new(ways: [&[Key]; 2], fault: Fault) -> Self {
        Self::of_stuff(ways, fault, SOFT_PA)
    }

    /// The same of stuff with this modulus, Pa.
    fn of_stuff(ways: [&[Key]; 2], fault: Fault, young_modulus_pa: f32) -> Self {
        let own = ways.map(<[Key]>::to_vec);
        let (mut plugged, mut broken, mut does): (_, _, fn(Vec<u8>) -> Vec<u8>) = (vec![0.0..1e6], 0.0..0.0, |r| r);
        match fault {
            Fault::None => {}
            Fault::Unplugged(out) => plugged = vec![0.0..out.start, out.end..1e6],
            Fault::Sends(when, what) => (broken, does) = (when, what),
        }
        let says = move |at_s: f64| {
            let states = [0, 1].map(|hand| {
                let (tip, grip) = at(&own[hand], at_s);
                reached(hand, tip, grip)
            });
            let report = report(states);
            if broken.contains(&at_s) { does(report) } else { report }
        };
        let mut app = App::new();
        app.add_plugins((TimePlugin, WhiteboardPlugin, InstrumentsPlugin, GraspingPlugin, TissuePlugin, device(&plugged, says)))
            .insert_resource(Time::<Fixed>::from_hz(60.0))
            .insert_resource(TimeUpdateStrategy::FixedTimesteps(1))
            .insert_resource(SceneRequirements { tissue: true, instruments: true, ..default() })
            .insert_resource(Gravity(Vec3::ZERO));
        app.world_mut().resource_mut::<TissueSettings>().drag_1_s = 20.0;
        let middle = bevy_math::DVec3::new(0.0, 0.5 * f64::from(TOP), 0.0);
        let mut mesh = SceneSolid::Block { size: [0.03, TOP, 0.01], cells: [12, 8, 4] }.mesh();
        for n in mesh.nodes().collect::<Vec<_>>() {
            let rest = mesh.rest(n) + middle;
            mesh.move_node(n, rest, std::iter::once((n, 1.0)).collect());
        }
        mesh.take_delta();
        let floor = mesh.nodes().filter(|n| mesh.rest(*n).y < 1e-6);
        let held = floor.map(|n| Attachment::node_to_space(n, mesh.rest(n).as_vec3(), 0.0)).collect();
        let stuff = OrganMaterial { young_modulus_pa, ..Default::default() };
        let organ = Organ { name: "tissue".into() };
        app.world_mut().spawn((organ, TissueState::at_rest(&mesh), TissueMesh(mesh), OrganMaterials(vec![stuff]), Attachments(held)));
        let tools = [0, 1].map(|hand| {
            let grasper =
                Instrument { kind: InstrumentKind::Grasper, name: "grasper".into(), shaft_length_m: 0.33, shaft_radius_m: 0.0025 };
            let (tip, grip) = at(ways[hand], 0.0);
            let held = [Hand::Right, Hand::Left][hand];
            app.world_mut().spawn((grasper, held, port(hand), reached(hand, tip, grip))).id()
        });
        app.update();
        Self { app, tools }
    }

    fn now_s(&self) -> f64 {
        self.app.world().resource::<Time<Fixed>>().elapsed_secs_f64()
    }

    fn until(&mut self, seconds: f64) {
        while self.now_s() < seconds {
            self.app.update();
        }
    }

    fn get<C: Component + Copy>(&self, hand: usize) -> C {
        *self.app.world().get::<C>(self.tools[hand]).unwrap()
    }

    fn tip(&self, hand: usize) -> Vec3 {
        let reach = working_reach(InstrumentKind::Grasper, None);
        self.get::<InstrumentPose>(hand).now.transform_point(Vec3::new(0.0, 0.0, -reach)).into()
    }

    /// Attachments of the tissue to the instrument in a hand.
    fn held(&mut self, hand: usize) -> usize {
        let (world, tool) = (self.app.world_mut(), self.tools[hand]);
        let all = world.query::<&Attachments>().single(world).unwrap();
        all.0.iter().filter(|a| matches!(a.anchor, Anchor::Tool { instrument, .. } if instrument == tool)).count()
    }

    fn condition(&self) -> DeviceCondition {
        self.app.world().resource::<DeviceStatus>().0[0].condition
    }
}

/// Waits aside with closed jaws.
fn aside(hand: usize) -> [Key; 1] {
    [(0.0, Vec3::new(if hand == 0 { 0.02 } else { -0.02 }, 0.08, 0.0), 1.0)]
}

/// The law of friction: along the shaft each pad does at most `friction` times its pressure, less what the pads, which lean towards each other at their tips, press the
/// tissue out. Stiff tissue slides on all of the pads at once, so that all of that is felt before it goes.
#[test]
fn a_handle_that_is_drawn_back_pulls_until_the_grasp_slips_at_the_force_that_friction_holds() {
    let mu = GraspSettings::default().friction;
    let mut theatre = Theatre::of_stuff([&pull_up(0.008, 0.03, 6.0), &aside(1)], Fault::None, STIFF_PA);
    theatre.until(1.4);
    let squeezed = theatre.get::<Grasp>(0);
    assert!(squeezed.points >= 12 && squeezed.pinch_n > 0.1, "{squeezed:?}");
    let (mut most, mut when_s) = ((0.0f32, 0.0f32, squeezed), 0.0);
    while theatre.now_s() < 8.0 {
        let angle_rad = theatre.get::<Jaws>(0).angle_rad;
        theatre.app.update();
        let now = theatre.get::<Grasp>(0);
        let (sin, cos) = angle_rad.sin_cos();
        let (pull_n, limit_n) = (-now.pull_n.y, 2.0 * now.pinch_n * (mu * cos - sin));
        assert!(pull_n <= 1.01 * limit_n, "{pull_n} N against {limit_n} N: {now:?}");
        if pull_n > most.0 {
            (most, when_s) = ((pull_n, limit_n, now), theatre.now_s());
        }
    }
    let (pull_n, limit_n, then) = most;
    println!("slips after {when_s:.2} s at {pull_n:.3} N, the law says {limit_n:.3} N; {then:?}");
    assert!(then.sliding > 0 && (pull_n / limit_n - 1.0).abs() < 0.03, "{pull_n} N against {limit_n} N: {then:?}");
    assert_eq!((theatre.get::<Grasp>(0).points, theatre.held(0)), (0, 0), "the tissue has slipped away");
}

#[test]
fn two_handles_take_tissue_from_each_other() {
    let lifted = TOP - DEEP + 0.002;
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
        (2.5, beside(TOP - DEEP), 0.0),
        (3.0, beside(TOP - DEEP), 1.0),
        (5.0, beside(lifted), 1.0),
    ];
    let mut theatre = Theatre::new([&right, &left], Fault::None);
    theatre.until(2.4);
    assert!(theatre.held(0) >= 12 && theatre.held(1) == 0, "the right hand alone holds");
    theatre.until(3.3);
    assert!(theatre.held(0) >= 12 && theatre.held(1) >= 12, "both hold");
    theatre.until(5.2);
    assert_eq!(theatre.held(0), 0);
    let kept = theatre.get::<Grasp>(1);
    assert!(kept.points >= 12 && kept.pull_n.y < -0.05, "{kept:?}");
}

/// The fault comes while tissue is held up. Meanwhile the hand goes elsewhere and opens; then it is squeezed again and moved.
fn in_mid_grasp(fault: Fault, expected: DeviceCondition) {
    let elsewhere = Vec3::new(0.015, TOP + 0.02, 0.003);
    let mut way = pull_up(0.008, 0.002, 0.5).to_vec();
    let up = way[4].1;
    way.extend([
        (2.6, up, 1.0),
        (3.0, elsewhere, 0.0),
        (4.0, elsewhere, 0.0),
        (4.5, elsewhere, 1.0),
        (5.5, elsewhere + 0.002 * Vec3::Y, 1.0),
        (6.0, elsewhere + 0.002 * Vec3::Y, 1.0),
        (6.5, elsewhere + 0.002 * Vec3::Y, 0.0),
    ]);
    let mut theatre = Theatre::new([&way, &aside(1)], fault);
    theatre.until(2.45);
    let before = theatre.get::<Grasp>(0);
    assert!(before.points >= 12 && before.pull_n.y < -0.05, "{before:?}");
    theatre.until(2.6);
    let (tip, jaws) = (theatre.tip(0), theatre.get::<Jaws>(0).angle_rad);
    assert_eq!(theatre.condition(), expected);
    while theatre.now_s() < 3.5 {
        theatre.app.update();
        assert_eq!((theatre.tip(0), theatre.get::<Jaws>(0).angle_rad), (tip, jaws), "{expected:?}");
    }
    let during = theatre.get::<Grasp>(0);
    assert!(during.points == before.points && (during.pull_n - before.pull_n).length() < 0.2 * before.pull_n.length(), "{during:?}");
    // The device is sound again and its handle is 2 cm away with its rings open.
    theatre.until(3.9);
    assert_eq!(theatre.condition(), DeviceCondition::Live);
    assert_eq!((theatre.tip(0), theatre.get::<Jaws>(0).angle_rad), (tip, jaws));
    // The handle moves up by 2 mm in a second: no tick moves the tip by more than that, and the tissue comes along.
    let (mut last, mut most) = (theatre.tip(0), 0.0f32);
    while theatre.now_s() < 5.8 {
        theatre.app.update();
        let now = theatre.tip(0);
        most = most.max(now.distance(last));
        last = now;
    }
    let after = theatre.get::<Grasp>(0);
    assert!(most < 1.5 * 0.002 / 60.0, "a jump of {most} m");
    assert!(last.y - tip.y > 0.0015, "it follows the hand: {tip} to {last}");
    assert!(after.points >= 12 && after.pull_n.y < 1.3 * before.pull_n.y, "{before:?}, {after:?}");
    // The rings have come to the jaws by now: opened, they let go.
    theatre.until(6.6);
    assert_eq!((theatre.get::<Grasp>(0).points, theatre.held(0)), (0, 0));
}

#[test]
fn unplugged_in_mid_grasp_the_tissue_stays_held_and_goes_on_from_there() {
    in_mid_grasp(Fault::Unplugged(2.5..2.9), DeviceCondition::Unplugged);
}

#[test]
fn nonsense_in_mid_grasp_moves_nothing_and_drops_nothing() {
    in_mid_grasp(Fault::Sends(2.5..3.6, |r| vec![0xff; r.len()]), DeviceCondition::Garbage);
}

#[test]
fn half_reports_in_mid_grasp_move_nothing_and_drop_nothing() {
    in_mid_grasp(Fault::Sends(2.5..3.6, |r| r[..r.len() / 2].to_vec()), DeviceCondition::Garbage);
}

/// The axis of insertion hangs while tissue is held: it is named, the tissue stays held, the other axes go on.
#[test]
fn a_stuck_axis_in_mid_grasp_drops_nothing() {
    fn hung(mut report: Vec<u8>) -> Vec<u8> {
        // The right hand's insertion, as it is at the height of the grasp.
        let counts = (reached(0, Vec3::new(0.008, TOP - DEEP + 0.002, 0.0), 1.0).insertion_m / 0.25 * 60_000.0).round() as u16;
        report[4..6].copy_from_slice(&counts.to_le_bytes());
        report
    }
    let mut way = pull_up(0.008, 0.002, 0.5).to_vec();
    let up = way[4].1;
    // Nothing that would tear: a millimetre to and fro, while the other hand travels far.
    way.extend((0..60).map(|k| (2.5 + 0.1 * f64::from(k), up + if k % 2 == 0 { 0.001 } else { -0.001 } * Vec3::X, 1.0)));
    let left: Vec<Key> =
        (0..90).map(|k| (0.1 * f64::from(k), Vec3::new(-0.02, 0.08, if k % 2 == 0 { 0.02 } else { -0.02 }), 1.0)).collect();
    let mut theatre = Theatre::new([&way, &left], Fault::Sends(2.5..1e6, hung));
    theatre.until(2.4);
    let before = theatre.get::<Grasp>(0);
    let mut across = (f32::INFINITY, f32::NEG_INFINITY);
    while theatre.now_s() < 8.4 {
        theatre.app.update();
        let x = theatre.tip(0).x;
        if theatre.now_s() > 2.6 {
            across = (across.0.min(x), across.1.max(x));
        }
    }
    let after = theatre.get::<Grasp>(0);
    println!("{:?}: {:?}", theatre.condition(), theatre.app.world().resource::<DeviceStatus>().0[0].advice);
    assert!(before.points >= 12 && after.points == before.points, "{before:?}, {after:?}");
    assert!(across.1 - across.0 > 0.0015, "the other axes go on: {across:?}");
}

/// Pinched harder than it bears the tissue is bruised where the pads were and nowhere else, as badly as they pressed too hard; pinched less it is not.
#[test]
fn a_pinch_beyond_what_the_tissue_bears_leaves_a_mark() {
    let squeezed = |limit_pa: f32| {
        let mut theatre = Theatre::new([&pull_up(0.008, 0.0, 0.5), &aside(1)], Fault::None);
        let world = theatre.app.world_mut();
        let organ = world.query_filtered::<Entity, With<Organ>>().single(world).unwrap();
        world.entity_mut(organ).insert(PinchLimit(limit_pa));
        theatre.until(2.0);
        let world = theatre.app.world();
        let marked: Vec<(Vec3, f32)> = {
            let (mesh, bruises) = (&world.get::<TissueMesh>(organ).unwrap().0, &world.get::<Bruises>(organ).unwrap().by_node);
            let bad = |n: NodeId| bruises.get(n.index()).copied().unwrap_or(0.0);
            mesh.nodes().filter(|n| bad(*n) > 0.0).map(|n| (mesh.rest(n).as_vec3(), bad(n))).collect()
        };
        (*world.resource::<GraspReport>(), marked)
    };
    let (gentle, marked) = squeezed(1e9);
    assert!(gentle.most_pa > 1e3 && gentle.bruising == 0 && gentle.bruised_m2 == 0.0 && marked.is_empty(), "{gentle:?}");
    let limit_pa = 0.6 * gentle.most_pa;
    let (hard, marked) = squeezed(limit_pa);
    let pads = keyhole_instruments::tools::jaw_pads(InstrumentKind::Grasper, 0.0025).unwrap();
    let both_m2 = 4.0 * pads.half_width_m * (pads.to_m - pads.from_m);
    println!("{hard:?}: {} nodes, {:.1} of {:.1} mm2", marked.len(), 1e6 * hard.bruised_m2, 1e6 * both_m2);
    assert_eq!((hard.bruising, hard.most_pa), (1, gentle.most_pa), "marks change nothing else");
    assert!(hard.bruised_m2 > 0.0 && hard.bruised_m2 < both_m2);
    let worst = marked.iter().map(|(_, bad)| *bad).fold(0.0, f32::max);
    assert!((worst - (hard.most_pa / limit_pa - 1.0)).abs() < 1e-4, "{worst}");
    // An edge of the mesh beyond the pads at most.
    assert!(!marked.is_empty() && marked.iter().all(|(at, _)| (at.x - 0.008).abs() < pads.half_width_m + 0.0026), "{marked:?}");
}

/// A hand in a device holds tissue and changes its instrument: it lets go, draws it out, has scissors after its time, and goes on from where they came in.
#[test]
fn an_instrument_is_exchanged_through_its_trocar() {
    let mut way = pull_up(0.008, 0.002, 0.5).to_vec();
    let up = way[4].1;
    way.extend([(6.5, up, 1.0), (7.5, up + 0.004 * Vec3::X, 1.0), (9.0, up + 0.004 * Vec3::X, 1.0)]);
    let mut theatre = Theatre::new([&way, &aside(1)], Fault::None);
    let tool = theatre.tools[0];
    theatre.app.world_mut().entity_mut(tool).insert(Tray(vec![InstrumentKind::Scissors, InstrumentKind::Hook]));
    theatre.until(2.4);
    assert!(theatre.held(0) >= 12);
    let started_s = theatre.now_s();
    theatre.app.world_mut().resource_mut::<HandInput>().exchange = true;
    theatre.app.update();
    assert_eq!(theatre.get::<Exchange>(0).stage, ExchangeStage::Withdraw);
    while theatre.get::<Exchange>(0).stage == ExchangeStage::Withdraw {
        theatre.app.update();
        assert!(theatre.now_s() < started_s + 2.0);
    }
    assert_eq!(theatre.held(0), 0, "what it held stays behind");
    assert!(theatre.get::<TrocarState>(0).insertion_m <= 0.0101);
    while theatre.app.world().get::<Exchange>(tool).is_some() {
        theatre.app.update();
    }
    let took_s = theatre.now_s() - started_s;
    println!("exchanged in {took_s:.2} s");
    assert!((2.5..5.0).contains(&took_s), "{took_s} s");
    let (world, kinds) = (theatre.app.world(), |tray: &Tray| tray.0.clone());
    let (instrument, tray) = (world.get::<Instrument>(tool).unwrap(), world.get::<Tray>(tool).unwrap());
    assert_eq!((instrument.kind, instrument.name.as_str()), (InstrumentKind::Scissors, "Scissors"));
    assert_eq!(kinds(tray), [InstrumentKind::Hook, InstrumentKind::Grasper]);
    assert!(world.get::<CuttingLine>(tool).is_some() && world.get::<JawPads>(tool).is_none());
    // The handle is 6 cm deeper than the scissors are: they go on from where they are, and not by a jump.
    let (mut last, mut most) = (theatre.get::<InstrumentPose>(0).now.translation, 0.0f32);
    while theatre.now_s() < 8.0 {
        theatre.app.update();
        let now = theatre.get::<InstrumentPose>(0).now.translation;
        most = most.max(now.distance(last));
        last = now;
    }
    assert!(most > 1e-5 && most < 1.5 * 0.004 / 60.0, "{most} m in a tick");
}
