//! Extended position-based dynamics (Macklin, Mueller, Chentanez 2016) with small steps: n substeps of one iteration (Macklin et al. 2019).
//!
//! Constraints of an element (Macklin & Mueller 2021), gradients by F:
//!
//! - deviatoric `C_D = |F|`, compliance `1 / (mu V)`, gradient `F / |F|`;
//! - hydrostatic `C_H = det F - 1 - mu / lambda`, compliance `1 / (lambda V)`, gradient `cof F`.
//!
//! Both are solved together as a 2x2 block (Ton-That, Kry, Andrews 2022), eight elements without a common node at a time, in parts of the organ that threads
//! share (`lanes_blocks.rs`). An inverted element yields three times as much to pressure as the material. Instead of the block an element can have
//! the paper's constraints, its six edges and its volume with the stiffnesses of [`crate::teschner`], solved one after the other.

use crate::body::Body;
use crate::colouring::Colouring;
use crate::element::Element;
use crate::hold::Hold;
use crate::lanes;
use crate::lanes_blocks::Blocks;
use crate::lanes_crew::Crew;
use crate::membrane::{Membrane, Triangle};
use crate::motion::{Fall, Nodes, Shared};
use crate::press::Presses;
use bevy_math::Vec3;
use keyhole_tetmesh::{TetMesh, TopologyDelta};
use keyhole_whiteboard::{Contact, TissueState};
use std::sync::{Mutex, PoisonError};

/// What holds an element in shape.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Constraints {
    /// The neo-Hookean energy, deviatoric and hydrostatic together.
    #[default]
    NeoHookean,
    /// Lengths of edges and volume: Poisson's ratio is at least 1/4, and large strains are those of another material.
    DistanceVolume,
}

/// Settings of [`crate::TissueModel::Xpbd`].
///
/// Limits, by `keyhole study stability` on a beam of 270 tetrahedra with 40 substeps of 1/60 s: from 10 MPa it shakes without end (springs do not); substeps of
/// less than 10 microseconds explode by rounding, for velocities are differences of positions; with a substep of 2.5 ms it is not back at rest
/// after 4 s; inside out or scrambled it stays tangled (springs come back).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct XpbdSettings {
    /// Substeps of one tick, of one iteration each; 0 counts as 1. Default 40: too few are a softer material, and the finer the mesh the more it takes.
    pub substeps: u32,
    /// What holds an element in shape. Default [`Constraints::NeoHookean`].
    pub constraints: Constraints,
}

impl Default for XpbdSettings {
    fn default() -> Self {
        Self { substeps: 40, constraints: Constraints::default() }
    }
}

/// What position-based dynamics keeps of a body between ticks: nothing before the first.
#[derive(Clone, Debug, Default)]
pub(crate) struct Xpbd {
    pub(crate) blocks: Option<Box<Blocks>>,
    nodes: Nodes,
    crew: Crew,
}

impl Xpbd {
    /// Carries it over a topology change; elements, colours and mesh are those after it.
    pub(crate) fn adopt(&mut self, mesh: &TetMesh, elements: &[Element], colouring: &Colouring, delta: &TopologyDelta) {
        if let Some(blocks) = &mut self.blocks {
            blocks.adopt(mesh, elements, colouring, delta);
        }
    }
}

/// Elements of a body that are worth a second thread, and a further one each.
const WORTH: usize = 2000;

