//! The tangent of a body by rows: where its entries are, and their values at the positions of a time step.
//!
//! With the energy of [`crate::material`] a body of linear tetrahedra has the elastic energy
//!
//! `E(x) = sum over edges of -L_ij |x_i - x_j|^2 / 2 + sum over tetrahedra of k (vol - a V)^2 / 2 + constant`, `k = lambda / V`,
//!
//! for `|F|^2` is quadratic in the positions and `det F = vol / V`. `L_ij = sum of mu V grad N_i . grad N_j` never changes but with the topology, and the rest
//! needs the deformed volume alone: neither the deformation gradient nor the inverse of the rest shape appears. With `G_i` the gradient of the volume by
//! node `i` and `p = k (vol - a V)`,
//!
//! - force `f_i = sum_j L_ij (x_i - x_j) - sum p G_i`,
//! - tangent `K_ij = L_ij + sum (k G_i G_j' + p [x_k - x_l] / 6)` for `(i, j, k, l)` an even permutation of the corners, `[w]` the matrix of `w x`;
//!   its rows sum to zero.
//!
//! Every row is gathered from the tetrahedra around its node by one thread, so the bits do not depend on the number of threads. Rows are kept in
//! chunks of [`CHUNK`] nodes that own their arrays: a topology change rebuilds the rows of the nodes it touched and moves those beside them.

use crate::element::Element;
use bevy_math::{Mat3A, Vec3, Vec3A, Vec4};
use keyhole_tetmesh::{NodeId, TetId, TetMesh};
use rayon::prelude::*;

/// Nodes of a chunk.
pub const CHUNK: usize = 64;

/// For each corner the other three, such that the four are an even permutation.
const OTHERS: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [3, 0, 1], [2, 1, 0]];

/// Largest pressure in multiples of the shear modulus for which the tangent is exact: beyond, what may be negative in it is bounded from above instead.
const MOST: f32 = 5.0;

/// Row length up to which the sums of a row are kept on the stack.
const USUAL: usize = 96;

/// A tetrahedron at the node of a row, and where in the row its other corners are.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Corner {
    tet: u32,
    others: [u16; 3],
}

/// What a tetrahedron adds to energy beyond the Laplacian.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Volumetric {
    /// `lambda / V`, Pa/m3.
    stiffness: f32,
    /// `a V`, m3.
    target: f32,
    /// Shear modulus, Pa.
    mu: f32,
}

/// The rows of [`CHUNK`] nodes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Chunk {
    /// Where each row begins, and the end.
    starts: Vec<u32>,
    columns: Vec<u32>,
    laplacian: Vec<f32>,
    corner_starts: Vec<u32>,
    corners: Vec<Corner>,
    /// Nine numbers an entry, by columns; and what a load of four may read beyond the last.
    blocks: Vec<f32>,
    diagonal: Vec<Mat3A>,
    inverse: Vec<Mat3A>,
}

/// All rows of a body.
#[derive(Clone, Debug, Default)]
pub struct Rows {
    pub(crate) chunks: Vec<Chunk>,
    volumetric: Vec<Volumetric>,
}

/// What a row needs besides the positions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Inertia<'a> {
    /// Added to the diagonal, N/m.
    pub added: &'a [f32],
    /// Whether a node moves freely.
    pub free: &'a [bool],
    /// Whether the part of the tangent that may be negative is left out.
    pub convex: bool,
}

/// Forces on a node.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Forces {
    /// Elastic, N.
    pub elastic: Vec3A,
    /// That for which the assembled tangent is the tangent under a rotation, N.
    pub turned: Vec3A,
}

impl Rows {
    /// Takes the constants of a tetrahedron over from its element.
    pub(crate) fn set_element(&mut self, tet: TetId, element: &Element) {
        if self.volumetric.len() <= tet.index() {
            self.volumetric.resize(tet.index() + 1, Volumetric::default());
        }
        let m = element.material;
        self.volumetric[tet.index()] = Volumetric { stiffness: m.lambda / element.volume, target: m.a() * element.volume, mu: m.mu };
    }

