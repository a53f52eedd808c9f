//! The smooth field of a mask: signed distance, blurred by about a voxel, its level set so that the volume stays.

use crate::distance::{along_axis, signed_distance, signed_distance_in_planes, squared_distance};
use glam::DVec3;
use rayon::prelude::*;

/// Standard deviation of the blur in voxels, on each axis, for bodies.
pub const BLUR_VOXELS: f64 = 0.7;
/// The same for surfaces that are only drawn: a vessel two voxels wide would dissolve under the wider blur.
pub const THIN_BLUR_VOXELS: f64 = 0.6;

/// Voxels longer than this many times their width are slices: a blur of one voxel along them would close everything between two.
const THICK: f64 = 2.0;
/// Distances within a slice count up to this part of the slices' distance: more joins outlines farther apart, and takes more from what is
/// thin and in one slice alone.
const SLICE_REACH: f32 = 0.5;

/// A scalar on a straight grid, interpolated trilinearly; beyond the grid its border continues.
#[derive(Clone, Debug)]
pub struct ScalarGrid {
    /// Samples along each axis.
    pub dims: [usize; 3],
    /// Distance between samples, mm.
    pub spacing: DVec3,
    /// Samples, x fastest.
    pub values: Vec<f32>,
}

impl ScalarGrid {
    /// The value at a point in the grid's coordinates, mm.
    #[must_use]
    pub fn sample(&self, p: DVec3) -> f64 {
        let mut base = [0; 3];
        let mut t = [0.0; 3];
        for a in 0..3 {
            let n = self.dims[a];
            let x = (p[a] / self.spacing[a]).clamp(0.0, (n - 1) as f64);
            base[a] = (x as usize).min(n.saturating_sub(2));
            t[a] = x - base[a] as f64;
        }
        let [nx, ny, _] = self.dims;
        let step = [1, nx, nx * ny].map(|s| s as isize);
        let stride: [usize; 3] = std::array::from_fn(|a| if self.dims[a] > 1 { step[a] as usize } else { 0 });
        let i = base[0] + base[1] * nx + base[2] * nx * ny;
        let v = |k: usize| f64::from(self.values[i + k]);
        let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
        let row = |k: usize| mix(v(k), v(k + stride[0]), t[0]);
        let plane = |k: usize| mix(row(k), row(k + stride[1]), t[1]);
        mix(plane(0), plane(stride[2]), t[2])
    }

    /// Distance to the surface of a mask in mm, negative inside, blurred by `blur` voxels, shifted so that as many voxel centres are
    /// inside as the mask has voxels.
    #[must_use]
    pub fn of_mask(dims: [usize; 3], spacing: DVec3, blur: f64, inside: impl Fn(usize) -> bool + Sync) -> Self {
        let thick = slice_axis(spacing);
        let values = match thick {
            Some(axis) => signed_distance_in_planes(dims, spacing, axis, &inside),
            None => signed_distance(dims, spacing, &inside),
        };
        let mut grid = Self { dims, spacing, values };
        let count = (0..grid.values.len()).filter(|i| inside(*i)).count();
        // Where there is nothing of the other kind the distance is infinite; the size of the grid stands for it.
        let far = (spacing * DVec3::from_array(dims.map(|d| d as f64))).length() as f32;
        let reach = thick.map_or(far, |axis| SLICE_REACH * spacing[axis] as f32);
        grid.values.par_iter_mut().for_each(|v| *v = v.clamp(-reach, reach));
        grid.blur([0, 1, 2].map(|axis| if thick == Some(axis) { 0.0 } else { blur }));
        let level = level_of(&mut grid.values.clone(), count);
        grid.shift(level);
        grid
    }

