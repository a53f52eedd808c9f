//! A preconditioner of three levels that adds: the diagonal blocks of the nodes, the rigid motions of small clusters, each on its own, and the
//! rigid motions of large clusters, all together.
//!
//! `z = D^-1 r + P1 D1^-1 P1' r + P2 A2^-1 P2' r`, `D1` the diagonal blocks of `P1' A P1` and `A2 = P2' A P2`: the multilevel diagonal scaling of
//! Bramble, Pasciak, Xu (1990) with aggregates in place of nested meshes and rigid motions as coarse functions (Vanek, Mandel, Brezina 1996 without
//! their smoothing). It is symmetric and positive whatever the clusters are, so a cut can make it worse but never wrong.
//!
//! A rotation of the whole body is a motion without force but that of the stress it has: `sum_j K_ij (w x x_j) = -w x f_i`. So for
//! nodes inside a large cluster the coarse tangent needs their force alone, and only entries that leave it are looked at.

use crate::clusters::{Clusters, NONE};
use crate::rows::{Forces, Inertia, Rows};
use bevy_math::{Mat3A, Vec3A};
use rayon::prelude::*;

/// Share of the inertia of a motion below which its pivot is taken to be that: less there cannot be but by rounding, or where the energy is not convex.
const LEAST: f32 = 0.5;

/// The pivot of a motion with this inertia. Its inverse root is zero for a motion that the nodes of a cluster cannot make.
fn inverse_root(pivot: f32, inertia: f32) -> f32 {
    if inertia > 0.0 { pivot.max(LEAST * inertia).sqrt().recip() } else { 0.0 }
}

/// Adds the inertia of a node, `arm` away in radii from the middle of its cluster, in each of the rigid motions.
fn add_inertia(sums: &mut [f32], arm: Vec3A, added: f32) {
    let squares = arm * arm;
    let turns = (Vec3A::splat(squares.element_sum()) - squares) * added;
    for (sum, more) in sums.iter_mut().zip([added, added, added, turns.x, turns.y, turns.z]) {
        *sum += more;
    }
}

/// Rigid motions of a cluster.
pub(crate) const RIGID: usize = 6;

/// A force and a torque, or a velocity and a rotation.
#[derive(Clone, Copy, Debug, Default)]
struct Twist {
    straight: Vec3A,
    turn: Vec3A,
}

impl Twist {
    fn array(self) -> [f32; RIGID] {
        let ([a, b, c], [d, e, f]) = (self.straight.to_array(), self.turn.to_array());
        [a, b, c, d, e, f]
    }

    fn from_slice(v: &[f32]) -> Self {
        Self { straight: Vec3A::new(v[0], v[1], v[2]), turn: Vec3A::new(v[3], v[4], v[5]) }
    }
}

/// A small cluster.
#[derive(Clone, Copy, Debug, Default)]
struct Small {
    centre: Vec3A,
    /// One over its radius, which makes rotations as large as translations, 1/m; zero for a single node.
    scale: f32,
    /// Lower triangle of the factor of its tangent, by rows.
    factor: [[f32; RIGID]; RIGID],
    /// What the nodes pull.
    pull: Twist,
    /// How it moves.
    motion: Twist,
}

/// A large cluster.
#[derive(Clone, Copy, Debug, Default)]
struct Large {
    centre: Vec3A,
    scale: f32,
}

/// The coarse levels at the positions of a time step.
#[derive(Clone, Debug, Default)]
pub struct Multilevel {
    /// Positions that the levels were prepared at, m: the rigid motions are those of there.
    at: Vec<Vec3A>,
    small: Vec<Small>,
    large: Vec<Large>,
    large_of: Vec<u32>,
    /// The tangent of the large clusters, then its factor; rows of [`Multilevel::order`] numbers.
    dense: Vec<f32>,
    /// Inertia of the motions of the large clusters, kg.
    inertia: Vec<f32>,
    /// Right-hand side and solution of the large clusters.
    vector: Vec<f32>,
}

impl Multilevel {
    /// Rows of the dense matrix.
    pub(crate) fn order(&self) -> usize {
        RIGID * self.large.len()
    }

    /// Bytes of all arrays.
    #[must_use]
    pub fn bytes(&self) -> usize {
        16 * self.at.capacity()
            + self.small.capacity() * size_of::<Small>()
            + self.large.capacity() * size_of::<Large>()
            + 4 * (self.large_of.capacity() + self.dense.capacity() + self.vector.capacity())
    }

