//! How a hand moves: way, depth, speed, smoothness, idle time.

use crate::metrics::smooth::Window;
use bevy_math::DVec3;

/// When a hand counts as idle. The published work says that idle is when a hand does not move (D'Angelo et al. 2015, doi 10.1016/j.amjsurg.2014.12.013),
/// not at which speed: these bounds are ours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IdleSettings {
    /// A tip below this speed does not move, m/s. Default 5 mm/s.
    pub speed_m_s: f64,
    /// For so long at least, s. Default 0.5.
    pub least_s: f64,
}

impl Default for IdleSettings {
    fn default() -> Self {
        Self { speed_m_s: 0.005, least_s: 0.5 }
    }
}

/// Sums over the movement of a tool's tip.
#[derive(Clone, Copy, Debug)]
pub struct HandMotion {
    dt_s: f64,
    idle: IdleSettings,
    window: Window,
    last: Option<(DVec3, f64)>,
    samples: u64,
    path_m: f64,
    depth_m: f64,
    /// Samples with derivatives.
    derived: u64,
    jerk2: f64,
    peak_m_s: f64,
    idle_run: u64,
    idle_samples: u64,
}

impl HandMotion {
    /// Nothing seen yet. `dt_s` is the time between samples.
    #[must_use]
    pub fn new(dt_s: f64, idle: IdleSettings) -> Self {
        Self {
            dt_s,
            idle,
            window: Window::default(),
            last: None,
            samples: 0,
            path_m: 0.0,
            depth_m: 0.0,
            derived: 0,
            jerk2: 0.0,
            peak_m_s: 0.0,
            idle_run: 0,
            idle_samples: 0,
        }
    }

    /// Takes a sample: where the tip is, and the port that its shaft passes, m.
    pub fn push(&mut self, tip: DVec3, port: DVec3) {
        let depth = tip.distance(port);
        if let Some((before, depth_before)) = self.last {
            self.path_m += tip.distance(before);
            self.depth_m += (depth - depth_before).abs();
        }
        self.last = Some((tip, depth));
        self.samples += 1;
        if let Some((velocity, jerk)) = self.window.push(tip, self.dt_s) {
            self.derived += 1;
            self.jerk2 += jerk.length_squared() * self.dt_s;
            self.peak_m_s = self.peak_m_s.max(velocity.length());
            self.rest(velocity.length());
        }
    }

    fn rest(&mut self, speed_m_s: f64) {
        if speed_m_s >= self.idle.speed_m_s {
            self.idle_run = 0;
            return;
        }
        self.idle_run += 1;
        let least = (self.idle.least_s / self.dt_s).ceil() as u64;
        self.idle_samples += match self.idle_run.cmp(&least) {
            std::cmp::Ordering::Less => 0,
            std::cmp::Ordering::Equal => least,
            std::cmp::Ordering::Greater => 1,
        };
    }

    /// Time from the first sample to the last, s.
    #[must_use]
    pub fn time_s(&self) -> f64 {
        self.samples.saturating_sub(1) as f64 * self.dt_s
    }

    /// Length of the tip's way, m.
    #[must_use]
    pub fn path_m(&self) -> f64 {
        self.path_m
    }

    /// Length of its way along the shaft, in and out, m.
    #[must_use]
    pub fn depth_m(&self) -> f64 {
        self.depth_m
    }

    /// Mean speed, m/s; `None` before there was time.
    #[must_use]
    pub fn speed_m_s(&self) -> Option<f64> {
        (self.samples > 1).then(|| self.path_m / self.time_s())
    }

    /// Time for which the hand was idle, s.
    #[must_use]
    pub fn idle_s(&self) -> f64 {
        self.idle_samples as f64 * self.dt_s
    }

