//! Extended position-based dynamics (Macklin, Mueller, Chentanez 2016) with small steps: n substeps of one iteration (Macklin et al. 2019).
//!
//! Constraints of an element (Macklin & Mueller 2021), gradients by F:
//!
//! - deviatoric `C_D = |F|`, compliance `1 / (mu V)`, gradient `F / |F|`;
//! - hydrostatic `C_H = det F - 1 - mu / lambda`, compliance `1 / (lambda V)`, gradient `cof F`.
//!
//! Both are solved together as a 2x2 block (Ton-That, Kry, Andrews 2022), elements one after the other by colour. Instead of them an element can have
//! the paper's constraints, its six edges and its volume with the stiffnesses of [`crate::teschner`], solved one after the other.

use crate::body::Body;
use crate::element::{Element, cofactor};
use crate::hold::Hold;
use crate::membrane::{Membrane, Triangle};
use crate::model::{drift, driven, inverse_masses};
use crate::settings::TissueSettings;
use bevy_math::{Mat3, Vec3};
use keyhole_tetmesh::EDGES;
use keyhole_whiteboard::TissueState;

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

/// Share of the product of its diagonal below which the determinant of a block is rounding.
const PARALLEL: f64 = 1e-12;

/// Steps a body over one tick of `dt` s under gravity (m/s2).
pub fn step(body: &Body, state: &mut TissueState, holds: &[Hold], gravity: Vec3, dt: f32, settings: &TissueSettings) {
    let own = XpbdSettings { substeps: settings.substeps, constraints: Constraints::NeoHookean };
    step_with(&own, body, None, state, holds, gravity, dt, settings.drag_1_s);
}

/// Steps a body and its membrane over one tick of `dt` s under gravity (m/s2) with this drag (1/s).
pub fn step_with(
    settings: &XpbdSettings,
    body: &Body,
    membrane: Option<&Membrane>,
    state: &mut TissueState,
    holds: &[Hold],
    gravity: Vec3,
    dt: f32,
    drag_1_s: f32,
) {
    let n = settings.substeps.max(1);
    let h = dt / n as f32;
    let driven = driven(holds, &state.positions);
    let inverse_mass = inverse_masses(body.masses(), &driven);
    let decay = (-drag_1_s * h).exp();
    let mut before = state.positions.clone();
    for substep in 0..n {
        let s = (substep + 1) as f32 / n as f32;
        before.copy_from_slice(&state.positions);
        let drift = drift(body.masses(), &state.velocities, holds);
        for ((x, v), w) in state.positions.iter_mut().zip(&state.velocities).zip(&inverse_mass) {
            if *w > 0.0 {
                *x += (drift + (*v - drift) * decay + gravity * h) * h;
            }
        }
        for (i, from, to) in &driven {
            state.positions[*i] = from.lerp(*to, s);
        }
        for colour in body.colouring().colours() {
            for &slot in colour {
                let element = &body.elements()[slot as usize];
                match settings.constraints {
                    Constraints::NeoHookean => solve(element, &mut state.positions, &inverse_mass, h),
                    Constraints::DistanceVolume => solve_springs(element, &mut state.positions, &inverse_mass, h),
                }
            }
        }
        for triangle in membrane.iter().flat_map(|m| m.triangles()) {
            solve_triangle(triangle, &mut state.positions, &inverse_mass, h);
        }
        for hold in holds.iter().filter(|hold| hold.fixes().is_none()) {
            pull(hold, s, &mut state.positions, &inverse_mass, h);
        }
        for ((v, x), b) in state.velocities.iter_mut().zip(&state.positions).zip(&before) {
            *v = (*x - *b) / h;
        }
    }
}

/// Edges and volume of an element: compliances `1 / k_D` and `1 / k_V` of the strains.
fn solve_springs(element: &Element, positions: &mut [Vec3], inverse_mass: &[f32], h: f32) {
    let at = element.indices();
    let w = at.map(|i| inverse_mass[i]);
    let (mu, bulk) = (element.material.mu, element.material.lambda - element.material.mu / 3.0);
    let rest = element.inverse_rest.inverse();
    let corner = [Vec3::ZERO, rest.x_axis, rest.y_axis, rest.z_axis];
    let soft = 6.0 / (15.0 * mu * element.volume * h * h);
    for [i, j] in EDGES {
        let length = corner[i].distance(corner[j]);
        let way = positions[at[j]] - positions[at[i]];
        let now = way.length();
        let weight = (w[i] + w[j]) / (length * length) + soft;
        if now <= 0.0 || w[i] + w[j] <= 0.0 {
            continue;
        }
        let step = way * (-(now - length) / (length * length * now * weight));
        positions[at[i]] -= step * w[i];
        positions[at[j]] += step * w[j];
    }
    let stiffness = (bulk - 5.0 * mu / 3.0) * element.volume;
    if stiffness <= 0.0 {
        return;
    }
    // The strain of the volume is the determinant less one.
    let f = element.deformation(at.map(|i| positions[i]));
    let c = cofactor(f);
    let g = c * element.inverse_rest.transpose();
    let g0 = g.x_axis + g.y_axis + g.z_axis;
    let weight =
        w[0] * g0.length_squared() + w[1] * g.x_axis.length_squared() + w[2] * g.y_axis.length_squared() + w[3] * g.z_axis.length_squared();
    let step = -(f.x_axis.dot(c.x_axis) - 1.0) / (weight + 1.0 / (stiffness * h * h));
    positions[at[0]] -= g0 * (step * w[0]);
    positions[at[1]] += g.x_axis * (step * w[1]);
    positions[at[2]] += g.y_axis * (step * w[2]);
    positions[at[3]] += g.z_axis * (step * w[3]);
}

