//! What to do with a mesh that is turned inside out somewhere.
//!
//! An inverted element can be in equilibrium with its neighbours, and going downhill does not take it out of there. So a tick that starts with a tangled body is
//! stepped with another energy, which has one minimum and no other equilibrium: `mu V |F - R|^2 / 2` summed over the elements, `R` one rotation for the whole
//! body. It is quadratic in the positions, so backward Euler is one linear system with a positive matrix, stable for any material and any tick, and what it tends to is
//! the rest shape, turned. `R` is the rotation of the nodes that are held; where they leave it open, that of the whole body (Horn 1987, "Closed-form solution of
//! absolute orientation using unit quaternions"). As soon as the body is no longer tangled it is stepped as usual.
//! A body of which nothing is fixed comes out of it as a rigid body instead ([`crate::island`]).

use crate::body::Body;
use crate::element::Element;
use crate::hold::Hold;
use crate::motion::{drift, driven, mean};
use bevy_math::{DMat3, DMat4, DQuat, DVec3, DVec4, Mat3, Vec3};
use keyhole_whiteboard::TissueState;

/// Weight of the whole body against that of the held nodes when the rotation is sought.
const WHOLE: f64 = 1e-3;
/// Squarings of a matrix of Horn's: the power that singles out its largest eigenvalue is two to this.
const SQUARINGS: u32 = 24;
/// Most iterations of conjugate gradients, and the share of the residual at which they stop. What is left is left for the next tick.
const ITERATIONS: u32 = 100;
const TOLERANCE: f64 = 1e-3;
/// A hold of several nodes without compliance is a spring this many times as stiff as its nodes.
const RIGID: f32 = 100.0;

/// A body with more than one in so many elements inverted is tangled, where they are more than a few or a quarter of all: a few may be a bridge of tissue about to be cut through, torn
/// out of shape by the weight of what hangs on it.
const TANGLED: usize = 20;
const FEW: usize = 16;

/// Whether too many of the elements are inverted.
#[must_use]
pub fn is_tangled(body: &Body, state: &TissueState) -> bool {
    let count = body.elements().iter().filter(|e| inverted(e, state)).count();
    count * TANGLED > body.elements().len() && (count > FEW || count * 4 > body.elements().len())
}

/// Whether an element is inside out, or flat.
pub(crate) fn inverted(element: &Element, state: &TissueState) -> bool {
    !element.is_empty() && element.deformation(element.indices().map(|i| state.positions[i])).determinant() <= 0.0
}

/// Steps a tangled body over one tick of `dt` s under gravity (m/s2) with this drag (1/s).
pub(crate) fn step(body: &Body, state: &mut TissueState, holds: &[Hold], gravity: Vec3, dt: f32, drag_1_s: f32) {
    let crumbs = &body.implicit.newton.crumbs;
    let fixed = driven(holds, &state.positions);
    let mut free: Vec<bool> = body.masses().iter().enumerate().map(|(i, m)| *m > 0.0 && !crumbs.contains(i)).collect();
    for (i, ..) in &fixed {
        free[*i] = false;
    }
    let turned = rotation(body, state, &fixed);
    let before = state.positions.clone();
    for (i, _, to) in &fixed {
        state.positions[*i] = *to;
    }
    let system = System::new(body, holds, free, dt);
    let drifting = drift(body.masses(), &state.velocities, holds);
    let decay = (-drag_1_s * dt).exp();
    let mut residual = vec![Vec3::ZERO; before.len()];
    for (i, r) in residual.iter_mut().enumerate().filter(|(i, _)| system.free[*i]) {
        *r = (drifting + (state.velocities[i] - drifting) * decay + gravity * dt) * (body.masses()[i] / dt);
    }
    for e in body.elements().iter().filter(|e| !e.is_empty()) {
        let at = e.indices();
        let strain = turned - e.deformation(at.map(|i| state.positions[i]));
        spread(&mut residual, at, strain * e.inverse_rest.transpose() * (e.volume * e.material.mu));
    }
    for (hold, stiffness) in &system.springs {
        let gap = hold.point.iter().map(|(n, w)| state.positions[n.index()] * *w).sum::<Vec3>() - hold.to;
        for (n, w) in &hold.point {
            residual[n.index()] -= gap * (*stiffness * w);
        }
    }
    for (x, d) in state.positions.iter_mut().zip(system.solve(residual)) {
        *x += d;
    }
    // What it did in its plight is forgotten, but where it went as a whole: else stiff tissue is no sooner untangled than its speed tangles it again.
    let moved = mean(body.masses(), state.positions.iter().zip(&before).map(|(x, b)| (*x - *b) / dt));
    let kept = if holds.is_empty() { moved } else { Vec3::ZERO };
    for (_, v) in state.velocities.iter_mut().enumerate().filter(|(i, _)| !crumbs.contains(*i)) {
        *v = kept;
    }
}

