//! Instruments that are fast, that turn, that are already in tissue, and that meet each other and anatomy.

use crate::meshes::{Thing, block};
use bevy_ecs::prelude::*;
use bevy_math::{Isometry3d, Quat, Vec3};
use keyhole_collision::anatomy::SolidSurface;
use keyhole_collision::contacts::{MovedPart, Party, with_tool_within, with_tools};
use keyhole_collision::meet::{part_against_part, part_against_surface};
use keyhole_collision::pad::Pad;
use keyhole_collision::tool::{Motion, ToolPart};
use keyhole_collision::{Body, Detector, Grading, Hit, Shape, mean_rest_edge_m};
use keyhole_whiteboard::{Contact, JawPads, StaticSurface};
use proptest::prelude::*;

const DT: f32 = 1.0 / 60.0;
/// 5 m/s for a tick, m.
const WAY: f32 = 5.0 * DT;

fn party<'a>(thing: &'a Thing, velocities: &'a [Vec3]) -> Party<'a> {
    let Thing { mesh, shape, positions } = thing;
    Party {
        organ: World::new().spawn_empty().id(),
        topology: mesh.topology(),
        shape,
        positions,
        velocities,
        edge_m: mean_rest_edge_m(mesh),
        friction: 0.1,
    }
}

/// A flap of 60 x 5 x 60 mm about the origin.
fn flap() -> Thing {
    Thing::new(block([8, 1, 8], [0.06, 0.005, 0.06]), |p| p - Vec3::new(0.03, 0.0025, 0.03))
}

fn touched(thing: &Thing, velocity: Vec3, part: &ToolPart, motion: &Motion) -> Vec<Contact> {
    let velocities = vec![velocity; thing.positions.len()];
    let mut contacts = Vec::new();
    with_tools(&party(thing, &velocities), &[bare(part, motion)], 0.0005, &mut contacts);
    contacts
}

/// A part without a pad.
fn bare<'a>(part: &'a ToolPart, motion: &'a Motion) -> MovedPart<'a> {
    MovedPart { tool: World::new().spawn_empty().id(), part, motion, friction: 0.2, pad: None }
}

fn parts() -> [ToolPart; 2] {
    let corners: Vec<Vec3> = (0..8)
        .map(|i| Vec3::new((i & 1) as f32 - 0.5, (i >> 1 & 1) as f32 - 0.5, (i >> 2) as f32 - 0.5) * Vec3::new(0.004, 0.003, 0.02))
        .collect();
    [ToolPart::capsule(Vec3::Z * -0.15, Vec3::Z * 0.15, 0.0025), ToolPart::hull(&corners).unwrap()]
}

