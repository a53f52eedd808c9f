//! A robot without sense in the default scene: it pushes, pulls and cuts at random, and nothing leaves the finite numbers, fails, grows, is torn out of shape or
//! lies in something else when all is still.
//!
//! `KEYHOLE_ROBOT_SECONDS` (simulated; default 24) and `KEYHOLE_ROBOT_SEED` (default 3: in so short a run not every robot touches everything) choose another run.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use bevy::prelude::*;
use keyhole::simulation::{Output, Settings, TICKS_PER_SECOND, faults, simulation};
use keyhole::{Theatre, theatre::default_scene};
use keyhole_instruments::{HandKey, HandTrack, Script};
use keyhole_tetmesh::components::Components;
use keyhole_tetmesh::{Boundary, NodeId, TetMesh};
use keyhole_tissue::TissueReport;
use keyhole_whiteboard::{
    Anchor, Attachments, Contacts, CutStatus, FreedFrom, Hand, InstrumentPose, Obstacle, Organ, Port, ScriptClock, TickCost, TickSystems,
    TissueMesh, TissueState,
};
use proptest::prelude::RngExt;
use proptest::test_runner::{RngAlgorithm, TestRng};
use std::collections::HashMap;

/// Thickness of what a slice takes off, m.
const SLICE_M: f32 = 0.012;
/// Seconds at the end of each minute, or of a shorter run, in which the hands are away and nothing is asked of the tissue.
const REST_S: f64 = 4.0;
/// How far in a tool stays that is drawn back, m.
const WITHDRAWN_M: f32 = 0.05;
/// How deep a point may be in something when the hands have been away for so long, m.
const DEEPEST_AT_REST_M: f32 = 0.002;
/// How many times as long as at rest an organ or a piece may be.
const MOST_STRETCHED: f32 = 2.0;
/// Cuts are made in the first half only: in the second the meshes stay as they are, and so must the memory.
const CUTTING_SHARE: f64 = 0.5;

fn variable<T: std::str::FromStr>(name: &str, default: T) -> T {
    std::env::var(name).ok().map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name}={text}: expected a number")))
}

/// Resident memory of this process, bytes; `None` where the system does not tell.
fn resident_bytes() -> Option<u64> {
    let pages: u64 = std::fs::read_to_string("/proc/self/statm").ok()?.split_whitespace().nth(1)?.parse().ok()?;
    Some(pages * 4096)
}

/// So many strokes it makes when it begins, and then one a minute: faster, there would soon be nothing left to push and to pull.
const FIRST_STROKES: u32 = 3;
/// Most nodes of a crumb. One that has come about in the last ticks is measured against the organ that it was a part of: a strand is drawn long by what hangs on it before
/// it parts.
const CRUMB: usize = 64;
/// For how many ticks.
const SETTLING: u64 = 20;

struct Robot {
    rng: TestRng,
    tips: [Vec3; 2],
}

/// Points of an organ's surface with their outward normals.
struct Skin {
    points: Vec<(Vec3, Vec3)>,
    centre: Vec3,
}

impl Skin {
    fn of(mesh: &TissueMesh, state: &TissueState) -> Self {
        let points: Vec<(Vec3, Vec3)> = Boundary::of(&mesh.0)
            .triangles
            .iter()
            .filter_map(|t| {
                let [a, b, c] = t.map(|n| state.position(n));
                Some(((a + b + c) / 3.0, (b - a).cross(c - a).try_normalize()?))
            })
            .collect();
        let centre = points.iter().map(|p| p.0).sum::<Vec3>() / points.len() as f32;
        Self { points, centre }
    }
}

impl Robot {
    fn direction(&mut self) -> Vec3 {
        loop {
            let v = Vec3::from_array([0; 3].map(|_| self.rng.random_range(-1.0..1.0_f32)));
            if v.length() > 0.1 && v.length() < 1.0 {
                return v.normalize();
            }
        }
    }

    /// A point of the surface that can be come to from a port.
    fn spot(&mut self, skin: &Skin, port: Vec3) -> (Vec3, Vec3) {
        for _ in 0..1000 {
            let (point, normal) = skin.points[self.rng.random_range(0..skin.points.len())];
            if normal.dot((port - point).normalize()) > 0.4 && point.distance(port) > 1.2 * WITHDRAWN_M {
                return (point, normal);
            }
        }
        skin.points[0]
    }