/// Adds to the four nodes of an element what its columns say of nodes 1, 2 and 3; node 0 gets minus their sum.
pub(crate) fn spread(out: &mut [Vec3], at: [usize; 4], columns: Mat3) {
    out[at[0]] -= columns.x_axis + columns.y_axis + columns.z_axis;
    out[at[1]] += columns.x_axis;
    out[at[2]] += columns.y_axis;
    out[at[3]] += columns.z_axis;
}

/// Adds the diagonal of the elements' Laplacian.
fn add_stiffness(elements: &[&Element], diagonal: &mut [f32]) {
    for e in elements {
        let g = e.inverse_rest.transpose();
        let stiffness = e.volume * e.material.mu;
        let first = g.x_axis + g.y_axis + g.z_axis;
        for (i, g) in e.indices().into_iter().zip([first, g.x_axis, g.y_axis, g.z_axis]) {
            diagonal[i] += stiffness * g.length_squared();
        }
    }
}

/// Inertia, the Laplacian of the elements and springs.
pub(crate) struct System<'a> {
    pub(crate) elements: Vec<&'a Element>,
    free: Vec<bool>,
    /// Mass over the square of the step, N/m.
    inertia: Vec<f32>,
    diagonal: Vec<f32>,
    springs: Vec<(&'a Hold, f32)>,
}

impl<'a> System<'a> {
    fn new(body: &'a Body, holds: &'a [Hold], free: Vec<bool>, dt: f32) -> Self {
        let inertia: Vec<f32> = body.masses().iter().map(|m| m / (dt * dt)).collect();
        let elements: Vec<&Element> = body.elements().iter().filter(|e| !e.is_empty()).collect();
        let mut diagonal = inertia.clone();
        add_stiffness(&elements, &mut diagonal);
        let spring = |hold: &'a Hold| {
            let around: f32 = hold.point.iter().map(|(n, w)| w.abs() * diagonal[n.index()]).sum();
            let compliance = hold.compliance_m_n.max(0.0);
            (hold, if compliance * RIGID * around > 1.0 { 1.0 / compliance } else { RIGID * around })
        };
        let springs: Vec<(&Hold, f32)> = holds.iter().filter(|hold| hold.fixes().is_none()).map(spring).collect();
        for (hold, stiffness) in &springs {
            for (n, w) in &hold.point {
                diagonal[n.index()] += stiffness * w * w;
            }
        }
        Self { elements, free, inertia, diagonal, springs }
    }

    /// Of some elements alone, without inertia and springs.
    pub(crate) fn around(elements: Vec<&'a Element>, free: Vec<bool>) -> Self {
        let inertia = vec![0.0; free.len()];
        let mut diagonal = inertia.clone();
        add_stiffness(&elements, &mut diagonal);
        Self { elements, free, inertia, diagonal, springs: Vec::new() }
    }

    fn multiply(&self, d: &[Vec3]) -> Vec<Vec3> {
        let mut out: Vec<Vec3> = d.iter().zip(&self.inertia).map(|(d, m)| *d * *m).collect();
        for e in &self.elements {
            let at = e.indices();
            spread(&mut out, at, e.deformation(at.map(|i| d[i])) * e.inverse_rest.transpose() * (e.volume * e.material.mu));
        }
        for (hold, stiffness) in &self.springs {
            let gap = hold.point.iter().map(|(n, w)| d[n.index()] * *w).sum::<Vec3>() * *stiffness;
            for (n, w) in &hold.point {
                out[n.index()] += gap * *w;
            }
        }
        self.mask(&mut out);
        out
    }

    fn mask(&self, values: &mut [Vec3]) {
        for (v, free) in values.iter_mut().zip(&self.free) {
            if !free {
                *v = Vec3::ZERO;
            }
        }
    }

    /// Conjugate gradients with the diagonal as preconditioner.
    pub(crate) fn solve(&self, mut residual: Vec<Vec3>) -> Vec<Vec3> {
        self.mask(&mut residual);
        let precondition =
            |r: &[Vec3]| -> Vec<Vec3> { r.iter().zip(&self.diagonal).map(|(r, d)| if *d > 0.0 { *r / *d } else { Vec3::ZERO }).collect() };
        let mut solution = vec![Vec3::ZERO; residual.len()];
        let mut z = precondition(&residual);
        let mut direction = z.clone();
        let mut size = dot(&residual, &z);
        let enough = TOLERANCE * TOLERANCE * size;
        for _ in 0..ITERATIONS {
            let image = self.multiply(&direction);
            let curvature = dot(&direction, &image);
            if curvature <= 0.0 || size <= enough {
                break;
            }
            let length = (size / curvature) as f32;
            for i in 0..solution.len() {
                solution[i] += direction[i] * length;
                residual[i] -= image[i] * length;
            }
            z = precondition(&residual);
            let next = dot(&residual, &z);
            let keep = (next / size) as f32;
            for (d, z) in direction.iter_mut().zip(&z) {
                *d = *z + *d * keep;
            }
            size = next;
        }
        solution
    }
}

