//! Images that stand at uneven distances or shifted against each other, on a straight and even grid; sheared labels likewise.

use crate::dicom_pixels::AIR;
use crate::dicom_series::CtVolume;
use crate::frame;
use crate::volume::LabelVolume;
use glam::{DAffine3, DMat3, DVec3};
use rayon::prelude::*;

/// A decoded image.
#[derive(Clone, Debug)]
pub struct Plane {
    /// Its first pixel's centre, seen from that of the first image: along the rows, along the columns, along the normal, mm.
    pub at: DVec3,
    /// Hounsfield units, x fastest.
    pub pixels: Vec<f32>,
}

/// The volume of images in order of their heights on the grid `straight`, which starts at the first image's corner: columns and rows
/// are added at its sides so that every image fits in. Between two images values are interpolated along the normal, each image being
/// read where it is; beyond an image there is air. `None` when the grid would have more than `most` voxels.
#[must_use]
pub fn straighten(planes: &[Plane], [nx, ny]: [usize; 2], spacing: DVec3, straight: DAffine3, most: usize) -> Option<CtVolume> {
    let (low, high) = planes.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(p.at), h.max(p.at)));
    let (before, after) = ((low / spacing).floor(), (high / spacing).ceil());
    let slices = ((high.z - low.z) / spacing.z).round() + 1.0;
    let size = [after.x - before.x + nx as f64, after.y - before.y + ny as f64, slices];
    let voxels: f64 = size.iter().product();
    if voxels.is_nan() || voxels > most as f64 {
        return None;
    }
    let dims = size.map(|n| n as usize);
    let origin = DVec3::new(before.x, before.y, 0.0);
    let mut hu = vec![AIR; dims.iter().product()];
    hu.par_chunks_mut(dims[0] * dims[1]).enumerate().for_each(|(z, out)| {
        let height = low.z + z as f64 * spacing.z;
        let above = planes.partition_point(|p| p.at.z < height).clamp(1, planes.len() - 1);
        let (a, b) = (&planes[above - 1], &planes[above]);
        let t = ((height - a.at.z) / (b.at.z - a.at.z)).clamp(0.0, 1.0) as f32;
        for (i, v) in out.iter_mut().enumerate() {
            let at = (origin + DVec3::new((i % dims[0]) as f64, (i / dims[0]) as f64, 0.0)) * spacing;
            let of = |p: &Plane| bilinear(&p.pixels, [nx, ny], (at.x - p.at.x) / spacing.x, (at.y - p.at.y) / spacing.y);
            *v = if t == 0.0 { of(a) } else { of(a) * (1.0 - t) + of(b) * t };
        }
    });
    Some(CtVolume { dims, voxel_to_lps: DAffine3 { translation: straight.transform_point3(origin), ..straight }, hu })
}

/// The value of an image between its pixels; air beyond it.
fn bilinear(pixels: &[f32], [nx, ny]: [usize; 2], x: f64, y: f64) -> f32 {
    // Half a pixel more than the outermost centres is still the image.
    if !(x >= -0.5 && y >= -0.5 && x <= nx as f64 - 0.5 && y <= ny as f64 - 0.5) {
        return AIR;
    }
    let (x, y) = (x.clamp(0.0, (nx - 1) as f64), y.clamp(0.0, (ny - 1) as f64));
    let (i, j) = ((x as usize).min(nx.saturating_sub(2)), (y as usize).min(ny.saturating_sub(2)));
    let (tx, ty) = ((x - i as f64) as f32, (y - j as f64) as f32);
    let at = |i: usize, j: usize| pixels[j.min(ny - 1) * nx + i.min(nx - 1)];
    let row = |j: usize| at(i, j) + (at(i + 1, j) - at(i, j)) * tx;
    row(j) + (row(j + 1) - row(j)) * ty
}

/// Labels on axes that are not perpendicular, on the straight grid that holds them, each voxel that of the nearest centre. The first axis
/// stays, the second stays in the plane of the first two. `None` when the grid would have more than `most` voxels.
#[must_use]
pub fn straighten_labels(labels: &LabelVolume, most: usize) -> Option<LabelVolume> {
    let m = labels.voxel_to_lps.matrix3;
    let x = m.x_axis.normalize();
    let y = (m.y_axis - x * m.y_axis.dot(x)).normalize();
    let mut z = x.cross(y);
    if z.dot(m.z_axis) < 0.0 {
        z = -z;
    }
    let size = frame::spacing(&labels.voxel_to_lps);
    // Layers keep the distance between them, which is less than the length of a slanting axis.
    let spacing = DVec3::new(size.x, m.y_axis.dot(y), m.z_axis.dot(z));
    let turn = DMat3::from_cols(x, y, z).transpose();
    let corner = |k: usize| DVec3::from_array(std::array::from_fn(|a| if k >> a & 1 == 1 { (labels.dims[a] - 1) as f64 } else { 0.0 }));
    let (low, high) = (0..8).fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), k| {
        let p = turn * (m * corner(k));
        (l.min(p), h.max(p))
    });
    let cells = ((high - low) / spacing).round() + DVec3::ONE;
    let voxels = cells.element_product();
    if voxels.is_nan() || voxels > most as f64 {
        return None;
    }
    let dims = cells.to_array().map(|n| n as usize);
    let matrix3 = DMat3::from_cols(x * spacing.x, y * spacing.y, z * spacing.z);
    let translation = labels.voxel_to_lps.translation + DMat3::from_cols(x, y, z) * low;
    let voxel_to_lps = DAffine3 { matrix3, translation };
    let back = labels.voxel_to_lps.inverse() * voxel_to_lps;
    let [nx, ny, nz] = labels.dims;
    let mut parts = vec![0; dims.iter().product()];
    parts.par_chunks_mut(dims[0] * dims[1]).enumerate().for_each(|(k, out)| {
        for (i, v) in out.iter_mut().enumerate() {
            let p = back.transform_point3(DVec3::new((i % dims[0]) as f64, (i / dims[0]) as f64, k as f64)).round();
            if p.min_element() >= 0.0 && p.cmplt(DVec3::new(nx as f64, ny as f64, nz as f64)).all() {
                *v = labels.parts[p.x as usize + nx * (p.y as usize + ny * p.z as usize)];
            }
        }
    });
    let mut notes = labels.notes.clone();
    notes.push(format!(
        "voxel axes {:.1} degrees off a right angle, resampled to a straight grid",
        frame::shear_degrees(&labels.voxel_to_lps)
    ));
    Some(LabelVolume { dims, parts, voxel_to_lps, notes, path: labels.path.clone(), names: labels.names.clone() })
}
