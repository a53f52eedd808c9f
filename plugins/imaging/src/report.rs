//! What is told about a mesh that was made: the figures that say whether it can be trusted.

use crate::components::ComponentReport;
use crate::surface_distance::{Distances, SurfaceDistance};
use std::fmt;

/// Seconds spent in each stage.
#[derive(Clone, Copy, Debug, Default, serde::Serialize)]
pub struct Seconds {
    /// Components, crop, holes.
    pub labels: f64,
    /// Distance fields, blur, level.
    pub field: f64,
    /// Lattice, stencils, repair, the search for the volume.
    pub stuffing: f64,
    /// Checks and figures.
    pub figures: f64,
}

/// A part of the mesh: the organ's own tissue, or a structure in it.
#[derive(Clone, Debug, serde::Serialize)]
pub struct PartReport {
    /// Name of the label.
    pub name: String,
    /// Material of its tetrahedra.
    pub material: u16,
    /// Number of tetrahedra.
    pub tets: usize,
    /// Volume of its voxels, ml.
    pub mask_ml: f64,
    /// Volume of its tetrahedra, ml.
    pub mesh_ml: f64,
}

/// The faces of the mesh between a part and what is around it.
#[derive(Clone, Debug, serde::Serialize)]
pub struct BorderReport {
    /// Material of the part.
    pub material: u16,
    /// Triangles of the border.
    pub faces: usize,
    /// Distance of their corners and middles from the border of the smoothed labels, mm.
    pub off: Distances,
}

/// A place where walls or gaps are about as thin as a cell.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct NarrowPlace {
    /// Where, patient LPS, mm.
    pub at_lps_mm: [f64; 3],
    /// Lattice points there that gave way.
    pub points: usize,
}

/// Quality figures of a volume mesh.
#[derive(Clone, Debug, serde::Serialize)]
pub struct MeshReport {
    /// What the reader of the scan has to say: what was left out, filled in or resampled.
    pub notes: Vec<String>,
    /// Components of the labels before the choice, largest first.
    pub found: Vec<ComponentReport>,
    /// Enclosed holes of the mask that were filled.
    pub holes_filled: usize,
    /// Voxels in them.
    pub hole_voxels: usize,
    /// Lattice cell, mm.
    pub edge_mm: f64,
    /// Number of tetrahedra.
    pub tets: usize,
    /// Number of nodes.
    pub nodes: usize,
    /// Smallest dihedral angle, degrees.
    pub min_dihedral_deg: f64,
    /// First percentile of the tetrahedra's smallest dihedral angles, degrees.
    pub p1_dihedral_deg: f64,
    /// Median of the tetrahedra's smallest dihedral angles, degrees.
    pub median_dihedral_deg: f64,
    /// Largest dihedral angle, degrees.
    pub max_dihedral_deg: f64,
    /// Mean of shortest / longest edge.
    pub mean_edge_ratio: f64,
    /// Volume of the mask with its holes filled, ml.
    pub mask_ml: f64,
    /// Volume of the mesh, ml.
    pub mesh_ml: f64,
    /// Mesh against mask, per cent.
    pub volume_error_percent: f64,
    /// How far the zero of the field was shifted to keep the volume, mm.
    pub level_mm: f64,
    /// Mesh surface to mask surface and back.
    pub surface_distance: SurfaceDistance,
    /// The parts.
    pub parts: Vec<PartReport>,
    /// The borders between parts.
    pub borders: Vec<BorderReport>,
    /// Separate bodies of the mesh.
    pub components: usize,
    /// Volume of bodies that only the lattice tore off and that were dropped, ml.
    pub dropped_ml: f64,
    /// Cavities open in the mask only through channels that the lattice closed, and that were opened again.
    pub cavities_opened: usize,
    /// Volume of such cavities that were too small or too far inside, and were filled, ml. Their walls count in the surface distance.
    pub voids_filled_ml: f64,
    /// Euler characteristic of the boundary: 2 a closed surface without handles.
    pub euler_characteristic: i64,
    /// Whether the boundary is a closed 2-manifold.
    pub closed_manifold: bool,
    /// Lattice points kept off the surface, for two sheets would have met there.
    pub unpinched: usize,
    /// Thin walls, narrow gaps and near-touching sheets: a smaller cell resolves them. The widest first.
    pub narrow: Vec<NarrowPlace>,
    /// Smallest corner of the mesh's box, world metres.
    pub min_m: [f64; 3],
    /// Largest corner of the mesh's box, world metres.
    pub max_m: [f64; 3],
    /// What was subtracted from world coordinates, metres; zero unless centring was asked for.
    pub centre_m: [f64; 3],
    /// Time.
    pub seconds: Seconds,
}

