//! A deformed surface seen from the side.

use crate::study::StudyError;
use crate::study::svg::{Drawing, FONT, svg};
use bevy_math::{DVec3, Vec3};
use keyhole_tetmesh::{Boundary, TetMesh};
use plotters::prelude::*;

const PANEL: (u32, u32) = (420, 300);
const HEAD: i32 = 46;
/// Panels side by side.
const ROW: usize = 3;

/// A body as it was left.
pub(crate) struct Still<'a> {
    pub title: [String; 2],
    pub mesh: &'a TetMesh,
    pub positions: &'a [Vec3],
}

/// Draws bodies in rows, each as large as its panel allows; outward sides pale, what is inside out red.
pub(crate) fn draw(name: &str, caption: &str, stills: &[Still]) -> Result<Drawing, StudyError> {
    let rows = stills.len().div_ceil(ROW).max(1) as u32;
    let text = svg(name, (PANEL.0 * ROW as u32, PANEL.1 * rows), |canvas| {
        for (panel, still) in canvas.split_evenly((rows as usize, ROW)).iter().zip(stills) {
            for (line, size, top) in [(&still.title[0], 15, 8), (&still.title[1], 13, 26)] {
                panel.draw(&Text::new(line.clone(), (10, top), (FONT, size).into_font()))?;
            }
            for (points, colour) in faces(still) {
                panel.draw(&Polygon::new(points.to_vec(), colour.filled()))?;
                let outline = vec![points[0], points[1], points[2], points[0]];
                panel.draw(&PathElement::new(outline, RGBColor(90, 60, 50).stroke_width(1)))?;
            }
        }
        Ok(())
    })?;
    Ok(Drawing { name: name.into(), caption: caption.into(), svg: text })
}

/// Triangles in pixels from back to front, with their colour.
fn faces(still: &Still) -> Vec<([(i32, i32); 3], RGBColor)> {
    let eye = DVec3::new(0.35, 0.45, 1.0).normalize();
    let right = DVec3::Y.cross(eye).normalize();
    let up = eye.cross(right);
    let place = |n: keyhole_tetmesh::NodeId| still.positions[n.index()].as_dvec3();
    let boundary = Boundary::of(still.mesh);
    let flat = |p: DVec3| (p.dot(right), p.dot(up));
    let seen = boundary.triangles.iter().flatten().map(|n| place(*n)).filter(|p| p.is_finite()).map(flat);
    let (mut low, mut high) = ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY));
    for (x, y) in seen {
        low = (low.0.min(x), low.1.min(y));
        high = (high.0.max(x), high.1.max(y));
    }
    let room = (f64::from(PANEL.0) - 24.0, f64::from(PANEL.1) - f64::from(HEAD) - 16.0);
    let size = ((high.0 - low.0) / room.0).max((high.1 - low.1) / room.1);
    if !(size.is_finite() && size > 0.0) {
        return Vec::new();
    }
    let pixel = |p: DVec3| {
        let (x, y) = flat(p);
        (12 + ((x - low.0) / size) as i32, PANEL.1 as i32 - 8 - ((y - low.1) / size) as i32)
    };
    let mut all: Vec<(f64, [(i32, i32); 3], RGBColor)> = boundary
        .triangles
        .iter()
        .map(|t| t.map(place))
        .filter(|p| p.iter().all(|p| p.is_finite()))
        .map(|p| {
            let facing = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or_zero().dot(eye);
            let shade = 0.5 + 0.5 * facing.abs();
            let base = if facing >= 0.0 { DVec3::new(214.0, 170.0, 150.0) } else { DVec3::new(190.0, 40.0, 40.0) } * shade;
            let [r, g, b] = base.to_array().map(|c| c as u8);
            ((p[0] + p[1] + p[2]).dot(eye), p.map(pixel), RGBColor(r, g, b))
        })
        .collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all.into_iter().map(|(_, points, colour)| (points, colour)).collect()
}