    /// The border between a part of a body and the rest of it, in mm, negative in the part: the distance to the part less that to the
    /// rest. Beyond the body it runs on where both are equally near, so the border meets the body's surface and does not follow it.
    /// Blurred and shifted as [`ScalarGrid::of_mask`], counting voxels of the body.
    #[must_use]
    pub fn of_part(
        dims: [usize; 3],
        spacing: DVec3,
        blur: f64,
        in_body: impl Fn(usize) -> bool + Sync,
        in_part: impl Fn(usize) -> bool + Sync,
    ) -> Self {
        let far = (spacing * DVec3::from_array(dims.map(|d| d as f64))).length() as f32;
        let mut values = squared_distance(dims, spacing, &in_part);
        let rest = squared_distance(dims, spacing, |i| in_body(i) && !in_part(i));
        values.par_iter_mut().zip(rest).for_each(|(p, r)| *p = (p.sqrt() - r.sqrt()).clamp(-far, far));
        let mut grid = Self { dims, spacing, values };
        grid.blur([blur; 3]);
        let mut inside: Vec<f32> = grid.values.iter().enumerate().filter(|(i, _)| in_body(*i)).map(|(_, v)| *v).collect();
        let count = (0..grid.values.len()).filter(|i| in_part(*i)).count();
        grid.shift(level_of(&mut inside, count));
        grid
    }

    /// Gaussian of `sigma` voxels along each axis, 0 for none; the border is continued.
    pub fn blur(&mut self, sigma: [f64; 3]) {
        for axis in (0..3).filter(|a| sigma[*a] > 0.0) {
            let sigma = sigma[axis];
            let reach = (3.0 * sigma).ceil() as usize;
            let weights: Vec<f32> = (0..=2 * reach).map(|k| (-0.5 * ((k as f64 - reach as f64) / sigma).powi(2)).exp() as f32).collect();
            let sum: f32 = weights.iter().sum();
            along_axis(&mut self.values, self.dims, axis, |line, out, _| {
                let n = line.len();
                for (i, o) in out.iter_mut().enumerate() {
                    let mut total = 0.0;
                    if i >= reach && i + reach < n {
                        for (w, v) in weights.iter().zip(&line[i - reach..]) {
                            total += w * v;
                        }
                    } else {
                        for (k, w) in weights.iter().enumerate() {
                            total += w * line[(i + k).saturating_sub(reach).min(n - 1)];
                        }
                    }
                    *o = total / sum;
                }
            });
        }
    }

    fn shift(&mut self, level: f32) {
        self.values.par_iter_mut().for_each(|v| *v -= level);
    }
}

/// The axis along which voxels are so much longer that slices are joined by their outlines.
fn slice_axis(spacing: DVec3) -> Option<usize> {
    (0..3).find(|a| (0..3).all(|b| b == *a || spacing[*a] > THICK * spacing[b]))
}

/// The level below which `count` of the values lie; 0 when that is none or all of them. The values end up in another order.
fn level_of(values: &mut [f32], count: usize) -> f32 {
    if count == 0 || count >= values.len() {
        return 0.0;
    }
    let (below, next, _) = values.select_nth_unstable_by(count, f32::total_cmp);
    (below.iter().copied().fold(f32::NEG_INFINITY, f32::max) + *next) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ball_keeps_its_volume_and_its_distances() {
        let (dims, spacing) = ([50, 40, 24], DVec3::new(0.8, 1.0, 2.0));
        // Half way between slices, so that the stairs are the same above and below.
        let centre = DVec3::new(20.0, 20.0, 23.0);
        let at = |i: usize| DVec3::new((i % 50) as f64, (i / 50 % 40) as f64, (i / 2000) as f64) * spacing;
        let inside = |i: usize| at(i).distance(centre) < 12.0;
        let grid = ScalarGrid::of_mask(dims, spacing, BLUR_VOXELS, inside);
        let count = (0..grid.values.len()).filter(|i| inside(*i)).count();
        assert_eq!(grid.values.iter().filter(|v| **v < 0.0).count(), count);
        for direction in [DVec3::X, DVec3::Y, DVec3::Z, DVec3::new(1.0, -1.0, 0.5).normalize()] {
            assert!(grid.sample(centre + direction * 12.0).abs() < spacing.dot(direction.abs()), "the surface is where it was, to a voxel");
            assert!((grid.sample(centre + direction * 17.0) - 5.0).abs() < 1.0, "values are distances");
        }
    }
}
