//! One picture of what was made: slices of the scan with the mesh's outline over them, and the surface from four sides.
//!
//! Where the CT is at hand slices show its greys, in a window for soft tissue, with inner parts tinted; without it they show the labels.
//!
//! Rows from the top: axial slices from the feet to the head, coronal ones from front to back, sagittal ones from the patient's right to
//! the left, then the surface seen from the front, the patient's left, behind and the patient's right. Slices are drawn as on a viewing
//! station: the patient's right at the picture's left, the front or the head at its top.

use crate::dicom_series::CtVolume;
use crate::error::ImagingError;
use crate::volume::Body;
use glam::{DAffine3, DVec3};
use rayon::prelude::*;
use std::path::Path;

/// Side of a tile in the picture, pixels.
const TILE: usize = 300;
/// Points of the drawing along one pixel.
const FINE: usize = 2;
/// Tiles in a row.
const COLUMNS: usize = 4;
/// Part of a tile that the body fills.
const FILL: f64 = 0.9;
/// Half the width of an outline, points of the drawing.
const PEN: f64 = 1.5;
const BACKGROUND: [f32; 3] = [14.0, 16.0, 20.0];
/// Labels in slices, the organ first; parts beyond them take the last.
const LABELS: [[f32; 3]; 3] = [[104.0, 104.0, 110.0], [176.0, 140.0, 88.0], [110.0, 140.0, 176.0]];
/// How much of a label's colour an inner part has over the greys of a CT.
const TINT: f32 = 0.3;
/// Hounsfield units that are black and white: level 40, width 400, the usual window for an abdomen.
const WINDOW: [f32; 2] = [-160.0, 240.0];
/// Width of the lines between tiles, points of the drawing.
const GAP: usize = 2;
/// Surface by material, likewise.
const SURFACE: [[f32; 3]; 3] = [[196.0, 112.0, 98.0], [226.0, 196.0, 130.0], [130.0, 170.0, 220.0]];
/// Outline of the organ and of the parts in it.
const OUTLINE: [[f32; 3]; 2] = [[0.0, 190.0, 225.0], [255.0, 196.0, 0.0]];

/// A picture, red, green and blue, rows from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Three bytes a pixel.
    pub rgb: Vec<u8>,
}

/// The triangles of a mesh in the grid's coordinates of its body, mm.
pub struct Outline<'a> {
    /// Nodes.
    pub nodes: &'a [DVec3],
    /// Triangles of the boundary, normals outward, and the material behind each.
    pub boundary: &'a [([u32; 3], u16)],
    /// Triangles between materials.
    pub borders: &'a [[u32; 3]],
}

/// A tile's frame: its middle, what is to the right, what is down, and what is away from the viewer, all in patient LPS.
struct View {
    middle: DVec3,
    right: DVec3,
    down: DVec3,
    away: DVec3,
}

/// Draws the sheet, with the greys of a CT when it holds the body.
#[must_use]
pub fn draw(body: &Body, outline: &Outline, ct: Option<&CtVolume>) -> Picture {
    let nodes: Vec<DVec3> = outline.nodes.iter().map(|p| body.grid_to_lps.transform_point3(*p)).collect();
    let low = nodes.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let high = nodes.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    let greys = ct.map(|volume| Greys { volume, from_lps: volume.voxel_to_lps.inverse() });
    let greys = greys.filter(|g| g.at((low + high) / 2.0).is_some());
    let side = TILE * FINE;
    let scale = FILL * side as f64 / (high - low).max_element();
    let middle = (low + high) / 2.0;
    let (l, p, s) = (DVec3::X, DVec3::Y, DVec3::Z);
    let mut views = Vec::new();
    for (right, down, away) in [(l, p, s), (l, -s, p), (p, -s, l)] {
        for k in 0..COLUMNS {
            let t = (k as f64 + 0.5) / COLUMNS as f64;
            let middle = middle + away * (low + (high - low) * t - middle).dot(away);
            views.push((View { middle, right, down, away }, Kind::Slice));
        }
    }
    for (right, away) in [(l, p), (p, -l), (-l, -p), (-p, l)] {
        views.push((View { middle, right, down: -s, away }, Kind::Surface));
    }
    let tiles: Vec<Vec<[f32; 3]>> = views
        .par_iter()
        .map(|(view, kind)| match kind {
            Kind::Slice => slice(body, greys.as_ref(), &nodes, outline, view, scale),
            Kind::Surface => surface(&nodes, outline, view, scale),
        })
        .collect();
    let rows = tiles.len() / COLUMNS;
    let (width, height) = (COLUMNS * TILE, rows * TILE);
    let mut rgb = vec![0; width * height * 3];
    for (i, pixel) in rgb.chunks_exact_mut(3).enumerate() {
        let (x, y) = (i % width, i / width);
        let (in_tile, edge) = ([x % TILE, y % TILE], TILE - GAP / FINE);
        if in_tile.iter().any(|v| *v >= edge) {
            pixel.copy_from_slice(&BACKGROUND.map(|c| c as u8));
            continue;
        }
        let tile = &tiles[y / TILE * COLUMNS + x / TILE];
        for (c, byte) in pixel.iter_mut().enumerate() {
            let fine = (0..FINE * FINE).map(|k| tile[(y % TILE * FINE + k / FINE) * side + x % TILE * FINE + k % FINE][c]);
            *byte = (fine.sum::<f32>() / (FINE * FINE) as f32).round() as u8;
        }
    }
    Picture { width, height, rgb }
}

