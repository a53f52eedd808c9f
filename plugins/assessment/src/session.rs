//! The sums of a session, and what they come to.

use crate::metrics::table::MetricId;
use crate::metrics::{CameraWatch, ForceWatch, HandMotion, IdleSettings, Margin, Resection, TouchCounter, ViewCone, shafts_touch};
use crate::results::{MarginSummary, Measured};
use bevy_math::DVec3;
use keyhole_whiteboard::Hand;

/// Touches of two shafts that are less apart than this are one, s.
const APART_S: f64 = 0.1;

/// What is a matter of choice in the metrics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MetricSettings {
    /// When a hand is idle.
    pub idle: IdleSettings,
    /// A grip beyond this does harm, N. Default 5: forces of delicate work with graspers stay below it; no bound is published that holds for all tissue.
    pub grip_limit_n: f64,
}

impl Default for MetricSettings {
    fn default() -> Self {
        Self { idle: IdleSettings::default(), grip_limit_n: 5.0 }
    }
}

/// An instrument in one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolSample {
    /// Whose.
    pub hand: Hand,
    /// The port, m.
    pub port: DVec3,
    /// End of the shaft, where the jaws begin, m.
    pub shaft_end: DVec3,
    /// What is worked with: the blade's tip or the middle of the pads, m.
    pub tip: DVec3,
    /// Radius of the shaft, m.
    pub radius_m: f64,
    /// Force of each jaw on what they hold, N; `None` while they hold nothing.
    pub grip_n: Option<f64>,
    /// Force on all tissue, N.
    pub tissue_n: f64,
}

/// Everything that is measured of a tick.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sample {
    /// Instruments, at most one a hand.
    pub tools: Vec<ToolSample>,
    /// Whether two instruments touch, where somebody looks at that; `None`: the distance of their shafts decides.
    pub tools_touch: Option<bool>,
    /// The endoscope's view.
    pub view: Option<ViewCone>,
    /// Blood that has been lost so far, ml; `None` where nothing can bleed.
    pub blood_lost_ml: Option<f64>,
    /// What of it has been aspirated so far, ml; `None` where nothing aspirates.
    pub aspirated_ml: Option<f64>,
    /// Clips misplaced, dropped and slipped so far; `None` where there is no clip applier.
    pub clip_errors: Option<u32>,
    /// Area that graspers have bruised so far, m2; `None` where nothing is grasped.
    pub bruised_m2: Option<f64>,
    /// Bites that have torn out so far; `None` where there is no suture.
    pub stitches_torn: Option<u64>,
    /// How often something was dropped so far; `None` where there is no task or nothing that holds.
    pub dropped: Option<u32>,
    /// How far what was cut out is off its circle, m; `None` while nothing has been cut out.
    pub off_circle_m: Option<f64>,
    /// Whether the supplying vessels are clamped; `None` where there is nothing to clamp.
    pub clamped: Option<bool>,
}

/// Sums over a session. They do not grow.
#[derive(Clone, Debug)]
pub struct Session {
    dt_s: f64,
    settings: MetricSettings,
    ticks: u64,
    hands: [Option<HandWatch>; 2],
    camera: CameraWatch,
    collisions: TouchCounter,
    two_tools: bool,
    blood_lost_ml: Option<f64>,
    aspirated_ml: Option<f64>,
    clip_errors: Option<u32>,
    bruised_m2: Option<f64>,
    stitches_torn: Option<u64>,
    dropped: Option<u32>,
    off_circle_m: Option<f64>,
    clamp_s: Option<f64>,
}

#[derive(Clone, Copy, Debug)]
struct HandWatch {
    motion: HandMotion,
    force: ForceWatch,
    /// Time out of view, s; `None` without an endoscope.
    unseen_s: Option<f64>,
}

/// What was resected.
#[derive(Clone, Debug, PartialEq)]
pub struct Resected {
    /// Volumes.
    pub volumes: Resection,
    /// The surface that was cut on what came free with tumour in it, all pieces together.
    pub margin: Option<Margin>,
}

impl Session {
    /// Nothing seen yet. `dt_s` is the length of a tick.
    #[must_use]
    pub fn new(dt_s: f64, settings: MetricSettings) -> Self {
        let apart = (APART_S / dt_s).ceil() as u32;
        Self {
            dt_s,
            settings,
            ticks: 0,
            hands: [None; 2],
            camera: CameraWatch::default(),
            collisions: TouchCounter::new(apart),
            two_tools: false,
            blood_lost_ml: None,
            aspirated_ml: None,
            clip_errors: None,
            bruised_m2: None,
            stitches_torn: None,
            dropped: None,
            off_circle_m: None,
            clamp_s: None,
        }
    }