    /// Log dimensionless jerk, `-ln(T^3 / v_peak^2 * integral |jerk|^2 dt)`: the higher, the smoother. `None` for a hand that has not moved.
    #[must_use]
    pub fn smoothness(&self) -> Option<f64> {
        let time_s = self.derived as f64 * self.dt_s;
        let dimensionless = time_s.powi(3) * self.jerk2 / (self.peak_m_s * self.peak_m_s);
        (dimensionless.is_finite() && dimensionless > 0.0).then(|| -dimensionless.ln())
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    fn moved(dt_s: f64, samples: u32, at: impl Fn(f64) -> DVec3) -> HandMotion {
        let mut motion = HandMotion::new(dt_s, IdleSettings::default());
        (0..=samples).for_each(|i| motion.push(at(f64::from(i) * dt_s), DVec3::ZERO));
        motion
    }

    /// In by 3 cm along x, across by 4 cm, straight back to the start: 3 + 4 + 5 cm of way. From the port at the origin, the tip starts at 10 cm; the
    /// corners are `sqrt(13^2 + 0)`, `sqrt(13^2 + 4^2)` and 10 cm away, so depth is `3 + (13.6015 - 13) + (13.6015 - 10)` cm.
    #[test]
    fn way_depth_and_speed_of_a_triangle() {
        let corners = [[10.0, 0.0], [13.0, 0.0], [13.0, 4.0], [10.0, 0.0]].map(|[x, y]| DVec3::new(x, y, 0.0) * 0.01);
        let mut motion = HandMotion::new(0.5, IdleSettings::default());
        corners.iter().for_each(|c| motion.push(*c, DVec3::ZERO));
        assert!((motion.path_m() - 0.12).abs() < 1e-12);
        let far = 185.0_f64.sqrt();
        assert!((motion.depth_m() - 0.01 * (3.0 + (far - 13.0) + (far - 10.0))).abs() < 1e-12);
        assert!((motion.speed_m_s().unwrap() - 0.12 / 1.5).abs() < 1e-12);
        assert_eq!(motion.smoothness(), None, "too few samples for a jerk");
    }

    /// The movement of least jerk, `x = L (10 u^3 - 15 u^4 + 6 u^5)` with `u = t/T` (Flash & Hogan 1985), has the peak speed `15/8 L/T` and
    /// `integral x'''^2 dt = 720 L^2/T^5`: the log dimensionless jerk is `-ln(720 / (15/8)^2) = -5.322`, whatever `L` and `T`.
    #[test]
    fn the_smoothest_movement_has_its_closed_form() {
        for (length, time) in [(0.1, 1.0), (0.02, 3.0)] {
            let dt = time / 2000.0;
            let motion = moved(dt, 2000, |t| {
                let u = t / time;
                DVec3::new(0.2, length * (10.0 * u.powi(3) - 15.0 * u.powi(4) + 6.0 * u.powi(5)), 0.0)
            });
            let expected = -(720.0_f64 / (15.0_f64 / 8.0).powi(2)).ln();
            let found = motion.smoothness().unwrap();
            // A window at each end has no derivative: the jerk is largest there, and 9 of 2000 samples are lost.
            assert!((found - expected).abs() < 0.03, "{found} against {expected}");
        }
    }

    #[test]
    fn a_tremor_is_less_smooth_and_a_straight_pull_has_no_jerk_but_its_own() {
        let smooth = |t: f64| DVec3::new(0.05 * (1.0 - (std::f64::consts::PI * t / 4.0).cos()), 0.0, 0.0);
        let calm = moved(1.0 / 60.0, 240, smooth).smoothness().unwrap();
        let tremor = |t: f64| smooth(t) + DVec3::Y * 0.0005 * (std::f64::consts::TAU * 6.0 * t).sin();
        let shaky = moved(1.0 / 60.0, 240, tremor).smoothness().unwrap();
        assert!(shaky < calm - 2.0, "{shaky} against {calm}");
    }

    /// 2 s at 10 cm/s, 1 s still, 2 s at 10 cm/s, 0.3 s still, 1 s at 10 cm/s: only the first stop is long enough. A window of nine samples sees it
    /// shorter by at most its length.
    #[test]
    fn short_stops_are_not_idle() {
        let place = |t: f64| {
            let moving = t.min(2.0) + (t - 3.0).clamp(0.0, 2.0) + (t - 5.3).clamp(0.0, 1.0);
            DVec3::X * (0.1 + 0.1 * moving)
        };
        let idle = moved(1.0 / 60.0, 378, place).idle_s();
        assert!(idle <= 1.0 && idle > 1.0 - 9.0 / 60.0, "{idle}");
        assert_eq!(moved(1.0 / 60.0, 600, |_| DVec3::X).smoothness(), None);
        let still = moved(1.0 / 60.0, 600, |_| DVec3::X).idle_s();
        assert!((still - 593.0 / 60.0).abs() < 1e-9, "{still}: all but the windows at both ends");
    }
}
