//! What the study cuts: meshes, strokes, and every combination of settings.

use crate::study::strokes::Stroke;
use keyhole_imaging::phantom::{self, PhantomSettings};
use keyhole_imaging::{Centring, ComponentChoice, ImagingError, LabelVolume, MeshOptions, pipeline};
use keyhole_tetmesh::{TetMesh, vtu};
use keyhole_whiteboard::{CutMethod, CutPattern, CutSettings};
use std::path::{Path, PathBuf};

/// Lattice cells of the phantom's kidney, mm: some 2 000, 8 000 and 30 000 tetrahedra.
pub const CELLS_MM: [f64; 3] = [10.2, 6.2, 4.0];
/// Voxels of the phantom that the kidney is meshed from, mm.
const VOXEL_MM: f64 = 2.0;
/// The methods, in the order of tables and plots.
pub const METHODS: [CutMethod; 3] = [CutMethod::Progressive, CutMethod::NonProgressive, CutMethod::Hybrid];
/// Patterns of hull and core: both minimal, both symmetric, the paper's own mixture.
pub const PATTERNS: [Pattern; 3] = [
    Pattern { hull: CutPattern::Minimal, core: CutPattern::Minimal },
    Pattern { hull: CutPattern::Symmetric, core: CutPattern::Symmetric },
    Pattern { hull: CutPattern::Symmetric, core: CutPattern::Minimal },
];
/// Way of the blade a sample, as parts of the mean edge.
pub const RATES: [f64; 2] = [0.25, 0.05];
/// Thresholds of the sweep.
pub const SWEEP: [f64; 8] = [0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4];

/// Patterns of hull and core.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pattern {
    /// Of tetrahedra at the surface.
    pub hull: CutPattern,
    /// Of the others.
    pub core: CutPattern,
}

impl Pattern {
    /// For plots and tables.
    #[must_use]
    pub fn name(self) -> String {
        if self.hull == self.core {
            pattern_name(self.hull).into()
        } else {
            format!("{} hull, {} core", pattern_name(self.hull), pattern_name(self.core))
        }
    }
}

/// As on the command line.
#[must_use]
pub fn method_name(method: CutMethod) -> &'static str {
    match method {
        CutMethod::Hybrid => "hybrid",
        CutMethod::Progressive => "progressive",
        CutMethod::NonProgressive => "non-progressive",
    }
}

/// As on the command line.
#[must_use]
pub fn pattern_name(pattern: CutPattern) -> &'static str {
    match pattern {
        CutPattern::Minimal => "minimal",
        CutPattern::Symmetric => "symmetric",
    }
}

/// A mesh with its name in tables.
#[derive(Clone, Debug)]
pub struct StudyMesh {
    /// Name.
    pub name: String,
    /// The mesh.
    pub mesh: TetMesh,
    /// Whether it is one of the phantom's, or was given.
    pub is_phantom: bool,
}

/// All that is to be cut.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Meshes, the phantom's first, coarse to fine.
    pub meshes: Vec<StudyMesh>,
    /// Strokes on every mesh.
    pub strokes: Vec<Stroke>,
    /// Seed of the strokes' places and of the power iteration.
    pub seed: u64,
    /// Moments of a cut at which figures are taken, its end among them.
    pub moments: usize,
    /// Way of the blade a sample, as parts of the mean edge.
    pub rates: Vec<f64>,
    /// Thresholds of the sweep.
    pub sweep: Vec<f64>,
}

/// One cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Combination {
    /// Index of the mesh.
    pub mesh: usize,
    /// The stroke.
    pub stroke: Stroke,
    /// Release policy.
    pub method: CutMethod,
    /// Patterns.
    pub pattern: Pattern,
    /// Snapping threshold; 0 off.
    pub snap: f64,
    /// Way of the blade a sample, as a part of the mean edge.
    pub rate: f64,
}

impl Combination {
    /// For the cutter.
    #[must_use]
    pub fn settings(&self) -> CutSettings {
        CutSettings { method: self.method, hull: self.pattern.hull, core: self.pattern.core, snap: self.snap }
    }
}

impl Plan {
    /// The study of some meshes as the command line asks for it.
    #[must_use]
    pub fn new(meshes: Vec<StudyMesh>, strokes: Vec<Stroke>, seed: u64) -> Self {
        Self { meshes, strokes, seed, moments: 40, rates: RATES.into(), sweep: SWEEP.into() }
    }

    /// Snapping as it is by default, and off.
    #[must_use]
    pub fn snaps() -> [f64; 2] {
        [CutSettings::default().snap, 0.0]
    }

    /// Strokes of a mesh: on the coarsest of the phantom's, several cuts through one another as well.
    fn strokes_of(&self, mesh: usize) -> Vec<Stroke> {
        let mut strokes = self.strokes.clone();
        if mesh == 0 && self.meshes[0].is_phantom && !strokes.contains(&Stroke::Cross) {
            strokes.push(Stroke::Cross);
        }
        strokes
    }