    /// Rebuilds the rows of these nodes, ascending, from a mesh and its elements.
    pub(crate) fn rebuild(&mut self, nodes: &[NodeId], mesh: &TetMesh, elements: &[Element]) {
        let slots = mesh.node_slots();
        while self.chunks.len() * CHUNK < slots {
            self.chunks.push(Chunk::empty());
        }
        let groups: Vec<&[NodeId]> = nodes.chunk_by(|a, b| a.index() / CHUNK == b.index() / CHUNK).collect();
        let of = |c: usize| groups.binary_search_by_key(&c, |g| g[0].index() / CHUNK).ok().map(|g| groups[g]);
        self.chunks.par_iter_mut().enumerate().with_min_len(4).for_each(|(c, chunk)| {
            if let Some(group) = of(c) {
                chunk.rebuild(c * CHUNK, group, mesh, elements);
            }
        });
    }

    /// The nodes that share a tetrahedron with this one, ascending.
    #[must_use]
    pub fn neighbours(&self, node: usize) -> &[u32] {
        self.chunks.get(node / CHUNK).map_or(&[], |c| &c.columns[c.row(node % CHUNK)])
    }

    /// The neighbours of a node with the blocks that join it to them.
    pub(crate) fn row(&self, node: usize) -> impl Iterator<Item = (usize, Mat3A)> + '_ {
        let chunk = &self.chunks[node / CHUNK];
        chunk.row(node % CHUNK).map(move |e| (chunk.columns[e] as usize, chunk.block(e)))
    }

    /// The diagonal block of a node.
    pub(crate) fn diagonal(&self, node: usize) -> Mat3A {
        self.chunks[node / CHUNK].diagonal[node % CHUNK]
    }

    /// About what a node resists with when its neighbours stay, N/m.
    pub(crate) fn stiffness(&self, node: usize) -> f32 {
        let chunk = &self.chunks[node / CHUNK];
        let ratio = chunk.corners(node % CHUNK).iter().map(|c| &self.volumetric[c.tet as usize]).map(|v| v.stiffness * v.target / v.mu);
        self.shear(node) * ratio.fold(0.0, f32::max)
    }

    /// What the shear modulus of the elements around a node resists with in any direction, N/m.
    pub(crate) fn shear(&self, node: usize) -> f32 {
        let chunk = &self.chunks[node / CHUNK];
        chunk.laplacian[chunk.row(node % CHUNK)].iter().map(|l| -l).sum()
    }

    /// Elastic force on a node at positions `x` (m), N, and how it falls with the place of the node alone, N/m: exact, for energy is quadratic in one node.
    pub(crate) fn node(&self, node: usize, x: &[Vec3A]) -> (Vec3A, Mat3A) {
        let (chunk, at) = (&self.chunks[node / CHUNK], node % CHUNK);
        let row = chunk.row(at);
        let arm = |entry: usize| x[chunk.columns[row.start + entry] as usize] - x[node];
        let mut force: Vec3A = chunk.laplacian[row.clone()].iter().enumerate().map(|(entry, l)| arm(entry) * -l).sum();
        let mut block = Mat3A::from_diagonal(Vec3::splat(self.shear(node)));
        for corner in chunk.corners(at) {
            let [a, b, c] = corner.others.map(|o| arm(usize::from(o)));
            let v = self.volumetric[corner.tet as usize];
            let gradient = (b - a).cross(c - a) / 6.0;
            force += gradient * (v.stiffness * (a.dot(b.cross(c)) / 6.0 - v.target));
            block += Mat3A::from_cols(gradient * gradient.x, gradient * gradient.y, gradient * gradient.z) * v.stiffness;
        }
        (force, block)
    }

    /// The constants of all tetrahedra, for [`Chunk::assemble`].
    pub(crate) fn split(&mut self) -> (&mut [Chunk], RowConstants<'_>) {
        (&mut self.chunks, RowConstants(&self.volumetric))
    }

    /// The constants of all tetrahedra, for [`Chunk::forces`].
    pub(crate) fn constants(&self) -> RowConstants<'_> {
        RowConstants(&self.volumetric)
    }

    /// Bytes of all arrays, unused capacity included.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.volumetric.capacity() * size_of::<Volumetric>() + self.chunks.iter().map(Chunk::bytes).sum::<usize>()
    }
}

