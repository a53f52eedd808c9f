//! From labels to tetrahedra in world metres.

use crate::cleave::{Parted, cleave};
use crate::components::{self, ComponentChoice, ComponentReport};
use crate::contact_sheet::{self, Outline};
use crate::dicom_series::CtVolume;
use crate::error::ImagingError;
use crate::field::{BLUR_VOXELS, ScalarGrid};
use crate::frame;
use crate::report::{BorderReport, MeshReport, NarrowPlace, PartReport, Seconds};
use crate::stuffing::{Keep, Stuffed, Stuffer, Unstuffed};
use crate::surface_distance::{self, Distances};
use crate::topology;
use crate::volume::{Body, LabelVolume};
use glam::DVec3;
use keyhole_tetmesh::{Boundary, MaterialId, TetMesh, quality};
use std::time::Instant;

/// Part of the mask's volume by which the mesh may differ when the search for the level ends.
const VOLUME_TOLERANCE: f64 = 1e-3;
/// Steps of that search. Each is one stuffing; the secant needs two or three.
const VOLUME_STEPS: usize = 6;
/// The same for a part, whose border is a part of the mesh's cell coarser in proportion, and the steps there.
const PART_TOLERANCE: f64 = 5e-3;
const PART_STEPS: usize = 3;
/// Cells beyond which a lattice is refused: some 2 GB.
const MAX_CELLS: f64 = 2e7;
/// Doublings beyond which a core has no room in any organ.
const MAX_DOUBLINGS: u8 = 6;
/// Cells within which thin walls count as one place.
const PLACE_CELLS: f64 = 3.0;
/// Part of the body that the lattice may tear off before the mesh is refused.
const MAX_DROPPED: f64 = 0.05;

/// What is asked of a mesh.
#[derive(Clone, Copy, Debug)]
pub struct MeshOptions {
    /// Lattice cell, mm.
    pub edge_mm: f64,
    /// How often the cell may double in the core, away from the surface and from borders between parts; 0 for one cell everywhere.
    pub core_doublings: u8,
    /// Which component.
    pub component: ComponentChoice,
    /// Whether the mesh is moved so that its box is centred at the origin.
    pub centring: Centring,
}

/// Where the mesh ends up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Centring {
    /// Where the patient is.
    #[default]
    Patient,
    /// With its box centred at the origin.
    Origin,
}

/// The stages, for a progress bar.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Components, crop, holes.
    Labels,
    /// Distance fields.
    Field,
    /// Tetrahedra.
    Stuffing,
    /// Quality figures.
    Figures,
}

impl Stage {
    /// What the user reads.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Labels => "components and holes",
            Self::Field => "smooth distance field",
            Self::Stuffing => "isosurface stuffing",
            Self::Figures => "quality figures",
        }
    }
}

/// The chosen body of a label volume, its holes closed.
pub struct Prepared {
    /// The body, with a margin around it.
    pub body: Body,
    /// All components that there were.
    pub found: Vec<ComponentReport>,
    /// Holes filled, and voxels in them.
    pub holes: (usize, usize),
}

/// Chooses the component, crops with `margin_mm` around it, closes holes.
///
/// # Errors
/// Those of [`components::choose`] and [`LabelVolume::check_geometry`].
pub fn prepare(mut labels: LabelVolume, component: ComponentChoice, margin_mm: f64) -> Result<Prepared, ImagingError> {
    labels.check_geometry()?;
    let (found, bounds) = components::choose(&mut labels, component)?;
    let mut body = labels.crop(bounds, margin_mm);
    drop(labels);
    let holes = components::close_holes(&mut body.parts, body.dims);
    Ok(Prepared { body, found, holes })
}

/// A mesh with what it was made of.
pub struct Made {
    /// The mesh, world metres.
    pub mesh: TetMesh,
    /// Its figures.
    pub report: MeshReport,
    body: Body,
    parted: Parted,
}

impl Made {
    /// The picture of the mesh over its CT, when there is one that holds it, or over its labels.
    #[must_use]
    pub fn contact_sheet(&self, ct: Option<&CtVolume>) -> contact_sheet::Picture {
        let (boundary, borders) = faces(&self.parted);
        let borders: Vec<[u32; 3]> = borders.into_iter().map(|(f, _)| f).collect();
        contact_sheet::draw(&self.body, &Outline { nodes: &self.parted.nodes, boundary: &boundary, borders: &borders }, ct)
    }
}

/// The mesh of [`make`] with its report.
///
/// # Errors
/// As [`make`].
pub fn mesh(labels: LabelVolume, options: &MeshOptions, progress: &mut dyn FnMut(Stage)) -> Result<(TetMesh, MeshReport), ImagingError> {
    make(labels, options, progress).map(|made| (made.mesh, made.report))
}