    /// Takes a tick.
    pub fn push(&mut self, sample: &Sample) {
        self.ticks += 1;
        for tool in &sample.tools {
            let watch = self.hands[index(tool.hand)].get_or_insert_with(|| HandWatch {
                motion: HandMotion::new(self.dt_s, self.settings.idle),
                force: ForceWatch::new(self.dt_s, self.settings.grip_limit_n),
                unseen_s: None,
            });
            watch.motion.push(tool.tip, tool.port);
            watch.force.push(tool.grip_n, tool.tissue_n);
            if let Some(view) = &sample.view {
                *watch.unseen_s.get_or_insert(0.0) += if view.sees(tool.tip) { 0.0 } else { self.dt_s };
            }
        }
        if let [one, other] = sample.tools.as_slice() {
            self.two_tools = true;
            let near = || shafts_touch([one.port, one.shaft_end], [other.port, other.shaft_end], one.radius_m + other.radius_m);
            self.collisions.push(sample.tools_touch.unwrap_or_else(near));
        }
        if let Some(view) = &sample.view {
            let tips: Vec<DVec3> = sample.tools.iter().map(|t| t.tip).collect();
            self.camera.push(view, DVec3::Y, &tips);
        }
        self.blood_lost_ml = sample.blood_lost_ml.or(self.blood_lost_ml);
        self.aspirated_ml = sample.aspirated_ml.or(self.aspirated_ml);
        self.clip_errors = sample.clip_errors.or(self.clip_errors);
        self.bruised_m2 = sample.bruised_m2.or(self.bruised_m2);
        self.stitches_torn = sample.stitches_torn.or(self.stitches_torn);
        self.dropped = sample.dropped.or(self.dropped);
        self.off_circle_m = sample.off_circle_m.or(self.off_circle_m);
        if let Some(clamped) = sample.clamped {
            *self.clamp_s.get_or_insert(0.0) += if clamped { self.dt_s } else { 0.0 };
        }
    }

    /// Ticks so far.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        self.ticks
    }

    /// What the sums come to, in the order of [`MetricId::ALL`], the left hand first. What could not be measured is not there.
    #[must_use]
    pub fn figures(&self, resected: Option<&Resected>) -> Vec<Measured> {
        let mut figures = Vec::new();
        for metric in MetricId::ALL {
            for hand in [None, Some(Hand::Left), Some(Hand::Right)] {
                let value = match hand {
                    Some(hand) => self.hands[index(hand)].as_ref().and_then(|watch| watch.value(metric)),
                    None => self.value(metric).or_else(|| resected.and_then(|r| r.value(metric))),
                };
                figures.extend(value.filter(|v| v.is_finite()).map(|value| Measured { metric, hand, value }));
            }
        }
        figures
    }

    fn value(&self, metric: MetricId) -> Option<f64> {
        match metric {
            MetricId::Time => Some(self.ticks as f64 * self.dt_s),
            MetricId::ToolCollisions => self.two_tools.then(|| f64::from(self.collisions.count())),
            MetricId::Horizon => self.camera.tilt_rad().map(f64::to_degrees),
            MetricId::Centring => self.camera.off_centre(),
            MetricId::Distance => self.camera.distance_m().map(|d| d * 1e3),
            MetricId::BloodLoss => self.blood_lost_ml,
            MetricId::Aspirated => self.aspirated_ml,
            MetricId::ClipErrors => self.clip_errors.map(f64::from),
            MetricId::Bruised => self.bruised_m2.map(|a| a * 1e6),
            MetricId::StitchesTorn => self.stitches_torn.map(|n| n as f64),
            MetricId::Dropped => self.dropped.map(f64::from),
            MetricId::OffTheLine => self.off_circle_m.map(|m| m * 1e3),
            MetricId::ClampTime => self.clamp_s,
            _ => None,
        }
    }
}

impl HandWatch {
    fn value(&self, metric: MetricId) -> Option<f64> {
        match metric {
            MetricId::PathLength => Some(self.motion.path_m() * 1e3),
            MetricId::Depth => Some(self.motion.depth_m() * 1e3),
            MetricId::Speed => self.motion.speed_m_s().map(|s| s * 1e3),
            MetricId::Smoothness => self.motion.smoothness(),
            MetricId::Idle => Some(self.motion.idle_s()),
            MetricId::OutOfView => self.unseen_s,
            MetricId::GripMean => self.force.grip_mean_n(),
            MetricId::GripMax => self.force.grip_max_n(),
            MetricId::TissueForceMean => self.force.tissue_mean_n(),
            MetricId::TissueForceMax => self.force.tissue_max_n(),
            MetricId::Overload => self.force.grip_max_n().map(|_| self.force.overload_n_s()),
            _ => None,
        }
    }
}

