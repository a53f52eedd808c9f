//! Stitches in the running application: two instruments in their ports, a needle, and two edges of soft tissue that are to come together.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod common {
    pub mod cubes;
}

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy::time::{TimePlugin, TimeUpdateStrategy};
use common::cubes;
use keyhole_grasping::GraspingPlugin;
use keyhole_instruments::{InstrumentsPlugin, PortFrame, ProxySettings, TrocarState, working_reach};
use keyhole_suturing::SuturingPlugin;
use keyhole_tetmesh::TetMesh;
use keyhole_tissue::{TissuePlugin, TissueSettings};
use keyhole_whiteboard::{
    Attachment, Attachments, Bites, Gravity, Hand, HoleKind, Instrument, InstrumentKind, InstrumentPose, Knot, Knots, Needle, Organ,
    OrganMaterial, OrganMaterials, Port, SceneRequirements, SimulationControl, SutureReport, TearResistance, Thread, TissueMesh,
    TissueState, WhiteboardPlugin,
};
use std::f32::consts::PI;

/// Force at which a bite tears out here, per length of tissue before it, N/m.
const TEAR_N_M: f32 = 500.0;

/// Half of the gap between the edges, m.
const GAP: f32 = 0.001;

/// A block from `low` to `high`, m.
fn block(low: Vec3, high: Vec3, counts: [usize; 3]) -> TetMesh {
    let (low, size, per) = (low.as_dvec3(), (high - low).as_dvec3(), counts.map(|n| n as f64));
    cubes::block(counts, |p| low + size * p / DVec3::from(per))
}

struct Theatre {
    app: App,
    tools: [Entity; 2],
    suture: Entity,
    flaps: [Entity; 2],
}

/// Where a hand has its instrument: the point between its pads (m), the roll (rad) and the grip.
#[derive(Clone, Copy)]
struct Hold {
    tip: Vec3,
    roll_rad: f32,
    grip: f32,
}

impl Theatre {
    /// Two flaps of soft tissue with a gap between them, each held at its far side, and a needle over them that will go in and out this far from the edges (m).
    fn new(from_edge: f32, tear_n_m: f32) -> Self {
        let mut app = App::new();
        app.add_plugins((TimePlugin, WhiteboardPlugin, InstrumentsPlugin, GraspingPlugin, SuturingPlugin, TissuePlugin))
            .insert_resource(Time::<Fixed>::from_hz(60.0))
            .insert_resource(TimeUpdateStrategy::FixedTimesteps(1))
            .insert_resource(SceneRequirements { tissue: true, instruments: true, suturing: true, ..default() })
            .insert_resource(Gravity(Vec3::ZERO))
            // What is held is put where it belongs at once.
            .insert_resource(ProxySettings { fastest_m_s: f32::INFINITY, ..default() });
        app.world_mut().resource_mut::<TissueSettings>().drag_1_s = 20.0;
        // No mouse: where the hands are is told below.
        app.world_mut().resource_mut::<SimulationControl>().demonstration = true;
        let flaps = [-1.0f32, 1.0].map(|side| {
            let (near, far) = (side * GAP, side * 0.022);
            let mesh = block(Vec3::new(near.min(far), -0.012, -0.008), Vec3::new(near.max(far), 0.0, 0.008), [8, 4, 6]);
            let edge = f64::from(far);
            let outer = mesh.nodes().filter(|n| (mesh.rest(*n).x - edge).abs() < 1e-6);
            let held = outer.map(|n| Attachment::node_to_space(n, mesh.rest(n).as_vec3(), 0.0)).collect();
            let stuff = OrganMaterial { young_modulus_pa: 60_000.0, ..Default::default() };
            let body = (Organ { name: "flap".into() }, TissueState::at_rest(&mesh), TissueMesh(mesh), OrganMaterials(vec![stuff]));
            app.world_mut().spawn((body, Attachments(held), TearResistance(tear_n_m))).id()
        });
        let height = 0.003;
        let mut needle = Needle::half_circle_26mm(Isometry3d::IDENTITY);
        let half = (needle.radius_m * needle.radius_m - height * height).sqrt();
        needle.pose = Isometry3d::from_translation(Vec3::new(half - GAP - from_edge, height, 0.0));
        let swage = needle.point(&needle.pose, 0.0);
        let tail = swage + 0.15 * Vec3::new(-0.8, 0.6, 0.0);
        let suture = app.world_mut().spawn((needle, Thread { points: vec![tail, swage], radius_m: 0.000_15, ..default() })).id();
        let tool = Instrument { kind: InstrumentKind::Grasper, name: "needle holder".into(), shaft_length_m: 0.33, shaft_radius_m: 0.0025 };
        let tools = [(Hand::Right, 0.02), (Hand::Left, -0.02)].map(|(hand, x)| {
            let port = Port { position: Vec3::new(x, 0.02, 0.2), inward: Vec3::NEG_Z };
            app.world_mut().spawn((tool.clone(), hand, port, TrocarState { insertion_m: 0.05, ..default() })).id()
        });
        app.update();
        Self { app, tools, suture, flaps }
    }

