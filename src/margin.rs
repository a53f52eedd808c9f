//! What was resected in the colours of its margin, and where to look at it from.

use bevy::prelude::*;
use keyhole_assessment::metrics::Margin;
use keyhole_assessment::results::plots::margin_colour;
use keyhole_view::{Paint, PaintedCut, Viewpoint};
use keyhole_whiteboard::{TissueMesh, TissueState};

/// From the middle of a piece to the camera, in its radii: it fills three quarters of the picture's height.
const DISTANCE: f32 = 3.6;

/// What the colours mean, for a legend: margin in mm, and text.
pub const LEGEND: [(f64, &str); 4] =
    [(0.0, "cut through tumour"), (0.1, "at the tumour"), (5.0, "5 mm of healthy tissue"), (10.0, "10 mm and more")];

/// The opened surfaces of pieces in the colours of their margins.
#[must_use]
pub fn paint(pieces: &[(Entity, Margin)]) -> Paint {
    let linear = |margin_m| {
        let [r, g, b] = margin_colour(margin_m);
        let colour = Color::srgb(r, g, b).to_linear();
        [colour.red, colour.green, colour.blue]
    };
    let painted = |(organ, margin): &(Entity, Margin)| PaintedCut {
        organ: *organ,
        colours: margin.vertices.iter().map(|v| (v.node, linear(v.margin_m))).collect(),
    };
    Paint(pieces.iter().map(painted).collect())
}

/// Where to look at pieces from, as they lie: from where most of what was cut faces, so far away that all is seen. `None` without a piece.
#[must_use]
pub fn viewpoint(world: &World, pieces: &[(Entity, Margin)]) -> Option<Viewpoint> {
    let (mut facing, mut low, mut high) = (Vec3::ZERO, Vec3::INFINITY, Vec3::NEG_INFINITY);
    for (entity, margin) in pieces {
        let (state, mesh) = (world.get::<TissueState>(*entity)?, world.get::<TissueMesh>(*entity)?);
        let place = |i: u32| state.position(margin.vertices[i as usize].node);
        facing += margin.triangles.iter().map(|[a, b, c]| (place(*b) - place(*a)).cross(place(*c) - place(*a))).sum::<Vec3>();
        for node in mesh.0.iter().flat_map(|(_, corners)| corners) {
            (low, high) = (low.min(state.position(node)), high.max(state.position(node)));
        }
    }
    let radius = low.distance(high) / 2.0;
    let target = (low + high) / 2.0;
    (radius.is_finite() && radius > 0.0).then(|| Viewpoint { eye: target + DISTANCE * radius * facing.normalize_or(Vec3::Y), target })
}
