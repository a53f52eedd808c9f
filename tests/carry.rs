//! What is loose falls onto solid anatomy, comes to rest there, and is taken by a grasper and carried out.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use bevy::prelude::*;
use keyhole::Theatre;
use keyhole::simulation::{Output, Settings, faults, simulation};
use keyhole_tissue::TissueReport;
use keyhole_whiteboard::{Contacts, Grasp, Obstacle, TissueState};

/// A piece of 28 x 10 x 12 mm falls 20 mm onto a table; a grasper from above takes it by its sides, without crushing it.
const SCENE: &str = r#"
(
    version: 1,
    name: "Carry out",
    description: "Take what lies on the table and carry it out.",
    gravity: (0.0, -9.81, 0.0),
    organs: [
        (
            name: "piece",
            shape: Block(size: (0.028, 0.010, 0.012), cells: (11, 4, 5)),
            materials: [(name: "piece", young_modulus_pa: 30000.0, poisson_ratio: 0.45, density_kg_m3: 1050.0, inside: (0.6, 0.2, 0.15), surface: (0.7, 0.4, 0.3))],
            transform: (translation: (0.0, 0.025, 0.0)),
        ),
    ],
    anatomy: [
        (name: "table", shape: Box(size: (0.20, 0.010, 0.10)), colour: (0.2, 0.4, 0.4), transform: (translation: (0.0, -0.005, 0.0)), solid: true, friction: 0.5),
    ],
    ports: [
        (name: "left", position: (0.0, 0.16, 0.0), inward: (0.0, -1.0, 0.0)),
        (name: "optic", position: (0.0, 0.10, 0.13), inward: (0.0, -0.60, -0.80)),
    ],
    instruments: [(kind: Grasper, hand: Left, port: "left", insertion_m: 0.09)],
    endoscope: (port: "optic", direction_of_view_deg: 0.0, angle_of_view_deg: 70.0, insertion_m: 0.04),
    demonstration: (
        seconds: 5.0,
        hands: [
            (hand: Left, keys: [
                (time_s: 0.0, tip: (0.0, 0.060, 0.0)),
                (time_s: 1.0, tip: (0.0, 0.060, 0.0)),
                (time_s: 1.8, tip: (0.0, 0.0035, 0.0)),
                (time_s: 2.3, tip: (0.0, 0.0035, 0.0), grip: 0.9),
                (time_s: 2.6, tip: (0.0, 0.0035, 0.0), grip: 0.9),
                (time_s: 4.0, tip: (0.035, 0.050, 0.0), grip: 0.9),
                (time_s: 5.0, tip: (0.035, 0.050, 0.0), grip: 0.9),
            ]),
        ],
        view: [(time_s: 0.0, target: (0.01, 0.015, 0.0), distance_m: 0.110)],
    ),
    views: (global: (eye: (0.06, 0.10, 0.20), target: (0.0, 0.01, 0.0))),
)
"#;

/// Mean place (m) and speed (m/s) of the piece, its lowest point (m), and how many of its contacts with the table push.
fn look(app: &mut App) -> (Vec3, f32, f32, usize) {
    let world = app.world_mut();
    let (state, contacts) = world.query::<(&TissueState, &Contacts)>().single(world).unwrap();
    let mean = |v: &[Vec3]| v.iter().sum::<Vec3>() / v.len() as f32;
    let lowest = state.positions.iter().fold(f32::INFINITY, |low, x| low.min(x.y));
    let carried = contacts.0.iter().filter(|c| matches!(c.against, Obstacle::Anatomy(_)) && c.force_n != Vec3::ZERO).count();
    (mean(&state.positions), mean(&state.velocities).length(), lowest, carried)
}

#[test]
fn a_loose_piece_lands_rests_and_is_carried_out() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("carry.scene.ron");
    std::fs::write(&file, SCENE).unwrap();
    let settings = Settings { output: Output::None, demonstration: true, ..Settings::default() };
    let mut app = simulation(Theatre::load(&file).unwrap(), settings);
    let mut grasps: Vec<Grasp> = Vec::new();
    let mut run = |seconds: f64| {
        for _ in 0..(seconds * 60.0) as u32 {
            app.update();
            let world = app.world_mut();
            grasps.push(*world.query::<&Grasp>().single(world).unwrap());
        }
        look(&mut app)
    };
    let (lying, speed, lowest, carried) = run(1.0);
    assert!(speed < 1e-3 && carried > 20, "{speed} m/s on {carried} contacts");
    assert!(lowest.abs() < 3e-4 && (lying.y - 0.005).abs() < 5e-4, "its lowest point is at {lowest} m, its middle at {lying}");
    let (lifted, _, lowest, carried) = run(3.4);
    assert!(lifted.distance(Vec3::new(0.035, 0.050, 0.0)) < 0.012, "it is at {lifted}, the jaws have gone to 35, 50 mm");
    assert!(lowest > 0.02 && carried == 0);
    let (held, speed, ..) = run(0.5);
    assert!(held.distance(lifted) < 1e-3 && speed < 0.02, "it slips: {lifted} to {held}, {speed} m/s");
    // From when the jaws are closed all that is between them presses on their pads: they, and not the jaws' steel, bear it.
    let least = grasps[156..].iter().map(|g| g.points).min().unwrap();
    let (low, high) = grasps[156..].iter().fold((f32::INFINITY, 0.0f32), |(low, high), g| (low.min(g.pinch_n), high.max(g.pinch_n)));
    println!("at least {least} points hold, and press with {low} to {high} N");
    assert!(least >= 10 && low > 1.0 && high < 3.0, "at least {least} points hold, and press with {low} to {high} N");
    assert_eq!(faults(), 0);
    assert!(app.world().resource::<TissueReport>().quarantined.is_empty());
}
