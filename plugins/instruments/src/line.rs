//! Where a cutting line is in a tick, and whether it cuts.
//!
//! Scissors cut from the crotch to the tips. The point where two blades that close from the angle `a0` cross runs along the jaw line: at the
//! angle `a` it is at `c = L (1 - a / a0)` from the pivot. What lies between the blades is cut there from the one edge to the other as they
//! stood when closing began, so the line is the segment across the opening from `(0, c sin a0, -c cos a0)` to
//! `(0, -c sin a0, -c cos a0)`, and what it sweeps while `c` goes from 0 to `L` is the triangle between the open blades, of area
//! `L^2 sin a0 cos a0`, however many ticks that takes.

use bevy_ecs::prelude::*;
use bevy_math::Vec3;
use keyhole_whiteboard::{Blade, CutTrigger, CuttingLine, LineShape};

/// The part of the jaws' length from which a stroke starts: at the pivot the line has no length. It leaves out the part
/// `CROTCH^2 = 0.0004` of the triangle.
pub const CROTCH: f32 = 0.02;

/// The stroke of closing jaws. Written by instruments.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct JawStroke(Option<Closing>);

/// Jaws on their way.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Closing {
    /// Angle of each jaw when they began to close, rad.
    from_rad: f32,
    /// How far the cut has come along the jaws, as a part of their length.
    reached: f32,
}

/// How an instrument's controls stand in a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Controls {
    /// Whether the pedal is down.
    pub pedal: bool,
    /// Angle of each jaw one tick ago, rad.
    pub before_rad: f32,
    /// Angle of each jaw now, rad.
    pub now_rad: f32,
}

impl JawStroke {
    /// The stroke after a tick, and the part of the jaws' length that it has reached; `None` when nothing is cut.
    ///
    /// A stroke begins with the first tick in which the jaws close, at [`CROTCH`]. It rests while they rest, and is over when the tips have been
    /// reached or the jaws open.
    fn advance(&mut self, before_rad: f32, now_rad: f32) -> Option<Closing> {
        self.0 = match self.0 {
            _ if now_rad > before_rad => None,
            None => (now_rad < before_rad).then_some(Closing { from_rad: before_rad, reached: CROTCH }),
            Some(stroke) if stroke.reached >= 1.0 => None,
            Some(stroke) => Some(Closing { reached: (1.0 - now_rad / stroke.from_rad).max(stroke.reached), ..stroke }),
        };
        self.0
    }
}

/// The blade of a tick.
#[must_use]
pub fn blade_now(line: &CuttingLine, controls: Controls, stroke: &mut JawStroke) -> Blade {
    let closing = stroke.advance(controls.before_rad, controls.now_rad);
    let active = match line.trigger {
        CutTrigger::Pedal => controls.pedal,
        CutTrigger::Closing => closing.is_some(),
    };
    let (tip, heel) = match (line.line, line.trigger) {
        (LineShape::Edge { tip, heel }, _) => (tip, heel),
        // Under current, shut scissors cut as a hook does.
        (LineShape::JawLine { length_m }, CutTrigger::Pedal) => (Vec3::new(0.0, 0.0, -length_m), Vec3::ZERO),
        (LineShape::JawLine { length_m }, CutTrigger::Closing) => {
            let at = closing.unwrap_or(Closing { from_rad: controls.now_rad, reached: CROTCH });
            across_jaws(at.from_rad, at.reached * length_m)
        }
    };
    Blade { tip, heel, active, kerf_m: line.kerf_m }
}