    fn get<C: Component + Clone>(&self) -> C {
        self.app.world().get::<C>(self.suture).unwrap().clone()
    }

    /// Puts a hand there. Its instrument turns about its port.
    fn put(&mut self, tool: usize, hold: Hold) {
        let mut entity = self.app.world_mut().entity_mut(self.tools[tool]);
        let (port, state) = (*entity.get::<Port>().unwrap(), *entity.get::<TrocarState>().unwrap());
        let told = TrocarState { roll_rad: hold.roll_rad, grip: hold.grip, ..state };
        let reach = working_reach(InstrumentKind::Grasper, None);
        entity.insert(PortFrame::of(&port).reach(hold.tip, reach, &told).unwrap());
    }

    fn open(&mut self, tool: usize) {
        self.app.world_mut().get_mut::<TrocarState>(self.tools[tool]).unwrap().grip = 0.0;
        self.app.update();
    }

    /// Brings the jaws to a place and closes them there. They come from aside and hardly open, so that no tissue comes between them on the way.
    fn take(&mut self, tool: usize, tip: Vec3) {
        let aside = tip + Vec3::new(0.0, 0.05, 0.03);
        for (tip, grip) in [(aside, 0.0), (aside, 0.9), (tip, 0.9), (tip, 0.9), (tip, 1.0)] {
            self.put(tool, Hold { tip, roll_rad: 0.0, grip });
            self.app.update();
        }
    }

    fn tip(&self, tool: usize) -> Vec3 {
        let pose = self.app.world().get::<InstrumentPose>(self.tools[tool]).unwrap().now;
        pose.transform_point(Vec3::new(0.0, 0.0, -working_reach(InstrumentKind::Grasper, None))).into()
    }

    /// Moves what a hand holds evenly to a place.
    fn carry(&mut self, tool: usize, to: Vec3, ticks: u32) {
        let (from, state) = (self.tip(tool), *self.app.world().get::<TrocarState>(self.tools[tool]).unwrap());
        for tick in 1..=ticks {
            let tip = from.lerp(to, tick as f32 / ticks as f32);
            self.put(tool, Hold { tip, roll_rad: state.roll_rad, grip: 1.0 });
            self.app.update();
        }
    }

    /// Drives the needle along its circle: the hand goes around its centre and rolls with it.
    fn turn(&mut self, tool: usize, angle_rad: f32, ticks: u32) {
        let centre = Vec3::from(self.get::<Needle>().pose.translation);
        let arm = self.tip(tool) - centre;
        for tick in 1..=ticks {
            let turned = angle_rad * tick as f32 / ticks as f32;
            let tip = centre + Quat::from_rotation_z(turned) * arm;
            self.put(tool, Hold { tip, roll_rad: -turned, grip: 1.0 });
            self.app.update();
        }
    }

