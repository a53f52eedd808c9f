//! What contacts do to bodies, by known answers.

use crate::finder::{DT, Ground, Thing, entity, tick};
use bevy_math::Vec3;
use keyhole_tetmesh::{DVec3, TetMesh};
use keyhole_tissue::beam::{GRAVITY, block};
use keyhole_tissue::{TeschnerSettings, TissueModel, TissueSettings, VbdSettings, XpbdSettings};

/// No sleep, no drag.
fn settings() -> TissueSettings {
    TissueSettings { sleep: false, drag_1_s: 0.0, ..Default::default() }
}

/// A cube that is dropped on the ground comes to rest on it without being thrown back, the ground carries its weight, and it never has more energy than it
/// had, whatever it is made of.
#[test]
fn a_dropped_cube_comes_to_rest() {
    for young in [1e3, 1e4, 1e6] {
        let ground = Ground::level(0.3);
        let mut cube = [Thing::cube(1, Vec3::new(0.0, 0.03, 0.0), young)];
        let weight = cube[0].mass() * 9.81;
        let total = |t: &Thing| t.energy() + f64::from(weight * (t.middle().y - 0.01));
        let start = total(&cube[0]);
        let mut most = start;
        let mut highest = f32::NEG_INFINITY;
        for i in 0..120 {
            tick(&mut cube, &[ground], None, GRAVITY, &settings());
            let now = total(&cube[0]);
            assert!(now <= most + 1e-3 * start, "{young} Pa, tick {i}: {now} J after {most}");
            most = most.min(now);
            highest = highest.max(cube[0].velocity().y);
        }
        // It lands with 0.6 m/s. What is soft springs back by what it has been pressed together.
        assert!(highest < if young > 5e3 { 0.05 } else { 0.1 }, "{young} Pa: thrown back with {highest} m/s");
        let lifted = cube[0].force_from(ground.entity);
        assert!((lifted - Vec3::Y * weight).length() < 0.01 * weight, "{young} Pa: {lifted} N of {weight}");
    }
}

/// On an incline with less than the angle of friction a cube stays where it is, for good; with more it slides as fast as it should.
#[test]
fn an_incline_holds_or_lets_slide() {
    for (mu, degrees) in [(0.1_f32, 4.0_f32), (0.1, 15.0), (0.3, 14.0), (0.3, 30.0), (0.5, 24.0), (0.5, 35.0)] {
        let angle = degrees.to_radians();
        let gravity = Vec3::new(angle.sin(), -angle.cos(), 0.0) * 9.81;
        let ground = Ground::level(mu);
        let mut cube = [Thing::cube(1, Vec3::new(0.0, 0.01, 0.0), 1e5)];
        let run = |cube: &mut [Thing], ticks: u32| {
            (0..ticks).for_each(|_| tick(cube, &[ground], None, gravity, &settings()));
            (cube[0].middle().x, cube[0].velocity().x)
        };
        run(&mut cube, 60);
        let (from, slow) = run(&mut cube, 30);
        let (to, fast) = run(&mut cube, 60);
        let pull = 9.81 * (angle.sin() - mu * angle.cos());
        let measured = (fast - slow) / (60.0 * DT);
        if pull < 0.0 {
            assert!((to - from).abs() < 1e-6, "mu {mu}, {degrees} degrees: crept {} m in a second", to - from);
        } else {
            assert!((measured / pull - 1.0).abs() < 0.04, "mu {mu}, {degrees} degrees: {measured} m/s2 of {pull}");
        }
    }
}

/// Three cubes of different stiffness on each other come to rest, and each interface carries the weight above it.
#[test]
fn a_stack_comes_to_rest() {
    let ground = Ground::level(0.3);
    let mut stack: Vec<Thing> = [(1e4, 0.0105), (1e5, 0.0312), (3e3, 0.0519)]
        .iter()
        .enumerate()
        .map(|(i, (young, y))| Thing::cube(1 + i as u32, Vec3::new(0.0003 * i as f32, *y, 0.0002 * i as f32), *young))
        .collect();
    for _ in 0..180 {
        tick(&mut stack, &[ground], Some((Vec3::Y, 0.3)), GRAVITY, &settings());
    }
    let weight = stack[0].mass() * 9.81;
    let carried = [stack[0].force_from(ground.entity).y, stack[1].force_from(stack[0].organ).y, stack[2].force_from(stack[1].organ).y];
    for (at, carried) in carried.into_iter().enumerate() {
        let above = weight * (3 - at) as f32;
        assert!((carried - above).abs() < 0.02 * above, "interface {at}: {carried} N of {above}");
    }
    for t in &stack {
        assert!(t.velocity().length() < 2e-3, "{} m/s", t.velocity());
    }
    let back = -stack[1].force_from(stack[2].organ);
    assert!((stack[2].force_from(stack[1].organ) - back).length() < 1e-3 * weight, "both sides list the same force");
}

