//! Free fall, friction, impact, rest, and thin walls.

use bevy_ecs::entity::Entity;
use bevy_math::{Isometry3d, Quat, Vec3};
use keyhole_rigid::RigidSettings;
use keyhole_rigid::shape::{Built, build};
use keyhole_rigid::world::RigidWorld;
use keyhole_whiteboard::{RigidPose, RigidShape};
use std::collections::BTreeMap;

const DT: f32 = 1.0 / 60.0;
const G: Vec3 = Vec3::new(0.0, -9.81, 0.0);

/// A titanium clip: 8 mm long, 1 mm high and 1.5 mm wide.
fn clip() -> Built {
    built(&boxed(Vec3::new(0.008, 0.001, 0.0015)), 4500.0)
}

fn built(shape: &RigidShape, density: f32) -> Built {
    build(shape, density, None).unwrap()
}

fn corners(size: Vec3) -> Vec<Vec3> {
    (0..8u8).map(|i| size * (Vec3::new(f32::from(i & 1), f32::from(i >> 1 & 1), f32::from(i >> 2)) - 0.5)).collect()
}

fn boxed(size: Vec3) -> RigidShape {
    RigidShape::Hull(corners(size))
}

/// The triangles of a box by [`corners`], from outside.
const BOX: [[u32; 3]; 12] =
    [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4], [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5]];

struct Theatre {
    world: RigidWorld,
    settings: RigidSettings,
    count: u32,
}

impl Theatre {
    fn new() -> Self {
        let settings = RigidSettings::default();
        Self { world: RigidWorld::new(), settings, count: 0 }
    }

    fn name(&mut self) -> Entity {
        self.count += 1;
        Entity::from_raw_u32(self.count).unwrap()
    }

    fn body(&mut self, built: &Built, at: RigidPose, friction: f32) -> Entity {
        let name = self.name();
        self.world.insert_body(name, built, &at, friction);
        name
    }

    /// A box of anatomy of that size, centred at a pose.
    fn block(&mut self, size: Vec3, at: Isometry3d, friction: f32) {
        let name = self.name();
        let vertices: Vec<Vec3> = corners(size).into_iter().map(|v| at * v).collect();
        self.world.insert_anatomy(name, &vertices, &BOX, friction).unwrap();
    }

    fn run(&mut self, seconds: f32) {
        for _ in 0..(seconds / DT).round() as u32 {
            let broken = self.world.tick(DT, self.settings.steps, G, &BTreeMap::new(), &BTreeMap::new());
            assert_eq!(broken, vec![]);
        }
    }

    fn pose(&self, body: Entity) -> RigidPose {
        *self.world.pose(body).unwrap()
    }
}

fn at(x: f32, y: f32, z: f32) -> RigidPose {
    RigidPose::at_rest(Isometry3d::from_translation(Vec3::new(x, y, z)))
}

/// Falls as v = g t and y = g t2 / 2, the latter by as much more as its substeps are coarse: g t h / 2.
#[test]
fn a_body_falls_freely() {
    let mut theatre = Theatre::new();
    let body = theatre.body(&clip(), RigidPose { angular_rad_s: Vec3::X, ..at(0.0, 0.0, 0.0) }, 0.3);
    theatre.run(0.5);
    let pose = theatre.pose(body);
    let fallen = -pose.now.translation.y;
    println!("fallen {fallen} m, speed {} m/s", pose.linear_m_s.y);
    assert!((pose.linear_m_s.y / (-9.81 * 0.5) - 1.0).abs() < 1e-5);
    let h = DT / theatre.settings.steps as f32 / 4.0;
    assert!((fallen - 9.81 * 0.125).abs() < 9.81 * 0.5 * h * 0.6, "{fallen}");
    // About its long axis, a principal one, it goes on turning as it did.
    assert!((pose.angular_rad_s - Vec3::X).length() < 5e-4, "{}", pose.angular_rad_s);
}

/// A slab at an angle below and above that of friction: it stays, or slides with g (sin a - mu cos a).
#[test]
fn friction_holds_and_slides_at_the_right_angle() {
    let slab = built(&boxed(Vec3::new(0.02, 0.004, 0.02)), 2000.0);
    for mu in [0.2f32, 0.5, 0.8] {
        for part in [0.8f32, 1.5] {
            let angle = (mu * part).atan();
            let mut theatre = Theatre::new();
            let tilt = Quat::from_rotation_z(angle);
            let ground = Isometry3d::new(tilt * Vec3::new(0.0, -0.05, 0.0), tilt);
            theatre.block(Vec3::new(2.0, 0.1, 0.2), ground, mu);
            let start = Isometry3d::new(tilt * Vec3::new(0.0, 0.002, 0.0), tilt);
            let body = theatre.body(&slab, RigidPose::at_rest(start), mu);
            theatre.run(0.1);
            let before = theatre.pose(body);
            theatre.run(0.4);
            let after = theatre.pose(body);
            let down = tilt * Vec3::NEG_X;
            let gained = (after.linear_m_s - before.linear_m_s).dot(down) / 0.4;
            let expected = (9.81 * (angle.sin() - mu * angle.cos())).max(0.0);
            println!("mu {mu} tan a = {part} mu: {gained} m/s2, by Coulomb {expected}");
            if part < 1.0 {
                let crept = (after.now.translation - before.now.translation).length();
                assert!(crept < 1e-4, "crept {crept} m");
            } else {
                assert!((gained - expected).abs() < 0.03 * expected, "{gained} {expected}");
            }
        }
    }
}

