//! Both hands in a device that is not there, through the code of real ones, in the scenes with clips and with needle and thread: a device leads the instruments where
//! the demonstration's script would, and what comes of it is on the whiteboard. Without a device the same is in `clip_scene.rs` and `stitch.rs`.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

mod common {
    pub mod handles;
}

use bevy::prelude::*;
use common::handles::{device, report};
use keyhole::Theatre;
use keyhole::simulation::{Output, Settings, TICKS_PER_SECOND, faults, simulation};
use keyhole_clipping::bleed::flow_ml_min;
use keyhole_instruments::{HandKey, HandTrack, PortFrame, Script, TrocarState, cutting_line, working_reach};
use keyhole_scene::{SceneHand, SceneInstrumentKind};
use keyhole_whiteboard::{
    Anchor, Attachments, Bites, BleedReport, Clip, ClipReport, CutStatus, DeviceCondition, DeviceStatus, Hand, HoleKind, Knots, Needle,
    Organ, SutureReport, Vessel,
};
use std::path::Path;

/// The hands in the order of a report.
const HANDS: [SceneHand; 2] = [SceneHand::Right, SceneHand::Left];

fn load(scene: &str) -> Theatre {
    Theatre::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(scene)).unwrap_or_else(|e| panic!("{e}"))
}

/// The keyframes of both hands in a scene's demonstration.
fn keys(theatre: &Theatre) -> [Vec<HandKey>; 2] {
    let hands = &theatre.scene.demonstration.as_ref().unwrap().hands;
    HANDS.map(|hand| {
        let track = hands.iter().find(|h| h.hand == hand).unwrap();
        let key = |k: &keyhole_scene::HandKeyframe| HandKey {
            time_s: k.time_s,
            tip: Vec3::from_array(k.tip),
            roll_rad: k.roll_deg.to_radians(),
            grip: k.grip,
            active: k.active,
        };
        track.keys.iter().map(key).collect()
    })
}

struct Bench {
    app: App,
}

impl Bench {
    /// A theatre with its instruments in a device whose handles go these ways.
    fn new(mut theatre: Theatre, ways: [Vec<HandKey>; 2]) -> Self {
        let tracks = HANDS.into_iter().zip(ways).map(|(hand, keys)| HandTrack { hand: hand.hand(), keys }).collect();
        let script = Script::new(tracks, Vec::new()).unwrap();
        let led: Vec<(Hand, PortFrame, f32)> = HANDS
            .into_iter()
            .map(|hand| {
                let tool = theatre.scene.instruments.iter().find(|i| i.hand == hand).unwrap();
                let kind = tool.kind.kind();
                let line = cutting_line(kind).map(|of_kind| tool.cutting_line(of_kind));
                (hand.hand(), PortFrame::of(&theatre.scene.port(&tool.port).unwrap()), working_reach(kind, line.as_ref()))
            })
            .collect();
        let states = move |at_s: f64| {
            [0, 1].map(|i: usize| {
                let (hand, frame, reach) = led[i];
                let key = script.hand(hand, at_s).unwrap();
                let told = TrocarState { roll_rad: key.roll_rad, grip: key.grip, pedal: key.active, ..default() };
                frame.reach(key.tip, reach, &told).unwrap()
            })
        };
        // The instruments stand where their handles will be found.
        for (hand, state) in HANDS.into_iter().zip(states(0.0)) {
            let tool = theatre.scene.instruments.iter_mut().find(|i| i.hand == hand).unwrap();
            (tool.yaw_deg, tool.pitch_deg) = (state.yaw_rad.to_degrees(), state.pitch_rad.to_degrees());
            tool.insertion_m = state.insertion_m;
        }
        let mut app = simulation(theatre, Settings { output: Output::None, demonstration: false, ..default() });
        // No plugin is added to a finished app: this one has nothing to finish.
        device(&[0.0..1e6], move |at_s| report(states(at_s))).build(&mut app);
        Self { app }
    }

    fn until(&mut self, seconds: f64) {
        while self.app.world().resource::<Time<Fixed>>().elapsed_secs_f64() < seconds {
            self.app.update();
        }
        assert_eq!((faults(), self.app.world().resource::<DeviceStatus>().0[0].condition), (0, DeviceCondition::Live));
    }

