//! From labels to a surface that is only drawn, in world metres.

use crate::components::{ComponentChoice, ComponentReport};
use crate::decimate::decimate;
use crate::error::ImagingError;
use crate::field::{ScalarGrid, THIN_BLUR_VOXELS};
use crate::frame;
use crate::pipeline::{Prepared, prepare};
use crate::surface::Surface;
use crate::volume::LabelVolume;
use glam::DVec3;
use keyhole_tetmesh::{Boundary, TetMesh};

/// Rounds of Taubin's smoothing: enough for the stairs of slices to go, too few for a vessel to get thinner.
const SMOOTHING: usize = 8;
/// Part of the cell that decimation may move the surface by.
const DECIMATION: f64 = 0.05;
/// Steps of the search for the mask's volume, and the part of it that ends the search.
const VOLUME_STEPS: usize = 12;
const VOLUME_TOLERANCE: f64 = 2e-3;
/// Grid points beyond which a surface is refused.
const MAX_POINTS: f64 = 1e8;

/// Figures of a drawn surface.
#[derive(Clone, Debug, serde::Serialize)]
pub struct SurfaceReport {
    /// Components of the labels before the choice, largest first.
    pub found: Vec<ComponentReport>,
    /// Cell of the surface nets, mm.
    pub edge_mm: f64,
    /// Triangles.
    pub triangles: usize,
    /// Nodes.
    pub nodes: usize,
    /// Volume of the mask, ml.
    pub mask_ml: f64,
    /// Volume within the surface, ml.
    pub surface_ml: f64,
}

/// The closed surface of a volume mesh, for anatomy that can be touched: one triangle on each side of each edge.
#[must_use]
pub fn solid(mesh: &TetMesh) -> Surface {
    let mut number: Vec<Option<u32>> = vec![None; mesh.node_slots()];
    let mut nodes = Vec::new();
    let triangles = Boundary::of(mesh).triangles.into_iter().map(|triangle| {
        triangle.map(|n| {
            *number[n.index()].get_or_insert_with(|| {
                nodes.push(mesh.rest(n));
                nodes.len() as u32 - 1
            })
        })
    });
    let triangles = triangles.collect();
    Surface { nodes, triangles }
}

/// The surface of all labels together. A component at the border of the volume ends there with a flat face.
///
/// # Errors
/// Empty labels, a component that is not there, a cell that is not positive or too small.
pub fn draw(labels: LabelVolume, component: ComponentChoice, edge_mm: f64) -> Result<(Surface, SurfaceReport), ImagingError> {
    let wrong = |extent: DVec3, reason| ImagingError::Edge { edge_mm, extent_mm: extent.to_array(), reason };
    if !(edge_mm.is_finite() && edge_mm > 0.0) {
        return Err(wrong(DVec3::ZERO, "the cell must be a positive length in millimetres"));
    }
    let voxel = frame::spacing(&labels.voxel_to_lps);
    let Prepared { body, found, .. } = prepare(labels, component, 2.0 * voxel.max_element())?;
    let (min, max) = body.extent_mm().unwrap_or_default();
    if ((max - min + 4.0 * voxel) / edge_mm).element_product() > MAX_POINTS {
        return Err(wrong(max - min, "the grid would have more than a hundred million points: use a larger --edge"));
    }
    let grid = ScalarGrid::of_mask(body.dims, body.spacing, THIN_BLUR_VOXELS, |i| body.parts[i] != 0);
    let room = voxel * 1.5 + DVec3::splat(edge_mm);
    let mask_mm3 = body.count() as f64 * body.voxel_mm3();
    let mut surface = volume_kept(mask_mm3, voxel.min_element() / 4.0, |level| {
        let mut surface = Surface::nets(&|p| grid.sample(p) + level, min - room, max + room, edge_mm);
        surface.smooth(SMOOTHING);
        decimate(surface, DECIMATION * edge_mm)
    });
    surface.nodes.iter_mut().for_each(|p| *p = frame::world_from_patient(body.grid_to_lps.transform_point3(*p)));
    let report = SurfaceReport {
        found,
        edge_mm,
        triangles: surface.triangles.len(),
        nodes: surface.nodes.len(),
        mask_ml: mask_mm3 * 1e-3,
        surface_ml: surface.volume() * 1e6,
    };
    Ok((surface, report))
}

/// The surface at the level at which it encloses `target`: smoothing takes from what is thin. `step` brackets the level, false position
/// finds it; the closest of all steps is taken.
fn volume_kept(target: f64, step: f64, surface_at: impl Fn(f64) -> Surface) -> Surface {
    let at = |level: f64| {
        let surface = surface_at(level);
        let error = surface.volume() - target;
        (surface, error)
    };
    let (mut best, mut least) = at(0.0);
    let mut ends = [(0.0, least), (0.0, least)];
    for _ in 0..VOLUME_STEPS {
        if least.abs() < VOLUME_TOLERANCE * target {
            break;
        }
        let [(l0, e0), (l1, e1)] = ends;
        // Lower levels enclose more.
        let level = if e0.signum() == e1.signum() { l1 + step * e1.signum() } else { l0 + (l1 - l0) * (0.1 + 0.8 * e0 / (e0 - e1)) };
        let (surface, error) = at(level);
        if e0.signum() == e1.signum() {
            ends = [(l1, e1), (level, error)];
        } else {
            ends[usize::from(error.signum() == e1.signum())] = (level, error);
        }
        if error.abs() < least.abs() {
            (best, least) = (surface, error);
        }
    }
    best
}
