//! A power law through points: least squares of the logarithms.

use serde::{Deserialize, Serialize};

/// `y = factor * x^exponent`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PowerLaw {
    /// The exponent.
    pub exponent: f64,
    /// Its standard error; none with two points, which a line always fits.
    pub error: Option<f64>,
    /// The value at one.
    pub factor: f64,
}

impl PowerLaw {
    /// Through the points whose coordinates are above zero and finite; none with fewer than two different places.
    #[must_use]
    pub fn through(points: &[(f64, f64)]) -> Option<Self> {
        let fit = |v: f64| v > 0.0 && v.is_finite();
        let logs: Vec<(f64, f64)> = points.iter().filter(|(x, y)| fit(*x) && fit(*y)).map(|(x, y)| (x.ln(), y.ln())).collect();
        let count = logs.len() as f64;
        let mean = |of: fn(&(f64, f64)) -> f64| logs.iter().map(of).sum::<f64>() / count;
        let (x, y) = (mean(|p| p.0), mean(|p| p.1));
        let spread: f64 = logs.iter().map(|p| (p.0 - x).powi(2)).sum();
        let together: f64 = logs.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
        let exponent = together / spread;
        // Without two places there is no spread, and no number.
        if !exponent.is_finite() {
            return None;
        }
        let left: f64 = logs.iter().map(|p| (p.1 - y - exponent * (p.0 - x)).powi(2)).sum();
        let error = (logs.len() > 2).then(|| (left / (count - 2.0) / spread).sqrt());
        Some(Self { exponent, error, factor: (y - exponent * x).exp() })
    }

    /// Its value at a place.
    #[must_use]
    pub fn at(&self, x: f64) -> f64 {
        self.factor * x.powf(self.exponent)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    #[test]
    fn a_power_law_is_found_and_its_error_is_that_of_regression() {
        let exact: Vec<_> = [1.0, 10.0, 300.0].map(|x: f64| (x, 3.0 * x.powf(1.5))).into();
        let found = PowerLaw::through(&exact).unwrap();
        assert!((found.exponent - 1.5).abs() < 1e-12 && (found.factor - 3.0).abs() < 1e-12 && found.error.unwrap() < 1e-12);
        assert!((found.at(20.0) / (3.0 * 20_f64.powf(1.5)) - 1.0).abs() < 1e-12);
        // By hand: logarithms (-1, 0), (0, 1), (1, 0): slope 0, the rest 2/3, spread 2.
        let e = std::f64::consts::E;
        let found = PowerLaw::through(&[(1.0 / e, 1.0), (1.0, e), (e, 1.0)]).unwrap();
        assert!(found.exponent.abs() < 1e-12 && (found.error.unwrap() - (2.0_f64 / 3.0 / 2.0).sqrt()).abs() < 1e-12);
        assert_eq!(PowerLaw::through(&[(2.0, 1.0), (2.0, 3.0)]), None);
        assert_eq!(PowerLaw::through(&[(2.0, 1.0), (3.0, 0.0)]), None);
        assert_eq!(PowerLaw::through(&[(1.0, 1.0), (2.0, 2.0)]).unwrap().error, None);
    }
}