    fn get<R: Resource + Clone>(&self) -> R {
        self.app.world().resource::<R>().clone()
    }

    /// Of the only one that there is.
    fn of<C: Component + Clone>(&mut self) -> C {
        let world = self.app.world_mut();
        world.query::<&C>().single(world).unwrap().clone()
    }
}

/// The left hand sets a clip on each side, the right one cuts between.
#[test]
fn two_handles_clip_an_artery_twice_and_cut_between_the_clips() {
    let theatre = load("clip_and_cut.scene.ron");
    let ways = keys(&theatre);
    let mut bench = Bench::new(theatre, ways);
    bench.until(3.2);
    assert_eq!((bench.get::<ClipReport>(), bench.get::<CutStatus>().fragments), (ClipReport { set: 1, ..default() }, 0));
    bench.until(9.8);
    assert_eq!(bench.get::<ClipReport>(), ClipReport { set: 2, ..default() });
    let world = bench.app.world_mut();
    assert!(world.query::<&Clip>().iter(world).all(|clip| clip.closes == 1.0 && !clip.pairs.is_empty()));
    assert_eq!(bench.get::<CutStatus>().fragments, 1, "the artery is cut through");
    assert_eq!(bench.get::<BleedReport>(), BleedReport::default(), "not a drop");
}

/// The same without the second clip: the end that it would have closed bleeds as what is cut through does by the law, the other one does not.
#[test]
fn without_the_second_clip_the_far_end_bleeds() {
    let theatre = load("clip_and_cut.scene.ron");
    let [mut right, mut left] = keys(&theatre);
    // The left hand goes back when it has set the first clip, and the right one does not wait for a second.
    left.retain(|key| key.time_s < 4.5);
    let back = HandKey { time_s: 4.6, ..left[0] };
    left.push(back);
    right.retain(|key| key.time_s != 0.0);
    right.iter_mut().for_each(|key| key.time_s -= 2.8);
    let mut bench = Bench::new(theatre, [right, left]);
    bench.until(7.0);
    assert_eq!(bench.get::<ClipReport>(), ClipReport { set: 1, ..default() });
    let (bleeding, vessel): (BleedReport, Vessel) = (bench.get(), {
        let world = bench.app.world_mut();
        world.query::<&Vessel>().iter(world).next().unwrap().clone()
    });
    let [site] = bleeding.sites[..] else { panic!("one end is open: {:?}", bleeding.sites) };
    let by_law = flow_ml_min(&vessel.far, std::f64::consts::PI * f64::from(vessel.radius_m).powi(2));
    println!("{site:?}, by the law {by_law} ml/min; {} ml lost", bleeding.lost_ml);
    assert!(site.towards.x < -0.5 && (f64::from(site.rate_ml_min) / by_law - 1.0).abs() < 1e-3, "{site:?}");
    assert!(bleeding.lost_ml > 0.2);
}

