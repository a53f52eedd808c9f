//! The scene with needle and thread: what its demonstration does, on the whiteboard.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use bevy::prelude::*;
use keyhole::{Output, Settings, Theatre, simulation};
use keyhole_whiteboard::{Bites, HoleKind, Instrument, InstrumentKind, Knots, Needle, SutureReport, Thread};
use std::path::Path;

fn suture<C: Component + Clone>(app: &mut App) -> C {
    let world = app.world_mut();
    world.query_filtered::<&C, With<Needle>>().single(world).unwrap().clone()
}

/// Both edges are taken in one go, the needle is handed over, the thread drawn after it, and two throws keep the edges together once both hands have let go.
#[test]
fn the_demonstration_ties_two_edges_together() {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/stitch.scene.ron");
    let theatre = Theatre::load(&scene).unwrap();
    let ticks = (theatre.demonstration_s().unwrap() * 60.0).ceil() as u32;
    let mut app = simulation(theatre, Settings { output: Output::None, demonstration: true, ..default() });
    assert_eq!(suture::<Needle>(&mut app).grips.len(), 1, "the right hand has the needle");
    let mut handed = false;
    for _ in 0..ticks {
        app.update();
        handed |= suture::<Needle>(&mut app).grips.len() == 2;
    }
    let (needle, thread, bites, knots): (Needle, Thread, Bites, Knots) =
        (suture(&mut app), suture(&mut app), suture(&mut app), suture(&mut app));
    assert!(handed && needle.grips.is_empty() && thread.grips.is_empty(), "{needle:?}");
    assert_eq!((bites.held.len(), bites.torn.len()), (2, 0), "{bites:?}");
    assert!(knots.tied.len() == 1 && knots.tied[0].throws.len() == 2 && knots.undone == 0, "{knots:?}");
    let [a, b] = [0, 1].map(|i| bites.held[i].holes.iter().find(|h| h.kind == HoleKind::Channel).unwrap().clone());
    let (rest, now) = (a.rest.distance(b.rest), a.anchor.distance(b.anchor));
    println!("{rest} m apart at first, {now} m at the end; {:?}, {:?}", knots.tied[0], app.world().resource::<SutureReport>());
    assert!(now < 0.8 * rest, "{rest} m at first, {now} m at the end");
    assert_eq!(*app.world().resource::<SutureReport>(), SutureReport::default());
    let world = app.world_mut();
    assert!(world.query::<&Instrument>().iter(world).all(|i| i.kind == InstrumentKind::NeedleHolder));
}