/// Meshes the union of all labels as one body; material 0 is the first label, 1 the second.
///
/// The border of an inner label is made of faces of the mesh. `progress` hears of each stage as it begins.
///
/// # Errors
/// Empty labels, a cell too large or too small for the body.
pub fn make(labels: LabelVolume, options: &MeshOptions, progress: &mut dyn FnMut(Stage)) -> Result<Made, ImagingError> {
    let a = options.edge_mm;
    if !(a.is_finite() && a > 0.0) {
        return Err(ImagingError::Edge { edge_mm: a, extent_mm: [0.0; 3], reason: "the cell must be a positive length in millimetres" });
    }
    let names = labels.names.clone();
    let mut notes = labels.notes.clone();
    let voxel = frame::spacing(&labels.voxel_to_lps);
    let mut seconds = Seconds::default();
    let mut clock = Instant::now();
    let mut lap = || std::mem::replace(&mut clock, Instant::now()).elapsed().as_secs_f64();

    progress(Stage::Labels);
    // The surface moves by less than a voxel; a lattice point outside it is at most a cell away.
    let Prepared { body, found, holes } = prepare(labels, options.component, 2.0 * voxel.max_element())?;
    for c in found.iter().filter(|c| c.chosen && !c.at_borders.is_empty()) {
        notes.push(format!(
            "component {} reaches the {} border of the volume and ends there with a flat face: what is beyond is missing",
            c.rank,
            c.at_borders.join(" and the ")
        ));
    }
    let (min, max) = body.extent_mm().unwrap_or_default();
    let extent = max - min + voxel;
    let cells = ((extent + 4.0 * a) / a).element_product();
    if cells > MAX_CELLS {
        let reason = "the lattice would have more than twenty million cells: use a larger --edge";
        return Err(ImagingError::Edge { edge_mm: a, extent_mm: extent.to_array(), reason });
    }
    seconds.labels = lap();

    progress(Stage::Field);
    let whole = ScalarGrid::of_mask(body.dims, body.spacing, BLUR_VOXELS, |i| body.parts[i] != 0);
    // The border of a part is that of all parts from it on: between two of them there is one border, not two.
    let inner: Vec<ScalarGrid> = (2..=names.len() as u8)
        .map(|part| ScalarGrid::of_part(body.dims, body.spacing, BLUR_VOXELS, |i| body.parts[i] != 0, |i| body.parts[i] >= part))
        .collect();
    seconds.field = lap();

    progress(Stage::Stuffing);
    let field = |p: DVec3| -beyond(&whole, p);
    let room = DVec3::splat(2.0 * a) + 2.0 * voxel;
    let sides = |p: DVec3| inner.iter().enumerate().fold(0, |all, (i, g)| all | u32::from(g.sample(p) < 0.0) << (i % 32));
    let stuffer = Stuffer::new(&field, min - room, max + room, a).with_core(options.core_doublings.min(MAX_DOUBLINGS), &sides);
    let target = body.count() as f64 * body.voxel_mm3();
    let keep = if options.component == ComponentChoice::All { Keep::All } else { Keep::Largest };
    let (stuffed, level) =
        stuff_to_volume(&stuffer, keep, target).map_err(|why| unresolved(why, a, extent, |p| body.grid_to_lps.transform_point3(p)))?;
    if stuffed.dropped_volume > MAX_DROPPED * target {
        let place_mm = body.grid_to_lps.transform_point3((min + max) / 2.0).to_array();
        return Err(ImagingError::Unresolved { edge_mm: a, place_mm, reason: "more than a twentieth of the body would be torn off" });
    }
    let mut parted =
        Parted { materials: vec![0; stuffed.tets.len()], nodes: stuffed.nodes, tets: stuffed.tets, lattice: stuffed.lattice, pinned: 0 };
    for (i, grid) in inner.iter().enumerate() {
        let target = body.parts.iter().filter(|p| usize::from(**p) >= i + 2).count() as f64 * body.voxel_mm3();
        parted = cleave_to_volume(&parted, grid, i as u16 + 1, target);
    }
    let materials: Vec<MaterialId> = parted.materials.iter().map(|m| MaterialId(*m)).collect();
    seconds.stuffing = lap();

    progress(Stage::Figures);
    let triangles = topology::boundary(&parted.tets);
    let surface_distance = surface_distance::between(&body, &parted.nodes, &triangles);
    let mut nodes: Vec<DVec3> = parted.nodes.iter().map(|p| frame::world_from_patient(body.grid_to_lps.transform_point3(*p))).collect();
    let bounds = |nodes: &[DVec3]| {
        (nodes.iter().copied().fold(DVec3::INFINITY, DVec3::min), nodes.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max))
    };
    let (low, high) = bounds(&nodes);
    let centre = if options.centring == Centring::Origin { (low + high) / 2.0 } else { DVec3::ZERO };
    nodes.iter_mut().for_each(|p| *p -= centre);
    let mesh = TetMesh::new(nodes, &parted.tets, &materials);
    let boundary = Boundary::of(&mesh);
    let q = quality::quality(&mesh);
    let mesh_mm3 = mesh.total_volume() * 1e9;
    let parts = names.iter().enumerate().map(|(i, name)| part(&mesh, &body, i, name)).collect();
    let (_, components) = topology::bodies(&parted.tets);
    let euler_characteristic = boundary.euler_characteristic();
    let closed_manifold = boundary.is_closed_manifold();
    seconds.figures = lap();
    let report = MeshReport {
        notes,
        found,
        holes_filled: holes.0,
        hole_voxels: holes.1,
        edge_mm: a,
        tets: mesh.tet_count(),
        nodes: mesh.node_count(),
        min_dihedral_deg: q.min_dihedral_deg,
        p1_dihedral_deg: q.p1_dihedral_deg,
        median_dihedral_deg: q.median_dihedral_deg,
        max_dihedral_deg: q.max_dihedral_deg,
        mean_edge_ratio: q.mean_edge_ratio,
        mask_ml: target * 1e-3,
        mesh_ml: mesh_mm3 * 1e-3,
        volume_error_percent: (mesh_mm3 / target - 1.0) * 100.0,
        level_mm: level,
        surface_distance,
        parts,
        components,
        dropped_ml: stuffed.dropped_volume * 1e-3,
        voids_filled_ml: stuffed.filled_volume * 1e-3,
        euler_characteristic,
        closed_manifold,
        cavities_opened: stuffed.opened,
        unpinched: stuffed.unpinched,
        narrow: narrow_places(&stuffed.narrow, PLACE_CELLS * a, |p| body.grid_to_lps.transform_point3(p)),
        borders: borders(&inner, &parted),
        min_m: (low - centre).to_array(),
        max_m: (high - centre).to_array(),
        centre_m: centre.to_array(),
        seconds,
    };
    Ok(Made { mesh, report, body, parted })
}

