//! A limit of stretch (Provot 1995, "Deformation constraints in a mass-spring model to describe rigid cloth behavior") for what a tick with contacts leaves.
//!
//! Where much touches at once, a stage ends before everything is balanced. What is left of it may be nothing to an organ and throw a node of some micrograms out of
//! it, further than its elements would ever let it go. So edges that are longer than tissue bears are shortened, both ends by the inverse of their masses, and the
//! ends no longer part. Linear momentum is kept, and energy only falls. What is in shape is not touched.

use crate::body::Body;
use crate::element::Element;
use bevy_math::{Mat3, Vec3};
use keyhole_tetmesh::EDGES;
use keyhole_whiteboard::TissueState;

/// How many times as long as at rest an edge may be. Parenchyma and capsule tear below twice, but where a thread or the tip of a tool draws at single elements they are
/// longer, and rightly so.
const MOST: f32 = 8.0;

/// Sum of the squares of the stretches from which on an element is looked at edge by edge: no edge of one below is longer than [`MOST`].
const SUSPECT: f32 = MOST * MOST;

/// Passes over what is too long. Elements around one that is corrected may be too long after it.
const PASSES: u32 = 8;

/// Shortens what is too long of a body; the nodes that are not `free` stay. Returns the number of edges that were.
pub(crate) fn limit_strain(body: &Body, state: &mut TissueState, free: &[bool]) -> usize {
    let mut corrected = 0;
    for _ in 0..PASSES {
        let mut found = 0;
        for e in body.elements.iter().filter(|e| !e.is_empty()) {
            let f = e.deformation(e.indices().map(|i| state.positions[i]));
            if f.x_axis.length_squared() + f.y_axis.length_squared() + f.z_axis.length_squared() > SUSPECT {
                found += shorten(e, body, state, free);
            }
        }
        corrected += found;
        if found == 0 {
            break;
        }
    }
    corrected
}

fn shorten(e: &Element, body: &Body, state: &mut TissueState, free: &[bool]) -> usize {
    let rest = e.inverse_rest.inverse();
    let corner = |k: usize, m: &Mat3| if k == 0 { Vec3::ZERO } else { m.col(k - 1) };
    let yields = |n: usize| if free[n] && body.masses[n] > 0.0 { body.masses[n].recip() } else { 0.0 };
    let mut found = 0;
    for [i, j] in EDGES {
        let most = MOST * corner(i, &rest).distance(corner(j, &rest));
        let (a, b) = (e.indices()[i], e.indices()[j]);
        let along = state.positions[b] - state.positions[a];
        let (length, both) = (along.length(), yields(a) + yields(b));
        if length.is_nan() || length <= most || both <= 0.0 {
            continue;
        }
        let direction = along / length;
        let (way, parting) = ((length - most) / both, (state.velocities[b] - state.velocities[a]).dot(direction).max(0.0) / both);
        for (n, sign) in [(a, 1.0), (b, -1.0)] {
            state.positions[n] += direction * (sign * way * yields(n));
            state.velocities[n] += direction * (sign * parting * yields(n));
        }
        found += 1;
    }
    found
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use crate::beam::{beam_material, block};
    use bevy_math::DVec3;

    /// A corner that was thrown out comes back to where tissue lets it be, with the momentum of the whole; a body in shape keeps every bit.
    #[test]
    fn what_was_thrown_out_comes_back() {
        let mesh = block([6, 3, 3], [0.06, 0.03, 0.03]);
        let body = Body::new(&mesh, &beam_material()).unwrap();
        let rest = TissueState::at_rest(&mesh);
        let free = vec![true; rest.positions.len()];
        let mut state = rest.clone();
        state.velocities.iter_mut().enumerate().for_each(|(i, v)| *v = Vec3::new(0.01 * i as f32, 0.0, 0.02));
        let before = state.clone();
        assert_eq!(limit_strain(&body, &mut state, &free), 0);
        assert!(state.positions == before.positions && state.velocities == before.velocities);

        let thrown = (0..free.len()).max_by(|a, b| rest.positions[*a].length().total_cmp(&rest.positions[*b].length())).unwrap();
        state.positions[thrown] += Vec3::new(0.3, 0.2, 0.0);
        state.velocities[thrown] = Vec3::new(6.0, 4.0, 0.0);
        let momentum = |s: &TissueState| s.velocities.iter().zip(&body.masses).map(|(v, m)| v.as_dvec3() * f64::from(*m)).sum::<DVec3>();
        let middle = |s: &TissueState| s.positions.iter().zip(&body.masses).map(|(x, m)| x.as_dvec3() * f64::from(*m)).sum::<DVec3>();
        let (p, c, energy) = (momentum(&state), middle(&state), body.elastic_energy(&state) + body.kinetic_energy(&state));
        assert!(limit_strain(&body, &mut state, &free) > 0);
        assert!(momentum(&state).distance(p) < 1e-5 * p.length() && middle(&state).distance(c) < 1e-5 * c.length());
        assert!(body.elastic_energy(&state) + body.kinetic_energy(&state) < energy);
        for e in body.elements.iter().filter(|e| !e.is_empty()) {
            let rest_edges = e.inverse_rest.inverse();
            for (k, n) in e.indices().into_iter().enumerate().skip(1) {
                let longest = MOST * rest_edges.col(k - 1).length();
                assert!(state.positions[n].distance(state.positions[e.indices()[0]]) < 1.05 * longest);
            }
        }
    }
}