    /// Every method, pattern, snapping and rate on every mesh, each once.
    #[must_use]
    pub fn combinations(&self) -> Vec<Combination> {
        let mut all = Vec::new();
        for mesh in 0..self.meshes.len() {
            for stroke in self.strokes_of(mesh) {
                for &rate in &self.rates {
                    for snap in Self::snaps() {
                        for pattern in PATTERNS {
                            for method in METHODS {
                                all.push(Combination { mesh, stroke, method, pattern, snap, rate });
                            }
                        }
                    }
                }
            }
        }
        all
    }

    /// The sweep of the snapping threshold: hybrid, minimal, at the coarser rate.
    #[must_use]
    pub fn sweep_combinations(&self) -> Vec<Combination> {
        let mut all = Vec::new();
        for mesh in 0..self.meshes.len() {
            for &stroke in &self.strokes {
                for &snap in &self.sweep {
                    let (method, pattern) = (CutMethod::Hybrid, PATTERNS[0]);
                    all.push(Combination { mesh, stroke, method, pattern, snap, rate: self.rates.first().copied().unwrap_or(RATES[0]) });
                }
            }
        }
        all
    }
}

/// The phantom's left kidney with its tumour, from voxels to tetrahedra as a user's scan would be, at one cell a mesh.
///
/// # Errors
/// A cell that does not resolve the kidney.
pub fn phantom_kidneys(cells_mm: &[f64]) -> Result<Vec<StudyMesh>, ImagingError> {
    let volume = phantom::sample(&PhantomSettings { pixel_mm: VOXEL_MM, slice_mm: VOXEL_MM, noise_hu: 0.0, seed: 0 });
    let names = ["kidney_left", "tumour"];
    let mut parts = vec![0_u8; volume.dims.iter().product()];
    for (part, name) in (1..).zip(names) {
        for mask in volume.structures.iter().zip(&volume.masks).filter(|(s, _)| s.name == name).map(|(_, m)| m) {
            parts.iter_mut().zip(mask).filter(|(_, m)| **m != 0).for_each(|(p, _)| *p = part);
        }
    }
    let labels = LabelVolume {
        path: PathBuf::from("phantom"),
        dims: volume.dims,
        parts,
        names: names.map(String::from).into(),
        voxel_to_lps: volume.voxel_to_lps,
        notes: Vec::new(),
    };
    let kidney = |cell: &f64| {
        let options = MeshOptions { edge_mm: *cell, core_doublings: 0, component: ComponentChoice::Largest, centring: Centring::Origin };
        let (mesh, _) = pipeline::mesh(labels.clone(), &options, &mut |_| ())?;
        Ok(StudyMesh { name: format!("phantom {} tets", mesh.tet_count()), mesh, is_phantom: true })
    };
    cells_mm.iter().map(kidney).collect()
}

/// A mesh from a file, by its file name.
///
/// # Errors
/// A file that is no mesh of tetrahedra.
pub fn read_mesh(path: &Path) -> Result<StudyMesh, vtu::VtuError> {
    let mesh = vtu::read(path)?;
    let stem = path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy();
    Ok(StudyMesh { name: format!("{stem} {} tets", mesh.tet_count()), mesh, is_phantom: false })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use keyhole_imaging::stuffing::{Keep, Stuffer};
    use keyhole_tetmesh::DVec3;

    /// An ellipsoid with half axes 1, 0.7 and 0.5 m, `cells` lattice cells along its longest axis.
    pub(crate) fn ball(cells: u32) -> TetMesh {
        let field = |p: DVec3| 1.0 - (p / DVec3::new(1.0, 0.7, 0.5)).length();
        let cell = 2.0 / f64::from(cells);
        let room = DVec3::splat(2.0 * cell);
        let stuffed = Stuffer::new(&field, -DVec3::ONE - room, DVec3::ONE + room, cell).stuff(0.0, Keep::Largest);
        let stuffed = stuffed.unwrap_or_else(|why| panic!("{cells} cells are too few: {why:?}"));
        TetMesh::new(stuffed.nodes, &stuffed.tets, &[])
    }

    #[test]
    fn every_combination_is_there_once() {
        let mesh = |is_phantom| StudyMesh { name: String::new(), mesh: ball(6), is_phantom };
        let plan = Plan::new(vec![mesh(true), mesh(false)], vec![Stroke::Straight, Stroke::S], 1);
        let all = plan.combinations();
        // Two strokes each, and the cross on the first.
        assert_eq!(all.len(), 5 * 2 * 2 * 3 * 3);
        assert!(all.iter().enumerate().all(|(i, c)| !all[..i].contains(c)));
        assert_eq!(plan.sweep_combinations().len(), 2 * 2 * SWEEP.len());
        assert_eq!(PATTERNS.map(Pattern::name), ["minimal", "symmetric", "symmetric hull, minimal core"]);
    }
}