/// Cuts a part out at the level at which it has the volume `target`, mm3, as [`stuff_to_volume`] does.
fn cleave_to_volume(mesh: &Parted, grid: &ScalarGrid, part: u16, target: f64) -> Parted {
    let at = |level: f64| {
        let mut cut = mesh.clone();
        cleave(&mut cut, &|p| level - grid.sample(p), part);
        let of_part = cut.tets.iter().zip(&cut.materials).filter(|(_, m)| **m >= part);
        let volume: f64 = of_part.map(|(t, _)| quality::volume(t.map(|n| cut.nodes[n as usize]))).sum();
        (cut, volume - target)
    };
    let (mut best, mut error) = at(0.0);
    if target == 0.0 {
        return best;
    }
    // A ball's surface stands for the border's.
    let area = (36.0 * std::f64::consts::PI * target * target).cbrt();
    let mut level = 0.0;
    for _ in 0..PART_STEPS {
        if error.abs() < PART_TOLERANCE * target {
            break;
        }
        level -= error / area;
        let (next, next_error) = at(level);
        if next_error.abs() >= error.abs() {
            break;
        }
        (best, error) = (next, next_error);
    }
    best
}

/// The boundary's triangles, each with the material behind it, and the triangles between materials, each with both.
fn faces(mesh: &Parted) -> (Vec<([u32; 3], u16)>, Vec<([u32; 3], [u16; 2])>) {
    let mut all: Vec<([u32; 3], [u32; 3], u16)> = Vec::with_capacity(4 * mesh.tets.len());
    for (t, m) in mesh.tets.iter().zip(&mesh.materials) {
        for f in keyhole_tetmesh::FACES {
            let face = f.map(|c| t[c]);
            let mut key = face;
            key.sort_unstable();
            all.push((key, face, *m));
        }
    }
    all.sort_unstable();
    let (mut boundary, mut borders) = (Vec::new(), Vec::new());
    for same in all.chunk_by(|a, b| a.0 == b.0) {
        match same {
            [(_, face, m)] => boundary.push((*face, *m)),
            [(key, _, m), (_, _, n)] if m != n => borders.push((*key, [*m, *n])),
            _ => {}
        }
    }
    (boundary, borders)
}

