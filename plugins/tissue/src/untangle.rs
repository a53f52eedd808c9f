//! Takes a few tangled places of a body out of their tangle where they are, before a tick.
//!
//! Where a tool crushes tissue, or a node was thrown out of it, some dozens of elements are inside out and all others are well. To send the whole body to its rest shape for that
//! ([`crate::rescue`]) takes it away from what it touches, and what it comes to lie in inverts it again; to leave it as it is makes every tick hard, for the energy is far from convex there.
//! So the nodes of inverted elements are put where the quadratic energy of the rescue, summed over the elements around them, is least while all other nodes stay, and go as the nodes
//! around them do on the mean. The rotation is that of the nodes around a place. Where elements are still inverted the places are made larger by what is next to them. What is kept is the
//! state with the fewest inverted elements; the step after it is one like any other, with all contacts.

use crate::body::Body;
use crate::element::Element;
use crate::hold::Hold;
use crate::rescue::{System, covariance, inverted, spread, turn};
use bevy_math::{DMat3, DVec3, Mat3, Vec3};
use keyhole_whiteboard::TissueState;

/// A body more than one in so many of whose nodes would have to be moved is tangled as a whole.
const PLACES: usize = 4;

/// How often the places are made larger.
const GROWTHS: u32 = 4;

/// Weight of the nodes of a place against those around it when its rotation is sought: it counts where these leave it open.
const WITHIN: f64 = 1e-3;

/// Takes inverted elements of a body out of their tangle, if they are few, as far as that helps.
pub(crate) fn step(body: &Body, state: &mut TissueState, holds: &[Hold]) {
    let crumbs = &body.implicit.newton.crumbs;
    let mut may_move: Vec<bool> = body.masses().iter().enumerate().map(|(i, m)| *m > 0.0 && !crumbs.contains(i)).collect();
    for node in holds.iter().filter_map(Hold::fixes) {
        may_move[node] = false;
    }
    let nodes = may_move.iter().filter(|may| **may).count();
    let before = state.clone();
    let mut best = before.clone();
    let mut left = usize::MAX;
    let mut loose = vec![false; may_move.len()];
    for growth in 0..=GROWTHS {
        let mut core = vec![false; loose.len()];
        let mut count = 0;
        for e in body.elements().iter().filter(|e| inverted(e, state)) {
            e.indices().iter().for_each(|i| core[*i] = true);
            count += 1;
        }
        if count < left {
            left = count;
            best.clone_from(state);
        }
        // The first time the nodes of inverted elements, then those of the elements around what is still inverted.
        if growth == 0 {
            (0..core.len()).filter(|i| core[*i]).for_each(|i| loose[i] = may_move[i]);
        } else {
            around(body, &core).flat_map(Element::indices).for_each(|i| loose[i] = may_move[i]);
        }
        if count == 0 || growth == GROWTHS || loose.iter().filter(|l| **l).count() * PLACES > nodes {
            break;
        }
        settle(body, state, &before, &loose);
    }
    *state = best;
}

/// The elements with a corner among nodes.
fn around<'a>(body: &'a Body, among: &'a [bool]) -> impl Iterator<Item = &'a Element> {
    body.elements().iter().filter(|e| !e.is_empty() && e.indices().iter().any(|i| among[*i]))
}

