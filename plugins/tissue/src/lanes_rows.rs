//! Nodes with the elements around each in lanes of eight, for vertex block descent.
//!
//! With the energy of [`crate::material`] as a Laplacian plus a function of each volume (see [`crate::rows`]) a node `i` needs of its neighbours `L_ij` and their
//! places, and of an element around it the other three corners and two constants: with `n` twice the area vector of the face across from it, which is six
//! times the gradient of the volume by the node,
//!
//! - force `f = sum_j L_ij (x_i - x_j) - sum q n`, `q = k (n . (x_i - x_j) - 6 a V) / 36`, `k = lambda / V`,
//! - matrix `L_ii + sum k n n' / 36`.

use crate::element::Element;
use crate::lanes::{Eight, Kernel, LANES, Lane, NEAR, Nodes, at, index, put};
use crate::lanes_parts::Parts;
use crate::vbd::Tick;
use bevy_math::{DVec3, Mat3, Vec3};
use keyhole_tetmesh::{NodeId, TetId, TetMesh};

/// Nodes of a part that are about right.
const TARGET: usize = 128;

/// For each corner of an element the other three, such that twice their area vector points to it.
const ACROSS: [[usize; 3]; 4] = [[1, 3, 2], [0, 2, 3], [3, 1, 0], [2, 0, 1]];

/// Eight elements around a node.
#[derive(Clone, Debug, Default)]
struct Around {
    /// `k / 36`, N/m5.
    stiffness: Eight,
    /// `6 a V`, m3.
    target: Eight,
    /// [`index`]es of the other corners.
    corners: [[u16; LANES]; 3],
}

/// Eight neighbours of a node.
#[derive(Clone, Debug, Default)]
struct Links {
    /// `L_ij`, N/m.
    laplacian: Eight,
    /// Their [`index`]es.
    nodes: [u16; LANES],
}

/// A node of a part.
#[derive(Clone, Copy, Debug)]
struct Own {
    node: u32,
    /// `L_ii`, N/m.
    diagonal: f32,
    /// Where its elements and neighbours end; they begin where those of the node before it end.
    around: u32,
    links: u32,
}

#[derive(Clone, Debug, Default)]
struct Pack {
    /// Nodes at hand, those of the part before their neighbours.
    nodes: Vec<u32>,
    own: Vec<Own>,
    around: Vec<Around>,
    links: Vec<Links>,
}

/// All nodes of an organ.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rows {
    parts: Parts,
    packs: Vec<Pack>,
}

fn beside(mesh: &TetMesh) -> impl Fn(u32, &mut Vec<u32>) + '_ {
    |node, near| {
        for tet in mesh.topology().around_node(NodeId(node)) {
            near.extend(mesh.corners(*tet).map(|n| n.0));
        }
    }
}

impl Rows {
    /// The nodes of a mesh.
    pub(crate) fn new(mesh: &TetMesh, elements: &[Element]) -> Self {
        let used = |n: &NodeId| !mesh.topology().around_node(*n).is_empty();
        let mut all: Vec<u32> = mesh.nodes().filter(used).map(|n| n.0).collect();
        all.sort_unstable();
        let parts = Parts::new(&all, TARGET, &beside(mesh));
        let packs = (0..parts.len()).map(|p| Pack::of(parts.items(p), mesh, elements)).collect();
        Self { parts, packs }
    }

    /// Carries it over a change of what is around these nodes, ascending.
    pub(crate) fn adopt(&mut self, nodes: &[NodeId], mesh: &TetMesh, elements: &[Element]) {
        let used = |n: u32| !mesh.topology().around_node(NodeId(n)).is_empty();
        let (there, others): (Vec<u32>, Vec<u32>) = nodes.iter().map(|n| n.0).partition(|n| self.parts.of(*n).is_some());
        let (changed, gone): (Vec<u32>, Vec<u32>) = there.into_iter().partition(|n| used(*n));
        let come: Vec<u32> = others.into_iter().filter(|n| used(*n)).collect();
        let touched = self.parts.adopt(&gone, &come, &changed, &beside(mesh));
        self.packs.resize_with(self.parts.len(), Pack::default);
        for part in touched {
            self.packs[part] = Pack::of(self.parts.items(part), mesh, elements);
        }
    }

    /// Number of colours of the parts.
    pub(crate) fn colours(&self) -> usize {
        self.parts.colours().len()
    }

    /// Number of parts of a colour.
    pub(crate) fn parts(&self, colour: usize) -> usize {
        self.parts.colours()[colour].len()
    }

    /// Moves the nodes of the `i`th part of a colour, one after the other.
    pub(crate) fn sweep(&self, colour: usize, i: usize, tick: &Tick<'_>, near: &mut Nodes) {
        let pack = &self.packs[self.parts.colours()[colour][i] as usize];
        for (place, node) in pack.nodes.iter().enumerate() {
            put(near, index(place), tick.nodes.at.get(*node as usize));
        }
        crate::lanes::run(Sweep { pack, tick, near });
    }