    /// Into the tissue and out again.
    fn push(&mut self, skin: &Skin, port: Vec3) -> Vec<(f64, Vec3, f32, bool)> {
        let (point, normal) = self.spot(skin, port);
        let aside = 0.01 * self.direction();
        let grip = self.rng.random_range(0.0..1.0);
        vec![
            (0.8, point + 0.02 * normal, grip, false),
            (1.8, point - 0.008 * normal + aside, grip, false),
            (2.8, point + 0.03 * normal, grip, false),
        ]
    }

    /// Jaws around a bit of tissue, a pull somewhere, and open.
    fn pull(&mut self, skin: &Skin, port: Vec3) -> Vec<(f64, Vec3, f32, bool)> {
        let (point, normal) = self.spot(skin, port);
        let away = point + 0.015 * (normal + self.direction());
        vec![
            (0.7, point + 0.015 * normal, 0.0, false),
            (1.1, point - 0.003 * normal, 0.0, false),
            (1.4, point - 0.003 * normal, 1.0, false),
            (2.2, away, 1.0, false),
            (2.5, away, 0.0, false),
            (2.9, point + 0.03 * normal, 0.0, false),
        ]
    }

    /// A sweep through the tissue in a plane through the port that takes a slice off.
    fn slice(&mut self, skin: &Skin, port: Vec3) -> Vec<(f64, Vec3, f32, bool)> {
        let axis = (skin.centre - port).normalize();
        let across = self.direction().reject_from(axis).normalize();
        let support = |turn: f32| {
            let normal = across * turn.cos() - axis * turn.sin();
            (skin.points.iter().map(|p| normal.dot(p.0 - port)).fold(f32::NEG_INFINITY, f32::max), normal)
        };
        let (mut low, mut high) = (-1.2, 1.2);
        for _ in 0..40 {
            let middle = (low + high) / 2.0;
            if support(middle).0 > SLICE_M { low = middle } else { high = middle }
        }
        let normal = support(low).1;
        let beyond: Vec<Vec3> = skin.points.iter().map(|p| p.0 - port).filter(|p| normal.dot(*p) > 0.0).collect();
        let along = beyond.iter().sum::<Vec3>().reject_from(normal).normalize();
        let aside = normal.cross(along);
        let angles = beyond.iter().map(|p| p.dot(aside).atan2(p.dot(along)));
        let (from, to) = angles.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), a| (l.min(a), h.max(a)));
        let reach = beyond.iter().map(|p| p.length()).fold(0.0, f32::max) + 0.008;
        let at = |share: f32| {
            let angle = from - 0.1 + share * (to - from + 0.2);
            port + reach * (along * angle.cos() + aside * angle.sin())
        };
        let mut keys = vec![(0.8, at(0.0) - 0.04 * (at(0.0) - port).normalize(), 0.0, false), (1.2, at(0.0), 0.0, true)];
        keys.extend((1..=6).map(|k| (1.2 + 0.25 * f64::from(k), at(k as f32 / 6.0), 0.0, k < 6)));
        keys.push((2.9, at(1.0) - 0.04 * (at(1.0) - port).normalize(), 0.0, false));
        keys
    }

    /// The blade dips into the tissue and is drawn along it.
    fn incise(&mut self, skin: &Skin, port: Vec3) -> Vec<(f64, Vec3, f32, bool)> {
        let (point, normal) = self.spot(skin, port);
        let along = 0.012 * self.direction().reject_from(normal).normalize_or(normal.any_orthonormal_vector());
        let deep = point - self.rng.random_range(0.004..0.012) * normal;
        vec![
            (0.8, point + 0.01 * normal - along, 0.0, false),
            (1.0, point + 0.005 * normal - along, 0.0, true),
            (1.4, deep - along, 0.0, true),
            (2.0, deep + along, 0.0, true),
            (2.4, point + 0.01 * normal + along, 0.0, false),
        ]
    }

    /// From one action to the next a hand draws its tool back through the port, turns it there and goes in again, as hands do: straight from place to place it may pass its own
    /// port, and a shaft that turns about there is swung round faster than any hand.
    fn track(&mut self, hand: Hand, port: Vec3, keys: Vec<(f64, Vec3, f32, bool)>) -> HandTrack {
        let tip = &mut self.tips[usize::from(hand == Hand::Right)];
        let (begin, (first_s, first)) = (*tip, (keys[0].0, keys[0].1));
        *tip = keys.last().unwrap().1;
        let drawn_back = |from: Vec3| port + (from - port).clamp_length_max(WITHDRAWN_M);
        let way = [(0.0, begin), (0.35 * first_s, drawn_back(begin)), (0.7 * first_s, drawn_back(first))];
        let key = |(time_s, tip, grip, active)| HandKey { time_s, tip, roll_rad: 0.0, grip, active };
        HandTrack { hand, keys: way.map(|(time_s, tip)| (time_s, tip, 0.0, false)).into_iter().chain(keys).map(key).collect() }
    }
}

