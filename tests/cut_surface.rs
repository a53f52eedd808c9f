//! A cut through the kidney by an unsteady hand, as the eye sees it: smoother than the mesh, joined to the skin without a gap.
#![expect(clippy::unwrap_used, reason = "a test panics where it fails")]

use bevy::math::DVec3;
use bevy::prelude::*;
use keyhole_cutting::{BladeId, Cutter};
use keyhole_tetmesh::{NodeId, TetMesh};
use keyhole_view::fairing::{Fairing, FairingSettings};
use keyhole_view::outer::OuterPlanes;
use keyhole_view::sheet::{Sheet, Side, Surface};
use std::collections::BTreeMap;
use std::path::Path;

/// A blade along y sweeps along x through all of the organ; each end wanders from the middle as a hand shakes.
fn cut_unsteadily(mesh: &mut TetMesh) {
    let mut cutter = Cutter::new(mesh);
    let edge = cutter.mean_edge_m();
    let corners = mesh.nodes().map(|n| mesh.rest(n)).fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
    let (low, size) = (corners.0, corners.1 - corners.0);
    let (points, steps) = ((1.2 * size.y / (0.35 * edge)) as usize, (1.2 * size.x / (0.15 * edge)) as usize);
    let shake = |s: f64, phase: f64| 0.1 * edge * ((31.0 * s + phase).sin() + (57.0 * s + 2.0 * phase).sin());
    for step in 0..=steps {
        let s = step as f64 / steps as f64;
        let end = |y: f64, phase: f64| low + size * DVec3::new(1.2 * s - 0.1, y, 0.5) + DVec3::Z * shake(s, phase);
        let (tip, heel) = (end(-0.1, 0.4), end(1.1, 1.7));
        let line: Vec<DVec3> = (0..=points).map(|i| tip.lerp(heel, i as f64 / points as f64)).collect();
        cutter.advance(mesh, BladeId(0), &line);
    }
    cutter.end_stroke(mesh);
}

/// Root mean square of the angles between neighbouring faces, degrees.
fn roughness(sheet: &Sheet, positions: &[Vec3]) -> f32 {
    let mut normals: BTreeMap<[usize; 2], Vec<Vec3>> = BTreeMap::new();
    for face in sheet.indices().chunks_exact(3) {
        let [a, b, c] = [0, 1, 2].map(|k| sheet.vertices()[face[k] as usize].node.index());
        let normal = (positions[b] - positions[a]).cross(positions[c] - positions[a]).normalize_or_zero();
        for (p, q) in [(a, b), (b, c), (c, a)] {
            normals.entry([p.min(q), p.max(q)]).or_default().push(normal);
        }
    }
    let cosines = normals.values().filter(|n| n.len() == 2).map(|n| n[0].dot(n[1]).clamp(-1.0, 1.0));
    let squares: Vec<f32> = cosines.map(|c| c.acos().to_degrees().powi(2)).collect();
    (squares.iter().sum::<f32>() / squares.len() as f32).sqrt()
}

#[test]
fn the_opened_kidney_is_shown_smoother_than_its_mesh_and_joined_to_its_skin() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/kidney.vtu");
    let mut mesh = keyhole_tetmesh::vtu::read(&file).unwrap();
    let planes = OuterPlanes::of(&mesh);
    let mut surface = Surface::of(&mesh, &planes);
    cut_unsteadily(&mut mesh);
    let delta = mesh.take_delta();
    surface.apply(&mesh, &planes, &delta);
    let (inside, skin) = (surface.sheet(Side::Inside), surface.sheet(Side::Skin));
    let positions: Vec<Vec3> = mesh.rest_positions().iter().map(|p| p.as_vec3()).collect();
    let (settings, mut shown) = (FairingSettings::default(), Vec::new());
    Fairing::of(inside, skin).show(&positions, &settings, &mut shown);
    let (before, after) = (roughness(inside, &positions), roughness(inside, &shown));
    println!("{} faces inside: {before:.1} degrees from face to face, shown with {after:.1}", inside.indices().len() / 3);
    assert!(inside.indices().len() > 3 * 500);
    assert!(after < 0.6 * before, "{before} to {after} degrees");
    // The mean of the edges around a node is no longer than the longest of them.
    let mut longest: BTreeMap<usize, f32> = BTreeMap::new();
    for face in inside.indices().chunks_exact(3) {
        let nodes = [0, 1, 2].map(|k| inside.vertices()[face[k] as usize].node.index());
        for (a, b) in [(0, 1), (1, 2), (2, 0)].map(|(i, j)| (nodes[i], nodes[j])) {
            let length = positions[a].distance(positions[b]);
            for node in [a, b] {
                let so_far = longest.entry(node).or_insert(0.0);
                *so_far = so_far.max(length);
            }
        }
    }
    let (mut rim, mut moved) = (0, 0);
    for (node, edge) in longest {
        let off = shown[node].distance(positions[node]);
        assert!(off <= 1.001 * settings.reach * edge, "node {node} is shown {off} m off its place");
        if skin.has_node(NodeId(node as u32)) {
            rim += 1;
            assert_eq!(shown[node], positions[node], "the rim");
        } else {
            moved += usize::from(off > 0.0);
        }
    }
    assert!(rim > 50 && moved > 200, "{rim} nodes on the rim, {moved} moved");
}