    /// Takes the levels to the positions `x` (m) at which `rows` were assembled with `inertia`, which gave `forces`.
    pub(crate) fn prepare(&mut self, clusters: &Clusters, rows: &Rows, x: &[Vec3A], inertia: Inertia<'_>, forces: &[Forces]) {
        self.at.clear();
        self.at.extend_from_slice(x);
        self.small.resize(clusters.nodes.len(), Small::default());
        self.small.par_iter_mut().zip(&clusters.nodes).enumerate().with_min_len(64).for_each(|(c, (small, nodes))| {
            (small.centre, small.scale) = extent(nodes.iter().copied(), x);
            factor_small(small, c as u32, nodes, clusters, rows, x, inertia);
        });
        self.large_of.clear();
        self.large_of.extend((0..x.len()).map(|n| if inertia.free[n] { clusters.large_of(n) } else { NONE }));
        self.large.clear();
        self.large.extend(clusters.children.iter().map(|children| {
            let (centre, scale) = extent(children.iter().flat_map(|c| &clusters.nodes[*c as usize]).copied(), x);
            Large { centre, scale }
        }));
        let order = self.order();
        self.dense.clear();
        self.dense.resize(order * order, 0.0);
        self.vector.resize(order, 0.0);
        let (large, large_of) = (&self.large, &self.large_of);
        if order > 0 {
            self.dense.par_chunks_mut(RIGID * order).enumerate().for_each(|(c, strip)| {
                for small in &clusters.children[c] {
                    for n in &clusters.nodes[*small as usize] {
                        let n = *n as usize;
                        if inertia.free[n] {
                            gather(n, c, strip, large, large_of, rows, x, inertia.added[n], forces[n].turned);
                        }
                    }
                }
            });
            self.inertia.clear();
            self.inertia.resize(order, 0.0);
            for ((children, large), sums) in clusters.children.iter().zip(&self.large).zip(self.inertia.chunks_mut(RIGID)) {
                for n in children.iter().flat_map(|c| &clusters.nodes[*c as usize]).map(|n| *n as usize).filter(|n| inertia.free[*n]) {
                    add_inertia(sums, (x[n] - large.centre) * large.scale, inertia.added[n]);
                }
            }
            factor_dense(&mut self.dense, &self.inertia);
        }
    }

    /// What the nodes of each small cluster pull: the first part of `z = B r`.
    pub(crate) fn restrict(&mut self, clusters: &Clusters, r: &[Vec3A]) {
        let x = &self.at;
        self.small.par_iter_mut().zip(&clusters.nodes).with_min_len(64).for_each(|(small, nodes)| {
            let mut pull = Twist::default();
            for n in nodes {
                let (n, r) = (*n as usize, r[*n as usize]);
                pull.straight += r;
                pull.turn += (x[n] - small.centre).cross(r);
            }
            small.pull = pull;
        });
    }

    /// How the clusters move with what pulls them: the second part.
    pub(crate) fn solve(&mut self, clusters: &Clusters) {
        self.small.par_iter_mut().with_min_len(64).for_each(|small| {
            let scaled = Twist { straight: small.pull.straight, turn: small.pull.turn * small.scale };
            small.motion = Twist::from_slice(&solve_small(&small.factor, scaled.array()));
            small.motion.turn *= small.scale;
        });
        let order = self.order();
        for ((children, large), out) in clusters.children.iter().zip(&self.large).zip(self.vector.as_chunks_mut::<RIGID>().0) {
            let mut pull = Twist::default();
            for small in children.iter().map(|c| &self.small[*c as usize]) {
                pull.straight += small.pull.straight;
                pull.turn += small.pull.turn + (small.centre - large.centre).cross(small.pull.straight);
            }
            pull.turn *= large.scale;
            *out = pull.array();
        }
        solve_dense(&self.dense, order, &mut self.vector);
        for ((children, large), motion) in clusters.children.iter().zip(&self.large).zip(self.vector.as_chunks::<RIGID>().0) {
            let motion = Twist::from_slice(motion);
            let turn = motion.turn * large.scale;
            for c in children {
                let small = &mut self.small[*c as usize];
                small.motion.straight += motion.straight + turn.cross(small.centre - large.centre);
                small.motion.turn += turn;
            }
        }
    }

    /// `z` by the motions of the clusters, zero where a node is not free; and the sum of the products of both: the last part.
    pub(crate) fn prolong(&self, clusters: &Clusters, rows: &Rows, r: &[Vec3A], z: &mut [Vec3A], partial: &mut [f32]) -> f64 {
        let size = crate::rows::CHUNK;
        let (small, x) = (&self.small, &self.at);
        z.par_chunks_mut(size)
            .zip(r.par_chunks(size))
            .zip(x.par_chunks(size))
            .zip(&rows.chunks)
            .zip(clusters.of_node.par_chunks(size))
            .zip(partial.par_iter_mut())
            .with_min_len(GRAIN)
            .for_each(|(((((z, r), x), chunk), of), partial)| {
                *partial = 0.0;
                for ((((z, r), x), inverse), of) in z.iter_mut().zip(r).zip(x).zip(chunk.inverses()).zip(of) {
                    *z = if *inverse == Mat3A::ZERO || *of == NONE {
                        Vec3A::ZERO
                    } else {
                        let small = &small[*of as usize];
                        *inverse * *r + small.motion.straight + small.motion.turn.cross(*x - small.centre)
                    };
                    *partial += z.dot(*r);
                }
            });
        partial.iter().map(|p| f64::from(*p)).sum()
    }

