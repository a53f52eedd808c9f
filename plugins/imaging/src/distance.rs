//! Exact Euclidean distance on an anisotropic grid.
//!
//! P. Felzenszwalb, D. Huttenlocher, "Distance Transforms of Sampled Functions", Theory of Computing 8 (2012): one pass a axis with the
//! lower envelope of parabolas, exact and linear in the number of voxels.

use glam::DVec3;
use rayon::prelude::*;

/// Squared distance, mm2, from every voxel centre to the nearest centre of a voxel where `seed` holds; infinite when there is none.
#[must_use]
pub fn squared_distance(dims: [usize; 3], spacing: DVec3, seed: impl Fn(usize) -> bool + Sync) -> Vec<f32> {
    along_axes(dims, spacing, &[0, 1, 2], seed)
}

/// The same along some of the axes only.
fn along_axes(dims: [usize; 3], spacing: DVec3, axes: &[usize], seed: impl Fn(usize) -> bool + Sync) -> Vec<f32> {
    let mut d: Vec<f32> = (0..dims[0] * dims[1] * dims[2]).into_par_iter().map(|i| if seed(i) { 0.0 } else { f32::INFINITY }).collect();
    for &axis in axes {
        along_axis(&mut d, dims, axis, |line, out, scratch| envelope(line, spacing[axis], out, scratch));
    }
    d
}

/// As [`signed_distance`], but within each plane across `axis` alone: infinite in planes that hold one kind only. Fields of slices that
/// are joined by interpolating these between them keep what is thin within a slice (S. Raya, J. Udupa, "Shape-based interpolation of
/// multidimensional objects", IEEE TMI 1990).
#[must_use]
pub fn signed_distance_in_planes(dims: [usize; 3], spacing: DVec3, axis: usize, inside: impl Fn(usize) -> bool + Sync) -> Vec<f32> {
    let axes = [(axis + 1) % 3, (axis + 2) % 3];
    let out = along_axes(dims, spacing, &axes, &inside);
    let into = along_axes(dims, spacing, &axes, |i| !inside(i));
    out.into_par_iter().zip(into).map(|(a, b)| a.sqrt() - b.sqrt()).collect()
}

/// Signed distance, mm, to the border between voxels where `inside` holds (negative) and others: the distance to the nearest centre of
/// the other kind. Between two neighbours of different kind its zero is half way.
#[must_use]
pub fn signed_distance(dims: [usize; 3], spacing: DVec3, inside: impl Fn(usize) -> bool + Sync) -> Vec<f32> {
    let out = squared_distance(dims, spacing, &inside);
    let into = squared_distance(dims, spacing, |i| !inside(i));
    out.into_par_iter().zip(into).map(|(a, b)| a.sqrt() - b.sqrt()).collect()
}

/// Buffers of one thread.
#[derive(Default)]
pub(crate) struct Scratch {
    vertex: Vec<usize>,
    bound: Vec<f64>,
}

/// Replaces every line along an axis by what `f(line, out, scratch)` writes.
pub(crate) fn along_axis(d: &mut [f32], dims: [usize; 3], axis: usize, f: impl Fn(&[f32], &mut [f32], &mut Scratch) + Sync) {
    let [nx, ny, nz] = dims;
    let n = dims[axis];
    let buffers = || (vec![0.0_f32; n], vec![0.0_f32; n], Scratch::default());
    match axis {
        0 => d.par_chunks_mut(nx).for_each_init(buffers, |(line, out, scratch), row| {
            line.copy_from_slice(row);
            f(line, out, scratch);
            row.copy_from_slice(out);
        }),
        1 => d.par_chunks_mut(nx * ny).for_each_init(buffers, |(line, out, scratch), slab| {
            for x in 0..nx {
                for y in 0..ny {
                    line[y] = slab[y * nx + x];
                }
                f(line, out, scratch);
                for y in 0..ny {
                    slab[y * nx + x] = out[y];
                }
            }
        }),
        _ => {
            // Columns along z interleave in memory: they are gathered into a transposed copy, row by row of y.
            let plane = nx * ny;
            let mut turned = vec![0.0_f32; d.len()];
            turned.par_chunks_mut(nz).enumerate().for_each_init(buffers, |(line, out, scratch), (column, to)| {
                for (z, v) in line.iter_mut().enumerate() {
                    *v = d[z * plane + column];
                }
                f(line, out, scratch);
                to.copy_from_slice(out);
            });
            d.par_chunks_mut(plane).enumerate().for_each(|(z, slab)| {
                for (column, v) in slab.iter_mut().enumerate() {
                    *v = turned[column * nz + z];
                }
            });
        }
    }
}

/// The lower envelope of the parabolas `line[q] + (h (p - q))2`.
fn envelope(line: &[f32], h: f64, out: &mut [f32], scratch: &mut Scratch) {
    let (v, z) = (&mut scratch.vertex, &mut scratch.bound);
    v.clear();
    z.clear();
    let h2 = h * h;
    for (q, f) in line.iter().enumerate().filter(|(_, f)| f.is_finite()) {
        let f = f64::from(*f);
        let mut from = f64::NEG_INFINITY;
        while let Some(&p) = v.last() {
            let (pf, qf) = (p as f64, q as f64);
            from = ((f + h2 * qf * qf) - (f64::from(line[p]) + h2 * pf * pf)) / (2.0 * h2 * (qf - pf));
            // `z` is as long as `v`.
            if z.last().is_some_and(|last| from <= *last) {
                v.pop();
                z.pop();
                from = f64::NEG_INFINITY;
            } else {
                break;
            }
        }
        v.push(q);
        z.push(from);
    }
    if v.is_empty() {
        out.fill(f32::INFINITY);
        return;
    }
    let mut k = 0;
    for (p, o) in out.iter_mut().enumerate() {
        while k + 1 < v.len() && z[k + 1] <= p as f64 {
            k += 1;
        }
        let d = p as f64 - v[k] as f64;
        *o = (f64::from(line[v[k]]) + h2 * d * d) as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn equals_brute_force(
            dims in [1usize..9, 1usize..9, 1usize..9],
            spacing in [0.3f64..5.0, 0.3f64..5.0, 0.3f64..5.0],
            picks in prop::collection::vec(0usize..729, 1..12),
        ) {
            let n = dims.iter().product::<usize>();
            let spacing = DVec3::from_array(spacing);
            let at = |i: usize| DVec3::new((i % dims[0]) as f64, (i / dims[0] % dims[1]) as f64, (i / (dims[0] * dims[1])) as f64) * spacing;
            let seeds: Vec<usize> = picks.iter().map(|p| p % n).collect();
            let got = squared_distance(dims, spacing, |i| seeds.contains(&i));
            for (i, g) in got.iter().enumerate() {
                let want = seeds.iter().map(|s| at(*s).distance_squared(at(i))).fold(f64::INFINITY, f64::min);
                prop_assert!((f64::from(*g) - want).abs() <= 1e-5 * want, "voxel {i}: {g} but {want}");
            }
        }
    }
}