/// What a tile shows.
enum Kind {
    Slice,
    Surface,
}

impl View {
    /// Right, down and away of a point, in points of the drawing.
    fn place(&self, p: DVec3, scale: f64) -> DVec3 {
        let (d, half) = ((p - self.middle) * scale, (TILE * FINE) as f64 / 2.0);
        DVec3::new(d.dot(self.right) + half, d.dot(self.down) + half, d.dot(self.away))
    }
}

/// A CT to be looked up by places in the patient.
struct Greys<'a> {
    volume: &'a CtVolume,
    from_lps: DAffine3,
}

impl Greys<'_> {
    /// The Hounsfield units at a point in patient LPS, mm, interpolated trilinearly; `None` beyond the volume.
    fn at(&self, p: DVec3) -> Option<f32> {
        let dims = self.volume.dims;
        let far = DVec3::from_array(dims.map(|n| n as f64 - 1.0));
        let v = self.from_lps.transform_point3(p);
        if v.min_element() < -0.5 || (v - far).max_element() > 0.5 {
            return None;
        }
        let v = v.clamp(DVec3::ZERO, far);
        let low = v.floor();
        let t = (v - low).as_vec3();
        let value = |corner: usize| {
            let index = |a: usize| (low[a] as usize + (corner >> a & 1)).min(dims[a] - 1);
            self.volume.hu[index(0) + dims[0] * (index(1) + dims[1] * index(2))]
        };
        let weight = |corner: usize| (0..3).map(|a| if corner >> a & 1 == 1 { t[a] } else { 1.0 - t[a] }).product::<f32>();
        Some((0..8).map(|c| weight(c) * value(c)).sum())
    }

    /// The same as a grey.
    fn grey(&self, p: DVec3) -> Option<[f32; 3]> {
        self.at(p).map(|hu| [255.0 * ((hu - WINDOW[0]) / (WINDOW[1] - WINDOW[0])).clamp(0.0, 1.0); 3])
    }
}

fn slice(body: &Body, greys: Option<&Greys>, nodes: &[DVec3], outline: &Outline, view: &View, scale: f64) -> Vec<[f32; 3]> {
    let side = TILE * FINE;
    let back = body.grid_to_lps.inverse();
    let half = side as f64 / 2.0;
    let mut tile: Vec<[f32; 3]> = (0..side * side)
        .map(|i| {
            let (x, y) = ((i % side) as f64 + 0.5 - half, (i / side) as f64 + 0.5 - half);
            let lps = view.middle + (view.right * x + view.down * y) / scale;
            let v = (back.transform_point3(lps) / body.spacing).round();
            let inside = v.min_element() >= 0.0 && (0..3).all(|a| v[a] < body.dims[a] as f64);
            let at = |v: DVec3| v.x as usize + body.dims[0] * (v.y as usize + body.dims[1] * v.z as usize);
            let part = usize::from(if inside { body.parts[at(v)] } else { 0 });
            let label = |part: usize| LABELS[(part - 1).min(LABELS.len() - 1)];
            match (greys.map(|g| g.grey(lps).unwrap_or(BACKGROUND)), part) {
                (None, 0) => BACKGROUND,
                (None, part) => label(part),
                (Some(grey), 0 | 1) => grey,
                (Some(grey), part) => std::array::from_fn(|c| grey[c] * (1.0 - TINT) + label(part)[c] * TINT),
            }
        })
        .collect();
    let faces = outline.borders.iter().map(|f| (f, OUTLINE[1])).chain(outline.boundary.iter().map(|(f, _)| (f, OUTLINE[0])));
    for (face, colour) in faces {
        let p = face.map(|n| view.place(nodes[n as usize], scale));
        let mut ends = Vec::new();
        for k in 0..3 {
            let (a, b) = (p[k], p[(k + 1) % 3]);
            // A corner in the plane counts as in front of it, so a triangle has two crossings or none.
            if (a.z < 0.0) != (b.z < 0.0) {
                ends.push(a.lerp(b, a.z / (a.z - b.z)));
            }
        }
        if let [a, b] = ends[..] {
            line(&mut tile, a, b, colour);
        }
    }
    tile
}

