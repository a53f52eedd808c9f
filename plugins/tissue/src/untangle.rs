//! Takes a few tangled places of a body out of their tangle where they are, before a tick.
//!
//! Where a tool crushes tissue, or a node was thrown out of it, some dozens of elements are inside out and all others are well. To send the whole body to its rest shape for that
//! ([`crate::rescue`]) takes it away from what it touches, and what it comes to lie in inverts it again. So the nodes of inverted elements are put where the quadratic
//! energy of the rescue, summed over the elements around them, is least while all other nodes stay, and go as the nodes around them do on the mean. The rotation
//! is that of the nodes around a place. Where elements are still inverted the places are made larger by what is next to them. The step after it is one like any other, with all contacts.

use crate::body::Body;
use crate::element::Element;
use crate::hold::Hold;
use crate::rescue::{System, spread};
use crate::rescue::{covariance, inverted, is_tangled, turn};
use bevy_math::{DMat3, DVec3, Mat3, Vec3};
use keyhole_whiteboard::TissueState;

/// A body more than one in so many of whose nodes would have to be moved is tangled as a whole.
const PLACES: usize = 4;

/// How often the places are made larger.
const GROWTHS: u32 = 4;

/// Weight of the nodes of a place against those around it when its rotation is sought: it counts where these leave it open.
const WITHIN: f64 = 1e-3;

/// Takes the inverted elements of a body out of their tangle, if they are few. Whether it is not tangled any more; if it still is nothing has changed.
pub(crate) fn step(body: &Body, state: &mut TissueState, holds: &[Hold]) -> bool {
    let crumbs = &body.implicit.newton.crumbs;
    let mut may_move: Vec<bool> = body.masses().iter().enumerate().map(|(i, m)| *m > 0.0 && !crumbs.contains(i)).collect();
    for node in holds.iter().filter_map(Hold::fixes) {
        may_move[node] = false;
    }
    let nodes = may_move.iter().filter(|may| **may).count();
    let before = state.clone();
    let mut loose = vec![false; may_move.len()];
    for _ in 0..GROWTHS {
        // The first time the nodes of inverted elements, then those of the elements around what is still inverted.
        let mut core = vec![false; loose.len()];
        for i in body.elements().iter().filter(|e| inverted(e, state)).flat_map(Element::indices) {
            core[i] = true;
        }
        let grown: Vec<usize> = match loose.iter().any(|l| *l) {
            false => (0..core.len()).filter(|i| core[*i]).collect(),
            true => around(body, &core).flat_map(Element::indices).collect(),
        };
        if grown.is_empty() {
            break;
        }
        for i in grown {
            loose[i] = may_move[i];
        }
        if loose.iter().filter(|l| **l).count() * PLACES > nodes {
            break;
        }
        settle(body, state, &before, &loose);
    }
    let out = !is_tangled(body, state);
    if !out {
        *state = before;
    }
    out
}

/// The elements with a corner among nodes.
fn around<'a>(body: &'a Body, among: &'a [bool]) -> impl Iterator<Item = &'a Element> {
    body.elements().iter().filter(|e| !e.is_empty() && e.indices().iter().any(|i| among[*i]))
}

/// Puts the nodes that are loose where those around them want them; velocities are those before.
fn settle(body: &Body, state: &mut TissueState, before: &TissueState, loose: &[bool]) {
    let elements: Vec<&Element> = around(body, loose).collect();
    let place_of = places(&elements, loose);
    // What is around each place, and then what is in it: mass, place at rest and place.
    let count = place_of.iter().copied().max().map_or(0, |most| most as usize + 1);
    let mut rims: Vec<Vec<usize>> = vec![Vec::new(); count];
    let mut insides: Vec<Vec<usize>> = vec![Vec::new(); count];
    let of: Vec<usize> =
        elements.iter().map(|e| e.indices().iter().filter(|i| loose[**i]).map(|i| place_of[*i] as usize).next().unwrap_or(0)).collect();
    for (e, place) in elements.iter().zip(&of) {
        for i in e.indices() {
            if loose[i] { &mut insides[*place] } else { &mut rims[*place] }.push(i);
        }
    }
    let mut turns = Vec::with_capacity(count);
    for (rim, inside) in rims.iter_mut().zip(&mut insides) {
        for list in [&mut *rim, &mut *inside] {
            list.sort_unstable();
            list.dedup();
        }
        turns.push(rotation(body, state, rim, inside));
        let (mass, momentum) = rim.iter().fold((0.0, DVec3::ZERO), |(mass, sum), i| {
            let m = f64::from(body.masses()[*i]);
            (mass + m, sum + before.velocities[*i].as_dvec3() * m)
        });
        if mass > 0.0 {
            inside.iter().for_each(|i| state.velocities[*i] = (momentum / mass).as_vec3());
        }
    }
    let system = System::around(elements, loose.to_vec());
    let mut residual = vec![Vec3::ZERO; loose.len()];
    for (e, place) in system.elements.iter().zip(&of) {
        let at = e.indices();
        let strain = turns[*place] - e.deformation(at.map(|i| state.positions[i]));
        spread(&mut residual, at, strain * e.inverse_rest.transpose() * (e.volume * e.material.mu));
    }
    for (x, d) in state.positions.iter_mut().zip(system.solve(residual)) {
        *x += d;
    }
}

