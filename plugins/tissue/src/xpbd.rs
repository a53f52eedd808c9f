//! Extended position-based dynamics (Macklin, Mueller, Chentanez 2016) with small steps: n substeps of one iteration (Macklin et al. 2019).
//!
//! Constraints of an element (Macklin & Mueller 2021), gradients by F:
//!
//! - deviatoric `C_D = |F|`, compliance `1 / (mu V)`, gradient `F / |F|`;
//! - hydrostatic `C_H = det F - 1 - mu / lambda`, compliance `1 / (lambda V)`, gradient `cof F`.
//!
//! Both are solved together as a 2x2 block (Ton-That, Kry, Andrews 2022), elements one after the other by colour.

use crate::body::Body;
use crate::element::{Element, cofactor};
use crate::hold::Hold;
use crate::settings::TissueSettings;
use bevy_math::{Mat3, Vec3};
use keyhole_whiteboard::TissueState;

/// Steps a body over one tick of `dt` s under gravity (m/s2).
pub fn step(body: &Body, state: &mut TissueState, holds: &[Hold], gravity: Vec3, dt: f32, settings: &TissueSettings) {
    let n = settings.substeps.max(1);
    let h = dt / n as f32;
    let mut inverse_mass: Vec<f32> = body.masses.iter().map(|m| if *m > 0.0 { 1.0 / m } else { 0.0 }).collect();
    let fixed: Vec<(usize, Vec3, Vec3)> = holds.iter().filter_map(|hold| hold.fixes().map(|i| (i, state.positions[i], hold.to))).collect();
    for (i, ..) in &fixed {
        inverse_mass[*i] = 0.0;
    }
    let decay = (-settings.drag_1_s * h).exp();
    let mut before = state.positions.clone();
    for substep in 0..n {
        let s = (substep + 1) as f32 / n as f32;
        before.copy_from_slice(&state.positions);
        for ((x, v), w) in state.positions.iter_mut().zip(&state.velocities).zip(&inverse_mass) {
            if *w > 0.0 {
                *x += (*v * decay + gravity * h) * h;
            }
        }
        for (i, from, to) in &fixed {
            state.positions[*i] = from.lerp(*to, s);
        }
        for colour in body.colouring.colours() {
            for &slot in colour {
                solve(&body.elements[slot as usize], &mut state.positions, &inverse_mass, h);
            }
        }
        for hold in holds.iter().filter(|hold| hold.fixes().is_none()) {
            pull(hold, s, &mut state.positions, &inverse_mass, h);
        }
        for ((v, x), b) in state.velocities.iter_mut().zip(&state.positions).zip(&before) {
            *v = (*x - *b) / h;
        }
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
    let soft = 1.0 / (element.volume * h * h);
    let dd = w[0] * d0.length_squared() + dot(&weighted, &deviatoric) + soft / constants.mu;
    let dh = w[0] * d0.dot(h0) + dot(&weighted, &hydrostatic);
    let hh = w[0] * h0.length_squared() + dot(&weighted_h, &hydrostatic) + soft / constants.lambda;
    let (cd, ch) = (-size, constants.a() - volume_ratio);
    let det = dd * hh - dh * dh;
    let ld = (cd * hh - ch * dh) / det;
    let lh = (ch * dd - cd * dh) / det;
    positions[at[0]] -= (d0 * ld + h0 * lh) * w[0];
    positions[at[1]] += weighted.x_axis * ld + weighted_h.x_axis * lh;
    positions[at[2]] += weighted.y_axis * ld + weighted_h.y_axis * lh;
    positions[at[3]] += weighted.z_axis * ld + weighted_h.z_axis * lh;
}

/// A hold as a constraint of three dimensions: its point less its anchor.
fn pull(hold: &Hold, s: f32, positions: &mut [Vec3], inverse_mass: &[f32], h: f32) {
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
