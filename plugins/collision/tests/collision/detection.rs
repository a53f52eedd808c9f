//! Hashing finds what looking at every pair finds, whatever the meshes, the scale, the cells and the number of threads.

use crate::meshes::{Thing, block, brute_force, divided};
use bevy_math::Vec3;
use keyhole_collision::{Body, Detector, Grading, Hit, Shape, mean_edge_m};
use keyhole_tetmesh::{DVec3, MaterialId, TetMesh};
use proptest::prelude::*;

/// Bodies of random tetrahedra between random nodes: overlapping, inverted, flat, all at one scale.
fn soups() -> impl Strategy<Value = Vec<(Vec<Vec3>, Vec<[u32; 4]>, bool)>> {
    let soup = (4u32..40).prop_flat_map(|nodes| {
        // Coordinates from a coarse raster make coincident nodes, flat tetrahedra and nodes on faces likely.
        let coordinate = prop_oneof![3 => (-40i32..40).prop_map(|c| c as f32 / 16.0), 2 => -2.5f32..2.5];
        let points = prop::collection::vec([coordinate.clone(), coordinate.clone(), coordinate].prop_map(Vec3::from_array), nodes as usize);
        let tet = prop::array::uniform4(0..nodes).prop_filter("four nodes", |t| (0..4).all(|i| !t[..i].contains(&t[i])));
        (points, prop::collection::vec(tet, 1..40), any::<bool>())
    });
    (prop::collection::vec(soup, 1..4), -6i32..=3).prop_map(|(mut soups, exponent)| {
        let scale = 10f32.powi(exponent);
        soups.iter_mut().flat_map(|s| &mut s.0).for_each(|x| *x *= scale);
        soups
    })
}

fn detect(bodies: &[Body], grading: Grading, threads: usize) -> Vec<Hit> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| Detector::default().detect(bodies, grading).to_vec())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn hashing_finds_what_brute_force_finds(soups in soups(), broken in prop::option::of((0usize..3, 0usize..40))) {
        let mut things: Vec<(Thing, bool)> = Vec::new();
        for (positions, tets, own) in soups {
            let mesh = TetMesh::new(positions.iter().map(|p| p.as_dvec3()).collect(), &tets, &[] as &[MaterialId]);
            things.push((Thing { shape: Shape::of(&mesh), mesh, positions }, own));
        }
        if let Some((thing, node)) = broken
            && let Some(position) = things.get_mut(thing).and_then(|t| t.0.positions.get_mut(node))
        {
            position.y = f32::NAN;
        }
        let bodies: Vec<Body> = things.iter().map(|(t, own)| t.body(*own)).collect();
        let tets: Vec<_> = things.iter().map(|(t, _)| t.mesh.iter().collect()).collect();
        let expected = brute_force(&bodies, &tets);
        let mean = mean_edge_m(&bodies).filter(|m| m.is_finite()).unwrap_or(1.0);
        for grading in [Grading::Hierarchical, Grading::Flat(mean), Grading::Flat(mean / 50.0)] {
            prop_assert_eq!(&detect(&bodies, grading, 1), &expected);
        }
        prop_assert_eq!(&detect(&bodies, Grading::Hierarchical, 3), &expected);
    }

    /// The shape after an edit is the shape of the edited mesh.
    #[test]
    fn a_shape_carried_over_a_delta_is_that_of_the_mesh(removed in prop::collection::btree_set(0u32..135, 1..60)) {
        let mut mesh = block([3, 3, 3], [1.0; 3]);
        let mut shape = Shape::of(&mesh);
        for (i, tet) in removed.iter().map(|t| keyhole_tetmesh::TetId(*t)).enumerate() {
            let (corners, attributes) = (mesh.corners(tet), mesh.tet(tet));
            mesh.remove_tet(tet);
            if i % 4 == 1 {
                // Four come in its place, and one of their corners is moved after that.
                let middle = corners.iter().map(|n| mesh.rest(*n)).sum::<DVec3>() / 4.0;
                let apex = mesh.add_node(middle, corners.iter().map(|n| (*n, 0.25)).collect());
                for k in 0..4 {
                    mesh.add_tet(std::array::from_fn(|c| if c == k { apex } else { corners[c] }), attributes);
                }
                mesh.move_node(corners[0], mesh.rest(corners[0]).lerp(middle, 0.1), [(corners[0], 0.9), (apex, 0.1)].into_iter().collect());
            } else if i % 3 == 0 {
                // The tetrahedron comes back with a corner of its own.
                let apex = mesh.split_node(corners[3]);
                mesh.add_tet([corners[0], corners[1], corners[2], apex], attributes);
            }
            if i % 5 == 4 {
                let delta = mesh.take_delta();
                shape.update(&mesh, &delta);
            }
        }
        let delta = mesh.take_delta();
        shape.update(&mesh, &delta);
        // Nodes that nothing holds any more go with the next cut.
        let lonely: Vec<_> = mesh.nodes().filter(|n| mesh.topology().around_node(*n).is_empty()).collect();
        lonely.into_iter().for_each(|n| mesh.remove_node(n));
        let delta = mesh.take_delta();
        shape.update(&mesh, &delta);
        prop_assert_eq!(shape, Shape::of(&mesh));
    }
}

#[test]
fn two_blocks_in_each_other_as_hashing_and_as_f64_see_them() {
    let planes = [(DVec3::splat(0.021), DVec3::new(1.0, 0.3, 0.1)), (DVec3::splat(0.0213), DVec3::new(1.0, 0.29, 0.1))];
    let turned = |p: Vec3| bevy_math::Quat::from_rotation_z(0.3) * p + Vec3::new(0.013, 0.011, 0.007);
    let things = [Thing::new(divided(&block([8; 3], [0.04; 3]), &planes), |p| p), Thing::new(block([7; 3], [0.04; 3]), turned)];
    let bodies = [things[0].body(true), things[1].body(true)];
    let hits = detect(&bodies, Grading::Hierarchical, 2);
    assert!(hits.len() > 300, "{} hits", hits.len());
    // Seen from outside, in double precision and by orientations alone: a node well inside one is found, one well outside is not.
    for (a, b) in [(0, 1), (1, 0)] {
        for (node, p) in things[a].positions.iter().enumerate() {
            for (tet, corners) in things[b].mesh.iter() {
                let x = corners.map(|n| things[b].positions[n.index()].as_dvec3());
                let p = p.as_dvec3();
                let volume = |[a, b, c, d]: [DVec3; 4]| (b - a).dot((c - a).cross(d - a));
                let least = (0..4)
                    .map(|i| volume(std::array::from_fn(|k| if k == i { p } else { x[k] })) / volume(x))
                    .min_by(f64::total_cmp)
                    .unwrap();
                let found = hits
                    .iter()
                    .any(|h| usize::from(h.node_body) == a && h.node.index() == node && h.tet == tet && usize::from(h.tet_body) == b);
                // What counts as well inside scales with the rounding of positions against the height of the tetrahedron.
                let area =
                    (0..4).map(|i| (x[(i + 1) % 4] - x[(i + 2) % 4]).cross(x[(i + 3) % 4] - x[(i + 2) % 4]).length()).fold(0.0, f64::max);
                let blur = 1e-6 * 0.06 * area / volume(x).abs();
                assert!(found || least < blur, "node {node} of {a} is in tet {} of {b}: {least:e}", tet.0);
                assert!(!found || least > -blur, "node {node} of {a} is not in tet {} of {b}: {least:e}", tet.0);
            }
        }
    }
    assert!(hits.iter().all(|h| h.node_body != h.tet_body), "a body that is not folded does not meet itself");
}
