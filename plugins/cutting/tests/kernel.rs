//! The kernel alone: every mask of edges and set of faces, in any order of edges; counts of the known states; templates checked elsewhere.

use keyhole_cutting::kernel::{Child, Vertex, subdivide};
use keyhole_tetmesh::quality::{is_positive, volume};
use keyhole_tetmesh::{DVec3, EDGES, EdgeKey, FACES, FaceKey, NodeId};
use proptest::prelude::*;

const CORNERS: [NodeId; 4] = [NodeId(0), NodeId(1), NodeId(2), NodeId(3)];

fn edge([i, j]: [usize; 2]) -> EdgeKey {
    EdgeKey::new(CORNERS[i], CORNERS[j])
}

fn face(f: usize) -> FaceKey {
    let [i, j, k] = FACES[f];
    FaceKey::new(CORNERS[i], CORNERS[j], CORNERS[k])
}

/// Points of a tetrahedron, of its crossings and of its face points.
#[derive(Debug)]
struct Shape {
    corners: [DVec3; 4],
    t: [f64; 6],
    w: [[f64; 3]; 4],
}

impl Shape {
    fn place(&self, v: Vertex) -> DVec3 {
        match v {
            Vertex::Corner(n) => self.corners[n.index()],
            Vertex::Edge(e) => {
                let i = EDGES.iter().position(|p| edge(*p) == e).unwrap_or(0);
                let [a, b] = e.nodes();
                self.corners[a.index()].lerp(self.corners[b.index()], self.t[i])
            }
            Vertex::Face(f) => {
                let i = (0..4).position(|i| face(i) == f).unwrap_or(0);
                let sum: f64 = self.w[i].iter().sum();
                f.nodes().iter().zip(self.w[i]).fold(DVec3::ZERO, |p, (n, w)| p + self.corners[n.index()] * (w / sum))
            }
        }
    }

    fn volume(&self, child: &Child) -> f64 {
        volume(child.map(|v| self.place(v)))
    }
}

fn shape() -> impl Strategy<Value = Shape> {
    let corner = prop::array::uniform3(-0.3..0.3_f64);
    (prop::array::uniform4(corner), prop::array::uniform6(0.05..0.95_f64), prop::array::uniform4(prop::array::uniform3(0.1..1.0_f64)))
        .prop_map(|(off, t, w)| {
            let regular = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
            Shape { corners: std::array::from_fn(|i| regular[i] + DVec3::from_array(off[i]) * 0.5), t, w }
        })
}

proptest! {
    #[test]
    fn children_are_positive_and_fill_the_tetrahedron(
        shape in shape(), mask in 0_usize..64, faces in 0_usize..16, order in Just((0..6).collect::<Vec<_>>()).prop_shuffle(),
        face_order in Just((0..4).collect::<Vec<_>>()).prop_shuffle(),
    ) {
        prop_assume!(is_positive(shape.corners));
        let edges: Vec<EdgeKey> = order.into_iter().filter(|e| mask >> e & 1 == 1).map(|e| edge(EDGES[e])).collect();
        let faces: Vec<FaceKey> = face_order.into_iter().filter(|f| faces >> f & 1 == 1).map(face).collect();
        let children = subdivide(CORNERS, &faces, &edges);
        prop_assert!(children.iter().all(|c| is_positive(c.map(|v| shape.place(v)))));
        let whole = volume(shape.corners);
        let sum: f64 = children.iter().map(|c| shape.volume(c)).sum();
        prop_assert!((sum - whole).abs() <= 1e-12 * whole);
    }

    /// What happens to a face depends on that face alone: the triangles on it are the same from both sides.
    #[test]
    fn neighbours_divide_their_common_face_alike(
        masks in prop::array::uniform2(0_usize..64), sets in prop::array::uniform2(0_usize..16), order in Just((0..9).collect::<Vec<_>>()).prop_shuffle(),
    ) {
        // Two tetrahedra share the face of nodes 1, 2, 3; the other has node 4 for node 0.
        let common: Vec<EdgeKey> = [[1, 2], [1, 3], [2, 3]].map(edge).to_vec();
        let rank = |e: &EdgeKey| {
            let [a, b] = e.nodes();
            let all = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3), (1, 4), (2, 4), (3, 4)];
            order[all.iter().position(|(p, q)| (a.0, b.0) == (*p, *q)).unwrap_or(0)]
        };
        let side = |apex: u32, mask: usize, set: usize| {
            let corners = [NodeId(apex), NodeId(1), NodeId(2), NodeId(3)];
            let mut edges: Vec<EdgeKey> = EDGES
                .iter()
                .enumerate()
                .filter(|(i, _)| if *i >= 3 { masks[0] >> i & 1 == 1 } else { mask >> i & 1 == 1 })
                .map(|(_, [i, j])| EdgeKey::new(corners[*i], corners[*j]))
                .collect();
            edges.sort_by_key(rank);
            let faces: Vec<FaceKey> = (0..4)
                .filter(|f| if *f == 0 { sets[0] & 1 == 1 } else { set >> f & 1 == 1 })
                .map(|f| FaceKey::new(corners[FACES[f][0]], corners[FACES[f][1]], corners[FACES[f][2]]))
                .collect();
            let on_common = |v: &Vertex| match v {
                Vertex::Corner(n) => n.0 != apex,
                Vertex::Edge(e) => common.contains(e),
                Vertex::Face(f) => *f == face(0),
            };
            let mut triangles: Vec<Vec<Vertex>> = subdivide(corners, &faces, &edges)
                .iter()
                .map(|c| c.iter().copied().filter(on_common).collect::<Vec<_>>())
                .filter(|t| t.len() == 3)
                .map(|mut t| { t.sort_unstable(); t })
                .collect();
            triangles.sort();
            triangles
        };
        prop_assert_eq!(side(0, masks[0], sets[0]), side(4, masks[1], sets[1]));
    }
}

