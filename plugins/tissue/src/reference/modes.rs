//! How a body swings about an equilibrium: its slowest mode of small amplitude.

use super::sparse::System;
use super::{Problem, ReferenceError};
use bevy_math::DVec3;

/// Most iterations, and the change of the square of the frequency at which they end.
const ITERATIONS: u32 = 60;
const TOLERANCE: f64 = 1e-9;

/// Angular frequency (1/s) of the slowest mode about an equilibrium at these positions (m), by inverse iteration from a shape that is like it: of modes that a symmetry keeps
/// apart, the one with the symmetry of the shape. Shapes are by node slot.
///
/// # Errors
/// When the tangent is not positive definite there.
pub fn slowest_mode(problem: &Problem, positions: &[DVec3], shape: &[DVec3]) -> Result<f64, ReferenceError> {
    let system = System::new(problem)?;
    let factor = system.factorise(problem, positions, 1.0, 0.0)?;
    let weighed = |v: &[DVec3]| -> Vec<DVec3> {
        v.iter().zip(&problem.masses).zip(&problem.fixed).map(|((v, m), f)| if *f { DVec3::ZERO } else { *v * *m }).collect()
    };
    let product = |a: &[DVec3], b: &[DVec3]| a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum::<f64>();
    let mut v = shape.to_vec();
    let mut square = 0.0;
    for _ in 0..ITERATIONS {
        let right = weighed(&v);
        let next = system.solve(&factor, &right);
        let image = weighed(&next);
        // Rayleigh's quotient of what comes out: its stiffness is what went in.
        let now = product(&next, &right) / product(&next, &image);
        let size = product(&next, &image).sqrt();
        v = next.into_iter().map(|x| x / size).collect();
        if (now - square).abs() <= TOLERANCE * now {
            return Ok(now.sqrt());
        }
        square = now;
    }
    Ok(square.sqrt())
}