/// An artery whose blood comes from the far end alone is cut without a clip; the left hand has a suction in the place of the applier and holds it open in the pool from 4.5 s on. What
/// was lost lies there until then, and is aspirated afterwards; the loss is what it would be without.
#[test]
fn a_pedal_aspirates_what_bleeds() {
    let bled = |pedal: bool| {
        let mut theatre = load("clip_and_cut.scene.ron");
        theatre.scene.organs[0].vessel.as_mut().unwrap().near.supply_ml_min = 0.0;
        let applier = theatre.scene.instruments.iter_mut().find(|i| i.hand == SceneHand::Left).unwrap();
        (applier.kind, applier.clips) = (SceneInstrumentKind::Suction, None);
        let [mut right, _] = keys(&theatre);
        right.retain(|key| key.time_s != 0.0);
        right.iter_mut().for_each(|key| key.time_s -= 6.4);
        let key = |time_s, tip, active| HandKey { time_s, tip, roll_rad: 0.0, grip: 0.0, active };
        // Where blood comes down that leaves the far stump to the left, a millimetre above the bed.
        let (aside, pool) = (Vec3::new(-0.0145, 0.026, 0.04), Vec3::new(-0.004, 0.001, 0.0));
        let left =
            vec![key(0.0, aside, false), key(3.6, aside, false), key(4.3, pool, false), key(4.5, pool, pedal), key(6.0, pool, pedal)];
        let mut bench = Bench::new(theatre, [right, left]);
        bench.until(4.4);
        let before: BleedReport = bench.get();
        assert_eq!(before.aspirated_ml, 0.0);
        bench.until(5.9);
        (before, bench.get::<BleedReport>())
    };
    let (before, taken) = bled(true);
    let (_, left) = bled(false);
    // A little flew elsewhere while the artery was being cut.
    let largest = |report: &BleedReport| report.pools.iter().map(|pool| pool.ml).fold(0.0, f64::max);
    println!(
        "{} ml lost, {} ml aspirated; without {} ml lost, {} ml in the pool",
        taken.lost_ml,
        taken.aspirated_ml,
        left.lost_ml,
        largest(&left)
    );
    assert!(before.lost_ml > 1.0 && largest(&before) > 0.9 * before.lost_ml, "{:?}", before.pools);
    for report in [&before, &taken, &left] {
        let known = report.pooled_ml() + report.aspirated_ml + report.gone_ml;
        assert!((known / report.lost_ml - 1.0).abs() < 1e-6, "{known} ml of {} ml", report.lost_ml);
    }
    // The suction is faster than the bleeding: it leaves no more of the pool than what comes down in a tick.
    let tick_ml = f64::from(left.rate_ml_min) / 60.0 / TICKS_PER_SECOND;
    assert!((taken.aspirated_ml - largest(&left)).abs() < 1.01 * tick_ml, "{taken:?}");
    assert_eq!((left.aspirated_ml, left.lost_ml), (0.0, taken.lost_ml), "no blood is lost less for being aspirated");
}

/// Both hands open and go aside once a knot has been pulled tight at `tied_s`.
fn let_go(way: &mut Vec<HandKey>, tied_s: f64) {
    way.retain(|key| key.time_s <= tied_s);
    let last = *way.last().unwrap();
    let aside = last.tip + Vec3::new(0.01 * last.tip.x.signum(), 0.0, 0.02);
    way.push(HandKey { time_s: tied_s + 0.3, grip: 0.3, ..last });
    way.push(HandKey { time_s: tied_s + 0.8, tip: aside, grip: 0.3, ..last });
}

/// How far what the two bites hold is apart at rest and now, m, and how long the loop of the only knot is, m.
fn edges(bench: &mut Bench) -> ([f32; 2], f32) {
    let (bites, knots): (Bites, Knots) = (bench.of(), bench.of());
    let [a, b] = [0, 1].map(|i| bites.held[i].holes.iter().find(|h| h.kind == HoleKind::Channel).unwrap().clone());
    let knot = &knots.tied[0];
    ([a.rest.distance(b.rest), a.anchor.distance(b.anchor)], knot.at_m[1] - knot.at_m[0])
}

/// How far the far side of each edge is drawn away to try a knot, m.
const DRAWN_M: f32 = 0.025;