fn dot(a: &[Vec3], b: &[Vec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(a.dot(*b))).sum()
}

/// The rotation of what is held without compliance, and where that leaves it open of the whole body.
fn rotation(body: &Body, state: &TissueState, fixed: &[(usize, Vec3, Vec3)]) -> Mat3 {
    let held: Vec<(f64, DVec3, DVec3)> =
        fixed.iter().map(|(i, _, to)| (f64::from(body.masses()[*i]), body.rest()[*i].as_dvec3(), to.as_dvec3())).collect();
    let all = (0..state.positions.len()).filter(|i| body.masses()[*i] > 0.0);
    let all: Vec<_> = all.map(|i| (f64::from(body.masses()[i]), body.rest()[i].as_dvec3(), state.positions[i].as_dvec3())).collect();
    let (spread, whole) = (covariance(&held), covariance(&all));
    let size = |m: &DMat3| m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
    let (a, b) = (size(&spread), size(&whole));
    let scaled = |m: DMat3, by: f64| if by > 0.0 { m * (1.0 / by) } else { DMat3::ZERO };
    DMat3::from_quat(turn(scaled(spread, a) + scaled(whole, b) * WHOLE)).as_mat3()
}

/// Sum of `m (x - mean) (X - mean)'` over points of mass `m`, rest place `X` and place `x`.
pub(crate) fn covariance(points: &[(f64, DVec3, DVec3)]) -> DMat3 {
    let mass: f64 = points.iter().map(|p| p.0).sum();
    if mass <= 0.0 {
        return DMat3::ZERO;
    }
    let mean = |of: fn(&(f64, DVec3, DVec3)) -> DVec3| points.iter().map(|p| of(p) * p.0).sum::<DVec3>() / mass;
    let (rest, now) = (mean(|p| p.1), mean(|p| p.2));
    let outer = |(m, rest_place, place): &(f64, DVec3, DVec3)| {
        let (a, b) = ((*place - now) * *m, *rest_place - rest);
        DMat3::from_cols(a * b.x, a * b.y, a * b.z)
    };
    points.iter().map(outer).fold(DMat3::ZERO, |sum, m| sum + m)
}

/// The rotation `R` with the largest trace of `R' A`; none where `A` says nothing.
pub(crate) fn turn(a: DMat3) -> DQuat {
    let [[xx, yx, zx], [xy, yy, zy], [xz, yz, zz]] = a.to_cols_array_2d();
    // Horn's matrix for quaternions in the order x, y, z, w; shifted so that its largest eigenvalue is that of largest size.
    let horn = DMat4::from_cols(
        DVec4::new(xx - yy - zz, xy + yx, xz + zx, zy - yz),
        DVec4::new(xy + yx, yy - xx - zz, yz + zy, xz - zx),
        DVec4::new(xz + zx, yz + zy, zz - xx - yy, yx - xy),
        DVec4::new(zy - yz, xz - zx, yx - xy, xx + yy + zz),
    );
    let size = |m: &DMat4| m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
    let shift = size(&horn);
    if shift.is_nan() || shift <= 0.0 {
        return DQuat::IDENTITY;
    }
    let mut power = horn * (1.0 / shift) + DMat4::IDENTITY;
    for _ in 0..SQUARINGS {
        power = power * power;
        power *= 1.0 / size(&power);
    }
    let longest = [power.x_axis, power.y_axis, power.z_axis, power.w_axis].into_iter().max_by(|a, b| a.length().total_cmp(&b.length()));
    let q = longest.unwrap_or(DVec4::W);
    DQuat::from_xyzw(q.x, q.y, q.z, q.w).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The rotation of turned points is found, of points in a plane and of mirrored ones' held face as well.
        #[test]
        fn a_rotation_is_found(axis in [-1.0..1.0, -1.0..1.0, 0.1..1.0], angle in -3.0..3.0, flat in any::<bool>()) {
            let q = DQuat::from_axis_angle(DVec3::from_array(axis).normalize(), angle);
            let points: Vec<_> = (0..20)
                .map(|i| {
                    let s = f64::from(i);
                    let p = DVec3::new((s * 0.7).sin(), (s * 1.3).cos(), if flat { 0.0 } else { (s * 2.1).sin() });
                    (1.0 + s, p, q * p + DVec3::ONE)
                })
                .collect();
            let found = turn(covariance(&points));
            prop_assert!(found.dot(q).abs() > 1.0 - 1e-9, "{found} of {q}");
        }
    }
}
