//! The scene in which an artery is clipped and cut: what its demonstration comes to, and what comes of doing it otherwise.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use bevy::prelude::*;
use keyhole::Theatre;
use keyhole::simulation::{Output, Settings, TICKS_PER_SECOND, faults, simulation};
use keyhole_clipping::bleed::flow_ml_min;
use keyhole_whiteboard::{BleedReport, Clip, ClipReport, CutStatus, Organ, TissueMesh, TissueState, Vessel};
use std::path::Path;

/// What a performance came to.
struct Outcome {
    clips: ClipReport,
    bleeding: BleedReport,
    vessel: Vessel,
    /// What each clip closes of the vessel, from the left to the right.
    closes: Vec<f32>,
    /// Pieces of the artery that are not connected.
    pieces: u32,
}

/// Performs the scene's demonstration with some of its words replaced.
fn perform(changes: &[(&str, &str)]) -> Outcome {
    let mut text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/clip_and_cut.scene.ron")).unwrap();
    for (from, to) in changes {
        assert!(text.contains(from), "the scene does not say {from}");
        text = text.replace(from, to);
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("changed.scene.ron");
    std::fs::write(&file, text).unwrap();
    let theatre = Theatre::load(&file).unwrap_or_else(|e| panic!("{e}"));
    let ticks = (theatre.demonstration_s().unwrap() * TICKS_PER_SECOND).ceil() as u64;
    let mut app = simulation(theatre, Settings { output: Output::None, demonstration: true, ..Settings::default() });
    let (mut lost_ml, mut before) = (0.0, ClipReport::default());
    for tick in 0..ticks {
        app.update();
        let bleeding = app.world().resource::<BleedReport>();
        lost_ml += f64::from(bleeding.rate_ml_min) / 60.0 / TICKS_PER_SECOND;
        assert!((bleeding.lost_ml - lost_ml).abs() <= 1e-5 * lost_ml, "what is lost is the sum of what flows");
        let clips = *app.world().resource::<ClipReport>();
        if clips != before || tick % 60 == 0 {
            println!(
                "tick {tick}: {clips:?}, {} ml/min from {} places, {:?}",
                bleeding.rate_ml_min,
                bleeding.sites.len(),
                app.world().resource::<CutStatus>()
            );
            before = clips;
        }
    }
    assert_eq!(faults(), 0);
    let world = app.world_mut();
    let mut organs = world.query::<(&Organ, &TissueMesh, &TissueState)>();
    for (organ, mesh, state) in organs.iter(world) {
        assert!(mesh.0.nodes().all(|n| state.position(n).is_finite()), "{}", organ.name);
    }
    let mut clips: Vec<_> = world.query::<&Clip>().iter(world).map(|c| (c.pose.translation.x, c.closes)).collect();
    clips.sort_by(|a, b| a.0.total_cmp(&b.0));
    let closes = clips.into_iter().map(|c| c.1).collect();
    let vessel = world.query::<&Vessel>().iter(world).next().unwrap().clone();
    let world = app.world();
    Outcome {
        clips: *world.resource::<ClipReport>(),
        bleeding: world.resource::<BleedReport>().clone(),
        vessel,
        closes,
        pieces: world.resource::<CutStatus>().fragments,
    }
}

#[test]
fn between_two_clips_it_is_cut_and_nothing_bleeds() {
    let it = perform(&[]);
    println!("{:?}, closes {:?}, {} pieces", it.clips, it.closes, it.pieces);
    assert_eq!(it.clips, ClipReport { set: 2, ..default() });
    assert_eq!(it.closes, [1.0, 1.0]);
    assert_eq!(it.pieces, 1, "the artery is cut through");
    assert_eq!(it.bleeding, BleedReport::default());
}

/// The cartridge is empty: both ends bleed by the law, the source's as much as its supply lets through.
#[test]
fn without_clips_it_bleeds_by_the_law() {
    let it = perform(&[("clips: (count: 8)", "clips: (count: 0)")]);
    assert_eq!((it.clips, it.bleeding.sites.len()), (ClipReport::default(), 2));
    let lumen = std::f64::consts::PI * f64::from(it.vessel.radius_m).powi(2);
    // Blood leaves towards the gap: what comes from the near end, on the left, to the right.
    let of_end = |side: f32| *it.bleeding.sites.iter().find(|s| s.towards.x * side > 0.5).unwrap();
    for (site, end) in [(of_end(1.0), it.vessel.near), (of_end(-1.0), it.vessel.far)] {
        let by_law = flow_ml_min(&end, lumen);
        println!("{site:?}, by the law {by_law} ml/min");
        assert!((f64::from(site.rate_ml_min) / by_law - 1.0).abs() < 1e-3);
    }
    assert!(it.bleeding.lost_ml > 2.0);
}

/// A clip that does not reach across the whole artery is misplaced, and what it leaves open bleeds.
#[test]
fn a_clip_half_across_leaks() {
    let it = perform(&[("(-0.0060, 0.0128, 0.0)", "(-0.0060, 0.0128, 0.0030)"), ("(0.0060, 0.0128, 0.0)", "(0.0060, 0.0128, 0.0030)")]);
    println!("{:?}, closes {:?}, {} ml/min", it.clips, it.closes, it.bleeding.rate_ml_min);
    // The jaws come at a slant, so that each of them is off by another part.
    assert!(it.clips.set == 2 && it.clips.misplaced >= 1 && it.clips.dropped == 0, "{:?}", it.clips);
    let partly = it.closes.iter().filter(|c| (0.05..0.999).contains(*c)).count();
    assert_eq!(partly as u32, it.clips.misplaced);
    // The left one is on the near end's side of the cut, the right one on the far one's: what flows past each is by the law of what it leaves open.
    let lumen = std::f64::consts::PI * f64::from(it.vessel.radius_m).powi(2);
    let ends = [it.vessel.near, it.vessel.far];
    let by_law: f64 = it.closes.iter().zip(&ends).map(|(closes, end)| flow_ml_min(end, f64::from(1.0 - closes) * lumen)).sum();
    assert!((f64::from(it.bleeding.rate_ml_min) / by_law - 1.0).abs() < 1e-3, "{} by the law {by_law}", it.bleeding.rate_ml_min);
}