/// Dropped flat from 5 cm it does not jump up again, lies where it ought to, and sleeps.
#[test]
fn what_falls_comes_to_rest_and_sleeps() {
    let mut theatre = Theatre::new();
    theatre.block(Vec3::new(0.2, 0.01, 0.2), Isometry3d::from_translation(Vec3::new(0.0, -0.005, 0.0)), 0.5);
    let tilted = Isometry3d::new(Vec3::new(0.0, 0.05, 0.0), Quat::from_euler(bevy_math::EulerRot::XYZ, 0.5, 0.2, 0.9));
    let flat = theatre.body(&clip(), at(0.03, 0.05, 0.0), 0.5);
    let other = theatre.body(&clip(), RigidPose::at_rest(tilted), 0.5);
    let mut highest = 0.0f32;
    theatre.run(0.15);
    for _ in 0..120 {
        theatre.run(DT);
        highest = highest.max(theatre.pose(flat).now.translation.y);
    }
    println!("highest after impact {highest} m, at rest {} {}", theatre.pose(flat).now.translation.y, theatre.pose(other).now.translation);
    assert!(highest < 0.0007, "it lies at half a millimetre");
    for body in [flat, other] {
        let pose = theatre.pose(body);
        assert!(pose.asleep && pose.linear_m_s == Vec3::ZERO, "{pose:?}");
        assert!((pose.now.translation.y - 0.0005).abs() < 0.0001 || (pose.now.translation.y - 0.00075).abs() < 0.0001, "{pose:?}");
    }
    assert_eq!(theatre.world.awake(), 0);
}

/// At 10 m/s a clip moves 17 cm a tick, and passes no wall of 1 mm, whichever way it is turned and wherever it is within its tick when it arrives.
#[test]
fn a_clip_passes_no_thin_wall() {
    for turn in 0..12u8 {
        let mut theatre = Theatre::new();
        theatre.block(Vec3::new(0.001, 0.6, 0.6), Isometry3d::IDENTITY, 0.3);
        let turned = Quat::from_euler(bevy_math::EulerRot::XYZ, f32::from(turn), 0.7 * f32::from(turn), 0.3);
        let from = Vec3::new(-0.1 - 0.013 * f32::from(turn), 0.05, 0.02);
        let start = RigidPose { linear_m_s: 10.0 * Vec3::X, ..RigidPose::at_rest(Isometry3d::new(from, turned)) };
        let body = theatre.body(&clip(), start, 0.3);
        for _ in 0..15 {
            theatre.run(DT);
            let x = theatre.pose(body).now.translation.x;
            assert!(x < 0.0, "turn {turn}: at {x} m");
        }
    }
}

/// Dropped on its edge, its end or its corner onto a floor of triangles from a third of its thickness to more than its length it passes none, and rests.
#[test]
fn a_clip_falls_through_no_mesh() {
    for cell in [0.0003f32, 0.001, 0.003, 0.02] {
        let cells = (0.04 / cell) as u32;
        let grid = |i: u32| i as f32 * cell - 0.02;
        let vertices: Vec<Vec3> = (0..=cells).flat_map(|z| (0..=cells).map(move |x| Vec3::new(grid(x), 0.0, grid(z)))).collect();
        let quads = (0..cells).flat_map(|z| (0..cells).map(move |x| x + z * (cells + 1)));
        let triangles: Vec<[u32; 3]> = quads.flat_map(|a| [[a, a + cells + 1, a + cells + 2], [a, a + cells + 2, a + 1]]).collect();
        for turn in 0..6u8 {
            let mut theatre = Theatre::new();
            let floor = theatre.name();
            theatre.world.insert_anatomy(floor, &vertices, &triangles, 0.3).unwrap();
            let turned = Quat::from_euler(bevy_math::EulerRot::XYZ, 0.4 * f32::from(turn), 0.3 * f32::from(turn), 0.5 + f32::from(turn));
            let start = RigidPose::at_rest(Isometry3d::new(Vec3::new(0.001, 0.03, 0.002), turned));
            let body = theatre.body(&clip(), start, 0.3);
            theatre.run(1.0);
            let pose = theatre.pose(body);
            let y = pose.now.translation.y;
            assert!((0.0004..0.005).contains(&y), "cell {cell} turn {turn}: {y}");
        }
    }
}