/// By how much the tissue has to go along `way` for no contact to be missed at the end of the tick, m.
fn pushed(thing: &Thing, velocity: Vec3, contacts: &[Contact], way: Vec3) -> f32 {
    let needed = |c: &Contact| {
        let x: Vec3 = c.point.iter().map(|(n, w)| *w * (thing.positions[n.index()] + velocity * DT)).sum();
        let missing = (c.surface_m + c.velocity_m_s * DT - x).dot(c.normal);
        let along = way.dot(c.normal);
        (along > 0.05).then(|| missing / along)
    };
    contacts.iter().filter_map(needed).fold(0.0, f32::max)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// Two parts that go and turn, and tissue that moves: the contacts are those of every part with every face of the surface, one by one, in that order.
    #[test]
    fn no_face_is_passed_over(
        turns in prop::array::uniform2(prop::array::uniform3(-3f32..3.0)),
        ways in prop::array::uniform2(prop::array::uniform3(-0.03f32..0.03)),
        twist in prop::array::uniform3(-0.6f32..0.6),
        velocity in prop::array::uniform3(-2f32..2.0),
    ) {
        let flap = flap();
        let velocities = vec![Vec3::from_array(velocity); flap.positions.len()];
        let party = party(&flap, &velocities);
        let motion = |k: usize| {
            let from = Isometry3d::new(Vec3::from_array(ways[1 - k]) / 3.0, Quat::from_scaled_axis(Vec3::from_array(turns[k])));
            let to = Isometry3d::new(Vec3::from(from.translation) + Vec3::from_array(ways[k]), Quat::from_scaled_axis(Vec3::from_array(twist)) * from.rotation);
            Motion { from, to, dt_s: DT }
        };
        let (parts, motions) = (parts(), [motion(0), motion(1)]);
        let moved: Vec<MovedPart> = parts.iter().zip(&motions).map(|(part, motion)| bare(part, motion)).collect();
        let mut contacts = Vec::new();
        let faces = with_tools(&party, &moved, 0.0005, &mut contacts);
        prop_assert_eq!(faces, 2 * flap.shape.triangles().count());
        let mut expected = Vec::new();
        for (part, motion) in parts.iter().zip(&motions) {
            for nodes in flap.shape.triangles() {
                let corners = nodes.map(|n| flap.positions[n.index()]);
                let touch = part.touch(motion, corners, corners.map(|p| p + velocities[0] * DT), 0.0005);
                expected.extend(touch.map(|t| (nodes, t.surface_m, t.normal)));
            }
        }
        let found: Vec<_> = contacts.iter().map(|c| ([0, 1, 2].map(|i| c.point[i].0), c.surface_m, c.normal)).collect();
        prop_assert_eq!(found, expected);
    }
}

