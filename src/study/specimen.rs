//! What soft-tissue models are compared on: bodies with loads whose answer is known, in closed form or by the reference.
//!
//! Every load is one that all models know: nodes fixed in place, gravity, and forces on nodes. A force is an attachment that gives way by
//! `COMPLIANCE` metres a newton towards a point as far away as that takes, so that it changes by less than a thousandth of itself on the way.

use crate::study::plan::phantom_kidneys;
use bevy_math::{DVec3, Vec3};
use keyhole_imaging::ImagingError;
use keyhole_tetmesh::{Boundary, NodeId, TetMesh};
use keyhole_tissue::beam::{block, fix};
use keyhole_tissue::reference::{Problem, ReferenceError, Statics, equilibrium};
use keyhole_tissue::{Hold, NeoHookean};
use keyhole_whiteboard::{OrganMaterial, OrganMaterials};
use smallvec::smallvec;

/// Compliance of the attachments that are forces, m/N.
const COMPLIANCE: f32 = 1e5;

/// Drag of all runs to rest, 1/s. More would end fast swings sooner and slow ones later.
const DRAG_1_S: f32 = 10.0;

/// What is done to a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Case {
    /// A beam of 60 x 30 x 30 mm hangs under its weight.
    Cantilever,
    /// A square bar of 80 x 20 x 20 mm is twisted by a couple.
    Torsion,
    /// A bar of 40 x 20 x 20 mm is pulled to one and a half of its length.
    Uniaxial,
    /// A block of 80 x 40 x 80 mm bears the pressure of a ball.
    Indentation,
    /// The phantom's kidney hangs at one end and is pulled at the other.
    Kidney,
}

impl Case {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Cantilever, Self::Torsion, Self::Uniaxial, Self::Indentation, Self::Kidney];

    /// Its name in tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Cantilever => "cantilever",
            Self::Torsion => "torsion",
            Self::Uniaxial => "uniaxial",
            Self::Indentation => "indentation",
            Self::Kidney => "kidney",
        }
    }

    /// What its answer is, with the unit.
    #[must_use]
    pub fn answer(self) -> &'static str {
        match self {
            Self::Cantilever => "mean displacement of the end, mm",
            Self::Torsion => "twist between quarter and three quarters of the length, degrees",
            Self::Uniaxial => "stretch",
            Self::Indentation => "depth under the middle of the ball, mm",
            Self::Kidney => "mean way down of the pulled nodes, mm",
        }
    }

    /// Meshes of it, coarse to fine: a number that [`Case::specimen`] takes.
    #[must_use]
    pub fn sizes(self) -> &'static [u32] {
        match self {
            Self::Cantilever => &[5, 8, 13],
            Self::Torsion => &[3, 5, 8],
            Self::Uniaxial => &[4, 8],
            Self::Indentation => &[10, 16, 24],
            Self::Kidney => &[102, 62],
        }
    }

    /// The body of a size.
    ///
    /// # Errors
    /// When the phantom cannot be meshed.
    pub fn specimen(self, size: u32) -> Result<Specimen, ImagingError> {
        Ok(match self {
            Self::Cantilever => cantilever(size),
            Self::Torsion => torsion(size),
            Self::Uniaxial => uniaxial(size),
            Self::Indentation => indentation(size),
            Self::Kidney => kidney(size)?,
        })
    }
}

/// What a displaced body is asked.
#[derive(Clone, Debug)]
enum Answer {
    /// Mean displacement of nodes along a direction, times a factor.
    Mean { nodes: Vec<NodeId>, along: DVec3, factor: f64 },
    /// Rotation about the x axis of one set of nodes less that of another, degrees.
    Twist { from: Vec<NodeId>, to: Vec<NodeId> },
    /// One and the mean displacement along x by the length.
    Stretch { nodes: Vec<NodeId>, length: f64 },
}

/// A body with what acts on it.
#[derive(Clone, Debug)]
pub struct Specimen {
    /// The case.
    pub case: Case,
    /// Its mesh.
    pub mesh: TetMesh,
    /// Its materials.
    pub materials: OrganMaterials,
    /// Fixed nodes and where, m.
    pub fixed: Vec<(NodeId, DVec3)>,
    /// Forces on nodes, N.
    pub forces: Vec<(NodeId, DVec3)>,
    /// Where the forces are those of a pressure on the surface: the same ones, half way between two nodes, N.
    pub pressed: Vec<([NodeId; 2], DVec3)>,
    /// m/s2.
    pub gravity: DVec3,
    /// Drag that brings it to rest soon, 1/s.
    pub drag_1_s: f32,
    /// The answer in closed form, where there is one.
    pub closed_form: Option<f64>,
    /// Size of an element for comparing meshes, m.
    pub edge_m: f64,
    answer: Answer,
}

