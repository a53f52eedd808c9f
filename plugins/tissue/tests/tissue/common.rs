//! What several tests need.

use bevy_math::Vec3;
use keyhole_tetmesh::{NodeId, TetId, TetMesh};
use keyhole_tissue::{Body, Hold, TissueSettings};
use keyhole_whiteboard::TissueState;

/// Splits edges near one of their ends, at `t` of their length, one edge at every `every`-th node: the slivers that a cut leaves.
pub fn split_edges(mesh: &mut TetMesh, every: usize, t: f64) {
    let free: Vec<NodeId> = mesh.nodes().filter(|n| mesh.rest(*n).x > 0.0).collect();
    for near in free.into_iter().skip(every - 1).step_by(every) {
        let tet = mesh.topology().around_node(near)[0];
        let far = mesh.corners(tet).into_iter().find(|n| *n != near).unwrap();
        split_edge(mesh, near, far, t);
    }
}

/// Splits one edge at `t` of its length.
pub fn split_edge(mesh: &mut TetMesh, near: NodeId, far: NodeId, t: f64) {
    let point = mesh.rest(near) * (1.0 - t) + mesh.rest(far) * t;
    let around: Vec<TetId> = mesh.topology().around_edge(near, far).collect();
    let middle = mesh.add_node(point, [(near, 1.0 - t), (far, t)].into_iter().collect());
    for tet in around {
        let (corners, attributes) = (mesh.corners(tet), mesh.tet(tet));
        mesh.remove_tet(tet);
        mesh.add_tet(corners.map(|n| if n == near { middle } else { n }), attributes);
        mesh.add_tet(corners.map(|n| if n == far { middle } else { n }), attributes);
    }
}

/// Separates the tetrahedra whose centre has `x > cut` from the others: the nodes between them are split.
pub fn separate(mesh: &mut TetMesh, cut: f64) {
    let beyond = |mesh: &TetMesh, t: TetId| mesh.points(t).iter().map(|p| p.x).sum::<f64>() / 4.0 > cut;
    let tets: Vec<TetId> = mesh.iter().map(|(t, _)| t).collect();
    let (right, left): (Vec<TetId>, Vec<TetId>) = tets.into_iter().partition(|t| beyond(mesh, *t));
    let mut twins: std::collections::BTreeMap<NodeId, NodeId> = Default::default();
    let shared: std::collections::BTreeSet<NodeId> = left.iter().flat_map(|t| mesh.corners(*t)).collect();
    for tet in right {
        let (corners, attributes) = (mesh.corners(tet), mesh.tet(tet));
        if corners.iter().any(|n| shared.contains(n)) {
            mesh.remove_tet(tet);
            let own = corners.map(|n| if shared.contains(&n) { *twins.entry(n).or_insert_with(|| mesh.split_node(n)) } else { n });
            mesh.add_tet(own, attributes);
        }
    }
}

/// Cuts the section at `x` above the height `y`: its nodes get twins on the far side.
pub fn slit(mesh: &mut TetMesh, x: f64, y: f64) {
    let tets: Vec<TetId> = mesh.iter().map(|(t, _)| t).collect();
    let cut = |mesh: &TetMesh, n: NodeId| (mesh.rest(n).x - x).abs() < 1e-6 && mesh.rest(n).y > y;
    let mut twins: std::collections::BTreeMap<NodeId, NodeId> = Default::default();
    for tet in tets {
        let (corners, attributes) = (mesh.corners(tet), mesh.tet(tet));
        let beyond = mesh.points(tet).iter().map(|p| p.x).sum::<f64>() / 4.0 > x;
        if beyond && corners.iter().any(|n| cut(mesh, *n)) {
            mesh.remove_tet(tet);
            let own = corners.map(|n| if cut(mesh, n) { *twins.entry(n).or_insert_with(|| mesh.split_node(n)) } else { n });
            mesh.add_tet(own, attributes);
        }
    }
}

/// Numbers in [0, 1), the same every time.
pub fn random() -> impl FnMut() -> f32 {
    let mut s = 1_u32;
    move || {
        s = s.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (s >> 8) as f32 / (1 << 24) as f32
    }
}

/// Runs ticks of 1/60 s; the state must stay finite.
pub fn run(body: &mut Body, state: &mut TissueState, holds: &[Hold], gravity: Vec3, settings: &TissueSettings, ticks: u32) {
    for tick in 0..ticks {
        body.step(state, holds, gravity, 1.0 / 60.0, settings);
        assert!(state.positions.iter().all(|x| x.is_finite()), "not finite at tick {tick}");
    }
}