/// A jaw that grips, its pad a little below the flap's upper face or its back a little above the lower one: what lies on the pad is the pad's, what the jaw's back pushes is not,
/// nor what is beyond the rim, and before the jaws close all of it is pushed.
#[test]
fn what_lies_on_a_pad_is_left_to_it() {
    let flap = flap();
    let velocities = vec![Vec3::ZERO; flap.positions.len()];
    let corners: Vec<Vec3> =
        (0..8).map(|i| Vec3::new((i & 1) as f32 * 0.004 - 0.002, (i >> 1 & 1) as f32 * 0.002, (i >> 2) as f32 * -0.02)).collect();
    let jaw = ToolPart::hull(&corners).unwrap();
    let pads = JawPads { from_m: 0.003, to_m: 0.019, half_width_m: 0.002, closed_gap_m: 0.0003 };
    let pad = Pad::of(&jaw, pads);
    let touched = |y: f32, pad: Option<Pad>| {
        let motion = Motion::still(Isometry3d::from_translation(Vec3::new(0.001, y, 0.012)), DT);
        let mut contacts = Vec::new();
        with_tools(&party(&flap, &velocities), &[MovedPart { pad, ..bare(&jaw, &motion) }], 0.0005, &mut contacts);
        let at = |c: &Contact| motion.from.inverse() * c.point.iter().map(|(n, w)| *w * flap.positions[n.index()]).sum::<Vec3>();
        contacts.iter().map(|c| (at(c), c.normal)).collect::<Vec<_>>()
    };
    let (bare_pad, gripping) = (touched(0.0025 - 0.0003, None), touched(0.0025 - 0.0003, Some(pad)));
    assert!(bare_pad.iter().any(|(at, _)| pad.is_beside(*at)) && bare_pad.iter().all(|(_, normal)| normal.y < -0.9), "{bare_pad:?}");
    assert!(gripping.iter().all(|(at, _)| !pad.is_beside(*at)), "{gripping:?}");
    let beyond: Vec<_> = bare_pad.iter().filter(|(at, _)| !pad.is_beside(*at)).copied().collect();
    assert_eq!(gripping, beyond);
    let back = touched(-0.0025 - 0.002 + 0.0003, Some(pad));
    assert!(back.iter().any(|(at, normal)| pad.is_beside(*at) && normal.y > 0.9), "{back:?}");
    assert_eq!(back, touched(-0.0025 - 0.002 + 0.0003, None));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    /// At 5 m/s, from any side and any way round, whether the tool comes, or the flap, or both: what is in the way goes with the tool, so far that the tool never
    /// is in it nor behind it.
    #[test]
    fn nothing_passes_a_flap_of_5_mm(
        jaw in any::<bool>(),
        turn in prop::array::uniform3(-3f32..3.0),
        (lean_x, lean_z, below) in (-1f32..1.0, -1f32..1.0, any::<bool>()),
        at in prop::array::uniform2(-0.02f32..0.02),
        before in 0.2f32..0.7,
        share in 0f32..1.0,
    ) {
        let flap = flap();
        let part = &parts()[usize::from(jaw)];
        // The way leads through the flap's middle plane at `at`, by at most 45 degrees from the vertical.
        let way = Vec3::new(lean_x, if below { 1.0 } else { -1.0 }, lean_z).normalize();
        let through = Vec3::new(at[0], 0.0, at[1]);
        let rotation = Quat::from_scaled_axis(Vec3::from_array(turn));
        let begin = Isometry3d::new(through - way * (before * WAY), rotation);
        // A tool that begins in the flap or on both sides of it is another matter.
        let up = -way.y.signum();
        let clear = part.spine().iter().all(|p| up * (begin * *p).y > 0.0025 + 2.0 * part.radius_m() + 0.001);
        prop_assume!(clear);
        let (tool, tissue) = (way * WAY * share, -way * WAY * (1.0 - share));
        let motion = Motion { from: begin, to: Isometry3d::new(Vec3::from(begin.translation) + tool, rotation), dt_s: DT };
        let contacts = touched(&flap, tissue / DT, part, &motion);
        prop_assert!(!contacts.is_empty());
        let gone = pushed(&flap, tissue / DT, &contacts, way);
        // Seen from the flap, as it was pushed, each point of the middle goes along a straight line to here.
        for p in part.spine() {
            let (from, to) = (begin * *p, begin * *p + way * (WAY - gone));
            let beside = from.abs().max(to.abs());
            // A tool of which only an end is over the flap slides off it as well.
            if beside.x < 0.028 && beside.z < 0.028 {
                prop_assert!(up * to.y > 0.0025 + 0.5 * part.radius_m(), "{to} after {gone} m; {} contacts", contacts.len());
            }
        }
    }

    /// The same about a port: a shaft that swings down on the flap, from above it to below, touches it from above, and what it touches has to go
    /// down with it.
    #[test]
    fn a_shaft_that_turns_about_its_port_passes_nothing(height in -0.02f32..0.08, far in 0.08f32..0.2, round in 0f32..6.3, from in 0.02f32..0.3, swing in 0.1f32..0.4) {
        let flap = flap();
        let shaft = ToolPart::capsule(Vec3::ZERO, Vec3::X * 0.3, 0.0025);
        let about = Quat::from_rotation_y(round);
        let port = about * Vec3::new(-far, height, 0.0);
        let at = |angle: f32| Isometry3d::new(port, about * Quat::from_rotation_z(angle));
        // Level with the flap's far corner from above, and then more.
        let level = ((0.008 - height) / (far - 0.045)).atan().max(((0.008 - height) / (far + 0.045)).atan());
        let low = ((-height) / far).atan();
        let motion = Motion { from: at(level + from), to: at(low - swing), dt_s: DT };
        let contacts = touched(&flap, Vec3::ZERO, &shaft, &motion);
        prop_assert!(!contacts.is_empty());
        prop_assert!(pushed(&flap, Vec3::ZERO, &contacts, -Vec3::Y) > 0.005);
    }
}