    /// Moves a node that holds pull, with the holds and its weights in them.
    pub(crate) fn alone(&self, pulled: &[(u32, u32, f32)], s: f32, tick: &Tick<'_>, near: &mut Nodes) {
        let Some((node, ..)) = pulled.first() else { return };
        let Some(part) = self.parts.of(*node) else { return };
        let pack = &self.packs[part];
        let Ok(place) = pack.own.binary_search_by_key(node, |own| own.node) else { return };
        let own = tick.nodes.at.get(*node as usize);
        if own[3] <= 0.0 {
            return;
        }
        put(near, index(place), own);
        let (around, links) = pack.of_node(place);
        let corners = around.iter().flat_map(|a| a.corners).chain(links.iter().map(|l| l.nodes)).flatten();
        for i in corners {
            put(near, i, tick.nodes.at.get(pack.nodes[usize::from(i) / 4] as usize));
        }
        crate::lanes::run(Alone { pack, place, pulled, s, tick, near });
    }
}

impl Pack {
    fn of(items: &[u32], mesh: &TetMesh, elements: &[Element]) -> Self {
        let mut near: Vec<u32> = Vec::new();
        items.iter().for_each(|n| beside(mesh)(*n, &mut near));
        near.sort_unstable();
        near.dedup();
        near.retain(|n| items.binary_search(n).is_err());
        let nodes: Vec<u32> = items.iter().copied().chain(near.iter().copied()).collect();
        assert!(nodes.len() <= NEAR, "{} nodes have {} neighbours, more than a mesh can have", items.len(), near.len());
        let place = |node: u32| {
            let found = items.binary_search(&node).unwrap_or_else(|_| items.len() + near.partition_point(|n| *n < node));
            index(found)
        };
        let mut pack = Self { nodes, ..Self::default() };
        let (mut tets, mut neighbours): (Vec<TetId>, Vec<(u32, f64)>) = Default::default();
        for (i, node) in items.iter().enumerate() {
            tets.clear();
            tets.extend_from_slice(mesh.topology().around_node(NodeId(*node)));
            // Whatever the history of the mesh.
            tets.sort_unstable();
            neighbours.clear();
            let mut diagonal = 0.0;
            for eight in tets.chunks(LANES) {
                let mut around = Around { corners: [[index(i); LANES]; 3], ..Default::default() };
                for (lane, tet) in eight.iter().enumerate() {
                    let element = &elements[tet.index()];
                    let corner = element.nodes.iter().position(|n| n == node).unwrap_or(0);
                    let m = element.material;
                    around.stiffness.0[lane] = m.lambda / element.volume / 36.0;
                    around.target.0[lane] = 6.0 * m.a() * element.volume;
                    for (others, c) in around.corners.iter_mut().zip(ACROSS[corner]) {
                        others[lane] = place(element.nodes[c]);
                    }
                    let gradients = gradients(element);
                    let scale = f64::from(m.mu) * f64::from(element.volume);
                    diagonal += scale * gradients[corner].length_squared();
                    for c in (0..4).filter(|c| *c != corner) {
                        neighbours.push((element.nodes[c], scale * gradients[corner].dot(gradients[c])));
                    }
                }
                pack.around.push(around);
            }
            neighbours.sort_by_key(|(n, _)| *n);
            let sums: Vec<(u32, f64)> = neighbours.chunk_by(|a, b| a.0 == b.0).map(|c| (c[0].0, c.iter().map(|(_, l)| l).sum())).collect();
            for eight in sums.chunks(LANES) {
                let mut links = Links { nodes: [index(i); LANES], ..Default::default() };
                for (lane, (n, l)) in eight.iter().enumerate() {
                    links.laplacian.0[lane] = *l as f32;
                    links.nodes[lane] = place(*n);
                }
                pack.links.push(links);
            }
            pack.own.push(Own { node: *node, diagonal: diagonal as f32, around: pack.around.len() as u32, links: pack.links.len() as u32 });
        }
        pack
    }

    /// What is around a node of the part.
    fn of_node(&self, place: usize) -> (&[Around], &[Links]) {
        let (around, links) = place.checked_sub(1).map_or((0, 0), |p| (self.own[p].around as usize, self.own[p].links as usize));
        let own = &self.own[place];
        (&self.around[around..own.around as usize], &self.links[links..own.links as usize])
    }
}

/// Gradients of the four shape functions, 1/m.
fn gradients(element: &Element) -> [DVec3; 4] {
    let rows = element.inverse_rest.as_dmat3().transpose();
    [-(rows.x_axis + rows.y_axis + rows.z_axis), rows.x_axis, rows.y_axis, rows.z_axis]
}

/// The nodes of a part, one after the other.
struct Sweep<'a> {
    pack: &'a Pack,
    tick: &'a Tick<'a>,
    near: &'a mut Nodes,
}

