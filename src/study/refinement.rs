//! The reference under refinement: what it tends to with linear and with ten-node elements, and how far from closed forms that is.

use crate::study::specimen::{Case, Specimen};
use crate::study::trade::TradeError;
use bevy_math::DVec3;
use keyhole_tissue::beam::block;
use keyhole_tissue::reference::{Problem, ReferenceError, Statics, equilibrium};
use keyhole_whiteboard::{OrganMaterial, OrganMaterials};

/// Elements of the reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Elements {
    /// Four nodes.
    Linear,
    /// Ten nodes.
    Quadratic,
}

impl Elements {
    /// In words.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Quadratic => "ten nodes",
        }
    }
}

/// An answer of the reference.
#[derive(Clone, Debug, PartialEq)]
pub struct Refined {
    /// What is asked.
    pub what: &'static str,
    /// With which elements.
    pub elements: Elements,
    /// Number of tetrahedra.
    pub tets: usize,
    /// The answer, mm.
    pub answer: f64,
    /// The closed forms, with their names.
    pub closed: Vec<(&'static str, f64)>,
}

/// A slender stiff beam of 80 x 10 x 10 mm, E 1 MPa, without Poisson's ratio, under its weight: it bends by less than a hundredth of its length.
const SLENDER: &str = "slender beam, small deflection";
const LENGTH: f64 = 0.08;
const SIDE: f64 = 0.01;
const YOUNG: f64 = 1e6;
const DENSITY: f64 = 1050.0;
const GRAVITY: f64 = 9.81;

/// `w L^4 / 8 E I` and with shear `w L^2 / 2 k G A`, `k = 5 / 6`, mm.
fn beam_theory() -> [(&'static str, f64); 2] {
    let (area, inertia) = (SIDE * SIDE, SIDE.powi(4) / 12.0);
    let weight = DENSITY * GRAVITY * area;
    let bending = weight * LENGTH.powi(4) / (8.0 * YOUNG * inertia);
    let shear = weight * LENGTH.powi(2) / (2.0 * 5.0 / 6.0 * YOUNG / 2.0 * area);
    [("Euler-Bernoulli", bending * 1e3), ("Timoshenko", (bending + shear) * 1e3)]
}

fn slender(m: u32, elements: Elements) -> Result<Refined, ReferenceError> {
    let mesh = block([8 * m, m, m], [LENGTH, SIDE, SIDE]);
    let material =
        OrganMaterial { young_modulus_pa: YOUNG as f32, poisson_ratio: 0.0, density_kg_m3: DENSITY as f32, ..Default::default() };
    let materials = OrganMaterials(vec![material]);
    let is_fixed = |n| mesh.rest(n).x == 0.0;
    let problem = match elements {
        Elements::Linear => Problem::new(&mesh, &materials, is_fixed)?,
        Elements::Quadratic => Problem::quadratic(&mesh, &materials, is_fixed)?,
    };
    let x = equilibrium(&problem, &problem.rest, &problem.weights(DVec3::NEG_Y * GRAVITY), Statics::default())?;
    let end: Vec<_> = mesh.nodes().filter(|n| mesh.rest(*n).x > LENGTH - 1e-9).collect();
    let answer = end.iter().map(|n| mesh.rest(*n).y - x[n.index()].y).sum::<f64>() / end.len() as f64 * 1e3;
    Ok(Refined { what: SLENDER, elements, tets: mesh.tet_count(), answer, closed: beam_theory().into() })
}

fn hanging(specimen: &Specimen, elements: Elements) -> Result<Refined, ReferenceError> {
    let body = match elements {
        Elements::Linear => specimen.problem()?,
        Elements::Quadratic => specimen.quadratic()?,
    };
    let x = specimen.rest(&body)?;
    let answer = -specimen.ask(|n| x[n.index()]);
    Ok(Refined { what: "cantilever of the comparison", elements, tets: specimen.mesh.tet_count(), answer, closed: Vec::new() })
}

/// Meshes of twice the fineness of both beams, with each kind of elements.
///
/// # Errors
/// When the reference has no answer.
pub fn conduct(mut done: impl FnMut(&str)) -> Result<Vec<Refined>, TradeError> {
    let mut all = Vec::new();
    let quadratic = Elements::Quadratic;
    for (elements, m) in [(Elements::Linear, 2), (Elements::Linear, 4), (Elements::Linear, 6), (quadratic, 1), (quadratic, 2)] {
        done(&format!("reference, {SLENDER}, {m} over its height, {}", elements.name()));
        all.push(slender(m, elements).map_err(|source| TradeError::Reference { case: SLENDER, tets: 40 * (m as usize).pow(3), source })?);
    }
    for (elements, sizes) in [(Elements::Linear, &[5, 8, 13][..]), (quadratic, &[3, 5, 8])] {
        for m in sizes {
            done(&format!("reference, cantilever, {m} over its height, {}", elements.name()));
            let specimen = Case::Cantilever.specimen(*m)?;
            let failed = |source| TradeError::Reference { case: "cantilever", tets: specimen.mesh.tet_count(), source };
            all.push(hanging(&specimen, elements).map_err(failed)?);
        }
    }
    Ok(all)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    /// Ten-node elements bend as beams do where linear ones of the same mesh are far too stiff.
    #[test]
    fn ten_nodes_bend() {
        let closed = beam_theory()[1].1;
        let [linear, quadratic] = [Elements::Linear, Elements::Quadratic].map(|e| slender(1, e).unwrap().answer / closed - 1.0);
        assert!(linear < -0.4 && quadratic.abs() < 0.02, "{linear} {quadratic}");
    }
}