    /// `z` of a node that is in a cluster, by the motions of the clusters.
    pub(crate) fn at(&self, clusters: &Clusters, node: usize, inverse: Mat3A, r: Vec3A) -> Vec3A {
        let small = &self.small[clusters.of_node[node] as usize];
        inverse * r + small.motion.straight + small.motion.turn.cross(self.at[node] - small.centre)
    }

    /// Adds a force (N) at a node to what pulls its cluster.
    pub(crate) fn pull(&mut self, clusters: &Clusters, node: usize, force: Vec3A) {
        let small = &mut self.small[clusters.of_node[node] as usize];
        small.pull.straight += force;
        small.pull.turn += (self.at[node] - small.centre).cross(force);
    }

    /// What a force at a node that is in a cluster is to its clusters.
    pub(crate) fn lever(&self, clusters: &Clusters, node: usize, force: Vec3A) -> Lever {
        let of = |centre: Vec3A, scale: f32| Twist { straight: force, turn: (self.at[node] - centre).cross(force) * scale }.array();
        let small = clusters.of_node[node];
        let large = clusters.large_of(node);
        let own = &self.small[small as usize];
        let above = self.large.get(large as usize);
        Lever {
            small,
            on_small: of(own.centre, own.scale),
            large: above.map(|_| large),
            on_large: above.map_or([0.0; RIGID], |l| of(l.centre, l.scale)),
        }
    }

    /// How a small cluster moves with forces on it, both as in [`Lever`].
    pub(crate) fn move_small(&self, cluster: u32, forces: [f32; RIGID]) -> [f32; RIGID] {
        solve_small(&self.small[cluster as usize].factor, forces)
    }

    /// Makes forces on the large clusters their motions, both as in [`Lever`].
    pub(crate) fn move_large(&self, forces: &mut [f32]) {
        solve_dense(&self.dense, self.order(), forces);
    }
}

/// What a force at a node is to its clusters: a force and a torque by their radius, N.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Lever {
    /// Its small cluster.
    pub small: u32,
    /// What it is to that.
    pub on_small: [f32; RIGID],
    /// Its large cluster, if it has one.
    pub large: Option<u32>,
    /// What it is to that.
    pub on_large: [f32; RIGID],
}

/// Chunks that one thread takes at least.
pub(crate) const GRAIN: usize = 8;

/// The middle of some nodes and one over their radius.
fn extent(nodes: impl Iterator<Item = u32> + Clone, x: &[Vec3A]) -> (Vec3A, f32) {
    let count = nodes.clone().count();
    if count == 0 {
        return (Vec3A::ZERO, 0.0);
    }
    let centre = nodes.clone().map(|n| x[n as usize]).sum::<Vec3A>() / count as f32;
    let square = nodes.map(|n| x[n as usize].distance_squared(centre)).sum::<f32>() / count as f32;
    (centre, if square > 0.0 { square.sqrt().recip() } else { 0.0 })
}

/// The columns of `A P` where `P` are the rigid motions of a cluster at a node `arm` away from its centre.
fn columns(block: Mat3A, arm: Vec3A, scale: f32) -> [Vec3A; RIGID] {
    let arm = arm * scale;
    let turned = |axis: Vec3A| block * axis.cross(arm);
    [block.x_axis, block.y_axis, block.z_axis, turned(Vec3A::X), turned(Vec3A::Y), turned(Vec3A::Z)]
}