/// What was seen.
#[derive(Debug, Default)]
struct Tally {
    with_instruments: u64,
    with_anatomy: u64,
    with_organs: u64,
    with_themselves: u64,
    deepest_at_rest_m: f32,
    deepest_at_rest: String,
    most_stretched: f32,
    stretched: String,
    most_tets: usize,
}

#[test]
fn a_random_robot_breaks_nothing() {
    let seconds: f64 = variable("KEYHOLE_ROBOT_SECONDS", 24.0);
    let seed: u64 = variable("KEYHOLE_ROBOT_SEED", 3);
    let mut app = simulation(Theatre::load(&default_scene().unwrap()).unwrap(), Settings { output: Output::None, ..Settings::default() });
    app.insert_resource(Script::default());
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&seed.to_le_bytes());
    let world = app.world_mut();
    let ports: Vec<(Hand, Vec3)> = world.query::<(&Hand, &Port)>().iter(world).map(|(h, p)| (*h, p.position)).collect();
    let port = |hand| ports.iter().find(|p| p.0 == hand).unwrap().1;
    let home = [Hand::Left, Hand::Right].map(|hand| port(hand) * 0.6);
    let mut robot = Robot { rng: TestRng::from_seed(RngAlgorithm::ChaCha, &bytes), tips: home };
    let mut tally = Tally::default();
    let mut memory: Vec<(f64, Option<u64>, usize)> = Vec::new();
    let ticks = (seconds * TICKS_PER_SECOND) as u64;
    let (act, minute) = ((3.0 * TICKS_PER_SECOND) as u64, (60.0 * TICKS_PER_SECOND).min(ticks as f64) as u64);
    let rest = (REST_S * TICKS_PER_SECOND) as u64;
    let mut parts = HashMap::new();
    for tick in 0..ticks {
        let resting = tick % minute >= minute - rest;
        if resting && tick % minute == minute - rest {
            let leave =
                |robot: &mut Robot, hand| robot.track(hand, port(hand), vec![(0.5, home[usize::from(hand == Hand::Right)], 0.0, false)]);
            let tracks = vec![leave(&mut robot, Hand::Left), leave(&mut robot, Hand::Right)];
            perform(&mut app, tracks);
        } else if (tick % minute).is_multiple_of(act) && tick % minute + act <= minute - rest {
            // What is begun is ended before the rest: a hand that was called away in the middle would jump.
            let world = app.world_mut();
            let mut organs: Vec<Entity> = world.query_filtered::<Entity, With<Organ>>().iter(world).collect();
            organs.sort_unstable();
            // Mostly the organ, sometimes a piece of it.
            let whole = world.query_filtered::<Entity, (With<Organ>, Without<FreedFrom>)>().single(world).unwrap();
            let piece = organs[robot.rng.random_range(0..organs.len())];
            let chosen = if robot.rng.random_range(0..4) == 0 { piece } else { whole };
            let of = |e: Entity, world: &World| Skin::of(world.get::<TissueMesh>(e).unwrap(), world.get::<TissueState>(e).unwrap());
            let (skin, organ) = (of(chosen, app.world()), of(whole, app.world()));
            let strokes = app.world().resource::<CutStatus>().strokes;
            let cuts = (tick as f64) < CUTTING_SHARE * ticks as f64 && strokes < FIRST_STROKES + (tick / minute) as u32;
            let right = match robot.rng.random_range(0..4) {
                0 if cuts => robot.slice(&organ, port(Hand::Right)),
                1 if cuts => robot.incise(&organ, port(Hand::Right)),
                _ => robot.push(&skin, port(Hand::Right)),
            };
            let left =
                if robot.rng.random_range(0..3) == 0 { robot.push(&skin, port(Hand::Left)) } else { robot.pull(&skin, port(Hand::Left)) };
            let tracks = vec![robot.track(Hand::Left, port(Hand::Left), left), robot.track(Hand::Right, port(Hand::Right), right)];
            perform(&mut app, tracks);
        }
        app.update();
        assert_eq!(faults(), 0, "a system failed in tick {tick}");
        let still = tick % minute + 1 == minute;
        look(&mut app, tick, still, &mut parts, &mut tally);
        if still || tick + 1 == ticks {
            let world = app.world_mut();
            let tets = world.query::<&TissueMesh>().iter(world).map(|m| m.0.tet_count()).sum();
            memory.push((tick as f64 / TICKS_PER_SECOND, resident_bytes(), tets));
            println!("after {} of {ticks} ticks: {tally:?}", tick + 1);
        }
    }
    let status = app.world().resource::<CutStatus>();
    println!("{seconds} s, seed {seed}: {tally:?}, {} strokes, {} fragments", status.strokes, status.fragments);
    let cost = app.world().resource::<TickCost>();
    let stages = TickSystems::ALL.iter().zip(cost.total.iter().zip(&cost.max));
    let stages: Vec<String> = stages
        .map(|(set, (total, max))| {
            format!("{set:?} {:.2} (largest {:.1})", total.as_secs_f64() * 1e3 / cost.ticks as f64, max.as_secs_f64() * 1e3)
        })
        .collect();
    println!("ms a tick: {}", stages.join(", "));
    for (time_s, bytes, tets) in &memory {
        println!("{time_s:6.1} s: {tets} tetrahedra, {} MiB", bytes.map_or("unknown".into(), |b| (b >> 20).to_string()));
    }
    assert!(app.world().resource::<TissueReport>().quarantined.is_empty(), "an organ left the finite numbers");
    for (what, count) in
        [("tool", tally.with_instruments), ("anatomy", tally.with_anatomy), ("organ", tally.with_organs), ("itself", tally.with_themselves)]
    {
        assert!(count > 0, "no contact with {what} in {seconds} s");
    }
    assert!(status.strokes > 0 && status.fragments > 0, "{status:?}");
    assert!(tally.deepest_at_rest_m <= DEEPEST_AT_REST_M, "{} m at rest: {}", tally.deepest_at_rest_m, tally.deepest_at_rest);
    // The meshes of the second half do not change; a run of a minute has only one measurement.
    let settled: Vec<u64> = memory.iter().filter(|m| m.0 > CUTTING_SHARE * seconds + 60.0).filter_map(|m| m.1).collect();
    if let (Some(first), Some(last)) = (settled.first(), settled.last()) {
        assert!(*last as f64 <= 1.02 * *first as f64, "memory grew from {first} to {last} bytes while nothing was cut");
    }
}