impl Specimen {
    /// What holds it and acts on it.
    #[must_use]
    pub fn holds(&self) -> Vec<Hold> {
        let mut holds: Vec<Hold> = self.fixed.iter().map(|(n, p)| fix(*n, p.as_vec3())).collect();
        for (node, force) in &self.forces {
            let far = self.mesh.rest(*node).as_vec3() + force.as_vec3() * COMPLIANCE;
            holds.push(Hold { point: smallvec![(*node, 1.0)], from: far, to: far, compliance_m_n: COMPLIANCE });
        }
        holds
    }

    /// As the reference sees it, with the loads on its nodes, N.
    ///
    /// # Errors
    /// When a material is none.
    pub fn problem(&self) -> Result<(Problem, Vec<DVec3>), ReferenceError> {
        let problem = Problem::new(&self.mesh, &self.materials, |n| self.fixed.iter().any(|(f, _)| *f == n))?;
        let mut loads = problem.weights(self.gravity);
        for (node, force) in &self.forces {
            loads[node.index()] += *force;
        }
        Ok((problem, loads))
    }

    /// The same in ten-node elements.
    ///
    /// # Errors
    /// When a material is none.
    pub fn quadratic(&self) -> Result<(Problem, Vec<DVec3>), ReferenceError> {
        let problem = Problem::quadratic(&self.mesh, &self.materials, |n| self.fixed.iter().any(|(f, _)| *f == n))?;
        let mut loads = problem.weights(self.gravity);
        for ([a, b], force) in &self.pressed {
            if let Some(middle) = problem.middle(*a, *b) {
                loads[middle] += *force;
            }
        }
        if self.pressed.is_empty() {
            for (node, force) in &self.forces {
                loads[node.index()] += *force;
            }
        }
        Ok((problem, loads))
    }

    /// Where a body of [`Self::problem`] or [`Self::quadratic`] comes to rest: positions by node slot, m.
    ///
    /// # Errors
    /// When there is no equilibrium.
    pub fn rest(&self, (problem, loads): &(Problem, Vec<DVec3>)) -> Result<Vec<DVec3>, ReferenceError> {
        let mut start = problem.rest.clone();
        for (node, place) in &self.fixed {
            start[node.index()] = *place;
        }
        let settings = Statics { load_steps: if self.case == Case::Uniaxial { 8 } else { 3 }, ..Statics::default() };
        equilibrium(problem, &start, loads, settings)
    }

    /// The answer of displaced positions, by node slot, m.
    #[must_use]
    pub fn ask(&self, x: impl Fn(NodeId) -> DVec3) -> f64 {
        let moved = |n: &NodeId| x(*n) - self.mesh.rest(*n);
        let mean = |nodes: &[NodeId], along: DVec3| nodes.iter().map(|n| moved(n).dot(along)).sum::<f64>() / nodes.len().max(1) as f64;
        match &self.answer {
            Answer::Mean { nodes, along, factor } => factor * mean(nodes, *along),
            Answer::Stretch { nodes, length } => 1.0 + mean(nodes, DVec3::X) / length,
            Answer::Twist { from, to } => {
                let rotation = |nodes: &[NodeId]| {
                    let count = nodes.len() as f64;
                    let (a, b) = (
                        nodes.iter().map(|n| self.mesh.rest(*n)).sum::<DVec3>() / count,
                        nodes.iter().map(|n| x(*n)).sum::<DVec3>() / count,
                    );
                    let (mut sine, mut cosine) = (0.0, 0.0);
                    for n in nodes {
                        let (p, q) = (self.mesh.rest(*n) - a, x(*n) - b);
                        sine += p.y * q.z - p.z * q.y;
                        cosine += p.y * q.y + p.z * q.z;
                    }
                    f64::atan2(sine, cosine).to_degrees()
                };
                rotation(to) - rotation(from)
            }
        }
    }

    /// Root mean square distance of positions from others, as a part of that of the others from rest.
    #[must_use]
    pub fn distance(&self, x: impl Fn(NodeId) -> Vec3, truth: &[DVec3]) -> f64 {
        let (mut off, mut way) = (0.0, 0.0);
        for n in self.mesh.nodes() {
            off += x(n).as_dvec3().distance_squared(truth[n.index()]);
            way += truth[n.index()].distance_squared(self.mesh.rest(n));
        }
        (off / way).sqrt()
    }

    /// Longest way of the answer's nodes in time, for the time of the first turn: positive in the load's direction.
    #[must_use]
    pub fn swings(&self) -> bool {
        self.case == Case::Cantilever
    }
}

/// E 10 kPa, nu 0.45, 1050 kg/m3: the material of the beam that engines are compared on.
fn soft() -> OrganMaterials {
    keyhole_tissue::beam::beam_material()
}

