//! Meshes that tests and benches share.

use bevy_math::Vec3;
use keyhole_collision::{Body, Hit, Shape, Weights};
use keyhole_tetmesh::{DVec3, MaterialId, NodeId, TetMesh};
use std::collections::BTreeMap;

/// A box of `cells` cubes, five tetrahedra each, with the given size in metres, one corner at the origin.
pub fn block(cells: [u32; 3], size: [f64; 3]) -> TetMesh {
    let [nx, ny, nz] = cells;
    let id = |i: u32, j: u32, k: u32| (i * (ny + 1) + j) * (nz + 1) + k;
    let mut nodes = Vec::new();
    for i in 0..=nx {
        for j in 0..=ny {
            for k in 0..=nz {
                let at = |n: u32, of: u32, length: f64| length * f64::from(n) / f64::from(of);
                nodes.push(DVec3::new(at(i, nx, size[0]), at(j, ny, size[1]), at(k, nz, size[2])));
            }
        }
    }
    let mut tets = Vec::new();
    for i in 0..nx {
        for j in 0..ny {
            for k in 0..nz {
                let odd = (i + j + k) % 2 == 1;
                let c = |x: u32, y: u32, z: u32| id(i + if odd { 1 - x } else { x }, j + y, k + z);
                tets.extend([
                    [c(1, 0, 0), c(0, 1, 0), c(0, 0, 1), c(1, 1, 1)],
                    [c(0, 0, 0), c(1, 0, 0), c(0, 1, 0), c(0, 0, 1)],
                    [c(1, 1, 0), c(1, 0, 0), c(1, 1, 1), c(0, 1, 0)],
                    [c(1, 0, 1), c(1, 0, 0), c(0, 0, 1), c(1, 1, 1)],
                    [c(0, 1, 1), c(0, 1, 0), c(1, 1, 1), c(0, 0, 1)],
                ]);
            }
        }
    }
    positive(nodes, tets)
}

/// The mesh with every tetrahedron turned the positive way round.
fn positive(nodes: Vec<DVec3>, mut tets: Vec<[u32; 4]>) -> TetMesh {
    for t in &mut tets {
        let p = t.map(|n| nodes[n as usize]);
        if (p[1] - p[0]).dot((p[2] - p[0]).cross(p[3] - p[0])) < 0.0 {
            t.swap(2, 3);
        }
    }
    TetMesh::new(nodes, &tets, &[] as &[MaterialId])
}

/// The mesh as it is after a blade has gone through it along each of these planes (a point and a normal): every tetrahedron that a plane crosses is
/// divided along it, and edges become as short as the planes pass by the nodes. The two sides stay joined.
pub fn divided(mesh: &TetMesh, planes: &[(DVec3, DVec3)]) -> TetMesh {
    let mut nodes = mesh.rest_positions().to_vec();
    let mut tets: Vec<[u32; 4]> = mesh.iter().map(|(_, c)| c.map(|n| n.0)).collect();
    for (point, normal) in planes {
        let side: Vec<f64> = nodes.iter().map(|x| (*x - *point).dot(*normal)).collect();
        let mut cuts: BTreeMap<[u32; 2], u32> = BTreeMap::new();
        let mut divided = Vec::new();
        for tet in &tets {
            let (mut above, mut below): (Vec<u32>, Vec<u32>) = tet.iter().partition(|n| side[**n as usize] > 0.0);
            if above.is_empty() || below.is_empty() {
                divided.push(*tet);
                continue;
            }
            if above.len() > below.len() {
                std::mem::swap(&mut above, &mut below);
            }
            let mut cut = |a: u32, b: u32| {
                *cuts.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                    let (sa, sb) = (side[a as usize], side[b as usize]);
                    nodes.push(nodes[a as usize].lerp(nodes[b as usize], sa / (sa - sb)));
                    nodes.len() as u32 - 1
                })
            };
            if let [tip] = above[..] {
                let base = [below[0], below[1], below[2]];
                let middle = base.map(|b| cut(tip, b));
                divided.push([tip, middle[0], middle[1], middle[2]]);
                divided.extend(prism(middle, base));
            } else {
                let ([a, b], [c, d]) = ([above[0], above[1]], [below[0], below[1]]);
                let [ac, ad, bc, bd] = [cut(a, c), cut(a, d), cut(b, c), cut(b, d)];
                divided.extend(prism([a, ac, ad], [b, bc, bd]));
                divided.extend(prism([c, ac, bc], [d, ad, bd]));
            }
        }
        tets = divided;
    }
    positive(nodes, tets)
}

/// Three tetrahedra of a prism. The diagonal of each side leaves from its lowest node, so that neighbours agree.
fn prism(low: [u32; 3], high: [u32; 3]) -> [[u32; 4]; 3] {
    // Turned so that the lowest of all six is the first of the lower triangle.
    let first = (0..3).min_by_key(|i| low[*i].min(high[*i])).unwrap_or(0);
    let (low, high) = if low[first] < high[first] { (low, high) } else { (high, low) };
    let turn = |t: [u32; 3]| [t[first], t[(first + 1) % 3], t[(first + 2) % 3]];
    let ([a, b, c], [d, e, f]) = (turn(low), turn(high));
    if b.min(f) < c.min(e) { [[a, b, c, f], [a, b, f, e], [a, e, f, d]] } else { [[a, b, c, e], [a, e, c, f], [a, e, f, d]] }
}

/// Positions of the mesh at rest.
pub fn at_rest(mesh: &TetMesh) -> Vec<Vec3> {
    mesh.rest_positions().iter().map(|p| p.as_vec3()).collect()
}

/// Every node against every tetrahedron.
pub fn brute_force(bodies: &[Body], tets: &[Vec<(keyhole_tetmesh::TetId, [NodeId; 4])>]) -> Vec<Hit> {
    let mut hits = Vec::new();
    for (tet_body, of) in bodies.iter().enumerate() {
        for (tet, corners) in &tets[tet_body] {
            let Some(weights) = Weights::of(corners.map(|n| of.positions[n.index()].into())) else { continue };
            for (node_body, nodes_of) in bodies.iter().enumerate() {
                let own = node_body == tet_body;
                for (node, position) in nodes_of.positions.iter().enumerate().map(|(n, p)| (NodeId(n as u32), *p)) {
                    let role = nodes_of.shape.role(node);
                    let looks = if own {
                        of.self_collision && role == keyhole_collision::Role::Surface
                    } else {
                        role != keyhole_collision::Role::Unused
                    };
                    if !looks || (own && corners.contains(&node)) {
                        continue;
                    }
                    if let Some(weights) = weights.inside(position.into()) {
                        hits.push(Hit { node_body: node_body as u16, node, tet_body: tet_body as u16, tet: *tet, weights });
                    }
                }
            }
        }
    }
    hits.sort_unstable_by_key(Hit::key);
    hits
}

/// A mesh with everything that detection wants.
pub struct Thing {
    /// The mesh.
    pub mesh: TetMesh,
    /// Its shape.
    pub shape: Shape,
    /// Its deformed positions, m.
    pub positions: Vec<Vec3>,
}

impl Thing {
    /// The mesh with every node moved.
    pub fn new(mesh: TetMesh, place: impl Fn(Vec3) -> Vec3) -> Self {
        Self { shape: Shape::of(&mesh), positions: at_rest(&mesh).into_iter().map(place).collect(), mesh }
    }

    /// What detection looks at.
    pub fn body(&self, self_collision: bool) -> Body<'_> {
        Body { shape: &self.shape, positions: &self.positions, self_collision }
    }
}
