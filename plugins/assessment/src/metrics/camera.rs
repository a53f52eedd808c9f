//! How the endoscope is held, and what it does not show.

use bevy_math::DVec3;

/// What an endoscope sees, as far as its angle goes: what tissue hides is not looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewCone {
    /// Tip of the endoscope, m.
    pub tip: DVec3,
    /// Unit vector along its view.
    pub direction: DVec3,
    /// Half of the angle of view, rad.
    pub half_angle_rad: f64,
    /// Unit vector to the right of the picture.
    pub right: DVec3,
}

impl ViewCone {
    /// How far from the middle of the picture a point is seen: 0 in the middle, 1 at the rim, above 1 out of view. In angles.
    #[must_use]
    pub fn off_centre(&self, point: DVec3) -> f64 {
        let to = point - self.tip;
        to.cross(self.direction).length().atan2(to.dot(self.direction)) / self.half_angle_rad
    }

    /// Whether a point is in the picture.
    #[must_use]
    pub fn sees(&self, point: DVec3) -> bool {
        self.off_centre(point) <= 1.0
    }

    /// Angle between the picture's horizontal and the horizon, rad; `up` is a unit vector.
    #[must_use]
    pub fn tilt_rad(&self, up: DVec3) -> f64 {
        self.right.dot(up).clamp(-1.0, 1.0).asin().abs()
    }
}

/// Means over a session of how the endoscope is held.
#[derive(Clone, Copy, Debug, Default)]
pub struct CameraWatch {
    samples: u64,
    tilt_rad: f64,
    with_tools: u64,
    off_centre: f64,
    distance_m: f64,
}

impl CameraWatch {
    /// Takes a sample: the view, the world's up, and where the tools' tips are (m).
    pub fn push(&mut self, view: &ViewCone, up: DVec3, tips: &[DVec3]) {
        self.samples += 1;
        self.tilt_rad += view.tilt_rad(up);
        if tips.is_empty() {
            return;
        }
        let middle = tips.iter().sum::<DVec3>() / tips.len() as f64;
        self.with_tools += 1;
        self.off_centre += view.off_centre(middle);
        self.distance_m += middle.distance(view.tip);
    }

    /// Mean angle between the picture's horizontal and the horizon, rad.
    #[must_use]
    pub fn tilt_rad(&self) -> Option<f64> {
        (self.samples > 0).then(|| self.tilt_rad / self.samples as f64)
    }

    /// Mean distance of the middle between the tips from the middle of the picture, as in [`ViewCone::off_centre`].
    #[must_use]
    pub fn off_centre(&self) -> Option<f64> {
        (self.with_tools > 0).then(|| self.off_centre / self.with_tools as f64)
    }

    /// Mean distance from the endoscope's tip to the middle between the tips, m.
    #[must_use]
    pub fn distance_m(&self) -> Option<f64> {
        (self.with_tools > 0).then(|| self.distance_m / self.with_tools as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(right: DVec3) -> ViewCone {
        ViewCone { tip: DVec3::new(0.0, 0.0, 0.1), direction: DVec3::NEG_Z, half_angle_rad: 0.5, right }
    }

    /// From 10 cm a point 10 cm tan(0.25) beside the axis is half way to the rim, one at tan(0.51) is outside, and one behind the tip is far out.
    #[test]
    fn the_cone_is_as_wide_as_its_angle() {
        let view = view(DVec3::X);
        assert!((view.off_centre(DVec3::Y * 0.1 * 0.25_f64.tan()) - 0.5).abs() < 1e-12);
        assert!(view.sees(DVec3::X * 0.1 * 0.49_f64.tan()) && !view.sees(DVec3::X * 0.1 * 0.51_f64.tan()));
        assert!((view.off_centre(DVec3::Z) - std::f64::consts::PI / 0.5).abs() < 1e-9);
    }

    /// Half of the time level, half of it rolled by 0.2 rad, with tips at 3 and 5 cm before the scope, seen half way to the rim in the second half.
    #[test]
    fn means_of_a_session() {
        let mut watch = CameraWatch::default();
        assert_eq!((watch.tilt_rad(), watch.distance_m()), (None, None));
        let ahead = |d: f64| DVec3::new(0.0, 0.0, 0.1 - d);
        watch.push(&view(DVec3::X), DVec3::Y, &[ahead(0.03), ahead(0.05)]);
        let side = DVec3::new(0.04 * 0.25_f64.tan(), 0.0, 0.06);
        watch.push(&view(DVec3::new(0.2_f64.cos(), 0.2_f64.sin(), 0.0)), DVec3::Y, &[side]);
        watch.push(&view(DVec3::X), DVec3::Y, &[]);
        let near = |found: Option<f64>, expected: f64| assert!(found.is_some_and(|f| (f - expected).abs() < 1e-9), "{found:?} {expected}");
        near(watch.tilt_rad(), 0.2 / 3.0);
        near(watch.off_centre(), 0.25);
        near(watch.distance_m(), (0.04 + 0.04 / 0.25_f64.cos()) / 2.0);
    }
}