/// Two handles stitch both edges and tie so many throws, the last of which is tight at `tied_s`; then the hands let go and the edges are drawn apart. Gives how far apart the bites
/// were at rest, once the hands had let go and at the end, and how far the knot has slipped, m.
fn tied(throws: usize, tied_s: f64) -> ([f32; 3], f32) {
    let theatre = load("stitch.scene.ron");
    let mut ways = keys(&theatre);
    ways.iter_mut().for_each(|way| let_go(way, tied_s));
    let mut bench = Bench::new(theatre, ways);
    bench.until(3.45);
    assert_eq!(bench.of::<Needle>().grips.len(), 2, "from hand to hand");
    bench.until(tied_s + 1.0);
    let (needle, bites, knots): (Needle, Bites, Knots) = (bench.of(), bench.of(), bench.of());
    assert!(needle.grips.is_empty(), "{needle:?}");
    assert_eq!((bites.held.len(), bites.torn.len()), (2, 0), "{bites:?}");
    assert!(knots.tied.len() == 1 && knots.tied[0].throws.len() == throws, "{knots:?}");
    let ([rest, together], loop_m) = edges(&mut bench);
    let ticks = 2.0 * TICKS_PER_SECOND as f32;
    for _ in 0..ticks as u32 {
        let world = bench.app.world_mut();
        for (organ, mut attachments) in world.query::<(&Organ, &mut Attachments)>().iter_mut(world) {
            let side = if organ.name == "left edge" { -1.0 } else { 1.0 };
            for a in attachments.0.iter_mut().filter(|a| a.until_s.is_infinite()) {
                if let Anchor::Space(place) = &mut a.anchor {
                    place.x += side * DRAWN_M / ticks;
                }
            }
        }
        bench.app.update();
    }
    let ([_, pulled], longer_m) = edges(&mut bench);
    println!(
        "{throws} throws: {rest} m apart at rest, {together} m when tied, {pulled} m when pulled; the loop of {loop_m} m slipped to {longer_m} m"
    );
    assert_eq!(bench.get::<SutureReport>(), SutureReport::default());
    ([rest, together, pulled], longer_m - loop_m)
}

/// Both have drawn the edges together when they are left alone.
#[test]
fn two_handles_tie_a_single_throw_that_slips_and_a_double_one_that_holds() {
    let (single, slipped_m) = tied(1, 15.7);
    let (double, held_m) = tied(2, 22.0);
    for [rest, together, _] in [single, double] {
        assert!(together < 0.8 * rest, "{together} m of {rest} m");
    }
    assert!(slipped_m > 0.0004, "a single throw slips: {slipped_m} m");
    assert!(held_m.abs() < 1e-6, "a double one holds: {held_m} m");
    assert!(double[2] < single[2], "{double:?} {single:?}");
}

/// Both hands go where they would with the needle so far to the left, and pull instead of tying. Gives what has become of the bites, and the greatest load on any, N.
fn pulled(to_the_left_m: f32) -> (Bites, f32, SutureReport) {
    let mut theatre = load("stitch.scene.ron");
    theatre.scene.organs.iter_mut().for_each(|edge| edge.tear_n_m = Some(TEAR_N_M));
    let mut ways = keys(&theatre);
    for way in &mut ways {
        way.retain(|key| key.time_s <= 10.2);
        way.iter_mut().for_each(|key| key.tip.x -= to_the_left_m);
    }
    let [_, left] = &mut ways;
    let last = *left.last().unwrap();
    left.push(HandKey { time_s: 12.2, tip: last.tip + Vec3::new(-0.03, 0.0, 0.0), ..last });
    let mut bench = Bench::new(theatre, ways);
    bench.until(10.2);
    let bites: Bites = bench.of();
    assert_eq!((bites.held.len(), bites.torn.len()), (2, 0), "before anybody pulls");
    let mut most = 0.0f32;
    for tenth in 1..=20 {
        bench.until(10.2 + 0.1 * f64::from(tenth));
        most = bench.of::<Bites>().held.iter().map(|b| b.load_n).fold(most, f32::max);
    }
    println!("{to_the_left_m} m to the left: {:?}, at most {most} N", bench.of::<Bites>().torn);
    (bench.of(), most, bench.get())
}

/// Force at which a bite tears out, per length of tissue before it, N/m.
const TEAR_N_M: f32 = 500.0;

#[test]
fn two_handles_tear_out_a_bite_near_the_edge_and_not_one_farther_in() {
    let (near, _, report) = pulled(0.0035);
    assert!(!near.torn.is_empty() && report.torn == near.torn.len() as u64, "{near:?}");
    for torn in &near.torn {
        assert!(torn.load_n > torn.strength_n && (torn.strength_n - TEAR_N_M * torn.depth_m).abs() < 1e-5, "{torn:?}");
    }
    let (far, most, report) = pulled(0.0);
    assert_eq!((far.held.len(), far.torn.len(), report), (2, 0, SutureReport::default()), "{:?}", far.torn);
    assert!(most > near.torn[0].load_n, "it bears what tore the other one out: {most} N");
}