    /// One stitch through both flaps, handed over in the middle, and the thread drawn after it.
    fn stitch(&mut self) {
        let needle: Needle = self.get();
        self.take(0, needle.point(&needle.pose, 0.1));
        assert_eq!(self.get::<Needle>().grips.len(), 1, "the right hand has the needle");
        self.turn(0, PI, 60);
        let needle: Needle = self.get();
        self.take(1, needle.point(&needle.pose, 0.95 * PI));
        assert_eq!(self.get::<Needle>().grips.len(), 2, "both hands have the needle");
        self.open(0);
        self.turn(1, 1.06 * PI, 120);
        let at = self.tip(1);
        self.carry(1, at + Vec3::new(0.02, 0.075, 0.0), 150);
    }

    /// Takes the tail with the right hand.
    fn take_tail(&mut self) {
        let thread: Thread = self.get();
        self.take(0, thread.points[2]);
        assert_eq!(self.get::<Thread>().grips.len(), 1, "the right hand has the tail");
        self.carry(0, Vec3::new(-0.027, 0.0436, 0.0), 60);
    }

    /// The needle once around the strand of the tail, on this side first, and both ends pulled until the knot holds so much, N.
    fn throw(&mut self, side: f32, hold_n: f32) {
        self.carry(0, Vec3::new(-0.027, 0.0436, 0.0), 60);
        let ties = |knots: &Knots| knots.tied.iter().map(|k| k.throws.len()).sum::<usize>();
        let before = ties(&self.get());
        let way =
            [(0.05, 0.03, 0.03), (-0.015, 0.025, 0.06), (-0.06, 0.02, 0.0), (-0.02, 0.02, -0.05), (0.03, 0.025, -0.04), (0.05, 0.025, 0.0)];
        for (x, y, z) in way {
            self.carry(1, Vec3::new(x, y, side * z), 30);
        }
        for step in 0..400 {
            let away = 0.0002 * step as f32;
            self.put(0, Hold { tip: Vec3::new(-0.027 - away, 0.0436, 0.0), roll_rad: 0.0, grip: 1.0 });
            self.carry(1, Vec3::new(0.05 + away, 0.025, 0.0), 1);
            let knots: Knots = self.get();
            if knots.tied.len() == 1 && ties(&knots) > before && knots.tied[0].hold_n >= hold_n {
                return;
            }
        }
        panic!("no throw: {:?}, {:?}", self.get::<Knots>(), self.get::<Bites>().torn);
    }

    /// How far what the two bites hold is apart, m: the middles of their channels, at rest and now.
    fn apart(&self) -> [f32; 2] {
        let bites: Bites = self.get();
        let [a, b] = [0, 1].map(|i| bites.held[i].holes.iter().find(|h| h.kind == HoleKind::Channel).unwrap().clone());
        [a.rest.distance(b.rest), a.anchor.distance(b.anchor)]
    }

    /// Opens both hands and draws the far sides of the flaps apart by this much each.
    fn load(&mut self, by: f32, ticks: u32) -> Vec<Knot> {
        self.open(0);
        self.open(1);
        let mut course = Vec::new();
        for _ in 0..ticks {
            for (flap, side) in [(0, -1.0), (1, 1.0)] {
                let mut attachments = self.app.world_mut().get_mut::<Attachments>(self.flaps[flap]).unwrap();
                for a in attachments.0.iter_mut().filter(|a| a.until_s.is_infinite()) {
                    if let keyhole_whiteboard::Anchor::Space(place) = &mut a.anchor {
                        place.x += side * by / ticks as f32;
                    }
                }
            }
            self.app.update();
            course.push(self.get::<Knots>().tied[0].clone());
        }
        course
    }
}

fn loop_m(knot: &Knot) -> f32 {
    knot.at_m[1] - knot.at_m[0]
}

