//! Face-connected components of voxels by runs along x, the choice among them, and holes.

use crate::disjoint_sets::DisjointSets;
use crate::error::ImagingError;
use crate::frame;
use crate::volume::{LabelVolume, Part, VoxelBox};
use glam::DVec3;

/// Which component is meshed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum ComponentChoice {
    /// The one that holds most of the second label (the kidney with the tumour), the largest when there is but one label.
    #[default]
    Auto,
    /// The largest.
    Largest,
    /// The one of this rank by volume, from 0.
    Rank(usize),
    /// All of them.
    All,
    /// The one that holds this point, patient LPS, mm.
    Seed(DVec3),
}

/// One component of the labels.
#[derive(Clone, Debug, serde::Serialize)]
pub struct ComponentReport {
    /// Rank by number of voxels, from 0.
    pub rank: usize,
    /// Number of voxels.
    pub voxels: usize,
    /// Volume, ml.
    pub volume_ml: f64,
    /// Volume of each part, ml, in the order of the labels.
    pub part_ml: Vec<f64>,
    /// Size along the voxel axes, mm.
    pub extent_mm: [f64; 3],
    /// Centre of its box in patient LPS, mm.
    pub centre_lps_mm: [f64; 3],
    /// Borders of the volume that it reaches: beyond them nothing is known, and it ends there with a flat face.
    pub at_borders: Vec<&'static str>,
    /// Whether it was chosen for the mesh.
    pub chosen: bool,
}

/// A maximal row of voxels of one kind: indices `start..end` along x in row `row`.
#[derive(Clone, Copy)]
struct Run {
    row: u32,
    start: u32,
    end: u32,
}

/// Runs with the component of each.
struct Runs {
    runs: Vec<Run>,
    component: Vec<u32>,
    count: usize,
}

/// Keeps the chosen components of a volume, sets every other voxel to nothing and reports all that there were.
///
/// # Errors
/// [`ImagingError::Empty`], [`ImagingError::NoComponent`], [`ImagingError::Seed`].
pub fn choose(volume: &mut LabelVolume, choice: ComponentChoice) -> Result<(Vec<ComponentReport>, VoxelBox), ImagingError> {
    let [nx, ny, _] = volume.dims;
    let found = connect(&volume.parts, volume.dims, |v| v != 0);
    if found.count == 0 {
        return Err(ImagingError::Empty { what: volume.names.join(" + "), dims: volume.dims });
    }
    let mut stats: Vec<Stats> = (0..found.count).map(|_| Stats::new(volume.names.len())).collect();
    for (run, &c) in found.runs.iter().zip(&found.component) {
        let base = run.row as usize * nx;
        stats[c as usize].add(*run, ny, &volume.parts[base + run.start as usize..base + run.end as usize]);
    }
    let mut order: Vec<usize> = (0..found.count).collect();
    order.sort_by(|a, b| stats[*b].voxels.cmp(&stats[*a].voxels).then(a.cmp(b)));
    let spacing = frame::spacing(&volume.voxel_to_lps);
    let chosen: Vec<usize> = match choice {
        ComponentChoice::All => order.clone(),
        ComponentChoice::Largest => vec![order[0]],
        ComponentChoice::Auto => {
            let inner = |c: usize| stats[c].parts.iter().skip(1).sum::<usize>();
            // `max_by_key` takes the last of equals: with one label that must be the largest, so the order is reversed.
            order.iter().rev().copied().max_by_key(|c| inner(*c)).into_iter().collect()
        }
        ComponentChoice::Rank(wanted) => match order.get(wanted) {
            Some(c) => vec![*c],
            None => {
                let list: Vec<String> =
                    order.iter().take(8).map(|c| format!("{:.2} ml", stats[*c].voxels as f64 * spacing.element_product() * 1e-3)).collect();
                return Err(ImagingError::NoComponent { wanted, count: found.count, list: list.join(", ") });
            }
        },
        ComponentChoice::Seed(seed) => {
            let p = volume.voxel_to_lps.inverse().transform_point3(seed).round();
            let voxel = p.to_array().map(|v| v as i64);
            let component = found.runs.iter().zip(&found.component).find(|(r, _)| {
                voxel[0] >= i64::from(r.start)
                    && voxel[0] < i64::from(r.end)
                    && (0..ny as i64).contains(&voxel[1])
                    && voxel[1] + voxel[2] * ny as i64 == i64::from(r.row)
            });
            match component {
                Some((_, c)) => vec![*c as usize],
                None => return Err(ImagingError::Seed { seed: seed.to_array(), voxel }),
            }
        }
    };
    let mut keep = vec![false; found.count];
    let mut all: Option<VoxelBox> = None;
    for &c in &chosen {
        keep[c] = true;
        let s = &stats[c];
        let b = all.get_or_insert(s.bounds);
        *b = VoxelBox {
            min: std::array::from_fn(|a| b.min[a].min(s.bounds.min[a])),
            max: std::array::from_fn(|a| b.max[a].max(s.bounds.max[a])),
        };
    }
    for (run, &c) in found.runs.iter().zip(&found.component) {
        if !keep[c as usize] {
            let base = run.row as usize * nx;
            volume.parts[base + run.start as usize..base + run.end as usize].fill(0);
        }
    }
    let ml = spacing.element_product() * 1e-3;
    let reports = order
        .iter()
        .enumerate()
        .map(|(rank, &c)| {
            let (s, b) = (&stats[c], &stats[c].bounds);
            let centre = DVec3::from_array(std::array::from_fn(|a| (b.min[a] + b.max[a]) as f64 / 2.0));
            ComponentReport {
                rank,
                voxels: s.voxels,
                volume_ml: s.voxels as f64 * ml,
                part_ml: s.parts.iter().map(|n| *n as f64 * ml).collect(),
                extent_mm: std::array::from_fn(|a| (b.max[a] - b.min[a] + 1) as f64 * spacing[a]),
                centre_lps_mm: volume.voxel_to_lps.transform_point3(centre).to_array(),
                at_borders: borders_of(volume.dims, *b),
                chosen: keep[c],
            }
        })
        .collect();
    // `chosen` is never empty here, so there is a box.
    Ok((reports, all.unwrap_or(VoxelBox { min: [0; 3], max: [0; 3] })))
}