/// A triangle of the membrane, its two constraints as a block.
fn solve_triangle(triangle: &Triangle, positions: &mut [Vec3], inverse_mass: &[f32], h: f32) {
    let at = triangle.nodes.map(|n| n as usize);
    let w = at.map(|i| f64::from(inverse_mass[i]));
    let (c, g) = triangle.constraints(at.map(|i| positions[i].as_dvec3()));
    let soft = 1.0 / (triangle.volume * f64::from(h * h));
    let product = |a: usize, b: usize| (0..3).map(|i| w[i] * g[a][i].dot(g[b][i])).sum::<f64>();
    let (dd, dh, hh) = (product(0, 0) + soft / triangle.mu, product(0, 1), product(1, 1) + soft / triangle.lambda);
    let det = dd * hh - dh * dh;
    if det <= 0.0 {
        return;
    }
    let (d, e) = ((-c[0] * hh + c[1] * dh) / det, (-c[1] * dd + c[0] * dh) / det);
    for i in 0..3 {
        positions[at[i]] += ((g[0][i] * d + g[1][i] * e) * w[i]).as_vec3();
    }
}

fn squares(m: &Mat3) -> f32 {
    dot(m, m)
}

fn dot(a: &Mat3, b: &Mat3) -> f32 {
    a.x_axis.dot(b.x_axis) + a.y_axis.dot(b.y_axis) + a.z_axis.dot(b.z_axis)
}

#[inline]
fn solve(element: &Element, positions: &mut [Vec3], inverse_mass: &[f32], h: f32) {
    let at = element.indices();
    let w = at.map(|i| inverse_mass[i]);
    let f = element.deformation(at.map(|i| positions[i]));
    let size = squares(&f).sqrt();
    let c = cofactor(f);
    let volume_ratio = f.x_axis.dot(c.x_axis);
    let constants = element.material;
    // Gradients at nodes 1, 2, 3 as columns; that at node 0 is minus their sum.
    let to_nodes = element.inverse_rest.transpose();
    let deviatoric = f * if size > 0.0 { 1.0 / size } else { 0.0 } * to_nodes;
    let hydrostatic = c * to_nodes;
    let d0 = deviatoric.x_axis + deviatoric.y_axis + deviatoric.z_axis;
    let h0 = hydrostatic.x_axis + hydrostatic.y_axis + hydrostatic.z_axis;
    let weighted = Mat3::from_cols(deviatoric.x_axis * w[1], deviatoric.y_axis * w[2], deviatoric.z_axis * w[3]);
    let weighted_h = Mat3::from_cols(hydrostatic.x_axis * w[1], hydrostatic.y_axis * w[2], hydrostatic.z_axis * w[3]);
    // In stiff tissue and in slivers the two gradients are almost parallel, and what tells them apart is the small compliance: in f32 nothing is left of it.
    let exact = |a: Vec3, b: Vec3| a.as_dvec3().dot(b.as_dvec3());
    let product = |a: &Mat3, a0: Vec3, b: &Mat3, b0: Vec3| {
        let [u, v, x, y] = w.map(f64::from);
        u * exact(a0, b0) + v * exact(a.x_axis, b.x_axis) + x * exact(a.y_axis, b.y_axis) + y * exact(a.z_axis, b.z_axis)
    };
    let soft = 1.0 / f64::from(element.volume * h * h);
    let dd = product(&deviatoric, d0, &deviatoric, d0) + soft / f64::from(constants.mu);
    let dh = product(&deviatoric, d0, &hydrostatic, h0);
    let hh = product(&hydrostatic, h0, &hydrostatic, h0) + soft / f64::from(constants.lambda);
    let (cd, ch) = (-f64::from(size), f64::from(constants.a()) - f64::from(volume_ratio));
    let det = dd * hh - dh * dh;
    // Where even that is rounding, each gets half of its own solution.
    let (ld, lh) =
        if det > PARALLEL * dd * hh { ((cd * hh - ch * dh) / det, (ch * dd - cd * dh) / det) } else { (0.5 * cd / dd, 0.5 * ch / hh) };
    let (ld, lh) = (ld as f32, lh as f32);
    positions[at[0]] -= (d0 * ld + h0 * lh) * w[0];
    positions[at[1]] += weighted.x_axis * ld + weighted_h.x_axis * lh;
    positions[at[2]] += weighted.y_axis * ld + weighted_h.y_axis * lh;
    positions[at[3]] += weighted.z_axis * ld + weighted_h.z_axis * lh;
}

/// A hold as a constraint of three dimensions: its point less its anchor.
pub(crate) fn pull(hold: &Hold, s: f32, positions: &mut [Vec3], inverse_mass: &[f32], h: f32) {
    let mut gap = -hold.from.lerp(hold.to, s);
    let mut w = 0.0;
    for (node, weight) in &hold.point {
        gap += positions[node.index()] * *weight;
        w += inverse_mass[node.index()] * weight * weight;
    }
    let lambda = -gap / (w + hold.compliance_m_n.max(0.0) / (h * h));
    if w > 0.0 {
        for (node, weight) in &hold.point {
            positions[node.index()] += lambda * (inverse_mass[node.index()] * weight);
        }
    }
}
