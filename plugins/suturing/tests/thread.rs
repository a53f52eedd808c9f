//! The thread against closed forms: it keeps its length, hangs as a catenary, gains no energy, and slides through eyes as Coulomb and the capstan say.

use bevy_math::DVec3;
use keyhole_suturing::chain::{Chain, Eye, EyeHold, Held, Slide, ThreadLaw};

const LAW: ThreadLaw = ThreadLaw {
    line_density_kg_m: 9.5e-5,
    stretch_n: 600.0,
    bending_n_m2: 0.0,
    damping_1_s: 5.0,
    gravity: DVec3::new(0.0, -9.81, 0.0),
    end_mass_kg: 0.0,
};
const DT: f64 = 1.0 / 60.0;

fn straight(from: DVec3, to: DVec3, segment_m: f64) -> Chain {
    let Some(chain) = Chain::along([from, to].into_iter(), segment_m) else { panic!("a line") };
    chain
}

/// Largest stretch of a segment.
fn strain(chain: &Chain) -> f64 {
    chain.places.windows(2).map(|p| p[0].distance(p[1]) / chain.segment_m - 1.0).fold(0.0, f64::max)
}

/// `2 a sinh(D / 2a) = L`, by bisection.
fn catenary(span: f64, length: f64) -> f64 {
    let (mut low, mut high) = (1e-3 * span, 1e3 * span);
    for _ in 0..200 {
        let a = (low * high).sqrt();
        if 2.0 * a * (span / (2.0 * a)).sinh() > length { low = a } else { high = a }
    }
    low
}

#[test]
fn a_thread_held_at_both_ends_hangs_as_a_catenary() {
    let (length, span) = (0.15, 0.08);
    let mut chain = straight(DVec3::ZERO, DVec3::new(length, 0.0, 0.0), 0.0025);
    let last = chain.places.len() - 1;
    let mut worst_strain: f64 = 0.0;
    for tick in 0..600 {
        // One end comes nearer within a second.
        let x = length + (span - length) * (f64::from(tick) / 60.0).min(1.0);
        let held = [Held { particle: 0, to: DVec3::ZERO }, Held { particle: last, to: DVec3::new(x, 0.0, 0.0) }];
        chain.step(&LAW, &mut [], &held, DT, 4);
        worst_strain = worst_strain.max(strain(&chain));
    }
    let a = catenary(span, length);
    let worst =
        chain.places.iter().map(|p| (p.y - a * (((p.x - span / 2.0) / a).cosh() - (span / 2.0 / a).cosh())).abs()).fold(0.0, f64::max);
    let sag = a * ((span / 2.0 / a).cosh() - 1.0);
    let pull = LAW.line_density_kg_m * 9.81 * a * (span / 2.0 / a).cosh();
    println!("off by {worst:e} m of a sag of {sag} m, strain {worst_strain:e}, tension {:e} N of {pull:e} N", chain.tension_n);
    assert!(worst < 0.005 * sag && worst_strain < 0.01, "off by {worst} m of a sag of {sag} m, strain {worst_strain}");
    assert!((chain.tension_n / pull - 1.0).abs() < 0.02);
}

/// Thrown, whipped and let go, the thread's energy falls in every substep, and its length stays.
#[test]
fn a_swinging_thread_gains_no_energy() {
    let law = ThreadLaw { damping_1_s: 0.0, bending_n_m2: 5e-9, ..LAW };
    let mut chain = straight(DVec3::ZERO, DVec3::new(0.15, 0.0, 0.02), 0.0025);
    let mass = law.line_density_kg_m * chain.segment_m;
    let energy = |c: &Chain| -> f64 {
        let ends = [0, c.places.len() - 1];
        let part = |(i, (x, v)): (usize, (&DVec3, &DVec3))| {
            (if ends.contains(&i) { 0.5 } else { 1.0 }) * mass * (0.5 * v.length_squared() + 9.81 * x.y)
        };
        c.places.iter().zip(&c.velocities).enumerate().map(part).sum()
    };
    let (start, mut before) = (energy(&chain), energy(&chain));
    let drop = mass * chain.places.len() as f64 * 9.81 * 0.075;
    for tick in 0..300 {
        chain.step(&law, &mut [], &[Held { particle: 0, to: DVec3::ZERO }], DT, 4);
        let now = energy(&chain);
        assert!(now <= before + 1e-3 * drop, "tick {tick}: {now} J after {before} J, at first {start} J");
        assert!(strain(&chain) < 0.01, "tick {tick}: {}", strain(&chain));
        before = now;
    }
}