/// Fills background that is enclosed by parts, each hole with the part before it; the number of holes and of their voxels.
pub fn close_holes(parts: &mut [Part], dims: [usize; 3]) -> (usize, usize) {
    let [nx, ny, nz] = dims;
    let found = connect(parts, dims, |v| v == 0);
    let mut open = vec![false; found.count];
    for (run, &c) in found.runs.iter().zip(&found.component) {
        let (y, z) = (run.row as usize % ny, run.row as usize / ny);
        if run.start == 0 || run.end as usize == nx || y == 0 || y + 1 == ny || z == 0 || z + 1 == nz {
            open[c as usize] = true;
        }
    }
    let mut filled = 0;
    for (run, &c) in found.runs.iter().zip(&found.component) {
        if !open[c as usize] {
            let base = run.row as usize * nx;
            // A closed run does not start at 0, so there is a voxel before it.
            let part = parts[base + run.start as usize - 1];
            parts[base + run.start as usize..base + run.end as usize].fill(part);
            filled += (run.end - run.start) as usize;
        }
    }
    (open.iter().filter(|o| !**o).count(), filled)
}

/// What is known of a component.
struct Stats {
    voxels: usize,
    parts: Vec<usize>,
    bounds: VoxelBox,
}

impl Stats {
    fn new(parts: usize) -> Self {
        Self { voxels: 0, parts: vec![0; parts], bounds: VoxelBox { min: [usize::MAX; 3], max: [0; 3] } }
    }

    fn add(&mut self, run: Run, ny: usize, voxels: &[Part]) {
        self.voxels += voxels.len();
        for v in voxels {
            self.parts[*v as usize - 1] += 1;
        }
        let (y, z) = (run.row as usize % ny, run.row as usize / ny);
        let low = [run.start as usize, y, z];
        let high = [run.end as usize - 1, y, z];
        for a in 0..3 {
            self.bounds.min[a] = self.bounds.min[a].min(low[a]);
            self.bounds.max[a] = self.bounds.max[a].max(high[a]);
        }
    }
}

/// The borders of the volume that a box reaches.
fn borders_of(dims: [usize; 3], b: VoxelBox) -> Vec<&'static str> {
    const SIDES: [[&str; 2]; 3] = [["first x", "last x"], ["first y", "last y"], ["first z", "last z"]];
    (0..3)
        .flat_map(|a| [(b.min[a] == 0, SIDES[a][0]), (b.max[a] + 1 == dims[a], SIDES[a][1])])
        .filter(|(at, _)| *at)
        .map(|(_, s)| s)
        .collect()
}

/// The face-connected components of the voxels that satisfy `inside`, numbered in order of their first voxel.
fn connect(parts: &[Part], dims: [usize; 3], inside: impl Fn(Part) -> bool) -> Runs {
    let [nx, ny, nz] = dims;
    let rows = ny * nz;
    let mut runs: Vec<Run> = Vec::new();
    let mut first = Vec::with_capacity(rows + 1);
    for row in 0..rows {
        first.push(runs.len());
        let line = &parts[row * nx..(row + 1) * nx];
        let mut x = 0;
        while x < nx {
            let Some(step) = line[x..].iter().position(|v| inside(*v)) else { break };
            let start = x + step;
            let end = line[start..].iter().position(|v| !inside(*v)).map_or(nx, |n| start + n);
            runs.push(Run { row: row as u32, start: start as u32, end: end as u32 });
            x = end;
        }
    }
    first.push(runs.len());
    let mut sets = DisjointSets::new(runs.len());
    for row in 0..rows {
        for (other, there) in [(row.wrapping_sub(1), row % ny > 0), (row.wrapping_sub(ny), row >= ny)] {
            if !there {
                continue;
            }
            let (mut i, mut j) = (first[row], first[other]);
            while i < first[row + 1] && j < first[other + 1] {
                if runs[i].start < runs[j].end && runs[j].start < runs[i].end {
                    sets.join(i as u32, j as u32);
                }
                if runs[i].end < runs[j].end {
                    i += 1;
                } else {
                    j += 1;
                }
            }
        }
    }
    let (component, count) = sets.numbers();
    Runs { runs, component, count }
}