/// What of a mesh hangs together: what a stroke has cut off belongs to the mesh until the tool has left.
struct Part {
    /// Ascending.
    nodes: Vec<NodeId>,
    /// Diagonal of its box at rest, m.
    extent_m: f32,
}

/// The parts of an organ, since when, and of how many nodes and tetrahedra.
#[derive(Default)]
struct Parts {
    counts: (usize, usize),
    since: u64,
    /// Diagonal of the organ's box at rest, m.
    extent_m: f32,
    all: Vec<Part>,
}

impl Part {
    fn all_of(mesh: &TetMesh) -> Vec<Self> {
        let components = Components::of(mesh);
        let mut nodes = vec![Vec::new(); components.len()];
        for (tet, corners) in mesh.iter() {
            nodes[components.component(tet) as usize].extend(corners);
        }
        nodes
            .into_iter()
            .map(|mut nodes| {
                nodes.sort_unstable();
                nodes.dedup();
                Self { extent_m: diagonal(nodes.iter().map(|n| mesh.rest(*n).as_vec3())), nodes }
            })
            .collect()
    }
}

/// Diagonal of the box around points, m; zero where there are none.
fn diagonal(points: impl Iterator<Item = Vec3>) -> f32 {
    let (low, high) = points.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
    if low.cmple(high).all() { low.distance(high) } else { 0.0 }
}