fn at(mesh: &TetMesh, is: impl Fn(DVec3) -> bool) -> Vec<NodeId> {
    mesh.nodes().filter(|n| is(mesh.rest(*n))).collect()
}

fn clamped(mesh: &TetMesh) -> Vec<(NodeId, DVec3)> {
    at(mesh, |p| p.x == 0.0).into_iter().map(|n| (n, mesh.rest(n))).collect()
}

/// A pressure (N/m2, as a vector) on the surface triangles whose three nodes are all among some: the forces half way along their edges, which is exact for what is
/// linear on each triangle.
fn press(mesh: &TetMesh, among: impl Fn(DVec3) -> bool, pressure: impl Fn(DVec3) -> DVec3) -> Vec<([NodeId; 2], DVec3)> {
    let mut pressed = Vec::new();
    for t in Boundary::of(mesh).triangles {
        let [a, b, c] = t.map(|n| mesh.rest(n));
        if [a, b, c].into_iter().all(&among) {
            let third = (b - a).cross(c - a).length() / 6.0;
            for (m, n) in [(0, 1), (1, 2), (2, 0)] {
                let force = pressure((mesh.rest(t[m]) + mesh.rest(t[n])) / 2.0) * third;
                if force != DVec3::ZERO {
                    pressed.push(([t[m], t[n]], force));
                }
            }
        }
    }
    pressed
}

/// Scales forces so that their sum along a direction is as wanted.
fn scale(pressed: &mut [([NodeId; 2], DVec3)], along: DVec3, wanted: f64) {
    let given: f64 = pressed.iter().map(|(_, f)| f.dot(along)).sum();
    pressed.iter_mut().for_each(|(_, f)| *f *= wanted / given);
}

/// What linear elements make of forces half way between nodes: half for each end.
fn on_nodes(mesh: &TetMesh, pressed: &[([NodeId; 2], DVec3)]) -> Vec<(NodeId, DVec3)> {
    let mut forces = vec![DVec3::ZERO; mesh.node_slots()];
    for (ends, force) in pressed {
        for n in ends {
            forces[n.index()] += *force / 2.0;
        }
    }
    mesh.nodes().filter(|n| forces[n.index()] != DVec3::ZERO).map(|n| (n, forces[n.index()])).collect()
}

fn cantilever(m: u32) -> Specimen {
    let n = match m {
        5 => 10,
        8 => 16,
        _ => 2 * m,
    };
    let mesh = keyhole_tissue::beam::beam(n, m);
    let end = at(&mesh, |p| p.x > 0.06 - 1e-9);
    Specimen {
        case: Case::Cantilever,
        fixed: clamped(&mesh),
        forces: Vec::new(),
        pressed: Vec::new(),
        gravity: DVec3::new(0.0, -9.81, 0.0),
        materials: soft(),
        drag_1_s: DRAG_1_S,
        closed_form: None,
        edge_m: 0.03 / f64::from(m),
        answer: Answer::Mean { nodes: end, along: DVec3::Y, factor: 1e3 },
        mesh,
    }
}

/// Small rotations: `T L / G J` with `J = 0.1406 a^4` for a square (Timoshenko, Goodier 1951).
fn torsion(m: u32) -> Specimen {
    let (length, side, couple) = (0.08, 0.02, 1e-4);
    let mesh = block([4 * m, m, m], [length, side, side]);
    let middle = DVec3::new(0.0, side / 2.0, side / 2.0);
    let end = at(&mesh, |p| p.x > length - 1e-9);
    let arm = |n: NodeId| DVec3::X.cross(mesh.rest(n) - middle);
    let total: f64 = end.iter().map(|n| arm(*n).length_squared()).sum();
    let forces = end.iter().map(|n| (*n, arm(*n) * (couple / total))).collect();
    let section = |x: f64| at(&mesh, |p| (p.x - x).abs() < 1e-9);
    let material = &soft().0[0];
    let shear = f64::from(material.young_modulus_pa) / (2.0 * (1.0 + f64::from(material.poisson_ratio)));
    let twist = couple * (length / 2.0) / (shear * 0.1406 * side.powi(4));
    Specimen {
        case: Case::Torsion,
        fixed: clamped(&mesh),
        forces,
        pressed: Vec::new(),
        gravity: DVec3::ZERO,
        materials: soft(),
        drag_1_s: DRAG_1_S,
        closed_form: Some(twist.to_degrees()),
        edge_m: side / f64::from(m),
        answer: Answer::Twist { from: section(length / 4.0), to: section(0.75 * length) },
        mesh,
    }
}