/// From the upper jaw's edge to the lower one's, `along_m` (m) from the pivot, with each jaw `angle_rad` off the shaft's axis.
fn across_jaws(angle_rad: f32, along_m: f32) -> (Vec3, Vec3) {
    let (sin, cos) = angle_rad.sin_cos();
    let edge = |side: f32| along_m * Vec3::new(0.0, side * sin, -cos);
    (edge(1.0), edge(-1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use keyhole_whiteboard::Joint;
    use proptest::prelude::*;

    fn scissors(length_m: f32) -> CuttingLine {
        CuttingLine { line: LineShape::JawLine { length_m }, trigger: CutTrigger::Closing, kerf_m: 0.0 }
    }

    /// The active blades of jaws that take these angles tick by tick, from the second on.
    fn strokes(line: &CuttingLine, angles: &[f32]) -> Vec<Vec<Blade>> {
        let mut stroke = JawStroke::default();
        let mut found: Vec<Vec<Blade>> = vec![Vec::new()];
        for pair in angles.windows(2) {
            let blade = blade_now(line, Controls { pedal: false, before_rad: pair[0], now_rad: pair[1] }, &mut stroke);
            match found.last_mut() {
                Some(last) if blade.active => last.push(blade),
                Some(last) if !last.is_empty() => found.push(Vec::new()),
                _ => {}
            }
        }
        found.retain(|s| !s.is_empty());
        found
    }

    /// Area that a line sweeps, m2: two triangles between each blade and the next.
    fn swept(blades: &[Blade]) -> f64 {
        let area = |a: Vec3, b: Vec3, c: Vec3| (b - a).as_dvec3().cross((c - a).as_dvec3()).length() / 2.0;
        blades.windows(2).map(|p| area(p[0].tip, p[0].heel, p[1].tip) + area(p[0].heel, p[1].heel, p[1].tip)).sum()
    }

    proptest! {
        /// In any number of ticks, at any pace, with pauses: the whole wedge between the blades and no more, once.
        #[test]
        fn closing_sweeps_the_wedge_between_the_jaws(
            open in 0.02f32..1.2, length in 0.002f32..0.05, paces in prop::collection::vec(0f32..1.0, 0..40), rest in 0usize..4,
        ) {
            let whole: f32 = paces.iter().sum::<f32>() + 0.1;
            let mut left = whole;
            let mut angles = vec![open];
            for pace in paces {
                left -= pace;
                angles.push(open * left / whole);
            }
            angles.push(0.0);
            angles.extend(vec![0.0; rest + 2]);
            let strokes = strokes(&scissors(length), &angles);
            prop_assert_eq!(strokes.len(), 1);
            let (open, length) = (f64::from(open), f64::from(length));
            let wedge = length * length * open.sin() * open.cos() * (1.0 - f64::from(CROTCH * CROTCH));
            prop_assert!((swept(&strokes[0]) - wedge).abs() < 1e-5 * wedge, "{} against {wedge}", swept(&strokes[0]));
        }
    }

    #[test]
    fn the_line_runs_between_the_edges_of_the_jaws_as_they_stood() {
        let (length, open) = (0.018, 0.4);
        let strokes = strokes(&scissors(length), &[open, 0.3, 0.1, 0.1, 0.0, 0.0]);
        let parts = [CROTCH, 0.75, 0.75, 1.0];
        assert_eq!(strokes[0].len(), parts.len());
        for (blade, part) in strokes[0].iter().zip(parts) {
            for (end, factor) in [(blade.tip, 1.0), (blade.heel, -1.0)] {
                let jaw = Joint::Hinge { pivot: Vec3::ZERO, axis: Vec3::X, factor }.at(open);
                assert!((jaw * Vec3::new(0.0, 0.0, -part * length)).distance(end) < 1e-6 * length, "{part}");
            }
        }
    }

    #[test]
    fn opening_ends_a_stroke_and_the_next_closing_starts_at_the_crotch_again() {
        let line = scissors(0.02);
        let strokes = strokes(&line, &[0.4, 0.4, 0.2, 0.1, 0.1, 0.15, 0.3, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(strokes.iter().map(Vec::len).collect::<Vec<_>>(), [3, 2]);
        assert!((strokes[0][0].tip.length() - CROTCH * 0.02).abs() < 1e-9);
        assert!((strokes[0][2].tip.length() - 0.75 * 0.02).abs() < 1e-8, "a pause keeps the line where it is");
        assert!((strokes[1][0].tip.length() - CROTCH * 0.02).abs() < 1e-9);
        assert!((strokes[1][1].tip.y - 0.02 * 0.3f32.sin()).abs() < 1e-8, "the wedge is that of the second opening");
    }

    #[test]
    fn a_pedal_cuts_along_the_edge_and_along_shut_jaws() {
        let edge = LineShape::Edge { tip: Vec3::new(0.0, 0.0, -0.01), heel: Vec3::ZERO };
        for line in [edge, LineShape::JawLine { length_m: 0.01 }] {
            let line = CuttingLine { line, trigger: CutTrigger::Pedal, kerf_m: 0.001 };
            for pedal in [false, true] {
                let controls = Controls { pedal, before_rad: 0.3, now_rad: 0.1 };
                let blade = blade_now(&line, controls, &mut JawStroke::default());
                assert_eq!(blade, Blade { tip: Vec3::new(0.0, 0.0, -0.01), heel: Vec3::ZERO, active: pedal, kerf_m: 0.001 });
            }
        }
    }
}