/// Numbers of children of the states of one sheet, for the minimal and the symmetric pattern.
#[test]
fn known_states_have_their_known_numbers_of_children() {
    let count = |edges: &[[usize; 2]], open: &[usize], full: &[usize]| {
        let edges: Vec<EdgeKey> = edges.iter().map(|e| edge(*e)).collect();
        let faces: Vec<FaceKey> = open.iter().chain(full).map(|f| face(*f)).collect();
        subdivide(CORNERS, &faces, &edges).len()
    };
    // Node 0 is cut off: its edges are crossed. Face i is opposite to node i.
    assert_eq!(count(&[[0, 1]], &[2, 3], &[]), 6);
    assert_eq!(count(&[[0, 1], [0, 2]], &[1, 2], &[]), 8);
    assert_eq!(count(&[[0, 1], [0, 2]], &[1, 2], &[3]), 10);
    assert_eq!(count(&[[0, 1], [0, 2], [0, 3]], &[], &[]), 4);
    assert_eq!(count(&[[0, 1], [0, 2], [0, 3]], &[], &[1, 2, 3]), 11);
    // Nodes 0 and 1 are parted from 2 and 3.
    assert_eq!(count(&[[0, 2], [0, 3], [1, 2], [1, 3]], &[], &[]), 6);
    assert_eq!(count(&[[0, 2], [0, 3], [1, 2], [1, 3]], &[], &[0, 1, 2, 3]), 15);
    assert_eq!(count(&[[0, 2], [0, 3], [1, 2]], &[0, 2], &[]), 10);
    assert_eq!(count(&[[0, 2], [0, 3], [1, 2]], &[0, 2], &[1, 3]), 14);
    assert_eq!((count(&[[0, 1], [0, 2]], &[], &[]), count(&[[0, 1]], &[], &[]), count(&[], &[], &[])), (3, 2, 1));
}

/// Templates that were checked independently: a tetrahedron cut right through by one plane, by the order of its edges. The kernel splits
/// edges in that order; both fill the same halves, so their volumes on each side agree for any crossing parameters.
#[test]
fn agrees_with_templates_checked_elsewhere() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/reference/cut_templates.json");
    let Ok(text) = std::fs::read_to_string(&path) else {
        println!("no templates beside the project: nothing compared");
        return;
    };
    let templates: serde_json::Value = serde_json::from_str(&text).expect("the templates are JSON");
    let shape = Shape {
        corners: [DVec3::ZERO, DVec3::new(1.0, 0.1, 0.0), DVec3::new(0.2, 1.0, 0.1), DVec3::new(0.1, 0.3, 0.9)],
        t: [0.4, 0.55, 0.3, 0.6, 0.45, 0.7],
        w: [[1.0; 3]; 4],
    };
    let node = |c: char| NodeId(c as u32 - 'A' as u32);
    let vertex = |name: &str| {
        let mut c = name.chars().map(node);
        match (c.next(), c.next()) {
            (Some(a), Some(b)) => Vertex::Edge(EdgeKey::new(a, b)),
            (Some(a), None) => Vertex::Corner(a),
            _ => panic!("a template names a vertex `{name}`"),
        }
    };
    let mut compared = 0;
    for state in ["3,0", "4,0"] {
        for template in templates[state].as_array().into_iter().flatten() {
            let tets: Vec<Child> = template["tets"]
                .as_array()
                .expect("tets")
                .iter()
                .map(|t| std::array::from_fn(|i| vertex(t[i].as_str().expect("a name"))))
                .collect();
            let mut edges: Vec<EdgeKey> =
                tets.iter().flatten().filter_map(|v| if let Vertex::Edge(e) = v { Some(*e) } else { None }).collect();
            edges.sort_unstable();
            edges.dedup();
            let ours = subdivide(CORNERS, &[], &edges);
            assert_eq!(ours.len(), tets.len(), "{state}");
            // The side of a child: whether it holds a corner that no crossing parts from node A.
            let with_a = |c: &Child| {
                c.iter().any(|v| matches!(v, Vertex::Corner(n) if *n == NodeId(0) || !edges.contains(&EdgeKey::new(NodeId(0), *n))))
            };
            let side = |tets: &[Child]| tets.iter().filter(|c| with_a(c)).map(|c| shape.volume(c).abs()).sum::<f64>();
            let all = |tets: &[Child]| tets.iter().map(|c| shape.volume(c).abs()).sum::<f64>();
            assert!((all(&ours) - all(&tets)).abs() < 1e-12);
            if state == "3,0" {
                assert!((side(&ours) - side(&tets)).abs() < 1e-12, "{state} {}", template["id_order"]);
            }
            compared += 1;
        }
    }
    assert!(compared > 0, "no template was found in {}", path.display());
}
