//! Derivatives of a sampled path: a cubic fitted to nine samples by least squares (Savitzky & Golay 1964, doi 10.1021/ac60214a047).
//!
//! With the window's middle at 0 and half of it `m`, a cubic is the sum of the discrete orthogonal polynomials `p1 = i` and
//! `p3 = 5 i^3 - (3 m^2 + 3 m - 1) i` and of even ones, which have no part in odd derivatives at 0. With `a_k = sum(p_k x) / sum(p_k^2)` the
//! velocity is `(a1 - (3 m^2 + 3 m - 1) a3) / h` and the jerk `30 a3 / h^3`.

use bevy_math::DVec3;

/// Half of a window, samples.
const HALF: i32 = 4;

/// Samples of a window: at 60 Hz it is 0.15 s long.
pub const WINDOW: usize = 2 * HALF as usize + 1;

/// What `i` is subtracted by in the cubic polynomial.
const LINEAR: f64 = (3 * HALF * HALF + 3 * HALF - 1) as f64;

/// The last samples of a path.
#[derive(Clone, Copy, Debug, Default)]
pub struct Window {
    samples: [DVec3; WINDOW],
    count: u64,
}

impl Window {
    /// Takes a sample (m). Once there are enough, gives velocity (m/s) and jerk (m/s3) in the middle of the window; `dt_s` is the time between samples.
    pub fn push(&mut self, sample: DVec3, dt_s: f64) -> Option<(DVec3, DVec3)> {
        self.samples.rotate_left(1);
        self.samples[WINDOW - 1] = sample;
        self.count += 1;
        (self.count >= WINDOW as u64).then(|| self.derivatives(dt_s))
    }

    fn derivatives(&self, dt_s: f64) -> (DVec3, DVec3) {
        let (mut first, mut third) = ((DVec3::ZERO, 0.0), (DVec3::ZERO, 0.0));
        for (i, x) in (-HALF..=HALF).zip(self.samples) {
            let i = f64::from(i);
            let (p1, p3) = (i, 5.0 * i * i * i - LINEAR * i);
            first = (first.0 + p1 * x, first.1 + p1 * p1);
            third = (third.0 + p3 * x, third.1 + p3 * p3);
        }
        let (a1, a3) = (first.0 / first.1, third.0 / third.1);
        ((a1 - LINEAR * a3) / dt_s, 30.0 * a3 / dt_s.powi(3))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cubic is its own fit: `x = 1 + 2 t - 3 t^2 + 4 t^3` has `v(0) = 2` and the jerk 24 everywhere.
    #[test]
    fn a_cubic_has_its_own_derivatives() {
        let mut window = Window::default();
        let dt = 0.1;
        let mut found = None;
        for i in -4..=4 {
            let t = f64::from(i) * dt;
            found = window.push(DVec3::new(1.0 + 2.0 * t - 3.0 * t * t + 4.0 * t * t * t, -t, 5.0), dt);
            assert_eq!(found.is_some(), i == 4);
        }
        let (v, j) = found.unwrap_or_default();
        assert!((v - DVec3::new(2.0, -1.0, 0.0)).length() < 1e-12, "{v}");
        assert!((j - DVec3::new(24.0, 0.0, 0.0)).length() < 1e-9, "{j}");
    }
}