/// `q^2 = (a s - mu / lambda) / s^2`, nominal stress `mu (s - q^2 / s)`: the fixed end is as narrow as the rest, so the strain is the same everywhere.
fn uniaxial(m: u32) -> Specimen {
    let (length, side, stretch) = (0.04, 0.02, 1.5);
    let mesh = block([2 * m, m, m], [length, side, side]);
    let materials = soft();
    let (mu, lambda) = NeoHookean::of(&materials.0[0]).map_or((0.0, 1.0), |c| (f64::from(c.mu), f64::from(c.lambda)));
    let ratio = mu / lambda;
    let narrow = (((1.0 + ratio) * stretch - ratio) / (stretch * stretch)).sqrt();
    let nominal = mu * (stretch - narrow * narrow / stretch);
    let middle = side / 2.0;
    let place = |p: DVec3| DVec3::new(p.x, middle + (p.y - middle) * narrow, middle + (p.z - middle) * narrow);
    let fixed = at(&mesh, |p| p.x == 0.0).into_iter().map(|n| (n, place(mesh.rest(n)))).collect();
    let end = |p: DVec3| p.x > length - 1e-9;
    let pressed = press(&mesh, end, |_| DVec3::X * nominal);
    Specimen {
        case: Case::Uniaxial,
        fixed,
        forces: on_nodes(&mesh, &pressed),
        pressed,
        gravity: DVec3::ZERO,
        materials,
        drag_1_s: DRAG_1_S,
        closed_form: Some(stretch),
        edge_m: side / f64::from(m),
        answer: Answer::Stretch { nodes: at(&mesh, end), length },
        mesh,
    }
}

/// The pressure of a ball on an elastic half-space, `p0 sqrt(1 - r^2 / a^2)` (Hertz 1882), as a dead load; its depth there is
/// `pi p0 a (1 - nu^2) / 2 E`, more than that of a block that rests on a plate.
fn indentation(m: u32) -> Specimen {
    let (width, height, radius, peak) = (0.08, 0.04, 0.016, 1500.0);
    let mesh = block([m, m / 2, m], [width, height, width]);
    let centre = DVec3::new(width / 2.0, height, width / 2.0);
    let pressure = |p: DVec3| DVec3::NEG_Y * (peak * (1.0 - (p - centre).length_squared() / (radius * radius)).max(0.0).sqrt());
    let mut pressed = press(&mesh, |p| p.y > height - 1e-9, pressure);
    // The same force in all whatever the nodes are: 2/3 pi a^2 p0.
    scale(&mut pressed, DVec3::NEG_Y, 2.0 / 3.0 * std::f64::consts::PI * radius * radius * peak);
    let under = at(&mesh, |p| p.distance(centre) < 1e-9);
    let fixed = at(&mesh, |p| p.y == 0.0).into_iter().map(|n| (n, mesh.rest(n))).collect();
    Specimen {
        case: Case::Indentation,
        fixed,
        forces: on_nodes(&mesh, &pressed),
        pressed,
        gravity: DVec3::ZERO,
        materials: soft(),
        drag_1_s: DRAG_1_S,
        closed_form: None,
        edge_m: width / f64::from(m),
        answer: Answer::Mean { nodes: under, along: DVec3::NEG_Y, factor: 1e3 },
        mesh,
    }
}

/// The nodes of a fifth of its length are fixed, a patch at the other end is pulled away and down with 0.4 N.
fn kidney(cell_tenths_mm: u32) -> Result<Specimen, ImagingError> {
    let mesh = phantom_kidneys(&[f64::from(cell_tenths_mm) / 10.0])?.remove(0).mesh;
    let (low, high) = mesh.nodes().map(|n| mesh.rest(n)).fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(a, b), p| (a.min(p), b.max(p)));
    let size = high - low;
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    let fixed: Vec<_> = at(&mesh, |p| p[axis] < low[axis] + 0.2 * size[axis]).into_iter().map(|n| (n, mesh.rest(n))).collect();
    let tip = mesh.nodes().max_by(|a, b| mesh.rest(*a)[axis].total_cmp(&mesh.rest(*b)[axis])).map_or(DVec3::ZERO, |n| mesh.rest(n));
    let mut pull = DVec3::ZERO;
    pull[axis] = 0.3;
    pull.y -= 0.25;
    let mut pressed = press(&mesh, |p| p.distance(tip) < 0.2 * size[axis], |_| pull);
    scale(&mut pressed, pull.normalize(), pull.length());
    let forces = on_nodes(&mesh, &pressed);
    Ok(Specimen {
        case: Case::Kidney,
        fixed,
        pressed,
        gravity: DVec3::new(0.0, -9.81, 0.0),
        materials: OrganMaterials(vec![OrganMaterial::default()]),
        drag_1_s: DRAG_1_S,
        closed_form: None,
        edge_m: f64::from(cell_tenths_mm) * 1e-4,
        answer: Answer::Mean { nodes: forces.iter().map(|(n, _)| *n).collect(), along: DVec3::NEG_Y, factor: 1e3 },
        forces,
        mesh,
    })
}