/// Two cubes that meet in free space keep the momentum that they have together, and do not go through each other.
#[test]
fn what_meets_in_free_space_keeps_its_momentum() {
    let mut pair = [Thing::cube(1, Vec3::ZERO, 1e4), Thing::cube(2, Vec3::new(0.0215, 0.004, 0.003), 4e4)];
    pair[0].state.velocities.fill(Vec3::new(0.06, 0.0, 0.0));
    pair[1].state.velocities.fill(Vec3::new(-0.04, 0.01, 0.0));
    let momentum = |pair: &[Thing]| pair[0].body.momentum(&pair[0].state).plus(pair[1].body.momentum(&pair[1].state));
    let energy = |pair: &[Thing]| pair[0].energy() + pair[1].energy();
    let (before, had) = (momentum(&pair), energy(&pair));
    let (mut most, mut met) = (had, 0);
    for _ in 0..40 {
        tick(&mut pair, &[], Some((Vec3::X, 0.3)), Vec3::ZERO, &settings());
        met += pair[0].contacts.0.len();
        let now = energy(&pair);
        // What is found inside has been let in by the tick: a part of that is given back.
        assert!(now <= most + 0.1 * had, "{now} J after {most}");
        most = most.min(now);
    }
    let after = momentum(&pair);
    assert!(met > 0);
    assert!((after.linear - before.linear).length() < 1e-6 * before.scale, "{} from {}", after.linear, before.linear);
    // In flight each is stepped as it was, which keeps it to the order of the step.
    let arm = 0.02 * before.scale;
    assert!((after.angular - before.angular).length() < 0.04 * arm, "{} from {}", after.angular, before.angular);
    // Plastic: what is left of the velocity with which they met is what soft cubes give back.
    assert!((pair[1].velocity() - pair[0].velocity()).x > -0.01, "{} {}", pair[0].velocity(), pair[1].velocity());
}

/// What begins 5 mm deep is pushed apart without being thrown: never faster than that depth by the time of the damper.
#[test]
fn what_begins_deep_is_pushed_apart_gently() {
    let mut pair = [Thing::cube(1, Vec3::ZERO, 1e4), Thing::cube(2, Vec3::new(0.0, 0.015, 0.0), 1e4)];
    let mut fastest = 0.0_f32;
    for _ in 0..60 {
        tick(&mut pair, &[], Some((Vec3::Y, 0.1)), Vec3::ZERO, &settings());
        fastest = fastest.max((pair[1].velocity() - pair[0].velocity()).length());
    }
    let apart = pair[1].middle().y - pair[0].middle().y;
    let left: f64 = pair.iter().map(Thing::energy).sum();
    let pressed = 1e4 * 0.02 * 0.02 * 0.005 * 0.005 / 0.02 / 2.0;
    assert!(apart > 0.0195, "still {apart} m apart");
    assert!(fastest < 0.005 / 0.03, "{fastest} m/s");
    assert!(left < 0.25 * pressed, "{left} J of {pressed}");

    // Sunk into the ground by a quarter, under gravity: it comes up, and is not thrown up.
    let ground = Ground::level(0.3);
    let mut cube = [Thing::cube(1, Vec3::new(0.0, 0.005, 0.0), 1e4)];
    let mut highest = 0.0_f32;
    for _ in 0..90 {
        tick(&mut cube, &[ground], None, GRAVITY, &settings());
        highest = highest.max(cube[0].middle().y);
    }
    assert!(highest < 0.0102 && cube[0].middle().y > 0.0097, "{highest} {}", cube[0].middle().y);
}