impl Kernel for Sweep<'_> {
    #[inline(always)]
    fn run<L: Lane>(self, token: L::Token) {
        let Self { pack, tick, near } = self;
        let (mut around, mut links) = (0, 0);
        for (place, own) in pack.own.iter().enumerate() {
            let (first_around, first_links) = (around, links);
            (around, links) = (own.around as usize, own.links as usize);
            let [x, y, z, w] = at(near, index(place));
            if !tick.moves(own.node, w) {
                continue;
            }
            let (force, matrix) =
                push::<L>(token, &pack.around[first_around..around], &pack.links[first_links..links], own.diagonal, [x, y, z], near);
            let x = Vec3::new(x, y, z);
            let new = x + tick.step(own.node, x, force, matrix, &[], 0.0);
            let new = [new.x, new.y, new.z, w];
            put(near, index(place), new);
            // At once, for a membrane looks there.
            tick.nodes.at.set(own.node as usize, new);
        }
    }
}

/// One node of a part.
struct Alone<'a> {
    pack: &'a Pack,
    place: usize,
    pulled: &'a [(u32, u32, f32)],
    s: f32,
    tick: &'a Tick<'a>,
    near: &'a mut Nodes,
}

impl Kernel for Alone<'_> {
    #[inline(always)]
    fn run<L: Lane>(self, token: L::Token) {
        let Self { pack, place, pulled, s, tick, near } = self;
        let own = &pack.own[place];
        let [x, y, z, _] = at(near, index(place));
        let (around, links) = pack.of_node(place);
        let (force, matrix) = push::<L>(token, around, links, own.diagonal, [x, y, z], near);
        let x = Vec3::new(x, y, z);
        tick.nodes.at.place(own.node as usize, x + tick.step(own.node, x, force, matrix, pulled, s));
    }
}

/// The force on a node (N), and the matrix of its energy (N/m).
#[inline(always)]
fn push<L: Lane>(token: L::Token, around: &[Around], links: &[Links], diagonal: f32, x: [f32; 3], near: &Nodes) -> (Vec3, Mat3) {
    let [x, y, z] = [L::splat(token, x[0]), L::splat(token, x[1]), L::splat(token, x[2])];
    let zero = L::splat(token, 0.0);
    let [mut fx, mut fy, mut fz] = [zero; 3];
    let [mut xx, mut xy, mut xz, mut yy, mut yz, mut zz] = [zero; 6];
    for eight in links {
        let [a, b, c, _] = L::gather(token, near, &eight.nodes);
        let l = L::load(token, &eight.laplacian);
        fx = l.mul_add(x - a, fx);
        fy = l.mul_add(y - b, fy);
        fz = l.mul_add(z - c, fz);
    }
    for eight in around {
        let [ax, ay, az, _] = L::gather(token, near, &eight.corners[0]);
        let [bx, by, bz, _] = L::gather(token, near, &eight.corners[1]);
        let [cx, cy, cz, _] = L::gather(token, near, &eight.corners[2]);
        let [ux, uy, uz] = [bx - ax, by - ay, bz - az];
        let [vx, vy, vz] = [cx - ax, cy - ay, cz - az];
        let nx = uz.neg_mul_add(vy, uy * vz);
        let ny = ux.neg_mul_add(vz, uz * vx);
        let nz = uy.neg_mul_add(vx, ux * vy);
        let volume = nx.mul_add(x - ax, ny.mul_add(y - ay, nz * (z - az)));
        let k = L::load(token, &eight.stiffness);
        let q = k * (volume - L::load(token, &eight.target));
        fx = q.neg_mul_add(nx, fx);
        fy = q.neg_mul_add(ny, fy);
        fz = q.neg_mul_add(nz, fz);
        let [kx, ky, kz] = [k * nx, k * ny, k * nz];
        xx = kx.mul_add(nx, xx);
        xy = kx.mul_add(ny, xy);
        xz = kx.mul_add(nz, xz);
        yy = ky.mul_add(ny, yy);
        yz = ky.mul_add(nz, yz);
        zz = kz.mul_add(nz, zz);
    }
    let force = Vec3::new(fx.sum(), fy.sum(), fz.sum());
    let (xy, xz, yz) = (xy.sum(), xz.sum(), yz.sum());
    let matrix = Mat3::from_cols(
        Vec3::new(xx.sum() + diagonal, xy, xz),
        Vec3::new(xy, yy.sum() + diagonal, yz),
        Vec3::new(xz, yz, zz.sum() + diagonal),
    );
    (force, matrix)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twice the area vector of what is across points to the node.
    #[test]
    fn across_is_outside_in() {
        let x = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
        for (i, [j, k, l]) in ACROSS.into_iter().enumerate() {
            let n = (x[k] - x[j]).cross(x[l] - x[j]);
            assert!((n.dot(x[i] - x[j]) - 1.0).abs() < 1e-6, "{i}");
        }
    }
}
