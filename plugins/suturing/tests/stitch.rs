//! Needle and thread in an app of their own, on tissue that is written by hand: rigid blocks on springs, whose answer to a pull is known.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_math::{DVec3, Isometry3d, Quat, Vec3};
use bevy_time::{Fixed, Time, TimePlugin, TimeUpdateStrategy};
use keyhole_suturing::{SutureSettings, SuturingPlugin};
use keyhole_tetmesh::TetMesh;
use keyhole_whiteboard::{
    Anchor, Attachments, Bites, Gravity, HoleKind, InstrumentPose, JawPads, Jaws, Knot, Knots, Needle, Organ, SceneRequirements,
    TearResistance, Thread, TickSystems, TissueMesh, TissueState, WhiteboardPlugin,
};
use std::f32::consts::PI;

/// A block from `low` to `high` (m) in cubes of five tetrahedra.
fn block(low: Vec3, high: Vec3, counts: [usize; 3]) -> TetMesh {
    let id = |i: usize, j: usize, k: usize| (i + (counts[0] + 1) * (j + (counts[1] + 1) * k)) as u32;
    let (low, size) = (low.as_dvec3(), (high - low).as_dvec3());
    let mut nodes = Vec::new();
    for k in 0..=counts[2] {
        for j in 0..=counts[1] {
            nodes.extend(
                (0..=counts[0]).map(|i| {
                    low + size * DVec3::new(i as f64 / counts[0] as f64, j as f64 / counts[1] as f64, k as f64 / counts[2] as f64)
                }),
            );
        }
    }
    let mut tets = Vec::new();
    let [nx, ny, _] = counts;
    for (i, j, k) in (0..counts.iter().product()).map(|c: usize| (c % nx, c / nx % ny, c / (nx * ny))) {
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

/// A block that moves as a whole against a spring to where it is at home.
#[derive(Component, Clone, Copy)]
struct Spring {
    /// N/m; infinite: it does not move at all.
    stiffness: f32,
    /// From its rest shape, m.
    home: Vec3,
}

/// Where the attachments of a block and its spring are in balance.
fn settle(mut blocks: Query<(&Spring, &TissueMesh, &mut TissueState, &mut Attachments)>, time: Res<Time<Fixed>>) {
    for (spring, mesh, mut state, mut attachments) in &mut blocks {
        attachments.expire(time.elapsed_secs_f64());
        let (mut pull, mut stiffness) = (Vec3::ZERO, spring.stiffness);
        for a in &attachments.0 {
            let Anchor::Space(anchor) = a.anchor else { continue };
            let home: Vec3 = spring.home + a.point.iter().map(|(n, w)| mesh.0.rest(*n).as_vec3() * *w).sum::<Vec3>();
            pull += (anchor - home) / a.compliance_m_n;
            stiffness += 1.0 / a.compliance_m_n;
        }
        let moved = if stiffness.is_finite() { pull / stiffness } else { Vec3::ZERO };
        for (place, rest) in state.positions.iter_mut().zip(mesh.0.rest_positions()) {
            *place = rest.as_vec3() + spring.home + moved;
        }
    }
}

const PADS: JawPads = JawPads { from_m: 0.003, to_m: 0.019, half_width_m: 0.002, closed_gap_m: 0.0003 };

struct Theatre {
    app: App,
    /// Two needle holders.
    tools: [Entity; 2],
    suture: Entity,
}

impl Theatre {
    /// Blocks with their springs, and a needle whose pose is `pose`, with 15 cm of thread that lies along `tail` (a unit vector) from its swage.
    fn new(blocks: Vec<(TetMesh, f32)>, pose: Isometry3d, tail: Vec3) -> Self {
        let mut app = App::new();
        app.add_plugins((TimePlugin, WhiteboardPlugin, SuturingPlugin))
            .insert_resource(Time::<Fixed>::from_hz(60.0))
            .insert_resource(TimeUpdateStrategy::FixedTimesteps(1))
            .insert_resource(SceneRequirements { tissue: true, instruments: true, suturing: true, ..Default::default() })
            .insert_resource(Gravity(Vec3::ZERO))
            .add_systems(FixedUpdate, settle.in_set(TickSystems::Tissue));
        for (mesh, spring) in blocks {
            app.world_mut().spawn((
                Organ { name: "block".into() },
                TissueState::at_rest(&mesh),
                TissueMesh(mesh),
                Spring { stiffness: spring, home: Vec3::ZERO },
            ));
        }
        let needle = Needle::half_circle_26mm(pose);
        let swage = needle.point(&pose, 0.0);
        let thread = Thread { points: vec![swage + 0.15 * tail, swage], radius_m: 0.00015, ..Default::default() };
        let suture = app.world_mut().spawn((needle, thread)).id();
        let open = Jaws { angle_rad: 0.5 };
        let away = Isometry3d::from_translation(Vec3::splat(10.0));
        let tools = [0, 1].map(|_| app.world_mut().spawn((PADS, open, InstrumentPose { now: away, before: away })).id());
        app.update();
        Self { app, tools, suture }
    }

    fn place(&mut self, tool: usize, now: Isometry3d) {
        let mut pose = self.app.world_mut().get_mut::<InstrumentPose>(self.tools[tool]).unwrap();
        *pose = InstrumentPose { now, before: pose.now };
    }

    fn jaws(&mut self, tool: usize, angle_rad: f32) {
        self.app.world_mut().get_mut::<Jaws>(self.tools[tool]).unwrap().angle_rad = angle_rad;
        self.app.update();
    }

    fn get<C: Component + Clone>(&self) -> C {
        self.app.world().get::<C>(self.suture).unwrap().clone()
    }

    /// Puts jaws so that the middle of their pads is at a place, and closes them there.
    fn take(&mut self, tool: usize, place: Vec3) {
        self.place(tool, Isometry3d::from_translation(place + Vec3::new(0.0, 0.0, 0.011)));
        self.jaws(tool, 0.5);
        self.jaws(tool, 0.0);
    }

    /// Moves what a tool holds from where it is to a place, evenly.
    fn carry(&mut self, tool: usize, to: Vec3, ticks: u32) {
        let from = self.app.world().get::<InstrumentPose>(self.tools[tool]).unwrap().now;
        let end = to + Vec3::new(0.0, 0.0, 0.011);
        for tick in 1..=ticks {
            let at = Vec3::from(from.translation).lerp(end, tick as f32 / ticks as f32);
            self.place(tool, Isometry3d::new(at, from.rotation));
            self.app.update();
        }
    }

    /// Turns the needle by an angle about its own centre, as a wrist does that rolls about it.
    fn turn(&mut self, tool: usize, angle: f32, ticks: u32) {
        let from = self.app.world().get::<InstrumentPose>(self.tools[tool]).unwrap().now;
        let needle: Needle = self.get();
        let centre = Vec3::from(needle.pose.translation);
        let axis = needle.pose.rotation * Vec3::Z;
        for tick in 1..=ticks {
            let turn = Quat::from_axis_angle(axis, angle * tick as f32 / ticks as f32);
            let around = Isometry3d::new(centre - turn * centre, turn);
            self.place(tool, around * from);
            self.app.update();
        }
    }

    /// Takes the needle at its swage third and drives it through the block: its centre is where it is, and its tip at the surface.
    fn stitch(&mut self) {
        let needle: Needle = self.get();
        self.take(0, needle.point(&needle.pose, 0.1));
        assert_eq!(self.get::<Needle>().grips.len(), 1, "the needle is held");
        self.turn(0, 0.9 * PI, 60);
    }
}

/// The needle stands over the block, its tip ahead: the plane of its circle is that of X and Y, driven from -X to X below.
fn over(centre: Vec3) -> Isometry3d {
    // From the swage at +X over the top: the tip at -X, moving down.
    Isometry3d::from_translation(centre)
}

#[test]
fn the_needle_goes_in_and_out_where_its_circle_meets_the_surface() {
    let height = 0.003;
    let mesh = block(Vec3::new(-0.02, -0.02, -0.01), Vec3::new(0.02, 0.0, 0.01), [8, 4, 4]);
    let mut theatre = Theatre::new(vec![(mesh, f32::INFINITY)], over(Vec3::new(0.001, height, 0.0005)), Vec3::X);
    theatre.stitch();
    let (bites, needle): (Bites, Needle) = (theatre.get(), theatre.get());
    assert_eq!(bites.held.len(), 1, "{bites:?}");
    let holes = &bites.held[0].holes;
    assert_eq!(holes.iter().map(|h| h.kind).collect::<Vec<_>>(), [HoleKind::Entry, HoleKind::Channel, HoleKind::Exit]);
    let half = (needle.radius_m * needle.radius_m - height * height).sqrt();
    for (hole, x) in [(&holes[0], -half), (&holes[2], half)] {
        let exact = Vec3::new(0.001 + x, 0.0, 0.0005);
        println!("{:?} off by {:e} m", hole.kind, hole.rest.distance(exact));
        assert!(hole.rest.distance(exact) < 1e-5, "{:?} at {} instead of {exact}", hole.kind, hole.rest);
    }
    let deepest = Vec3::new(0.001, height - needle.radius_m, 0.0005);
    assert!(holes[1].rest.distance(deepest) < 0.002, "{}", holes[1].rest);
    // Drawn back it has not been there.
    theatre.turn(0, -0.9 * PI, 60);
    assert!(theatre.get::<Bites>().held.is_empty());
}

/// Through both blocks with one bite each: the thread's ends, one beyond each block.
fn through_both(gap: f32, spring: f32, from_edge: f32) -> Theatre {
    let block_at = |from: f32, to: f32| block(Vec3::new(from, -0.02, -0.01), Vec3::new(to, 0.0, 0.01), [4, 4, 4]);
    let blocks = vec![(block_at(-0.02, -gap / 2.0), spring), (block_at(gap / 2.0, 0.02), spring)];
    let height = 0.003;
    let half = (0.026f32 / PI).hypot(0.0).powi(2) - height * height;
    let centre = Vec3::new(half.sqrt() - gap / 2.0 - from_edge, height, 0.0005);
    let mut theatre = Theatre::new(blocks, over(centre), Vec3::new(-0.8, 0.6, 0.0));
    theatre.stitch();
    // The second jaws take the tip, the first let go, and the thread is pulled through.
    let needle: Needle = theatre.get();
    theatre.take(1, needle.point(&needle.pose, 0.95 * PI));
    theatre.jaws(0, 0.5);
    theatre.turn(1, 1.1 * PI, 70);
    let needle: Needle = theatre.get();
    let at = needle.point(&needle.pose, 0.95 * PI);
    theatre.carry(1, at + Vec3::new(0.02, 0.08, 0.0), 120);
    theatre
}

/// How far the two blocks are apart, m.
fn gap(theatre: &mut Theatre) -> f32 {
    let world = theatre.app.world_mut();
    let xs = |state: &TissueState| {
        state.positions.iter().map(|p| p.x).fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
    };
    let mut ends: Vec<(f32, f32)> = world.query::<&TissueState>().iter(world).map(xs).collect();
    ends.sort_by(|a, b| a.0.total_cmp(&b.0));
    ends[1].0 - ends[0].1
}

#[test]
fn the_thread_follows_the_needle_through_both_edges_and_pulls_them_together() {
    let mut theatre = through_both(0.004, 60.0, 0.005);
    let (bites, thread): (Bites, Thread) = (theatre.get(), theatre.get());
    assert_eq!((bites.held.len(), bites.torn.len()), (2, 0));
    assert!(bites.held.iter().flat_map(|b| &b.holes).all(|h| h.at_m < thread.length_m), "the needle is through");
    let pulled = gap(&mut theatre);
    assert!(pulled < 0.002, "{pulled} m of 4 mm are left");
}

/// A bite is as strong as there is tissue between it and the edge that it is pulled to.
#[test]
fn a_bite_near_the_edge_tears_out_and_one_farther_in_holds() {
    let torn = |from_edge: f32| {
        let mut theatre = through_both(0.004, 60.0, from_edge);
        let thread: Thread = theatre.get();
        theatre.take(0, thread.points[2]);
        theatre.carry(0, Vec3::new(-0.027, 0.0436, 0.0), 60);
        for _ in 0..4 {
            let place = |t: &Theatre, tool: usize| Vec3::from(t.app.world().get::<InstrumentPose>(t.tools[tool]).unwrap().now.translation);
            let (tail, needle) = (place(&theatre, 0), place(&theatre, 1));
            let down = Vec3::new(0.0, 0.0, 0.011);
            theatre.place(0, Isometry3d::from_translation(tail));
            theatre.carry(1, needle - down + Vec3::new(0.01, 0.0, 0.0), 30);
        }
        theatre.get::<Bites>()
    };
    let near = torn(0.0015);
    let far = torn(0.006);
    for t in &near.torn {
        println!("{t:?}");
        assert!(t.load_n > t.strength_n && (t.strength_n - 300.0 * t.depth_m).abs() < 1e-5);
    }
    assert!(!near.torn.is_empty());
    assert_eq!((far.held.len(), far.torn.len()), (2, 0), "{:?}", far.torn);
    // As much tissue as was left to the edge, and that much more farther in.
    assert!(far.held[0].strength_n > 2.0 * near.torn[0].strength_n);
}

/// Loops the needle around the strand of the tail, in front of it first or behind it, and pulls both ends until the outermost knot holds this, N.
fn throw(theatre: &mut Theatre, side: f32, hold_n: f32) {
    theatre.carry(0, Vec3::new(-0.027, 0.0436, 0.0), 60);
    let way =
        [(0.05, 0.03, 0.03), (-0.015, 0.025, 0.06), (-0.06, 0.02, 0.0), (-0.02, 0.02, -0.05), (0.03, 0.025, -0.04), (0.05, 0.025, 0.0)];
    let ties = |knots: &Knots| knots.tied.iter().map(|k| k.throws.len()).sum::<usize>();
    let before = ties(&theatre.get());
    for (x, y, z) in way {
        theatre.carry(1, Vec3::new(x, y, side * z), 30);
    }
    let winding = theatre.get::<Knots>().winding;
    assert!(winding.abs() > 0.9, "looped {winding} times");
    for step in 0..400 {
        let away = 0.0002 * step as f32;
        theatre.place(0, Isometry3d::from_translation(Vec3::new(-0.027 - away, 0.0436, 0.011)));
        theatre.carry(1, Vec3::new(0.05 + away, 0.025, 0.0), 1);
        let knots: Knots = theatre.get();
        let together = knots.tied.len() == 1 && ties(&knots) > before;
        if together && knots.tied[0].hold_n >= hold_n {
            return;
        }
    }
    panic!("no throw: {:?}, {:?}", theatre.get::<Knots>(), theatre.get::<Bites>().torn);
}

/// Opens the jaws and draws the blocks apart by this much each: load on the stitch, N, and the knot, tick by tick.
fn load(theatre: &mut Theatre, by: f32, ticks: u32) -> Vec<(f32, Knot)> {
    theatre.jaws(0, 0.5);
    theatre.jaws(1, 0.5);
    let away = Isometry3d::from_translation(Vec3::splat(1.0));
    theatre.place(0, away);
    theatre.place(1, away);
    let mut course = Vec::new();
    for tick in 1..=ticks {
        let world = theatre.app.world_mut();
        let mut load = 0.0f32;
        for (mut spring, mesh, state) in world.query::<(&mut Spring, &TissueMesh, &TissueState)>().iter_mut(world) {
            let rest = mesh.0.rest_positions()[0].as_vec3();
            load = load.max((spring.stiffness * (rest + spring.home - state.positions[0])).length());
            spring.home = Vec3::new(by * rest.x.signum(), 0.0, 0.0) * tick as f32 / ticks as f32;
        }
        theatre.app.update();
        course.push((load, theatre.get::<Knots>().tied[0].clone()));
    }
    course
}

/// The loop runs over the gap twice: where holes do not drag at it, a load is twice the tension that the knot has to hold.
#[test]
fn a_single_throw_slips_and_a_double_one_holds() {
    let tied = |throws: usize| {
        let mut theatre = through_both(0.004, 60.0, 0.005);
        // Here it is the knot that is to fail.
        let world = theatre.app.world_mut();
        let organs: Vec<Entity> = world.query_filtered::<Entity, With<Organ>>().iter(world).collect();
        for organ in organs {
            world.entity_mut(organ).insert(TearResistance(3000.0));
        }
        let thread: Thread = theatre.get();
        theatre.take(0, thread.points[2]);
        throw(&mut theatre, 1.0, 0.3);
        if throws > 1 {
            throw(&mut theatre, -1.0, 0.72);
        }
        let mut settings = theatre.app.world_mut().resource_mut::<SutureSettings>();
        (settings.friction, settings.thread_drag_n) = (0.0, 0.005);
        theatre
    };
    let mut single = tied(1);
    let knot = single.get::<Knots>().tied[0].clone();
    assert_eq!(knot.turns(), 1);
    let course = load(&mut single, 0.03, 240);
    let loop_m = |k: &Knot| k.at_m[1] - k.at_m[0];
    let slips = course.iter().position(|(_, k)| loop_m(k) > loop_m(&knot) + 0.002).unwrap();
    let load_n = course[slips].0;
    println!("slips at {load_n} N, holds {} N on each strand", knot.hold_n);
    assert!((load_n / (2.0 * knot.hold_n) - 1.0).abs() < 0.2, "slips at {load_n} N");
    let most = course.iter().map(|(n, _)| *n).fold(0.0, f32::max);
    assert!(most < 1.2 * load_n && loop_m(&course[239].1) > loop_m(&knot) + 0.02, "and goes on slipping: {most} N");

    let mut double = tied(2);
    let knot = double.get::<Knots>().tied[0].clone();
    assert!(knot.throws.len() == 2 && knot.turns() >= 2, "{knot:?}");
    let course = load(&mut double, 0.03, 240);
    let most = course.iter().map(|(n, _)| *n).fold(0.0, f32::max);
    println!("{:?} bears {most} N", knot.throws);
    assert!(most > 1.4 * load_n, "{most} N");
    assert!((loop_m(&course[239].1) - loop_m(&knot)).abs() < 1e-4 && double.get::<Knots>().undone == 0);
    assert!(double.get::<Bites>().torn.is_empty());
}

/// A needle whose tip was inside once dragged tissue along for as far as it was carried, 1 N a millimetre: nothing but whole bites tore out.
#[test]
fn a_needle_that_is_carried_off_sideways_tears_out() {
    let mesh = block(Vec3::new(-0.02, -0.02, -0.01), Vec3::new(0.02, 0.0, 0.01), [8, 4, 4]);
    let mut theatre = Theatre::new(vec![(mesh, f32::INFINITY)], over(Vec3::new(0.001, 0.003, 0.0005)), Vec3::X);
    let needle: Needle = theatre.get();
    theatre.take(0, needle.point(&needle.pose, 0.1));
    theatre.turn(0, 0.35 * PI, 30);
    let bites: Bites = theatre.get();
    assert!(bites.held.len() == 1 && bites.held[0].holes.len() == 1 && bites.torn.is_empty(), "the tip is inside: {bites:?}");
    let mut most = 0.0f32;
    for _ in 0..20 {
        let at = Vec3::from(theatre.app.world().get::<InstrumentPose>(theatre.tools[0]).unwrap().now.translation);
        theatre.carry(0, at - Vec3::new(0.0, 0.0, 0.011) + 0.002 * Vec3::Z, 4);
        most = theatre.get::<Bites>().held.iter().map(|b| b.load_n).fold(most, f32::max);
    }
    let bites: Bites = theatre.get();
    println!("bears {most} N: {:?}", bites.torn);
    assert_eq!((bites.held.len(), bites.torn.len()), (0, 1), "{bites:?}");
    // A centimetre of tissue is beside it.
    assert!((0.3..300.0 * 0.015).contains(&most), "{most} N");
}