/// How far the faces between materials are from the fields' borders, part by part.
fn borders(inner: &[ScalarGrid], mesh: &Parted) -> Vec<BorderReport> {
    let (_, shared) = faces(mesh);
    inner
        .iter()
        .enumerate()
        .map(|(i, grid)| {
            let part = i as u16 + 1;
            let of_border = shared.iter().filter(|(_, m)| (m[0] >= part) != (m[1] >= part));
            let mut off: Vec<f64> = of_border
                .flat_map(|(f, _)| {
                    let p = f.map(|n| mesh.nodes[n as usize]);
                    [p[0], p[1], p[2], (p[0] + p[1] + p[2]) / 3.0]
                })
                // The field is a difference of two distances: beyond the body it grows twice as fast as one.
                .map(|p| grid.sample(p).abs())
                .collect();
            off.sort_unstable_by(f64::total_cmp);
            BorderReport { material: part, faces: off.len() / 4, off: Distances::of(&off) }
        })
        .collect()
}

/// Points within `reach` of the first of them as one place, the places with most points first.
fn narrow_places(points: &[DVec3], reach: f64, to_lps: impl Fn(DVec3) -> DVec3) -> Vec<NarrowPlace> {
    let mut places: Vec<(DVec3, usize)> = Vec::new();
    for p in points {
        match places.iter_mut().find(|(q, _)| q.distance(*p) < reach) {
            Some((_, n)) => *n += 1,
            None => places.push((*p, 1)),
        }
    }
    places.sort_by_key(|p| std::cmp::Reverse(p.1));
    places.into_iter().map(|(p, points)| NarrowPlace { at_lps_mm: to_lps(p).to_array(), points }).collect()
}

/// The field of a grid, growing with the distance from the grid beyond it.
fn beyond(grid: &ScalarGrid, p: DVec3) -> f64 {
    let far = DVec3::from_array(grid.dims.map(|n| (n - 1) as f64)) * grid.spacing;
    grid.sample(p) + p.distance(p.clamp(DVec3::ZERO, far))
}

/// Stuffs at the level at which the tetrahedra have the volume `target`, mm3: secant steps, the first with the area of the surface as the
/// slope. The closest of all steps is taken; the level is returned with it.
fn stuff_to_volume(stuffer: &Stuffer, keep: Keep, target: f64) -> Result<(Stuffed, f64), Unstuffed> {
    let volume = |s: &Stuffed| s.tets.iter().map(|t| quality::volume(t.map(|n| s.nodes[n as usize]))).sum::<f64>();
    let mut best = stuffer.stuff(0.0, keep)?;
    let mut best_level = 0.0;
    let mut error = volume(&best) - target;
    let area: f64 = topology::boundary(&best.tets)
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|n| best.nodes[n as usize]);
            (b - a).cross(c - a).length() / 2.0
        })
        .sum();
    let (mut last, mut slope) = ((0.0, error), area);
    for _ in 0..VOLUME_STEPS {
        if error.abs() < VOLUME_TOLERANCE * target {
            break;
        }
        let level = last.0 - last.1 / slope;
        // A level at which the lattice no longer resolves the body ends the search with what there is.
        let Ok(next) = stuffer.stuff(level, keep) else { break };
        let next_error = volume(&next) - target;
        let secant = (next_error - last.1) / (level - last.0);
        // The volume jumps where the lattice's topology changes: there the area stays the slope.
        if secant.is_finite() && secant > 0.2 * area && secant < 5.0 * area {
            slope = secant;
        }
        last = (level, next_error);
        if next_error.abs() < error.abs() {
            (best, best_level, error) = (next, level, next_error);
        }
    }
    Ok((best, best_level))
}

fn unresolved(why: Unstuffed, a: f64, extent: DVec3, to_lps: impl Fn(DVec3) -> DVec3) -> ImagingError {
    match why {
        Unstuffed::Nothing => ImagingError::Edge {
            edge_mm: a,
            extent_mm: extent.to_array(),
            reason: "no lattice point lies inside the body: use a smaller --edge",
        },
        Unstuffed::Pinched(p) => {
            ImagingError::Unresolved { edge_mm: a, place_mm: to_lps(p).to_array(), reason: "two sheets of the surface meet there" }
        }
        Unstuffed::Open(p) => {
            ImagingError::Unresolved { edge_mm: a, place_mm: to_lps(p).to_array(), reason: "the surface leaves the lattice there" }
        }
    }
}

fn part(mesh: &TetMesh, body: &Body, index: usize, name: &str) -> PartReport {
    let material = MaterialId(index as u16);
    let tets: Vec<_> = mesh.iter().filter(|(t, _)| mesh.tet(*t).material == material).collect();
    PartReport {
        name: name.into(),
        material: material.0,
        tets: tets.len(),
        mask_ml: body.parts.iter().filter(|p| usize::from(**p) == index + 1).count() as f64 * body.voxel_mm3() * 1e-3,
        mesh_ml: tets.iter().fold(0.0, |sum, (t, _)| sum + mesh.volume(*t)) * 1e6,
    }
}