/// The number of the place that each loose node is in: nodes of one element are in one place.
fn places(elements: &[&Element], loose: &[bool]) -> Vec<u32> {
    let mut parent: Vec<u32> = (0..loose.len() as u32).collect();
    fn root(parent: &mut [u32], mut i: u32) -> u32 {
        while parent[i as usize] != i {
            parent[i as usize] = parent[parent[i as usize] as usize];
            i = parent[i as usize];
        }
        i
    }
    for e in elements {
        let mut corners = e.indices().into_iter().filter(|i| loose[*i]);
        let Some(first) = corners.next() else { continue };
        for other in corners {
            let (a, b) = (root(&mut parent, first as u32), root(&mut parent, other as u32));
            parent[a.max(b) as usize] = a.min(b);
        }
    }
    let mut number = vec![0; loose.len()];
    let mut count = 0;
    for i in (0..loose.len()).filter(|i| loose[*i]) {
        let root = root(&mut parent, i as u32) as usize;
        if root == i {
            number[i] = count;
            count += 1;
        } else {
            number[i] = number[root];
        }
    }
    number
}

/// The rotation of what is around a place, and where that leaves it open of the place.
fn rotation(body: &Body, state: &TissueState, rim: &[usize], inside: &[usize]) -> Mat3 {
    let points = |nodes: &[usize]| -> Vec<(f64, DVec3, DVec3)> {
        nodes.iter().map(|i| (f64::from(body.masses()[*i]), body.rest()[*i].as_dvec3(), state.positions[*i].as_dvec3())).collect()
    };
    let scaled = |m: DMat3| {
        let size = m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
        if size > 0.0 { m * size.recip() } else { m }
    };
    let sum = scaled(covariance(&points(rim))) + scaled(covariance(&points(inside))) * WITHIN;
    DMat3::from_quat(turn(sum)).as_mat3()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use crate::beam::{beam_material, block};
    use bevy_math::Quat;
    use proptest::prelude::*;
    use proptest::sample::subsequence;

    const EDGE_M: f32 = 0.01;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        /// Nodes thrown out of a block that has been turned and stretched are put back where they were, those at its surface about there, and as fast as their neighbours; no other
        /// node moves, and what is fixed stays.
        #[test]
        fn nodes_that_were_thrown_out_are_put_back(
            axis in [-1.0..1.0_f32, -1.0..1.0_f32, 0.1..1.0_f32],
            angle in -3.0..3.0_f32,
            stretch in 0.8..1.2_f32,
            out in subsequence((0..343_usize).collect::<Vec<_>>(), 1..4),
            ways in proptest::collection::vec([-5.0..5.0_f32, -5.0..5.0_f32, 1.0..5.0_f32], 3),
        ) {
            let mesh = block([6, 6, 6], [0.06; 3]);
            let body = Body::new(&mesh, &beam_material()).unwrap();
            let mut state = TissueState::at_rest(&mesh);
            let turn = Quat::from_axis_angle(Vec3::from_array(axis).normalize(), angle);
            for (x, v) in state.positions.iter_mut().zip(&mut state.velocities) {
                *x = turn * (*x * Vec3::new(stretch, 1.0, 1.0));
                *v = Vec3::new(1.0, 2.0, 3.0);
            }
            let whole = state.clone();
            let holds: Vec<Hold> = mesh
                .nodes()
                .filter(|n| mesh.rest(*n).x < 1e-6)
                .map(|n| Hold { point: smallvec::smallvec![(n, 1.0)], from: whole.positions[n.index()], to: whole.positions[n.index()], compliance_m_n: 0.0 })
                .collect();
            let held = |i: usize| holds.iter().any(|h| h.fixes() == Some(i));
            for (i, way) in out.iter().zip(&ways).filter(|(i, _)| !held(**i)) {
                state.positions[*i] += EDGE_M * Vec3::from_array(*way);
                state.velocities[*i] = 100.0 * Vec3::from_array(*way);
            }
            let touched: Vec<bool> = {
                let mut core = vec![false; state.positions.len()];
                body.elements().iter().filter(|e| inverted(e, &state)).flat_map(Element::indices).for_each(|i| core[i] = true);
                core
            };
            // A corner may be thrown out and nothing be inverted: it is left where it is.
            prop_assume!(out.iter().all(|i| touched[*i] || held(*i)));
            let before = body.elements().iter().filter(|e| inverted(e, &state)).count();
            prop_assert!(step(&body, &mut state, &holds));
            prop_assert_eq!(body.elements().iter().filter(|e| inverted(e, &state)).count(), 0, "of {}", before);
            for i in 0..state.positions.len() {
                if held(i) {
                    prop_assert_eq!(state.positions[i], whole.positions[i]);
                } else if touched[i] {
                    let off = state.positions[i].distance(whole.positions[i]);
                    prop_assert!(off < 0.5 * EDGE_M, "node {} is {} m off", i, off);
                    prop_assert!(state.velocities[i].distance(Vec3::new(1.0, 2.0, 3.0)) < 1e-3);
                }
            }
        }
    }

    /// What is tangled as a whole is left as it is, for others to rescue.
    #[test]
    fn what_is_tangled_as_a_whole_is_left() {
        let mesh = block([6, 6, 6], [0.06; 3]);
        let body = Body::new(&mesh, &beam_material()).unwrap();
        let mut state = TissueState::at_rest(&mesh);
        state.positions.iter_mut().for_each(|x| x.x = -x.x);
        let before = state.clone();
        assert!(!step(&body, &mut state, &[]));
        assert_eq!(state, before);
    }
}