/// Constants of all tetrahedra.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RowConstants<'a>(&'a [Volumetric]);

impl Chunk {
    fn empty() -> Self {
        Self {
            starts: vec![0; CHUNK + 1],
            corner_starts: vec![0; CHUNK + 1],
            diagonal: vec![Mat3A::IDENTITY; CHUNK],
            inverse: vec![Mat3A::ZERO; CHUNK],
            ..Self::default()
        }
    }

    fn row(&self, at: usize) -> std::ops::Range<usize> {
        self.starts[at] as usize..self.starts[at + 1] as usize
    }

    fn corners(&self, at: usize) -> &[Corner] {
        &self.corners[self.corner_starts[at] as usize..self.corner_starts[at + 1] as usize]
    }

    fn block(&self, entry: usize) -> Mat3A {
        let b = &self.blocks[9 * entry..9 * entry + 9];
        Mat3A::from_cols(Vec3A::new(b[0], b[1], b[2]), Vec3A::new(b[3], b[4], b[5]), Vec3A::new(b[6], b[7], b[8]))
    }

    fn bytes(&self) -> usize {
        4 * (self.starts.capacity() + self.columns.capacity() + self.laplacian.capacity() + self.corner_starts.capacity())
            + self.corners.capacity() * size_of::<Corner>()
            + self.blocks.capacity() * 4
            + (self.diagonal.capacity() + self.inverse.capacity()) * size_of::<Mat3A>()
    }

    fn rebuild(&mut self, first: usize, nodes: &[NodeId], mesh: &TetMesh, elements: &[Element]) {
        let old = std::mem::replace(self, Self::empty());
        let mut touched = nodes.iter().peekable();
        for at in 0..CHUNK {
            if touched.next_if(|n| n.index() == first + at).is_some() {
                self.push_row(NodeId((first + at) as u32), mesh, elements);
            } else {
                self.columns.extend_from_slice(&old.columns[old.row(at)]);
                self.laplacian.extend_from_slice(&old.laplacian[old.row(at)]);
                self.corners.extend_from_slice(old.corners(at));
            }
            self.starts[at + 1] = self.columns.len() as u32;
            self.corner_starts[at + 1] = self.corners.len() as u32;
        }
        self.blocks.resize(9 * self.columns.len() + 1, 0.0);
    }

    fn push_row(&mut self, node: NodeId, mesh: &TetMesh, elements: &[Element]) {
        let mut around = mesh.topology().around_node(node).to_vec();
        around.sort_unstable();
        let mut columns: Vec<u32> = around.iter().flat_map(|t| mesh.corners(*t)).filter(|n| *n != node).map(|n| n.0).collect();
        columns.sort_unstable();
        columns.dedup();
        let mut laplacian = vec![0.0_f64; columns.len()];
        for tet in around {
            let element = &elements[tet.index()];
            let Some(own) = element.nodes.iter().position(|n| *n == node.0) else { continue };
            let b = element.inverse_rest.transpose();
            let gradients = [-(b.x_axis + b.y_axis + b.z_axis), b.x_axis, b.y_axis, b.z_axis];
            let others = OTHERS[own].map(|c| {
                let slot = columns.partition_point(|n| *n < element.nodes[c]);
                laplacian[slot] += f64::from(element.material.mu * element.volume * gradients[own].dot(gradients[c]));
                slot as u16
            });
            self.corners.push(Corner { tet: tet.0, others });
        }
        self.columns.extend(columns);
        self.laplacian.extend(laplacian.into_iter().map(|l| l as f32));
    }