impl Resected {
    /// The distribution of the margin.
    #[must_use]
    pub fn summary(&self) -> Option<MarginSummary> {
        self.margin.as_ref().map(MarginSummary::of)
    }

    fn value(&self, metric: MetricId) -> Option<f64> {
        let margin = self.margin.as_ref();
        match metric {
            MetricId::TumourLeft => Some(self.volumes.tumour_left_m3() * 1e6),
            MetricId::HealthyRemoved => Some(self.volumes.healthy_removed_m3() * 1e6),
            MetricId::Preserved => self.volumes.preserved().map(|p| p * 100.0),
            MetricId::MarginLeast => margin.map(|m| m.least_m() * 1e3),
            MetricId::MarginMean => margin.map(|m| m.mean_m() * 1e3),
            MetricId::MarginMedian => margin.map(|m| m.quantile_m(0.5) * 1e3),
            MetricId::MarginPositive => margin.map(|m| m.part_within(0.0) * 100.0),
            MetricId::CutSurface => margin.map(|m| m.area_m2() * 1e6),
            _ => None,
        }
    }
}

fn index(hand: Hand) -> usize {
    match hand {
        Hand::Left => 0,
        Hand::Right => 1,
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    /// One second at 10 Hz: the right tip goes 1 cm a tick along x and is out of view from the 6th tick on, grips with 7 N from the 8th; vessels are clamped in
    /// the last three ticks; 2 ml are lost.
    #[test]
    fn a_second_by_hand() {
        let mut session = Session::new(0.1, MetricSettings::default());
        for tick in 1..=10 {
            let tip = DVec3::new(0.01 * f64::from(tick), 0.0, 0.0);
            let tool = |hand, tip| ToolSample {
                hand,
                port: DVec3::NEG_X,
                shaft_end: tip,
                tip,
                radius_m: 0.0025,
                grip_n: (tick >= 8).then_some(7.0),
                tissue_n: 0.0,
            };
            // From 10 cm above the middle of what is seen, 5.5 cm are at the rim.
            let view = ViewCone { tip: DVec3::Z * 0.1, direction: DVec3::NEG_Z, half_angle_rad: 0.55_f64.atan(), right: DVec3::X };
            session.push(&Sample {
                tools: vec![tool(Hand::Right, tip)],
                tools_touch: None,
                view: Some(view),
                blood_lost_ml: Some(0.2 * f64::from(tick)),
                aspirated_ml: Some(0.1 * f64::from(tick)),
                clip_errors: Some(3),
                bruised_m2: Some(if tick > 7 { 3e-6 } else { 0.0 }),
                stitches_torn: None,
                dropped: Some(1),
                off_circle_m: None,
                clamped: Some(tick >= 8),
            });
        }
        let figures = session.figures(None);
        let value = |metric, hand| figures.iter().find(|m| m.metric == metric && m.hand == hand).map(|m| m.value);
        let near = |metric, hand, expected: f64| {
            let found = value(metric, hand).unwrap();
            assert!((found - expected).abs() < 1e-9, "{metric:?}: {found} against {expected}");
        };
        let right = Some(Hand::Right);
        near(MetricId::Time, None, 1.0);
        near(MetricId::PathLength, right, 90.0);
        near(MetricId::Depth, right, 90.0);
        near(MetricId::Speed, right, 100.0);
        near(MetricId::OutOfView, right, 0.5);
        near(MetricId::GripMax, right, 7.0);
        near(MetricId::Overload, right, 3.0 * 0.1 * 2.0);
        near(MetricId::BloodLoss, None, 2.0);
        near(MetricId::Aspirated, None, 1.0);
        near(MetricId::ClipErrors, None, 3.0);
        near(MetricId::Bruised, None, 3.0);
        assert_eq!(value(MetricId::StitchesTorn, None), None, "there is no suture");
        near(MetricId::ClampTime, None, 0.3);
        near(MetricId::Horizon, None, 0.0);
        assert_eq!(value(MetricId::PathLength, Some(Hand::Left)), None, "there is no left hand");
        assert_eq!(value(MetricId::ToolCollisions, None), None, "one tool meets no other");
        assert_eq!(value(MetricId::TumourLeft, None), None, "nothing was resected");
    }
}