fn factor_small(
    small: &mut Small,
    own: u32,
    nodes: &[u32],
    clusters: &Clusters,
    rows: &Rows,
    x: &[Vec3A],
    Inertia { free, added, .. }: Inertia<'_>,
) {
    let mut m = [[0.0_f32; RIGID]; RIGID];
    let mut inertia = [0.0_f32; RIGID];
    for i in nodes.iter().map(|n| *n as usize).filter(|n| free[*n]) {
        let mut sum = columns(rows.diagonal(i), x[i] - small.centre, small.scale);
        for (j, block) in rows.row(i).filter(|(j, _)| clusters.of_node[*j] == own && free[*j]) {
            for (s, c) in sum.iter_mut().zip(columns(block, x[j] - small.centre, small.scale)) {
                *s += c;
            }
        }
        let arm = (x[i] - small.centre) * small.scale;
        add_inertia(&mut inertia, arm, added[i]);
        for (q, column) in sum.into_iter().enumerate() {
            let entries = Twist { straight: column, turn: arm.cross(column) }.array();
            for (row, e) in m.iter_mut().zip(entries) {
                row[q] += e;
            }
        }
    }
    for q in 0..RIGID {
        for p in 0..=q {
            let v = m[q][p] - m[q][..p].iter().zip(&m[p][..p]).map(|(a, b)| a * b).sum::<f32>();
            // The diagonal keeps its inverse, zero for a motion that is none.
            m[q][p] = if p < q { v * m[p][p] } else { inverse_root(v, inertia[q]) };
        }
    }
    small.factor = m;
}

fn solve_small(factor: &[[f32; RIGID]; RIGID], mut b: [f32; RIGID]) -> [f32; RIGID] {
    for q in 0..RIGID {
        for k in 0..q {
            b[q] -= factor[q][k] * b[k];
        }
        b[q] *= factor[q][q];
    }
    for q in (0..RIGID).rev() {
        for k in q + 1..RIGID {
            b[q] -= factor[k][q] * b[k];
        }
        b[q] *= factor[q][q];
    }
    b
}

/// Adds what node `i` of large cluster `own` has in the strip of its six rows, up to the diagonal.
fn gather(i: usize, own: usize, strip: &mut [f32], large: &[Large], large_of: &[u32], rows: &Rows, x: &[Vec3A], added: f32, force: Vec3A) {
    let order = RIGID * large.len();
    let Large { centre, scale } = large[own];
    let arm = (x[i] - centre) * scale;
    let mut add = |to: usize, column: usize, sum: Vec3A| {
        for (row, e) in (Twist { straight: sum, turn: arm.cross(sum) }).array().into_iter().enumerate() {
            strip[row * order + RIGID * to + column] += e;
        }
    };
    // The whole row moved by the own cluster's motions, less what is not in it.
    let whole = |axis: Vec3A| axis.cross(arm) * added - axis.cross(force) * scale;
    let mut inside = [Vec3A::X * added, Vec3A::Y * added, Vec3A::Z * added, whole(Vec3A::X), whole(Vec3A::Y), whole(Vec3A::Z)];
    for (j, block) in rows.row(i).filter(|(j, _)| large_of[*j] != own as u32) {
        for (s, c) in inside.iter_mut().zip(columns(block, x[j] - centre, scale)) {
            *s -= c;
        }
        let other = large_of[j] as usize;
        if other < own {
            for (q, c) in columns(block, x[j] - large[other].centre, large[other].scale).into_iter().enumerate() {
                add(other, q, c);
            }
        }
    }
    for (q, sum) in inside.into_iter().enumerate() {
        add(own, q, sum);
    }
}

/// Factors the lower triangle of a dense matrix by rows in place; the diagonal keeps its inverse, zero for a motion without inertia.
fn factor_dense(m: &mut [f32], inertia: &[f32]) {
    let order = inertia.len();
    for q in 0..order {
        let (above, rest) = m.split_at_mut(q * order);
        let row = &mut rest[..=q];
        let original = row[q];
        for p in 0..q {
            let other = &above[p * order..=p * order + p];
            let v = row[p] - dot(&row[..p], &other[..p]);
            row[p] = v * other[p];
        }
        let v = original - dot(&row[..q], &row[..q]);
        row[q] = inverse_root(v, inertia[q]);
    }
}

/// Solves with the factor of a dense matrix by rows, the diagonal of which is its inverse.
pub(crate) fn solve_dense(m: &[f32], order: usize, b: &mut [f32]) {
    for q in 0..order {
        let row = &m[q * order..=q * order + q];
        b[q] = (b[q] - dot(&row[..q], &b[..q])) * row[q];
    }
    for q in (0..order).rev() {
        let row = &m[q * order..=q * order + q];
        let v = b[q] * row[q];
        b[q] = v;
        for (b, m) in b[..q].iter_mut().zip(&row[..q]) {
            *b -= *m * v;
        }
    }
}

/// Sum of products, in lanes of a fixed number: the same bits whatever the machine's vectors are.
pub(crate) fn dot(a: &[f32], b: &[f32]) -> f32 {
    let (a, a_rest) = a.as_chunks::<16>();
    let (b, b_rest) = b.as_chunks::<16>();
    let mut lanes = [0.0_f32; 16];
    for (a, b) in a.iter().zip(b) {
        for ((lane, a), b) in lanes.iter_mut().zip(a).zip(b) {
            *lane += a * b;
        }
    }
    let tail: f32 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    lanes.iter().sum::<f32>() + tail
}
