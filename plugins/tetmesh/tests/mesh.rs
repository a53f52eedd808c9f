//! The mesh: adjacency under editing, shape against closed forms, the boundary and the components of known bodies, each input error.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use keyhole_tetmesh::check::checked;
use keyhole_tetmesh::components::Components;
use keyhole_tetmesh::quality;
use keyhole_tetmesh::{Boundary, DVec3, MeshError, NodeId, Tet, TetId, TetMesh, Topology};
use proptest::prelude::*;

/// The six tetrahedra of a unit cube around its diagonal (Kuhn 1960), in corners numbered x + 2 y + 4 z.
const KUHN: [[usize; 4]; 6] = [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]];

/// A block of n x n x n cubes of edge `h` m, six tetrahedra each, its lowest corner at `origin`.
fn block(n: usize, h: f64, origin: DVec3) -> (Vec<DVec3>, Vec<[u32; 4]>) {
    let m = n + 1;
    let at = |i: usize, j: usize, k: usize| (i + m * (j + m * k)) as u32;
    let nodes = (0..m * m * m).map(|c| origin + h * DVec3::new((c % m) as f64, (c / m % m) as f64, (c / m / m) as f64)).collect();
    let mut tets = Vec::new();
    for c in 0..n * n * n {
        let (i, j, k) = (c % n, c / n % n, c / n / n);
        tets.extend(KUHN.map(|t| t.map(|v| at(i + (v & 1), j + (v >> 1 & 1), k + (v >> 2)))));
    }
    (nodes, tets)
}

fn cube(n: usize) -> TetMesh {
    let (nodes, tets) = block(n, 1.0 / n as f64, DVec3::ZERO);
    checked(&nodes, &tets, &[]).unwrap()
}

/// What can be asked of a topology, in an order that does not depend on its history.
fn answers(t: &Topology) -> Vec<(TetId, [NodeId; 4], [Option<TetId>; 4], Vec<Vec<TetId>>)> {
    t.iter()
        .map(|(id, c)| {
            let around = c.map(|n| {
                let mut a = t.around_node(n).to_vec();
                a.sort_unstable();
                a
            });
            (id, c, [0, 1, 2, 3].map(|f| t.neighbour(id, f)), around.to_vec())
        })
        .collect()
}

proptest! {
    /// Whatever is taken out and put back, in whatever order: the adjacency is the one built from nothing.
    #[test]
    fn editing_keeps_the_adjacency_of_a_rebuilt_mesh(picks in prop::collection::vec(0_usize..48, 1..120)) {
        let mut mesh = cube(2);
        let all: Vec<(TetId, [NodeId; 4])> = mesh.iter().collect();
        let mut held: Vec<Option<TetId>> = all.iter().map(|(t, _)| Some(*t)).collect();
        for (step, pick) in picks.into_iter().enumerate() {
            match held[pick].take() {
                Some(tet) => mesh.remove_tet(tet),
                None => held[pick] = Some(mesh.add_tet(all[pick].1, Tet::default())),
            }
            if step % 7 == 0 {
                let _ = mesh.take_delta();
            }
        }
        let mut rebuilt = Topology::default();
        for (t, c) in mesh.iter() {
            rebuilt.insert(t, c);
        }
        prop_assert_eq!(mesh.tet_count(), held.iter().flatten().count());
        prop_assert_eq!(answers(mesh.topology()), answers(&rebuilt));
    }

    /// The delta of any edits, applied to the set of tetrahedra before, gives the set after.
    #[test]
    fn the_delta_says_what_happened(picks in prop::collection::vec(0_usize..48, 1..60)) {
        let mut mesh = cube(2);
        let all: Vec<(TetId, [NodeId; 4])> = mesh.iter().collect();
        let mut held: Vec<Option<TetId>> = all.iter().map(|(t, _)| Some(*t)).collect();
        let mut set: std::collections::BTreeMap<TetId, [NodeId; 4]> = all.iter().copied().collect();
        for pick in picks {
            match held[pick].take() {
                Some(tet) => mesh.remove_tet(tet),
                None => held[pick] = Some(mesh.add_tet(all[pick].1, Tet::default())),
            }
        }
        let delta = mesh.take_delta();
        for t in &delta.removed {
            prop_assert!(set.remove(t).is_some(), "removed what was not there");
        }
        for a in &delta.added {
            prop_assert!(set.insert(a.tet, a.nodes).is_none(), "added into an occupied slot");
        }
        prop_assert!(set.into_iter().eq(mesh.iter()));
    }
}

#[test]
fn the_regular_tetrahedron_has_its_closed_forms() {
    let p = [[1.0, 1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, -1.0, -1.0], [-1.0, -1.0, 1.0]].map(DVec3::from_array);
    let edge = 8.0_f64.sqrt();
    assert!(quality::is_positive(p));
    assert!((quality::volume(p) - edge.powi(3) / (6.0 * 2.0_f64.sqrt())).abs() < 1e-14 * edge.powi(3));
    assert!((quality::edge_ratio(p) - 1.0).abs() < 1e-15);
    assert!((quality::min_altitude(p) - edge * (2.0_f64 / 3.0).sqrt()).abs() < 1e-14 * edge);
    for angle in quality::dihedral_angles(p) {
        assert!((angle - (1.0_f64 / 3.0).acos()).abs() < 1e-14, "{angle}");
    }
}