/// A tool at 5 m/s takes tissue along; crushed between two of them it stays finite, and comes back when they let go.
#[test]
fn tissue_gives_way_to_a_tool_and_comes_back() {
    let mut cube = [Thing::cube(1, Vec3::ZERO, 1e4)];
    let mut wall = Ground { point: Vec3::new(-0.012, 0.0, 0.0), normal: Vec3::X, velocity: Vec3::X * 5.0, ..Ground::level(0.3) };
    for _ in 0..6 {
        tick(&mut cube, &[wall], None, Vec3::ZERO, &settings());
        wall.point += wall.velocity * DT;
    }
    let least = cube[0].state.positions.iter().map(|x| x.x).fold(f32::INFINITY, f32::min);
    // What has been hit within a tick is on its way out.
    assert!(least > wall.point.x - 0.004, "{least} m, the wall is at {}", wall.point.x);

    let mut cube = [Thing::cube(1, Vec3::ZERO, 1e4)];
    let mut walls = [-1.0_f32, 1.0].map(|s| Ground {
        entity: entity(1001 + (s > 0.0) as u32),
        point: Vec3::X * (s * 0.0102),
        normal: Vec3::X * -s,
        velocity: Vec3::X * (-s * 0.1),
        friction: 0.3,
    });
    let mut most = 0.0_f64;
    for i in 0..40 {
        // Together until 2 mm are left, then apart.
        let away = if i < 5 { 1.0 } else { -5.0 };
        for wall in &mut walls {
            wall.velocity = wall.normal * 0.1 * away;
        }
        tick(&mut cube, &walls, None, Vec3::ZERO, &settings());
        most = most.max(cube[0].energy());
        for wall in &mut walls {
            wall.point += wall.velocity * DT;
        }
    }
    let shape = cube[0].body.elastic_energy(&cube[0].state);
    assert!(most.is_finite() && shape < 1e-3 * most, "{shape} J left of {most}");
}

/// The other models: a cube comes to rest with its weight on the ground, stays on a slope that holds it and slides on one that does not. Their bounds are looser.
#[test]
fn the_other_models_answer_contacts() {
    let models = [
        TissueModel::Xpbd(XpbdSettings::default()),
        TissueModel::Vbd(VbdSettings::default()),
        TissueModel::Teschner(TeschnerSettings::default()),
    ];
    for model in models {
        for (mu, degrees) in [(0.3_f32, 0.0_f32), (0.3, 10.0), (0.3, 30.0)] {
            let angle = degrees.to_radians();
            let gravity = Vec3::new(angle.sin(), -angle.cos(), 0.0) * 9.81;
            let ground = Ground::level(mu);
            let mut cube = Thing::cube(1, Vec3::new(0.0, 0.01, 0.0), 1e4);
            let mut state = cube.model(model);
            let (mut slow, mut lifted) = ((0.0, 0.0), Vec3::ZERO);
            for i in 0..90 {
                let mut contacts = Vec::new();
                ground.find(&cube, &mut contacts);
                state.step_touching(&mut cube.body, &mut cube.state, &[], &mut contacts, gravity, DT, &settings());
                cube.contacts.0 = contacts;
                if i == 29 {
                    slow = (cube.middle().x, cube.velocity().x);
                }
                if i > 29 {
                    lifted += cube.force_from(ground.entity) / 60.0;
                }
            }
            let weight = cube.mass() * 9.81 * angle.cos();
            let measured = (cube.velocity().x - slow.1) / (60.0 * DT);
            let pull = 9.81 * (angle.sin() - mu * angle.cos());
            assert!((lifted.y / weight - 1.0).abs() < 0.2, "{}: {lifted} N of {weight}", model.name());
            if pull < 0.0 {
                assert!((cube.middle().x - slow.0).abs() < 5e-4, "{}: crept {} m", model.name(), cube.middle().x - slow.0);
            } else {
                assert!((measured / pull - 1.0).abs() < 0.3, "{}: {measured} m/s2 of {pull}", model.name());
            }
        }
    }
}

/// The same bits on one thread and on two.
#[test]
fn contacts_are_the_same_on_any_number_of_threads() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let ground = Ground::level(0.3);
            let mut stack = [Thing::cube(1, Vec3::new(0.0, 0.0102, 0.0), 1e4), Thing::cube(2, Vec3::new(0.001, 0.0303, 0.0), 5e4)];
            for _ in 0..12 {
                tick(&mut stack, &[ground], Some((Vec3::Y, 0.3)), GRAVITY, &settings());
            }
            stack.map(|t| (t.state, t.contacts))
        })
    };
    assert_eq!(run(1), run(2));
}

