//! The judge of meshes is judged: it accepts a sound body and its cut halves, and finds each fault that is planted.

mod common;

use common::oracle::Body;

/// A row of `n` unit cubes along x, six tetrahedra each (Kuhn 1960).
fn row(n: usize) -> Body {
    const KUHN: [[u32; 4]; 6] = [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]];
    let points = (0..=n).flat_map(|x| [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]].map(|[y, z]| [x as f64, y, z])).collect();
    let node = |cube: u32, corner: u32| 4 * (cube + (corner & 1)) + (corner >> 1);
    let tets = (0..n as u32).flat_map(|c| KUHN.map(|t| t.map(|v| node(c, v)))).collect();
    Body { points, tets, ..Body::default() }
}

/// The faults of a body, empty when it is sound.
fn faults(body: &Body) -> String {
    body.examine().err().map(|f| f.to_string()).unwrap_or_default()
}

#[test]
fn a_sound_body_has_its_facts() {
    let facts = row(3).examine().unwrap_or_else(|f| panic!("{f}"));
    assert!((facts.volume - 3.0).abs() < 1e-12 && (facts.outer_area - 14.0).abs() < 1e-12, "{facts}");
    assert_eq!((facts.fragments.len(), facts.opened_area, facts.pinched), (1, 0.0, 0));
}

#[test]
fn two_halves_that_lie_against_each_other_are_a_cut() {
    let mut body = row(2);
    let seam: Vec<u32> = (4..8).collect();
    for n in &seam {
        body.points.push(body.points[*n as usize]);
    }
    for tet in &mut body.tets[6..] {
        *tet = tet.map(|n| if seam.contains(&n) { n + 8 } else { n });
    }
    let facts = body.examine().unwrap_or_else(|f| panic!("{f}"));
    assert_eq!((facts.fragments.len(), facts.pinched), (2, 0));
    assert!((facts.opened_area - 1.0).abs() < 1e-12 && (facts.outer_area - 10.0).abs() < 1e-12, "{facts}");
    // Left together at one node, the halves are pinched there.
    for tet in &mut body.tets[6..] {
        *tet = tet.map(|n| if n == 12 { 4 } else { n });
    }
    assert_eq!(body.examine().unwrap_or_else(|f| panic!("{f}")).pinched, 1);
}

#[test]
fn a_hanging_node_is_found() {
    // The edge 0 - 7 of the first cube is split in one of its six tetrahedra only.
    let mut body = row(1);
    let [a, b] = [body.tets[0][0], body.tets[0][3]].map(|n| body.points[n as usize]);
    body.points.push([0, 1, 2].map(|k| 0.3 * a[k] + 0.7 * b[k]));
    let [p, q, r, s] = body.tets[0];
    body.tets[0] = [p, q, r, 8];
    body.tets.push([8, q, r, s]);
    assert!(faults(&body).contains("hanging node: node 8"), "{}", faults(&body));
}

#[test]
fn lips_that_do_not_match_are_found() {
    let mut body = row(2);
    let seam: Vec<u32> = (4..8).collect();
    for n in &seam {
        body.points.push(body.points[*n as usize]);
    }
    for tet in &mut body.tets[6..] {
        *tet = tet.map(|n| if seam.contains(&n) { n + 8 } else { n });
    }
    // One lip gets a node in the middle of a face that the other has not.
    let t = body.tets.iter().position(|t| t.iter().filter(|n| seam.contains(n)).count() == 3);
    let t = t.unwrap_or_else(|| panic!("a tetrahedron has a face in the seam"));
    let face: Vec<u32> = body.tets[t].into_iter().filter(|n| seam.contains(n)).collect();
    let middle = [0, 1, 2].map(|k| face.iter().map(|n| body.points[*n as usize][k]).sum::<f64>() / 3.0);
    let new = body.points.len() as u32;
    body.points.push(middle);
    let old = body.tets.swap_remove(t);
    body.tets.extend(face.iter().map(|f| old.map(|n| if n == *f { new } else { n })));
    assert!(faults(&body).contains("hanging node"), "{}", faults(&body));
}

#[test]
fn turned_doubled_and_flat_tetrahedra_are_found() {
    let mut body = row(2);
    body.tets[3].swap(0, 1);
    assert!(faults(&body).contains("not positive: tetrahedron 3"), "{}", faults(&body));
    assert!(faults(&body).contains("orientation"), "{}", faults(&body));
    let mut body = row(2);
    body.tets.push(body.tets[4]);
    assert!(faults(&body).contains("overfull face") || faults(&body).contains("orientation"), "{}", faults(&body));
    let mut body = row(2);
    let flat = body.tets[0];
    body.points[flat[3] as usize] = body.points[flat[2] as usize];
    assert!(faults(&body).contains("not positive"), "{}", faults(&body));
    let mut body = row(2);
    body.tets[0][0] = 99;
    assert!(faults(&body).contains("unknown node"), "{}", faults(&body));
}