/// Steps a body and its membrane over one tick of `dt` s under gravity (m/s2) with this drag (1/s), and writes the forces at its contacts down.
pub fn step_with(
    settings: &XpbdSettings,
    body: &mut Body,
    membrane: Option<&Membrane>,
    state: &mut TissueState,
    holds: &[Hold],
    gravity: Vec3,
    dt: f32,
    drag_1_s: f32,
    contacts: &mut [Contact],
) {
    let n = settings.substeps.max(1) as usize;
    let h = dt / n as f32;
    let fall = Fall { h, gravity, decay: (-drag_1_s * h).exp() };
    let Xpbd { mut blocks, mut nodes, mut crew } = std::mem::take(&mut body.xpbd);
    let blocks = match blocks.take().filter(|b| b.constraints() == settings.constraints) {
        Some(blocks) => blocks,
        None => Box::new(Blocks::new(&body.elements, &body.colouring, settings.constraints)),
    };
    nodes.load(&body.masses, state, holds);
    let presses = Mutex::new(Presses::new(body, contacts, |i| nodes.at.point(i)));
    let alone = !contacts.is_empty() || membrane.is_some() || holds.iter().any(|hold| hold.fixes().is_none());
    let (colours, rows) = (blocks.colours(), nodes.rows());
    // A substep: the sums for the drift, the nodes, the elements by colour, and what one thread does alone. After the last one the nodes once more.
    let period = colours + 3;
    let free = nodes.free;
    let tasks = |step: usize| match step % period {
        0 if free => 1,
        0 => 0,
        1 => rows,
        k if k == period - 1 => usize::from(alone),
        k => blocks.parts(k - 2),
    };
    let workers = (body.elements.len() / WORTH).clamp(1, rayon::current_num_threads());
    let task = |step: usize, i: usize, near: &mut lanes::Nodes| {
        let substep = step / period;
        let s = (substep + 1) as f32 / n as f32;
        match step % period {
            0 => {
                for r in 0..rows {
                    let mut row = nodes.row(r);
                    if substep > 0 {
                        nodes.finish(&mut row, h);
                    }
                    Nodes::sum(&mut row, &body.masses, |row, i| row.velocity[i]);
                }
                nodes.average();
            }
            1 => {
                let mut row = nodes.row(i);
                if substep > 0 {
                    nodes.finish(&mut row, h);
                }
                if substep < n {
                    nodes.begin(&mut row, nodes.mean(), fall, s);
                }
            }
            k if k == period - 1 => {
                for triangle in membrane.iter().flat_map(|m| m.triangles()) {
                    solve_triangle(triangle, &nodes.at, h);
                }
                for hold in holds.iter().filter(|hold| hold.fixes().is_none()) {
                    nodes.pull(hold, s, h);
                }
                let place = |i: usize| (nodes.at.point(i), nodes.at.get(i)[3]);
                let shift = |i: usize, by| nodes.at.place(i, nodes.at.point(i) + by);
                presses.lock().unwrap_or_else(PoisonError::into_inner).push_out(h, s * dt, place, shift);
            }
            k => blocks.solve(k - 2, i, h, &nodes.at, near),
        }
    };
    crew.run(workers, n * period + 2, tasks, task);
    nodes.store(state);
    presses.into_inner().unwrap_or_else(PoisonError::into_inner).write(contacts, dt);
    body.xpbd = Xpbd { blocks: Some(blocks), nodes, crew };
}

/// A triangle of the membrane, its two constraints as a block.
fn solve_triangle(triangle: &Triangle, nodes: &Shared, h: f32) {
    let at = triangle.nodes.map(|n| n as usize);
    let w = at.map(|i| f64::from(nodes.get(i)[3]));
    let (c, g) = triangle.constraints(at.map(|i| nodes.point(i).as_dvec3()));
    let soft = 1.0 / (triangle.volume * f64::from(h * h));
    let product = |a: usize, b: usize| (0..3).map(|i| w[i] * g[a][i].dot(g[b][i])).sum::<f64>();
    let (dd, dh, hh) = (product(0, 0) + soft / triangle.mu, product(0, 1), product(1, 1) + soft / triangle.lambda);
    let det = dd * hh - dh * dh;
    if det <= 0.0 {
        return;
    }
    let (d, e) = ((-c[0] * hh + c[1] * dh) / det, (-c[1] * dd + c[0] * dh) / det);
    for i in 0..3 {
        nodes.place(at[i], nodes.point(at[i]) + ((g[0][i] * d + g[1][i] * e) * w[i]).as_vec3());
    }
}