/// Puts the nodes that are loose where those around them want them; velocities are those before.
fn settle(body: &Body, state: &mut TissueState, before: &TissueState, loose: &[bool]) {
    // Only what is around: of a large body little is.
    let mut nodes: Vec<usize> = around(body, loose).flat_map(Element::indices).collect();
    nodes.sort_unstable();
    nodes.dedup();
    let here = |i: usize| nodes.partition_point(|n| *n < i) as u32;
    let elements: Vec<Element> = around(body, loose).map(|e| Element { nodes: e.indices().map(here), ..*e }).collect();
    let free: Vec<bool> = nodes.iter().map(|i| loose[*i]).collect();
    let mut positions: Vec<Vec3> = nodes.iter().map(|i| state.positions[*i]).collect();
    let places = Places::of(&elements, &free);
    let point = |i: usize| (f64::from(body.masses()[nodes[i]]), body.rest()[nodes[i]].as_dvec3(), positions[i].as_dvec3());
    let turns: Vec<Mat3> = places.rims.iter().zip(&places.insides).map(|(rim, inside)| rotation(rim, inside, &point)).collect();
    for (rim, inside) in places.rims.iter().zip(&places.insides) {
        let (mass, momentum) = rim.iter().fold((0.0, DVec3::ZERO), |(mass, sum), i| {
            let m = f64::from(body.masses()[nodes[*i]]);
            (mass + m, sum + before.velocities[nodes[*i]].as_dvec3() * m)
        });
        if mass > 0.0 {
            inside.iter().for_each(|i| state.velocities[nodes[*i]] = (momentum / mass).as_vec3());
        }
    }
    let mut residual = vec![Vec3::ZERO; nodes.len()];
    for (e, place) in elements.iter().zip(&places.of) {
        let at = e.indices();
        let strain = turns[*place] - e.deformation(at.map(|i| positions[i]));
        spread(&mut residual, at, strain * e.inverse_rest.transpose() * (e.volume * e.material.mu));
    }
    let solution = System::around(elements.iter().collect(), free).solve(residual);
    for (x, d) in positions.iter_mut().zip(solution) {
        *x += d;
    }
    for (i, x) in nodes.iter().zip(positions).filter(|(i, _)| loose[**i]) {
        state.positions[*i] = x;
    }
}

/// What hangs together of elements by nodes that are free.
struct Places {
    /// By element.
    of: Vec<usize>,
    /// The nodes around each place, which are not free, and those in it; ascending.
    rims: Vec<Vec<usize>>,
    insides: Vec<Vec<usize>>,
}

impl Places {
    /// Of elements each of which has a free node.
    fn of(elements: &[Element], free: &[bool]) -> Self {
        let mut parent: Vec<usize> = (0..free.len()).collect();
        let root = |parent: &mut Vec<usize>, mut i: usize| {
            while parent[i] != i {
                parent[i] = parent[parent[i]];
                i = parent[i];
            }
            i
        };
        let inside = |e: &Element| e.indices().into_iter().filter(|i| free[*i]);
        for e in elements {
            let roots: Vec<usize> = inside(e).map(|i| root(&mut parent, i)).collect();
            let least = roots.iter().copied().min().unwrap_or_default();
            roots.into_iter().for_each(|r| parent[r] = least);
        }
        let roots: Vec<usize> = elements.iter().map(|e| inside(e).next().map_or(0, |i| root(&mut parent, i))).collect();
        let mut names = roots.clone();
        names.sort_unstable();
        names.dedup();
        let of: Vec<usize> = roots.into_iter().map(|r| names.partition_point(|n| *n < r)).collect();
        let (mut rims, mut insides) = (vec![Vec::new(); names.len()], vec![Vec::new(); names.len()]);
        for (e, place) in elements.iter().zip(&of) {
            for i in e.indices() {
                if free[i] { &mut insides[*place] } else { &mut rims[*place] }.push(i);
            }
        }
        for list in rims.iter_mut().chain(&mut insides) {
            list.sort_unstable();
            list.dedup();
        }
        Self { of, rims, insides }
    }
}

/// The rotation of what is around a place, and where that leaves it open of the place. `point` tells mass, place at rest and place of a node.
fn rotation(rim: &[usize], inside: &[usize], point: &impl Fn(usize) -> (f64, DVec3, DVec3)) -> Mat3 {
    let scaled = |nodes: &[usize]| {
        let m = covariance(&nodes.iter().map(|i| point(*i)).collect::<Vec<_>>());
        let size = m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
        if size > 0.0 { m * size.recip() } else { m }
    };
    DMat3::from_quat(turn(scaled(rim) + scaled(inside) * WITHIN)).as_mat3()
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
        /// Nodes thrown out of a block that has been turned and stretched are put back about where they were and go as their neighbours do, and what is fixed stays.
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
            step(&body, &mut state, &holds);
            prop_assert_eq!(body.elements().iter().filter(|e| inverted(e, &state)).count(), 0, "of {}", before);
            for (i, (x, v)) in state.positions.iter().zip(&state.velocities).enumerate() {
                if held(i) {
                    prop_assert_eq!(*x, whole.positions[i]);
                } else if touched[i] {
                    let off = x.distance(whole.positions[i]);
                    prop_assert!(off < 0.5 * EDGE_M, "node {} is {} m off", i, off);
                    prop_assert!(v.distance(Vec3::new(1.0, 2.0, 3.0)) < 1e-3);
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
        step(&body, &mut state, &[]);
        assert_eq!(state, before);
    }
}