    /// Elastic forces on the nodes of this chunk, the first of which is `first`.
    pub(crate) fn forces(&self, first: usize, constants: RowConstants<'_>, x: &[Vec3A], out: &mut [Vec3A]) {
        let mut usual = [Vec3A::ZERO; USUAL];
        let mut longer = Vec::new();
        for (at, out) in out.iter_mut().enumerate() {
            let row = self.row(at);
            let arms = room(&mut usual, &mut longer, row.len(), Vec3A::ZERO);
            let here = x[first + at];
            let mut force = Vec3A::ZERO;
            for ((arm, l), j) in arms.iter_mut().zip(&self.laplacian[row.clone()]).zip(&self.columns[row]) {
                *arm = x[*j as usize] - here;
                force -= *arm * *l;
            }
            for corner in self.corners(at) {
                let [a, b, c] = corner.others.map(|o| arms[usize::from(o)]);
                let v = constants.0[corner.tet as usize];
                let gradient = (b - a).cross(c - a);
                let pressure = v.stiffness * (a.dot(b.cross(c)) / 6.0 - v.target);
                force += gradient * (pressure / 6.0);
            }
            *out = force;
        }
    }

    /// Assembles the rows of this chunk, the first node of which is `first`, at positions `x` (m); writes the forces. Returns how
    /// many corners of inverted tetrahedra there are.
    pub(crate) fn assemble(
        &mut self,
        first: usize,
        constants: RowConstants<'_>,
        x: &[Vec3A],
        inertia: Inertia<'_>,
        out: &mut [Forces],
    ) -> u32 {
        let mut inverted = 0;
        let mut usual = [[Vec3A::ZERO; 4]; USUAL];
        let mut longer = Vec::new();
        let mut usual_arms = [Vec3A::ZERO; USUAL];
        let mut longer_arms = Vec::new();
        for (at, out) in out.iter_mut().enumerate() {
            let row = self.row(at);
            if row.is_empty() {
                (self.diagonal[at], self.inverse[at], *out) = (Mat3A::IDENTITY, Mat3A::ZERO, Forces::default());
                continue;
            }
            let sums = room(&mut usual, &mut longer, row.len(), [Vec3A::ZERO; 4]);
            sums.fill([Vec3A::ZERO; 4]);
            let arms = room(&mut usual_arms, &mut longer_arms, row.len(), Vec3A::ZERO);
            let here = x[first + at];
            for (arm, j) in arms.iter_mut().zip(&self.columns[row.clone()]) {
                *arm = x[*j as usize] - here;
            }
            let (mut hydrostatic, mut turned, mut bounded) = (Vec3A::ZERO, Vec3A::ZERO, Vec3A::ZERO);
            for corner in &self.corners[self.corner_starts[at] as usize..self.corner_starts[at + 1] as usize] {
                let others = corner.others.map(usize::from);
                let [a, b, c] = others.map(|o| arms[o]);
                let v = constants.0[corner.tet as usize];
                let gradients = [b.cross(c), c.cross(a), a.cross(b)];
                let own = gradients[0] + gradients[1] + gradients[2];
                let pressure = v.stiffness * (a.dot(gradients[0]) / 6.0 - v.target);
                hydrostatic += own * pressure;
                let kept = if inertia.convex { 0.0 } else { pressure.clamp(-MOST * v.mu, MOST * v.mu) };
                turned += own * kept;
                inverted += u32::from(a.dot(gradients[0]) <= 0.0);
                if kept != pressure {
                    // What is left out is bounded from above: |d2 vol| <= (|e_k| + |e_l|) |u_j|^2 / 6 over the edges e from any corner, u their
                    // changes; here the mean of what the four corners say.
                    let bound = (pressure - kept).abs() / 24.0;
                    let [p, q, r] = [a.length(), b.length(), c.length()];
                    let [ab, bc, ca] = [a.distance(b), b.distance(c), c.distance(a)];
                    for ((o, arm), around) in others.iter().zip([a, b, c]).zip([q + r + ab + ca, r + p + ab + bc, p + q + bc + ca]) {
                        let weight = bound * around;
                        let sum = &mut sums[*o];
                        sum[0].x -= weight;
                        sum[1].y -= weight;
                        sum[2].z -= weight;
                        bounded += arm * weight;
                    }
                }
                let raised = own * (v.stiffness / -36.0);
                let bend = [b - c, c - a, a - b];
                for q in 0..3 {
                    let sum = &mut sums[others[q]];
                    let g = gradients[q];
                    sum[0] += raised * g.x;
                    sum[1] += raised * g.y;
                    sum[2] += raised * g.z;
                    sum[3] += bend[q] * kept;
                }
            }
            let mut total = Mat3A::ZERO;
            let mut shear = Vec3A::ZERO;
            for (((entry, sum), l), arm) in row.clone().zip(sums.iter()).zip(&self.laplacian[row.clone()]).zip(arms.iter()) {
                let w = sum[3] * (1.0 / 6.0);
                let b = Mat3A::from_cols(
                    sum[0] + Vec3A::new(*l, w.z, -w.y),
                    sum[1] + Vec3A::new(-w.z, *l, w.x),
                    sum[2] + Vec3A::new(w.y, -w.x, *l),
                );
                total += b;
                shear -= *arm * *l;
                let place = &mut self.blocks[9 * entry..9 * entry + 9];
                place[..3].copy_from_slice(&b.x_axis.to_array());
                place[3..6].copy_from_slice(&b.y_axis.to_array());
                place[6..9].copy_from_slice(&b.z_axis.to_array());
            }
            *out = Forces { elastic: shear + hydrostatic * (1.0 / 6.0), turned: shear + turned * (1.0 / 6.0) + bounded };
            let added = Vec3A::splat(inertia.added[first + at]);
            // The bent parts of a tetrahedron cancel in the diagonal, but for rounding.
            let d = (total + total.transpose()) * -0.5 + Mat3A::from_diagonal(added.into());
            self.diagonal[at] = d;
            self.inverse[at] = if inertia.free[first + at] && inertia.added[first + at] > 0.0 { d.inverse() } else { Mat3A::ZERO };
        }
        inverted
    }

