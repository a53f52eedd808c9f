//! Prestress: a scan is taken under gravity, so the shape that was scanned is already loaded. The rest shape is the one whose equilibrium under
//! gravity is the scanned one.
//!
//! Found by going back by what is left over (Sellier 2011, "An iterative method for the inverse elasto-static problem"): the equilibrium `x` of a rest
//! shape `X` misses the scanned shape by `x - s`, and `X - (x - s)` misses it by less.

use super::{Problem, ReferenceError, Statics, equilibrium};
use bevy_math::DVec3;
use keyhole_tetmesh::{NodeId, TetMesh};
use keyhole_whiteboard::OrganMaterials;

/// A rest shape and how well it answers.
#[derive(Clone, Debug, PartialEq)]
pub struct Unloaded {
    /// Rest position by node slot, m.
    pub rest: Vec<DVec3>,
    /// Largest distance of a node at equilibrium from where it was scanned, m.
    pub error_m: f64,
    /// Equilibria that were computed.
    pub rounds: u32,
}

/// The rest shape of a mesh that was scanned under gravity (m/s2), with the nodes that `is_fixed` says held where they are. Ends when no node is
/// further than `tolerance` of the sag from its scanned place, or after `rounds`.
///
/// # Errors
/// When a material is none, when nothing holds the body, or when an equilibrium is not found.
pub fn unloaded(
    mesh: &TetMesh,
    materials: &OrganMaterials,
    is_fixed: impl Fn(NodeId) -> bool,
    gravity: DVec3,
    tolerance: f64,
    rounds: u32,
) -> Result<Unloaded, ReferenceError> {
    let scanned = Problem::new(mesh, materials, is_fixed)?;
    let target = scanned.rest.clone();
    // What is weighed is what was scanned: the masses stay those of the scanned shape.
    let loads = scanned.weights(gravity);
    let mut problem = scanned.clone();
    let mut best = Unloaded { rest: target.clone(), error_m: f64::INFINITY, rounds: 0 };
    let mut start = target.clone();
    let mut sag = 0.0_f64;
    // A step back that overshoots is halved.
    let mut length = 1.0;
    for round in 1..=rounds.max(1) {
        let settings = Statics { load_steps: if round == 1 { 4 } else { 1 }, tolerance: 1e-8, ..Statics::default() };
        let x = equilibrium(&problem, &start, &loads, settings)?;
        let miss: Vec<DVec3> = x.iter().zip(&target).map(|(x, s)| *x - *s).collect();
        let error = miss.iter().map(|m| m.length()).fold(0.0, f64::max);
        sag = sag.max(error);
        if error < best.error_m {
            best = Unloaded { rest: problem.rest.clone(), error_m: error, rounds: round };
        } else {
            length *= 0.5;
        }
        if error <= tolerance * sag || round == rounds {
            break;
        }
        let mut rest = problem.rest.clone();
        for ((r, m), f) in rest.iter_mut().zip(&miss).zip(&problem.fixed) {
            if !f {
                *r -= *m * length;
            }
        }
        problem = reshaped(&scanned, rest);
        start = target.clone();
    }
    best.rounds = best.rounds.max(1);
    Ok(best)
}

/// The same body with another rest shape, its masses as they are.
fn reshaped(problem: &Problem, rest: Vec<DVec3>) -> Problem {
    let tets = problem
        .tets
        .iter()
        .map(|t| {
            let material = crate::material::NeoHookean { mu: t.mu as f32, lambda: t.lambda as f32 };
            super::Tetra::new(t.nodes, t.nodes.map(|n| rest[n as usize]), material)
        })
        .collect();
    Problem { tets, rest, ..problem.clone() }
}