/// The points of a part's middle that are in the tissue.
fn within(thing: &Thing, part: &ToolPart, motion: &Motion) -> Vec<Hit> {
    let middle: Vec<Vec3> = part.spine().iter().map(|p| motion.from * *p).collect();
    let shape = Shape::of_points(middle.len());
    let tool = Body { shape: &shape, positions: &middle, self_collision: false };
    let mut detector = Detector::default();
    let hits = detector.detect(&[thing.body(false), tool], Grading::Hierarchical);
    assert!(hits.iter().all(|h| (h.node_body, h.tet_body) == (1, 0)));
    hits.to_vec()
}

/// A shaft through the middle of a block touches no triangle from outside. The tissue goes down, for the shaft is nearest to the upper face.
#[test]
fn a_shaft_inside_pushes_the_tissue_the_shortest_way() {
    let turn = Quat::from_rotation_x(0.4) * Quat::from_rotation_z(0.9);
    let thing = Thing::new(block([8, 6, 8], [0.06, 0.04, 0.06]), |p| turn * p);
    let velocities = vec![Vec3::ZERO; thing.positions.len()];
    let shaft = ToolPart::capsule(Vec3::Z * -0.1, Vec3::Z * 0.1, 0.0025);
    let at = Isometry3d::new(turn * Vec3::new(0.0291, 0.031, 0.03), turn);
    let motion = Motion { from: at, to: Isometry3d::new(Vec3::from(at.translation) + turn * Vec3::X * 0.001, turn), dt_s: DT };
    let hits = within(&thing, &shaft, &motion);
    let mut contacts = Vec::new();
    let mut last = None;
    let tool = bare(&shaft, &motion);
    with_tool_within(&party(&thing, &velocities), tool, &hits, &mut last, &mut contacts);
    assert!(contacts.len() >= 20, "{} contacts along 60 mm", contacts.len());
    for c in &contacts {
        let x: Vec3 = c.point.iter().map(|(n, w)| *w * thing.positions[n.index()]).sum();
        assert!((c.normal + turn * Vec3::Y).length() < 1e-5, "{c:?}");
        assert!((c.depth_m - (0.009 + 0.0025)).abs() < 1e-5 && (c.depth_m + (x - c.surface_m).dot(c.normal)).abs() < 1e-6, "{c:?}");
        assert!((c.velocity_m_s - turn * Vec3::X * 0.06).length() < 1e-3);
    }
    assert!(last.is_some_and(|l| (l - Vec3::Y).length() < 1e-6));
    // Sunk to just below the middle, the way that it has begun to go is kept; without one it is the other.
    let below = Isometry3d::new(turn * Vec3::new(0.0291, 0.018, 0.03), turn);
    let motion = Motion::still(below, DT);
    let hits = within(&thing, &shaft, &motion);
    for (mut last, way) in [(last, Vec3::Y), (None, -Vec3::Y)] {
        let mut contacts = Vec::new();
        with_tool_within(&party(&thing, &velocities), bare(&shaft, &motion), &hits, &mut last, &mut contacts);
        assert!(!contacts.is_empty() && contacts.iter().all(|c| (c.normal + turn * way).length() < 1e-5));
    }
}

/// Wherever a part is in a block, and whichever way round: pushed as the contacts say, tick by tick, the block comes off it.
#[test]
fn tissue_comes_off_a_tool_that_is_inside() {
    for (case, part) in (0..12).zip(parts().iter().cycle()) {
        let angle = 0.7 * case as f32;
        let at = Isometry3d::new(
            Vec3::new(0.02 + 0.003 * (case % 5) as f32, 0.012 + 0.004 * (case % 4) as f32, 0.03),
            Quat::from_rotation_y(angle) * Quat::from_rotation_x(0.4 * angle),
        );
        let mut thing = Thing::new(block([8, 6, 8], [0.06, 0.04, 0.06]), |p| p);
        let velocities = vec![Vec3::ZERO; thing.positions.len()];
        let motion = Motion::still(at, DT);
        let (mut last, mut gone) = (None, 0.0);
        for _ in 0..200 {
            let hits = within(&thing, part, &motion);
            let mut contacts = Vec::new();
            let tool = bare(part, &motion);
            with_tool_within(&party(&thing, &velocities), tool, &hits, &mut last, &mut contacts);
            if contacts.is_empty() {
                break;
            }
            let step = contacts.iter().map(|c| c.normal).sum::<Vec3>().normalize() * 0.001;
            gone += step.length();
            thing.positions.iter_mut().for_each(|x| *x += step);
        }
        assert!(within(&thing, part, &motion).is_empty(), "case {case} after {gone} m");
        assert!(gone < 0.045, "case {case}: the block is 40 mm thick, but went {gone} m");
    }
}

