//! The scene in which rings go from peg to peg: each is lifted off its peg by the right hand, handed over in the air, and left round a peg of the other side.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use bevy::prelude::*;
use keyhole::Theatre;
use keyhole::simulation::{Output, Settings, TICKS_PER_SECOND, faults, simulation};
use keyhole_whiteboard::{Anchor, Attachments, Contacts, Hand, Instrument, Obstacle, Organ, TissueState};
use std::path::Path;

/// Height of the pegs' ends, m.
const PEG_TOP: f32 = 0.022;

/// What a ring is at after a tick.
#[derive(Clone, Copy, Debug)]
struct Ring {
    /// Its middle, m, and speed, m/s.
    middle: Vec3,
    speed: f32,
    /// Its lowest point, m.
    lowest: f32,
    /// Whether the pads of the left and of the right hand's jaws are on it from both sides.
    held: [bool; 2],
    /// Whether anatomy pushes it.
    touches: bool,
}

/// The rings by name, and whether each encloses the vertical line through a place.
fn look(app: &mut App, name: &str, peg: Vec2) -> (Ring, bool) {
    let world = app.world_mut();
    let hands: Vec<(Entity, Hand)> =
        world.query_filtered::<(Entity, &Hand), With<Instrument>>().iter(world).map(|(e, h)| (e, *h)).collect();
    let mut organs = world.query::<(&Organ, &TissueState, &Contacts, &Attachments)>();
    let (_, state, contacts, attachments) = organs.iter(world).find(|(organ, ..)| organ.name == name).unwrap();
    let mean = |v: &[Vec3]| v.iter().sum::<Vec3>() / v.len() as f32;
    let pushing = contacts.0.iter().filter(|c| c.force_n != Vec3::ZERO);
    let by = |hand| {
        // The upper jaw is where Y is above zero in the instrument's frame.
        let jaws = attachments.0.iter().filter_map(|a| match a.anchor {
            Anchor::Tool { instrument, local } if hands.contains(&(instrument, hand)) => Some(local.y > 0.0),
            Anchor::Tool { .. } | Anchor::Space(_) => None,
        });
        jaws.clone().any(|upper| upper) && jaws.clone().any(|upper| !upper)
    };
    let ring = Ring {
        middle: mean(&state.positions),
        speed: mean(&state.velocities).length(),
        lowest: state.positions.iter().fold(f32::INFINITY, |low, x| low.min(x.y)),
        held: [by(Hand::Left), by(Hand::Right)],
        touches: pushing.clone().any(|c| matches!(c.against, Obstacle::Anatomy(_))),
    };
    // No half turn around the line is without a node.
    let mut turns: Vec<f32> = state.positions.iter().map(|x| (x.xz() - peg).to_angle()).collect();
    turns.sort_by(f32::total_cmp);
    let first = turns[0] + std::f32::consts::TAU;
    let widest = turns.iter().skip(1).chain([&first]).zip(&turns).fold(0.0, |w: f32, (b, a)| w.max(b - a));
    (ring, widest < std::f32::consts::PI)
}

#[test]
fn the_rings_go_from_peg_to_peg_by_way_of_both_hands() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/peg_transfer.scene.ron");
    let theatre = Theatre::load(&file).unwrap_or_else(|e| panic!("{e}"));
    let ticks = (theatre.demonstration_s().unwrap() * TICKS_PER_SECOND).ceil() as u64;
    let rings = [("orange ring", Vec2::new(-0.030, 0.020)), ("blue ring", Vec2::new(-0.030, -0.020))];
    let mut app = simulation(theatre, Settings { output: Output::None, demonstration: true, ..Settings::default() });
    // What has been seen of each ring: lifted by the right hand alone, held by both in the air, by the left alone.
    let mut seen = [[false; 3]; 2];
    let mut dropped = false;
    for tick in 1..=ticks {
        app.update();
        for ((name, peg), seen) in rings.iter().zip(&mut seen) {
            let (ring, _) = look(&mut app, name, *peg);
            let in_air = ring.lowest > PEG_TOP && !ring.touches;
            match ring.held {
                [false, true] => seen[0] |= in_air,
                [true, true] => seen[1] |= seen[0] && in_air,
                [true, false] => seen[2] |= seen[1] && in_air,
                [false, false] => dropped |= in_air,
            }
            if tick % 15 == 0 {
                println!("{:.2} s: {name}: {ring:?}", tick as f64 / TICKS_PER_SECOND);
            }
        }
    }
    assert_eq!(faults(), 0);
    assert!(!dropped, "a ring is in the air and nobody holds it");
    for ((name, peg), seen) in rings.iter().zip(seen) {
        let (ring, around) = look(&mut app, name, *peg);
        assert_eq!(seen, [true; 3], "{name}: lifted, held by both, by the left alone");
        assert!(around && ring.middle.y < PEG_TOP, "{name} is not round its peg: {ring:?}");
        assert!(ring.held == [false; 2] && ring.speed < 1e-3, "{name} is not at rest: {ring:?}");
        assert!((ring.middle.y - 0.005).abs() < 1e-3 && ring.lowest.abs() < 1e-3, "{name} does not lie on the board: {ring:?}");
    }
}