impl fmt::Display for MeshReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for note in &self.notes {
            writeln!(f, "note: {note}")?;
        }
        writeln!(f, "components of the labels: {}", self.found.len())?;
        for c in self.found.iter().take(6) {
            let mark = if c.chosen { " <- meshed" } else { "" };
            let [x, y, z] = c.extent_mm;
            let [l, p, s] = c.centre_lps_mm;
            writeln!(f, "  {}: {:.2} ml, {x:.0} x {y:.0} x {z:.0} mm, around LPS ({l:.0}, {p:.0}, {s:.0}) mm{mark}", c.rank, c.volume_ml)?;
        }
        if self.found.len() > 6 {
            let rest = &self.found[6..];
            writeln!(f, "  and {} more, {:.2} ml together", rest.len(), rest.iter().map(|c| c.volume_ml).sum::<f64>())?;
        }
        if self.holes_filled > 0 {
            writeln!(f, "holes filled: {} ({} voxels)", self.holes_filled, self.hole_voxels)?;
        }
        writeln!(f, "mesh: {} tets, {} nodes, cell {} mm", self.tets, self.nodes, self.edge_mm)?;
        for p in &self.parts {
            writeln!(f, "  material {} {}: {} tets, {:.2} ml (mask {:.2} ml)", p.material, p.name, p.tets, p.mesh_ml, p.mask_ml)?;
        }
        for b in self.borders.iter().filter(|b| b.faces > 0) {
            let (m, d) = (b.material, b.off);
            writeln!(
                f,
                "  border of material {m}: {} faces, off by mean {:.3}, 95 % {:.3}, max {:.3} mm",
                b.faces, d.mean_mm, d.p95_mm, d.max_mm
            )?;
        }
        writeln!(
            f,
            "dihedral angles: min {:.2}, 1st percentile {:.2}, median {:.2}, max {:.2} degrees; mean edge ratio {:.3}",
            self.min_dihedral_deg, self.p1_dihedral_deg, self.median_dihedral_deg, self.max_dihedral_deg, self.mean_edge_ratio
        )?;
        writeln!(f, "volume: {:.3} ml, mask {:.3} ml ({:+.3} %)", self.mesh_ml, self.mask_ml, self.volume_error_percent)?;
        for (name, d) in [("mesh to mask", self.surface_distance.mesh_to_mask), ("mask to mesh", self.surface_distance.mask_to_mesh)] {
            writeln!(f, "surface distance, {name}: mean {:.3}, 95 % {:.3}, max {:.3} mm", d.mean_mm, d.p95_mm, d.max_mm)?;
        }
        let manifold = if self.closed_manifold { "a closed 2-manifold" } else { "NOT a closed 2-manifold" };
        writeln!(f, "boundary: {manifold}, {} component(s), Euler characteristic {}", self.components, self.euler_characteristic)?;
        if self.dropped_ml > 0.0 {
            writeln!(f, "dropped: {:.3} ml that the lattice tore off", self.dropped_ml)?;
        }
        if self.cavities_opened > 0 {
            writeln!(f, "opened: {} cavities whose channels the lattice had closed", self.cavities_opened)?;
        }
        if self.voids_filled_ml > 0.0 {
            writeln!(f, "filled: {:.3} ml of cavities whose channels the lattice does not resolve", self.voids_filled_ml)?;
        }
        for n in self.narrow.iter().take(4) {
            let [l, p, s] = n.at_lps_mm;
            writeln!(
                f,
                "thin: a wall or a gap about as thin as a cell around LPS ({l:.0}, {p:.0}, {s:.0}) mm, {} lattice point(s)",
                n.points
            )?;
        }
        if self.narrow.len() > 4 {
            writeln!(f, "  and at {} more places; a smaller cell resolves them", self.narrow.len() - 4)?;
        }
        let s = self.seconds;
        write!(f, "seconds: labels {:.2}, field {:.2}, stuffing {:.2}, figures {:.2}", s.labels, s.field, s.stuffing, s.figures)
    }
}