/// A stack at rest falls asleep with the forces at its contacts, stays as it is to the bit, and wakes when the ground moves.
#[test]
fn a_stack_sleeps_and_wakes() {
    let mut ground = Ground::level(0.3);
    let asleep = TissueSettings::default();
    let mut stack = [Thing::cube(1, Vec3::new(0.0, 0.0102, 0.0), 1e4), Thing::cube(2, Vec3::new(0.0, 0.0303, 0.0), 1e4)];
    let slept = (0..600).any(|_| {
        tick(&mut stack, &[ground], Some((Vec3::Y, 0.3)), GRAVITY, &asleep);
        stack.iter().all(|t| t.body.sleeping_bounds().is_some())
    });
    assert!(slept, "{:?}", stack.each_ref().map(|t| t.velocity()));
    tick(&mut stack, &[ground], Some((Vec3::Y, 0.3)), GRAVITY, &asleep);
    let before = stack.each_ref().map(|t| (t.state.clone(), t.contacts.clone()));
    tick(&mut stack, &[ground], Some((Vec3::Y, 0.3)), GRAVITY, &asleep);
    assert_eq!(before, stack.each_ref().map(|t| (t.state.clone(), t.contacts.clone())));
    let weight = 2.0 * stack[0].mass() * 9.81;
    assert!((stack[0].force_from(ground.entity).y / weight - 1.0).abs() < 0.02);
    ground.velocity = Vec3::Y * 0.01;
    tick(&mut stack, &[ground], Some((Vec3::Y, 0.3)), GRAVITY, &asleep);
    assert!(stack.iter().all(|t| t.body.sleeping_bounds().is_none()) && stack[1].state != before[1].0);
}

/// A scrap of some micrograms that hangs on a body by nothing falls freely, however hard the body is hit meanwhile: what the solver leaves of the whole is little to the
/// body and would be much to the scrap.
#[test]
fn a_scrap_falls_freely_beside_what_is_hit() {
    let cube = block([6; 3], [0.02; 3]);
    let size = 2e-4;
    let scrap = [DVec3::ZERO, DVec3::X * size, DVec3::Y * size, DVec3::Z * size].map(|p| p + DVec3::new(0.05, 0.1, 0.0));
    let nodes: Vec<DVec3> = cube.nodes().map(|n| cube.rest(n)).chain(scrap).collect();
    let first = nodes.len() as u32 - 4;
    let tets: Vec<[u32; 4]> = cube.iter().map(|(_, c)| c.map(|n| n.0)).chain([[first, first + 1, first + 2, first + 3]]).collect();
    let ground = Ground::level(0.3);
    let mut thing = [Thing::new(1, TetMesh::new(nodes, &tets, &[]), 1e4)];
    thing[0].shift(Vec3::Y * 0.005);
    let mass = thing[0].mass();
    for node in 0..first as usize {
        thing[0].state.velocities[node] = Vec3::new(0.2, -1.0, 0.0);
    }
    let fell = |t: &Thing| t.state.velocities[first as usize..].iter().sum::<Vec3>() / 4.0;
    let mut most = 0.0_f32;
    for i in 1..=8 {
        tick(&mut thing, &[ground], None, GRAVITY, &settings());
        most = most.max(thing[0].force_from(ground.entity).length());
        let expected = GRAVITY * (i as f32 * DT);
        let got = fell(&thing[0]);
        assert!((got - expected).length() < 1e-3, "tick {i}: {got} m/s instead of {expected}");
    }
    assert!(most > 3.0 * mass * 9.81, "the body is hit: {most} N");
}

/// A corner that lies up to a hundred edges outside of a cube on the ground is brought back: to the whole it is next to nothing, and to Newton's method stiff in all directions but one.
#[test]
fn a_node_that_was_thrown_out_comes_back() {
    for far in [0.05, 0.5] {
        let ground = Ground::level(0.3);
        let mut thing = [Thing::new(1, block([4; 3], [0.02; 3]), 1e4)];
        thing[0].shift(Vec3::NEG_Y * 1e-4);
        (0..30).for_each(|_| tick(&mut thing, &[ground], None, GRAVITY, &settings()));
        let before = thing[0].state.positions.clone();
        let corner = (0..before.len()).max_by(|a, b| before[*a].element_sum().total_cmp(&before[*b].element_sum())).unwrap();
        thing[0].state.positions[corner] += Vec3::new(0.8, 0.6, 0.0) * far;
        tick(&mut thing, &[ground], None, GRAVITY, &settings());
        let off = |t: &Thing| t.state.positions.iter().zip(&before).map(|(x, b)| x.distance(*b)).fold(0.0, f32::max);
        assert!(off(&thing[0]) < 0.02, "{} m after one tick, from {far} m", off(&thing[0]));
        (0..90).for_each(|_| tick(&mut thing, &[ground], None, GRAVITY, &settings()));
        assert!(off(&thing[0]) < 1e-3, "{} m after a second and a half, from {far} m", off(&thing[0]));
    }
}
