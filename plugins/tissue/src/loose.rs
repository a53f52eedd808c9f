//! Parts of a body that hang together with nothing else of it: scraps that a stroke has cut out before the tool has left, and pieces of a mesh that never was one.
//!
//! What conjugate gradients leave of the balance is small beside all that the body does. Beside what a scrap of some micrograms does it is not: a thousandth of the
//! weight of an organ throws it across the theatre. So each such part is moved all together to where inertia, contacts and springs balance on it.

use crate::newton::{Part, Weights};
use crate::touches::Touches;
use bevy_math::DVec3;

/// Moves every loose part of the bodies that no node is fixed of to its own balance of linear momentum. The residuals and the contacts are those where the bodies are;
/// the residuals are spent.
pub(crate) fn settle_loose(parts: &mut [Part<'_>], touches: &mut Touches, weights: Weights) {
    for at in 0..parts.len() {
        let loose = std::mem::take(&mut parts[at].newton.clusters.loose);
        for nodes in &loose {
            let Part { tissue, newton } = &parts[at];
            let is_in = |n: u32| nodes.binary_search(&n).is_ok();
            if nodes.iter().any(|n| !newton.free[*n as usize]) {
                continue;
            }
            let left: DVec3 = nodes.iter().map(|n| newton.gradients.residual[*n as usize].as_dvec3()).sum();
            let mut against: f64 = nodes.iter().map(|n| f64::from(tissue.body.masses[*n as usize] * weights.inertia)).sum();
            for spring in &newton.springs {
                let weight: f32 = spring.point.iter().filter(|(n, _)| is_in(n.0)).map(|(_, w)| w).sum();
                against += f64::from(spring.stiffness * weight * weight);
            }
            if against <= 0.0 {
                continue;
            }
            let shift = touches.balance(parts, |a| a.part as usize == at && is_in(a.node), left, against);
            for n in nodes {
                parts[at].newton.x[*n as usize] += shift;
            }
        }
        parts[at].newton.clusters.loose = loose;
    }
    touches.look(parts);
}