/// Where an anchor is, m.
fn place(anchor: &Anchor, poses: &HashMap<Entity, InstrumentPose>) -> Option<Vec3> {
    match anchor {
        Anchor::Space(at) => Some(*at),
        Anchor::Tool { instrument, local } => poses.get(instrument).map(|pose| pose.now.transform_point(*local).into()),
    }
}

fn perform(app: &mut App, tracks: Vec<HandTrack>) {
    let script = Script::new(tracks, Vec::new()).unwrap();
    app.insert_resource(ScriptClock { end_s: script.end_s(), ..default() });
    app.insert_resource(script);
    app.world_mut().resource_mut::<keyhole_whiteboard::SimulationControl>().demonstration = true;
}

fn look(app: &mut App, tick: u64, still: bool, parts: &mut HashMap<Entity, Parts>, tally: &mut Tally) {
    let world = app.world_mut();
    let mut tets = 0;
    let poses: HashMap<Entity, InstrumentPose> = world.query::<(Entity, &InstrumentPose)>().iter(world).map(|(e, p)| (e, *p)).collect();
    let mut organs = world.query::<(Entity, &Organ, &TissueMesh, &TissueState, &Contacts, &Attachments)>();
    for (entity, organ, mesh, state, contacts, attachments) in organs.iter(world) {
        tets += mesh.0.tet_count();
        let finite = mesh.0.nodes().all(|n| state.position(n).is_finite() && state.velocities[n.index()].is_finite());
        assert!(finite, "{} is not finite in tick {tick}", organ.name);
        let known = parts.entry(entity).or_default();
        let counts = (mesh.0.node_count(), mesh.0.tet_count());
        if known.counts != counts {
            let extent_m = diagonal(mesh.0.nodes().map(|n| mesh.0.rest(n).as_vec3()));
            *known = Parts { counts, since: tick, extent_m, all: Part::all_of(&mesh.0) };
        }
        for part in &known.all {
            let has_just_parted = part.nodes.len() <= CRUMB && tick - known.since < SETTLING;
            // What is held at both ends is as long as its holders are apart.
            let held = attachments.0.iter().filter(|a| a.point.iter().all(|(n, _)| part.nodes.binary_search(n).is_ok()));
            let anchors: Vec<Vec3> = held.filter_map(|a| place(&a.anchor, &poses)).collect();
            let own = if has_just_parted { known.extent_m } else { part.extent_m };
            let allowed = own.max(diagonal(anchors.iter().copied()));
            let stretched = diagonal(part.nodes.iter().map(|n| state.position(*n))) / allowed;
            let described = || format!("{} nodes of {} of {} tetrahedra in tick {tick}", part.nodes.len(), organ.name, mesh.0.tet_count());
            assert!(stretched <= MOST_STRETCHED, "{stretched} times: {}", described());
            if stretched > tally.most_stretched && !has_just_parted {
                tally.most_stretched = stretched;
                tally.stretched = described();
            }
        }
        for contact in &contacts.0 {
            match contact.against {
                Obstacle::Instrument(_) => tally.with_instruments += 1,
                Obstacle::Anatomy(_) => tally.with_anatomy += 1,
                Obstacle::Organ { .. } => tally.with_organs += 1,
                Obstacle::Own(_) => tally.with_themselves += 1,
            }
            if still && contact.depth_m > tally.deepest_at_rest_m {
                tally.deepest_at_rest_m = contact.depth_m;
                tally.deepest_at_rest = format!("{} in {:?}", organ.name, contact.against);
            }
        }
    }
    tally.most_tets = tally.most_tets.max(tets);
}