/// A thread in an eye, pulled through it at an angle: the tension beyond is what drag and the capstan's law say.
fn pull_through(turn_rad: f64, friction: f64, drag_n: f64) -> ([f64; 2], f64, Chain) {
    let law = ThreadLaw { gravity: DVec3::ZERO, ..LAW };
    // Two eyes: the first gives the second a tension to multiply.
    let mut chain = straight(DVec3::new(-0.06, 0.0, 0.0), DVec3::new(0.04, 0.0, 0.0), 0.0025);
    let last = chain.places.len() - 1;
    let eye = |x: f64, friction: f64| Eye {
        drag_n: [drag_n; 2],
        friction,
        ..Eye::new(EyeHold::Tissue { place: DVec3::new(x, 0.0, 0.0), compliance_m_n: 1e-4 }, x + 0.06, DVec3::new(x, 0.0, 0.0))
    };
    let mut eyes = [eye(-0.01, 0.0), eye(0.0, friction)];
    for tick in 0..420 {
        let t = f64::from(tick) * DT;
        // Turned in two seconds, pulled 2 cm in five.
        let angle = turn_rad * (t / 2.0).min(1.0);
        let r = 0.039 + 0.004 * (t - 2.0).max(0.0);
        let place = r * DVec3::new(angle.cos(), angle.sin(), 0.0);
        chain.step(&law, &mut eyes, &[Held { particle: last, to: place }], DT, 4);
        if std::env::var("DBG").is_ok() {
            println!(
                "{tick} {:?} at {:.6} {:.6} T {:?} {:?} strain {:e} {:?}",
                eyes.map(|e| e.slide),
                eyes[0].at_m,
                eyes[1].at_m,
                eyes[0].tension_n,
                eyes[1].tension_n,
                strain(&chain),
                eyes[1].place
            );
            if strain(&chain) > 1.0 {
                panic!()
            }
        }
    }
    (eyes[1].tension_n, eyes[1].at_m, chain)
}

#[test]
fn a_thread_is_pulled_through_an_eye_against_friction() {
    for (turn, friction, drag) in [(0.0, 0.0, 0.05), (0.0, 0.3, 0.2), (1.0, 0.25, 0.1), (1.5, 0.4, 0.1)] {
        let ([tail, needle], at, chain) = pull_through(turn, friction, drag);
        // The first eye drags, the second drags and turns.
        let expected = drag + drag * (friction * turn).exp();
        println!(
            "turn {turn} friction {friction} drag {drag}: {tail} N, {needle} N of {expected} N; {at} m at the eye, strain {}",
            strain(&chain)
        );
        assert!((tail / drag - 1.0).abs() < 0.05, "{tail} N before the second eye, {drag} N of drag at the first");
        assert!((needle / expected - 1.0).abs() < 0.05, "{needle} N against {expected} N");
        // The thread has come through by as much as was pulled.
        assert!((at - (0.1 - 0.039 - 0.004 * 5.0)).abs() < 1.5e-3, "{at} m");
    }
}

/// A pull below the friction moves nothing; the thread never turns back by itself.
#[test]
fn friction_holds_what_is_pulled_less() {
    let law = ThreadLaw { gravity: DVec3::ZERO, ..LAW };
    let mut chain = straight(DVec3::new(-0.05, 0.0, 0.0), DVec3::new(0.05, 0.0, 0.0), 0.0025);
    let last = chain.places.len() - 1;
    let hold = EyeHold::Tissue { place: DVec3::ZERO, compliance_m_n: 1e-3 };
    let mut eyes = [Eye { drag_n: [1.0; 2], ..Eye::new(hold, 0.05, DVec3::ZERO) }];
    for tick in 0..240 {
        // 0.8 mm into a compliance of a millimetre a newton.
        let pulled = 0.0008 * (f64::from(tick) / 60.0).min(1.0);
        chain.step(&law, &mut eyes, &[Held { particle: last, to: DVec3::new(0.05 + pulled, 0.0, 0.0) }], DT, 4);
    }
    assert_eq!(eyes[0].at_m, 0.05);
    assert_eq!(eyes[0].slide, Slide::Rests);
    // The compliance and the thread's own stretch, one after the other.
    let expected = 0.0008 / (1e-3 + 0.05 / law.stretch_n);
    assert!((chain.end_tension_n[1] / expected - 1.0).abs() < 1e-3, "{:?} against {expected} N", chain.end_tension_n);
}
