//! The phantom on a voxel grid: Hounsfield units and segments.

use super::anatomy::{Structure, abdomen};
use glam::{DAffine3, DMat3, DVec3};
use rayon::prelude::*;

/// Density of air, Hounsfield units.
const AIR: f64 = -1000.0;
/// Smallest corner of what is scanned, mm LPS from the left kidney's centre.
const LOW: DVec3 = DVec3::new(-240.0, -160.0, -145.0);
/// Largest corner, mm.
const HIGH: DVec3 = DVec3::new(116.0, 92.0, 228.0);

/// How the phantom is scanned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhantomSettings {
    /// Distance of pixels within a slice, mm.
    pub pixel_mm: f64,
    /// Distance of slices, mm.
    pub slice_mm: f64,
    /// Standard deviation of the noise, Hounsfield units; 0 for none.
    pub noise_hu: f64,
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for PhantomSettings {
    fn default() -> Self {
        Self { pixel_mm: 1.5, slice_mm: 1.5, noise_hu: 12.0, seed: 1 }
    }
}

/// A sampled phantom.
pub struct PhantomVolume {
    /// Voxels along each axis: columns, rows, slices.
    pub dims: [usize; 3],
    /// From voxel indices to patient LPS, mm.
    pub voxel_to_lps: DAffine3,
    /// Hounsfield units, x fastest.
    pub hu: Vec<i16>,
    /// The voxels of each structure, one byte a voxel (0 or 1), in the order of `structures`.
    pub masks: Vec<Vec<u8>>,
    /// What was sampled.
    pub structures: Vec<Structure>,
}

/// Samples the phantom at voxel centres.
///
/// # Panics
/// When a spacing is not positive and finite.
#[must_use]
pub fn sample(settings: &PhantomSettings) -> PhantomVolume {
    let spacing = DVec3::new(settings.pixel_mm, settings.pixel_mm, settings.slice_mm);
    assert!(spacing.is_finite() && spacing.min_element() > 0.0, "voxels of {spacing} mm");
    let dims = ((HIGH - LOW) / spacing).floor().to_array().map(|n| n as usize + 1);
    let structures = abdomen();
    let masks: Vec<Vec<u8>> = structures.iter().map(|s| mask(s, dims, spacing)).collect();
    let plane = dims[0] * dims[1];
    let mut hu = vec![0_i16; plane * dims[2]];
    hu.par_chunks_mut(plane).enumerate().for_each(|(z, slice)| {
        for (i, v) in slice.iter_mut().enumerate() {
            let index = z * plane + i;
            let first = masks.iter().position(|m| m[index] != 0);
            let density = first.map_or(AIR, |s| structures[s].hu) + settings.noise_hu * gauss(settings.seed, index as u64);
            *v = density.round().clamp(-1024.0, 3071.0) as i16;
        }
    });
    let voxel_to_lps = DAffine3 { matrix3: DMat3::from_diagonal(spacing), translation: LOW };
    PhantomVolume { dims, voxel_to_lps, hu, masks, structures }
}

fn mask(structure: &Structure, dims: [usize; 3], spacing: DVec3) -> Vec<u8> {
    let (low, high) = structure.shape.bounds();
    let last = DVec3::from_array(dims.map(|n| (n - 1) as f64));
    let first = ((low - LOW) / spacing).floor().clamp(DVec3::ZERO, last).to_array().map(|v| v as usize);
    let end = ((high - LOW) / spacing).ceil().clamp(DVec3::ZERO, last).to_array().map(|v| v as usize);
    let mut mask = vec![0; dims.iter().product()];
    let plane = dims[0] * dims[1];
    mask.par_chunks_mut(plane * BLOCK).enumerate().filter(|(slab, _)| (first[2] / BLOCK..=end[2] / BLOCK).contains(slab)).for_each(
        |(slab, out)| {
            for y in (first[1]..=end[1]).step_by(BLOCK) {
                for x in (first[0]..=end[0]).step_by(BLOCK) {
                    block(structure, out, [x, y, slab * BLOCK], dims, end, spacing);
                }
            }
        },
    );
    mask
}

/// Voxels along each side of a block that is looked at as a whole first.
const BLOCK: usize = 6;
/// By how much the functions may grow faster than the distance: ellipsoids and blends are distances only near their surface.
const STEEPNESS: f64 = 2.0;

/// One block of a slab: where the surface is too far away to pass through it, its middle speaks for all of it.
fn block(structure: &Structure, slab: &mut [u8], [x0, y0, z0]: [usize; 3], dims: [usize; 3], end: [usize; 3], spacing: DVec3) {
    let at = |x: usize, y: usize, z: usize| LOW + DVec3::new(x as f64, y as f64, z as f64) * spacing;
    let half = spacing * (BLOCK as f64 - 1.0) / 2.0;
    let middle = structure.shape.distance(at(x0, y0, z0) + half);
    let whole = (middle.abs() > STEEPNESS * half.length()).then(|| u8::from(middle < 0.0));
    if whole == Some(0) {
        return;
    }
    for z in z0..(z0 + BLOCK).min(dims[2]) {
        for y in y0..(y0 + BLOCK).min(end[1] + 1) {
            for x in x0..(x0 + BLOCK).min(end[0] + 1) {
                let inside = whole.unwrap_or_else(|| u8::from(structure.shape.distance(at(x, y, z)) < 0.0));
                slab[((z - z0) * dims[1] + y) * dims[0] + x] = inside;
            }
        }
    }
}

/// About a standard normal number, from the index alone: the sum of four uniform ones (Irwin-Hall), so any order of voxels gives the same.
fn gauss(seed: u64, index: u64) -> f64 {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ index.wrapping_mul(0xd1b5_4a32_d192_ed03);
    let sum: f64 = (0..4).map(|_| uniform(&mut state)).sum();
    // Four uniform numbers have mean 2 and variance 1/3.
    (sum - 2.0) * 3.0_f64.sqrt()
}

/// SplitMix64 (Steele, Lea, Flood 2014) as a number in [0, 1).
fn uniform(state: &mut u64) -> f64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}
