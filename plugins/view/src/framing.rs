//! Where the scene is and how large: what the cameras frame and where the surroundings go.

use crate::anatomy::AnatomyBounds;
use crate::organs::OrganViews;
use bevy::prelude::*;

/// The place of the scene.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct Framing {
    /// Middle of the organs, m.
    pub focus: Vec3,
    /// Radius of the sphere about the focus that holds the organs, m.
    pub radius_m: f32,
    /// Height of the lowest thing, m.
    pub floor_m: f32,
    /// Whether there has been anything to frame.
    pub framed: bool,
}

impl Default for Framing {
    fn default() -> Self {
        Self { focus: Vec3::ZERO, radius_m: 0.06, floor_m: -0.06, framed: false }
    }
}

/// Frames the organs when the first one comes and once more when anatomy has come; lets go when all are gone.
pub fn frame_scene(mut framing: ResMut<Framing>, organs: Res<OrganViews>, anatomy: Res<AnatomyBounds>) {
    if framing.framed && !anatomy.is_changed() && organs.skin_points().next().is_some() {
        return;
    }
    let Some(bounds) = bounds(organs.skin_points()) else {
        framing.framed = false;
        return;
    };
    let (low, high) = bounds;
    let floor = anatomy.0.map_or(low.y, |(below, _)| below.y.min(low.y));
    *framing = Framing { focus: (low + high) / 2.0, radius_m: low.distance(high) / 2.0, floor_m: floor, framed: true };
}

/// The box around points, `None` when there is none.
pub fn bounds(points: impl Iterator<Item = Vec3>) -> Option<(Vec3, Vec3)> {
    points
        .filter(|p| p.is_finite())
        .fold(None, |sofar: Option<(Vec3, Vec3)>, p| Some(sofar.map_or((p, p), |(low, high)| (low.min(p), high.max(p)))))
}