    /// Adds to the row of a node what joins it to some of its neighbours, and to its diagonal so that the row sums to what it did.
    pub(crate) fn add(&mut self, at: usize, entries: impl Iterator<Item = (u32, Mat3A)>) {
        let row = self.row(at);
        let mut total = Mat3A::ZERO;
        for (column, block) in entries {
            let Ok(slot) = self.columns[row.clone()].binary_search(&column) else { continue };
            let place = 9 * (row.start + slot);
            for (b, more) in self.blocks[place..place + 9].iter_mut().zip(block.to_cols_array()) {
                *b += more;
            }
            total += block;
        }
        self.diagonal[at] -= (total + total.transpose()) * 0.5;
    }

    /// Inverts the diagonal block of a node that moves freely anew.
    pub(crate) fn invert(&mut self, at: usize) {
        if self.inverse[at] != Mat3A::ZERO {
            self.inverse[at] = self.diagonal[at].inverse();
        }
    }

    /// `y = A x` for the nodes of this chunk, zero where a node is not free; and the sum of the products of both.
    pub(crate) fn multiply(&self, first: usize, x: &[Vec3A], free: &[bool], out: &mut [Vec3A]) -> f32 {
        let mut product = 0.0;
        for (at, out) in out.iter_mut().enumerate() {
            let own = x[first + at];
            let row = self.row(at);
            let mut sum = self.diagonal[at] * own;
            let columns = &self.columns[row.clone()];
            for (j, b) in columns.iter().zip(self.blocks[9 * row.start..].windows(10).step_by(9)) {
                let v = x[*j as usize];
                sum += load(&b[0..4]) * v.x + load(&b[3..7]) * v.y + load(&b[6..10]) * v.z;
            }
            *out = if free[first + at] { sum } else { Vec3A::ZERO };
            product += own.dot(*out);
        }
        product
    }