/// A slab of anatomy, 4 mm thick, its upper face at y = 0.
fn slab() -> SolidSurface {
    let vertices =
        (0..8).map(|i| Vec3::new((i & 1) as f32 * 0.4 - 0.2, (i >> 1 & 1) as f32 * 0.004 - 0.004, (i >> 2) as f32 * 0.4 - 0.2)).collect();
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let triangles = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    SolidSurface::new(&StaticSurface { vertices, triangles }).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// A tool that comes down on a thin slab, slowly or at 5 m/s, belongs above it, by as much as it is too low.
    #[test]
    fn a_tool_belongs_on_the_side_of_anatomy_that_it_came_from(jaw in any::<bool>(), turn in prop::array::uniform2(-1f32..1.0), above in 0.0002f32..0.03, down in 0f32..WAY) {
        let part = &parts()[usize::from(jaw)];
        let rotation = Quat::from_rotation_y(turn[0]) * Quat::from_rotation_z(turn[1]);
        let lowest = |at: f32| at - 0.0025;
        let from = Isometry3d::new(Vec3::Y * (above + 0.0025), rotation);
        let to = Isometry3d::new(Vec3::Y * (above + 0.0025 - down), rotation);
        let met = part_against_surface(part, &Motion { from, to, dt_s: DT }, &slab(), 0.01 + down, 0.01, |_| true);
        prop_assert!(met.iter().all(|m| (m.normal - Vec3::Y).length() < 0.02), "{met:?}");
        let deepest = met.iter().map(|m| m.depth_m).max_by(f32::total_cmp);
        if !jaw {
            // The shaft lies level: closed form.
            let depth = -lowest(above + 0.0025 - down);
            prop_assert!(deepest.is_some_and(|d| (d - depth).abs() < 2e-4) || (deepest.is_none() && depth < -0.009), "{deepest:?} {depth}");
        }
        for m in &met {
            prop_assert!((m.depth_m + m.point.y).abs() < 2e-4, "{m:?}");
        }
    }

    /// Two shafts that cross: the one belongs where it came from, and both see the same.
    #[test]
    fn two_shafts_do_not_change_sides(angle in 0.3f32..2.8, above in 0.0055f32..0.03, down in 0f32..WAY) {
        let [shaft, _] = parts();
        let still = Motion::still(Isometry3d::IDENTITY, DT);
        let at = |y: f32| Isometry3d::new(Vec3::Y * y, Quat::from_rotation_y(angle));
        let falls = Motion { from: at(above), to: at(above - down), dt_s: DT };
        let met = part_against_part((&shaft, &falls), (&shaft, &still), 0.01 + down);
        let depth = 0.005 - (above - down);
        prop_assert_eq!(met.is_some(), depth > -0.01 - down);
        if let Some(m) = met {
            prop_assert!((m.normal - Vec3::Y).length() < 1e-2 && (m.depth_m - depth).abs() < 2e-4, "{m:?} {depth}");
            let other = part_against_part((&shaft, &still), (&shaft, &falls), 0.01 + down).unwrap();
            prop_assert!((other.normal + m.normal).length() < 1e-2 && (other.depth_m - m.depth_m).abs() < 2e-4);
            prop_assert!(m.mirrored().point.distance(other.point) < 1e-3, "{:?} {other:?}", m.mirrored());
        }
    }
}
