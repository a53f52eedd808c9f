//! Needles with their threads: what a scene says about them, and how they begin.

use crate::format::{Placement, SceneHand, SceneInstrumentKind, Triple};
use bevy_math::{Isometry3d, Vec3};
use keyhole_whiteboard::{Needle, Thread};
use serde::{Deserialize, Serialize};
use std::f32::consts::PI;

/// Density of a needle's steel, kg/m3.
const STEEL_KG_M3: f32 = 7900.0;

/// A curved needle at the end of its thread.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneSuture {
    /// Where the needle is at first. Its frame: the centre of its circle is the origin; its wire lies in the plane of X and Y, from the swage, where the thread is, on X,
    /// right-handed about Z to the tip.
    #[serde(default)]
    pub transform: Placement,
    /// The hand that has it between its closed jaws at first. It is held as it lies there: the `transform` is then in the frame of the instrument, whose jaws turn about X at
    /// its origin and point along -Z. Default none: then it lies where it is.
    #[serde(default)]
    pub held_by: Option<SceneHand>,
    /// Length of the needle along its wire, mm. Default 26.
    #[serde(default = "default_needle")]
    pub needle_mm: f32,
    /// Angle from swage to tip, degrees: 180 is a half circle, 135 three eighths. Default 180.
    #[serde(default = "default_arc")]
    pub arc_deg: f32,
    /// Thickness of the needle's wire, mm. Default 0.66.
    #[serde(default = "default_wire")]
    pub wire_mm: f32,
    /// Thickness of the thread, mm: gauge 2-0 has 0.3, 4-0 has 0.15. Default 0.3.
    #[serde(default = "default_thread")]
    pub thread_mm: f32,
    /// Length of the thread, m. Default 0.15.
    #[serde(default = "default_length")]
    pub thread_m: f32,
    /// Where its thread lies at first, seen from the swage: straight in this direction of the world, of any length. Default up.
    #[serde(default = "default_towards")]
    pub towards: Triple,
}

fn default_needle() -> f32 {
    26.0
}

fn default_arc() -> f32 {
    180.0
}

fn default_wire() -> f32 {
    0.66
}

fn default_thread() -> f32 {
    0.3
}

fn default_length() -> f32 {
    0.15
}

fn default_towards() -> Triple {
    [0.0, 1.0, 0.0]
}

impl SceneSuture {
    /// The needle with this pose in the world, and its thread.
    #[must_use]
    pub fn needle(&self, pose: Isometry3d) -> (Needle, Thread) {
        let (length_m, arc_rad, wire_radius_m) = (self.needle_mm * 1e-3, self.arc_deg.to_radians(), self.wire_mm * 0.5e-3);
        let needle = Needle {
            radius_m: length_m / arc_rad,
            arc_rad,
            wire_radius_m,
            mass_kg: STEEL_KG_M3 * PI * wire_radius_m * wire_radius_m * length_m,
            ..Needle::half_circle_26mm(pose)
        };
        let swage = needle.point(&pose, 0.0);
        let tail = swage + self.thread_m * Vec3::from_array(self.towards).normalize_or(Vec3::Y);
        (needle, Thread { points: vec![tail, swage], radius_m: self.thread_mm * 0.5e-3, ..Thread::default() })
    }
}

impl SceneInstrumentKind {
    /// Whether its jaws hold a needle.
    #[must_use]
    pub fn holds(self) -> bool {
        matches!(self, Self::Grasper | Self::NeedleHolder)
    }

    /// How messages name it.
    #[must_use]
    pub fn spoken(self) -> String {
        let name = format!("{self:?}");
        let spaced =
            name.chars().enumerate().flat_map(|(i, c)| (i > 0 && c.is_uppercase()).then_some(' ').into_iter().chain(c.to_lowercase()));
        spaced.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_suture_that_says_nothing_is_a_half_circle_of_26_mm() {
        let text = "(version: 1, name: \"s\", organs: [], sutures: [()])";
        let scene = crate::parse(text).unwrap_or_else(|error| panic!("{error}"));
        let pose = Isometry3d::from_translation(Vec3::X);
        let (needle, thread) = scene.sutures[0].needle(pose);
        let expected = Needle::half_circle_26mm(pose);
        assert!((needle.radius_m - expected.radius_m).abs() < 1e-7 && (needle.mass_kg / expected.mass_kg - 1.0).abs() < 1e-5);
        assert_eq!((needle.arc_rad, needle.pose), (expected.arc_rad, pose));
        assert!((thread.points[0] - thread.points[1]).distance(0.15 * Vec3::Y) < 1e-6);
        assert_eq!(thread.points[1], needle.point(&pose, 0.0));
    }

    #[test]
    fn kinds_have_names_that_are_read() {
        assert_eq!(
            (SceneInstrumentKind::NeedleHolder.spoken(), SceneInstrumentKind::Hook.spoken()),
            ("needle holder".into(), "hook".into())
        );
    }
}