/// A line as wide as the pen.
fn line(tile: &mut [[f32; 3]], a: DVec3, b: DVec3, colour: [f32; 3]) {
    let side = TILE * FINE;
    let (a, b) = (a.truncate(), b.truncate());
    let low = (a.min(b) - PEN).floor().max(glam::DVec2::ZERO);
    let high = (a.max(b) + PEN).ceil().min(glam::DVec2::splat((side - 1) as f64));
    let d = b - a;
    for y in low.y as usize..=high.y.max(0.0) as usize {
        for x in low.x as usize..=high.x.max(0.0) as usize {
            let q = glam::DVec2::new(x as f64 + 0.5, y as f64 + 0.5) - a;
            let t = if d.length_squared() > 0.0 { (q.dot(d) / d.length_squared()).clamp(0.0, 1.0) } else { 0.0 };
            if (q - d * t).length_squared() <= PEN * PEN && x < side && y < side {
                tile[y * side + x] = colour;
            }
        }
    }
}

fn surface(nodes: &[DVec3], outline: &Outline, view: &View, scale: f64) -> Vec<[f32; 3]> {
    let side = TILE * FINE;
    let mut tile = vec![BACKGROUND; side * side];
    let mut depth = vec![f64::INFINITY; side * side];
    // From above the viewer's left shoulder.
    let light = (-view.away - view.down * 0.7 - view.right * 0.5).normalize();
    for (face, material) in outline.boundary {
        let at = face.map(|n| nodes[n as usize]);
        let normal = (at[1] - at[0]).cross(at[2] - at[0]).normalize_or_zero();
        if normal.dot(view.away) >= 0.0 {
            continue;
        }
        let bright = (0.25 + 0.75 * normal.dot(light).max(0.0)) as f32;
        let colour = SURFACE[usize::from(*material).min(SURFACE.len() - 1)].map(|c| c * bright);
        let p = at.map(|q| view.place(q, scale));
        let area = (p[1] - p[0]).truncate().perp_dot((p[2] - p[0]).truncate());
        let low = p[0].min(p[1]).min(p[2]).floor().max(DVec3::ZERO);
        let high = p[0].max(p[1]).max(p[2]).ceil();
        for y in low.y as usize..(high.y.max(0.0) as usize + 1).min(side) {
            for x in low.x as usize..(high.x.max(0.0) as usize + 1).min(side) {
                let q = glam::DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let w = [0, 1, 2].map(|k| (p[(k + 1) % 3].truncate() - q).perp_dot(p[(k + 2) % 3].truncate() - q) / area);
                let z = (0..3).map(|k| w[k] * p[k].z).sum::<f64>();
                if w.iter().all(|w| *w >= 0.0) && z < depth[y * side + x] {
                    depth[y * side + x] = z;
                    tile[y * side + x] = colour;
                }
            }
        }
    }
    tile
}

/// Writes a picture as PNG.
///
/// # Errors
/// Those of the file system.
pub fn write(path: &Path, picture: &Picture) -> Result<(), ImagingError> {
    let fail = |e: png::EncodingError| ImagingError::Io { path: path.into(), source: std::io::Error::other(e) };
    crate::publish::whole_file(path, |out| {
        let mut encoder = png::Encoder::new(out, picture.width as u32, picture.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.write_header().map_err(fail)?.write_image_data(&picture.rgb).map_err(fail)
    })
}