    /// The inverses of the diagonal blocks, zero for nodes that are not free.
    pub(crate) fn inverses(&self) -> &[Mat3A] {
        &self.inverse
    }
}

/// Room for the numbers of a row: on the stack, but for a row that is unusually long.
fn room<'a, T: Copy>(usual: &'a mut [T; USUAL], longer: &'a mut Vec<T>, length: usize, zero: T) -> &'a mut [T] {
    if length <= USUAL {
        return &mut usual[..length];
    }
    longer.resize(longer.len().max(length), zero);
    &mut longer[..length]
}

/// Three numbers by a load of four.
#[inline]
fn load(numbers: &[f32]) -> Vec3A {
    Vec3A::from_vec4(Vec4::from_slice(numbers))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use crate::Body;
    use crate::beam::{beam_material, block};
    use bevy_math::Vec3;
    use keyhole_whiteboard::TissueState;

    /// The tangent is the derivative of the forces, and a rotation gives the force that the coarse levels count on, wherever the body is.
    #[test]
    fn tangent_is_the_derivative_of_the_force() {
        let mesh = block([2, 2, 2], [0.02, 0.02, 0.02]);
        let mut body = Body::new(&mesh, &beam_material()).unwrap();
        let wave = |i: usize, p: Vec3| Vec3A::from(p + Vec3::new((i as f32).sin(), (2.0 * i as f32).cos(), (3.0 * i as f32).sin()) * 4e-4);
        let x: Vec<Vec3A> = TissueState::at_rest(&mesh).positions.iter().enumerate().map(|(i, p)| wave(i, *p)).collect();
        let (added, free) = (vec![0.0; x.len()], vec![true; x.len()]);
        let rows = &mut body.implicit.newton.rows;
        let mut forces = vec![Forces::default(); x.len()];
        let (chunks, constants) = rows.split();
        chunks[0].assemble(0, constants, &x, Inertia { added: &added, free: &free, convex: false }, &mut forces);
        let direction: Vec<Vec3A> = (0..x.len()).map(|i| Vec3A::new((5.0 * i as f32).cos(), (7.0 * i as f32).sin(), 0.3)).collect();
        let turn = Vec3A::new(0.2, -0.5, 0.7);
        let turned: Vec<Vec3A> = x.iter().map(|x| turn.cross(*x)).collect();
        let (mut image, mut rotated) = (vec![Vec3A::ZERO; x.len()], vec![Vec3A::ZERO; x.len()]);
        rows.chunks[0].multiply(0, &direction, &free, &mut image);
        rows.chunks[0].multiply(0, &turned, &free, &mut rotated);
        let step = 2e-5;
        let at = |s: f32| {
            let moved: Vec<Vec3A> = x.iter().zip(&direction).map(|(x, d)| *x + *d * s).collect();
            let mut out = vec![Vec3A::ZERO; x.len()];
            rows.chunks[0].forces(0, rows.constants(), &moved, &mut out);
            out
        };
        let size = image.iter().map(|i| i.length()).fold(0.0, f32::max);
        for (i, ((ahead, behind), image)) in at(step).iter().zip(&at(-step)).zip(&image).enumerate() {
            let difference = (*behind - *ahead) / (2.0 * step);
            assert!((difference - *image).length() < 5e-3 * size, "node {i}: {difference} by differences, {image}");
        }
        for (rotated, force) in rotated.iter().zip(&forces) {
            assert!((*rotated + turn.cross(force.turned)).length() < 1e-4 * size * 0.02, "{rotated} from {}", force.turned);
            assert!((force.turned - force.elastic).length() < 1e-4 * size * 0.02);
        }
    }
}