#[test]
fn a_stitch_draws_two_edges_together_and_its_knot_keeps_them_there() {
    let mut theatre = Theatre::new(0.005, 3000.0);
    theatre.stitch();
    let bites: Bites = theatre.get();
    assert_eq!((bites.held.len(), bites.torn.len()), (2, 0));
    assert_eq!([bites.held[0].organ, bites.held[1].organ], theatre.flaps);
    theatre.take_tail();
    theatre.throw(1.0, 0.1);
    theatre.throw(-1.0, 0.24);
    let knot = theatre.get::<Knots>().tied[0].clone();
    assert_eq!(knot.throws.len(), 2);
    let [rest, tied] = theatre.apart();
    theatre.open(0);
    theatre.open(1);
    for _ in 0..120 {
        theatre.app.update();
    }
    let [_, left] = theatre.apart();
    println!("{rest} m apart at first, {tied} m when tied, {left} m two seconds later; {knot:?}");
    assert!(tied < 0.6 * rest && left < 0.6 * rest, "{rest} m, {tied} m, {left} m");
    assert!((loop_m(&theatre.get::<Knots>().tied[0]) - loop_m(&knot)).abs() < 1e-4, "the knot has not moved");
}

#[test]
fn a_single_throw_slips_under_a_load_that_a_double_one_holds() {
    let slipped = |throws: u32| {
        let mut theatre = Theatre::new(0.005, 3000.0);
        theatre.stitch();
        theatre.take_tail();
        theatre.throw(1.0, 0.1);
        if throws > 1 {
            theatre.throw(-1.0, 0.24);
        }
        let before = theatre.get::<Knots>().tied[0].clone();
        let course = theatre.load(0.006, 180);
        assert!(theatre.get::<Bites>().torn.is_empty() && theatre.get::<Bites>().held.len() == 2);
        println!("{before:?}: the loop from {} m to {} m", loop_m(&before), loop_m(&course[179]));
        loop_m(&course[179]) - loop_m(&before)
    };
    let (single, double) = (slipped(1), slipped(2));
    assert!(single > 0.002, "a single throw slips: {single} m");
    assert!(double.abs() < 1e-4, "a double one holds: {double} m");
}

/// Both hands pull, the one at the tail and the one at the needle, until something gives: the bite with little tissue before it is out, the one farther in is not, and
/// afterwards nothing bears more than it can.
#[test]
fn a_bite_near_the_edge_tears_out_when_it_is_pulled_and_one_farther_in_holds() {
    let pulled = |from_edge: f32| {
        let mut theatre = Theatre::new(from_edge, TEAR_N_M);
        theatre.stitch();
        let bites: Bites = theatre.get();
        assert_eq!((bites.held.len(), bites.torn.len()), (2, 0), "before anybody pulls");
        theatre.take_tail();
        let needle_end = theatre.tip(1);
        let (mut before, mut after) = (0.0f32, 0.0f32);
        for step in 1..=320 {
            let away = 0.04 * step as f32 / 320.0;
            theatre.put(0, Hold { tip: Vec3::new(-0.027, 0.0436, 0.0), roll_rad: 0.0, grip: 1.0 });
            theatre.carry(1, needle_end + away * Vec3::X, 1);
            let bites: Bites = theatre.get();
            let load = bites.held.iter().map(|b| b.load_n).fold(0.0, f32::max);
            let worst = if bites.torn.is_empty() { &mut before } else { &mut after };
            *worst = load.max(*worst);
        }
        println!("{from_edge} m: {:?}, at most {before} N, after a tear {after} N", theatre.get::<Bites>().torn);
        (theatre.get::<Bites>(), before.max(after), *theatre.app.world().resource::<SutureReport>())
    };
    let (near, most, report) = pulled(0.0015);
    assert!(!near.torn.is_empty() && report.torn == near.torn.len() as u64, "{near:?}");
    for torn in &near.torn {
        assert!(torn.load_n > torn.strength_n && (torn.strength_n - TEAR_N_M * torn.depth_m).abs() < 1e-5, "{torn:?}");
    }
    assert!(most < 3.0, "{most} N");
    let (far, most, report) = pulled(0.006);
    assert_eq!((far.held.len(), far.torn.len(), report), (2, 0, SutureReport::default()), "{:?}", far.torn);
    assert!(most > near.torn[0].load_n, "it bears what tore the other one out: {most} N");
}