#[test]
fn the_corner_tetrahedron_has_its_closed_forms() {
    let p = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
    // Three right angles at the axes, the angle between (1, 1, 1) and an axis at the three others.
    let slant = (1.0 / 3.0_f64.sqrt()).acos();
    let expected = [1.0, 1.0, 1.0].map(|_: f64| std::f64::consts::FRAC_PI_2).into_iter().chain([slant; 3]);
    for (angle, expected) in quality::dihedral_angles(p).into_iter().zip(expected) {
        assert!((angle - expected).abs() < 1e-14, "{angle} {expected}");
    }
    assert!((quality::edge_ratio(p) - 0.5_f64.sqrt()).abs() < 1e-15);
    assert!((quality::volume(p) - 1.0 / 6.0).abs() < 1e-16);
    let mirrored = [p[0], p[2], p[1], p[3]];
    assert!(!quality::is_positive(mirrored) && !quality::is_positive([p[0], p[1], p[2], p[1]]));
}

#[test]
fn the_boundary_of_a_cube_is_a_sphere_of_area_six() {
    let mesh = cube(3);
    let boundary = Boundary::of(&mesh);
    assert_eq!(boundary.triangles.len(), 6 * 2 * 9);
    assert_eq!(boundary.euler_characteristic(), 2);
    assert!(boundary.is_closed_manifold());
    assert!((boundary.area(&mesh) - 6.0).abs() < 1e-12);
    assert!((mesh.total_volume() - 1.0).abs() < 1e-12);
    // Divergence theorem: the outward triangles enclose the volume of the tetrahedra.
    let enclosed: f64 = boundary.triangles.iter().map(|t| t.map(|n| mesh.rest(n))).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum();
    assert!((enclosed - 1.0).abs() < 1e-12, "{enclosed}");
}

#[test]
fn two_blocks_at_an_edge_are_closed_but_no_manifold() {
    let (mut nodes, mut tets) = block(1, 1.0, DVec3::ZERO);
    let (more, others) = block(1, 1.0, DVec3::new(1.0, 1.0, 0.0));
    // The second block shares the edge x = y = 1 with the first: its corners 0 and 4 are the first one's 3 and 7.
    tets.extend(others.iter().map(|t| {
        t.map(|n| {
            if n == 0 {
                3
            } else if n == 4 {
                7
            } else {
                n + 8
            }
        })
    }));
    nodes.extend(more);
    let mesh = checked(&nodes, &tets, &[]).unwrap();
    assert!(!Boundary::of(&mesh).is_closed_manifold());
    assert_eq!(Components::of(&mesh).len(), 2, "an edge does not connect");
}

#[test]
fn components_are_ordered_by_volume() {
    let (mut nodes, mut tets) = block(1, 1.0, DVec3::ZERO);
    let (more, others) = block(2, 1.0, DVec3::splat(5.0));
    tets.extend(others.iter().map(|t| t.map(|n| n + 8)));
    nodes.extend(more);
    let mesh = checked(&nodes, &tets, &[]).unwrap();
    let components = Components::of(&mesh);
    assert!((components.volumes[0] - 8.0).abs() < 1e-12 && (components.volumes[1] - 1.0).abs() < 1e-12 && components.len() == 2);
    assert!(mesh.iter().all(|(t, _)| components.component(t) == u32::from(t.0 < 6)));
}

#[test]
fn the_hull_is_what_touches_the_surface() {
    let mesh = cube(4);
    let inside = |n: NodeId| mesh.rest(n).to_array().iter().all(|x| *x > 0.0 && *x < 1.0);
    for (t, c) in mesh.iter() {
        assert_eq!(mesh.tet(t).hull, !c.into_iter().all(inside));
    }
}

#[test]
fn every_input_error_names_its_place() {
    let (nodes, tets) = block(1, 1.0, DVec3::ZERO);
    let with = |change: &dyn Fn(&mut Vec<DVec3>, &mut Vec<[u32; 4]>)| {
        let (mut n, mut t) = (nodes.clone(), tets.clone());
        change(&mut n, &mut t);
        checked(&n, &t, &[]).unwrap_err()
    };
    assert_eq!(with(&|_, t| t.clear()), MeshError::Empty);
    assert_eq!(with(&|_, t| t[2][3] = 8), MeshError::UnknownNode { tet: 2, node: 8, nodes: 8 });
    assert!(matches!(with(&|n, _| n[5].y = f64::INFINITY), MeshError::NotFinite { node: 5, .. }));
    assert_eq!(with(&|_, t| t[4].swap(0, 1)), MeshError::NotPositive { tet: 4, volume_mm3: -1e9 / 6.0 });
    assert_eq!(with(&|_, t| t[1] = [0, 1, 3, 1]), MeshError::NotPositive { tet: 1, volume_mm3: 0.0 });
    assert_eq!(with(&|_, t| t.push([7, 3, 1, 0])), MeshError::Duplicate { first: 0, second: 6 });
    let third = with(&|n, t| {
        n.push(DVec3::new(0.9, -1.0, 0.2));
        t.push([0, 1, 7, 8]);
    });
    assert_eq!(third, MeshError::NonManifoldFace { nodes: [0, 1, 7], count: 3 });
    assert!(third.to_string().contains("[0, 1, 7]"));
}

#[test]
fn nodes_that_nothing_uses_are_left_out() {
    let (mut nodes, tets) = block(1, 1.0, DVec3::ZERO);
    nodes.insert(0, DVec3::splat(9.0));
    let mesh = checked(&nodes, &tets.iter().map(|t| t.map(|n| n + 1)).collect::<Vec<_>>(), &[]).unwrap();
    assert_eq!(mesh.node_count(), 8);
    assert!((mesh.total_volume() - 1.0).abs() < 1e-15);
}
