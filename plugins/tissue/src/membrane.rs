//! The capsule: a thin stiff membrane on the surface of an organ, cut with it.
//!
//! Each triangle of the surface carries, a unit of rest area and thickness, `mu/2 (|F|^2 - 2) + lambda/2 ((J - a)^2 - (1 - a)^2)` with `J` its area by
//! its rest area and `a = 1 + mu/lambda`: the energy of the tissue ([`crate::NeoHookean`]) in two dimensions, finite for any triangle. It linearises to
//! plane stress with `mu = E / 2(1 + nu)` and `lambda = E nu / (1 - nu^2) + mu`, and has no stiffness against bending.
//!
//! A face that a cut opens gets none. Where a cut divides the surface, the parts of a triangle inherit it: they are found by where they lie in
//! the rest shape, so a subdivision that is taken back inherits it too.

use crate::reference::energy::skew;
use bevy_math::{DMat3, DVec3};
use keyhole_tetmesh::{Boundary, FACES, TetId, TetMesh, TopologyDelta};
use rustc_hash::FxHashMap;
use smallvec::SmallVec;

/// What a capsule is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capsule {
    /// Young's modulus, Pa; above 0.
    pub young_modulus_pa: f64,
    /// Poisson's ratio, in [0, 0.5].
    pub poisson_ratio: f64,
    /// Thickness, m; above 0.
    pub thickness_m: f64,
}

impl Default for Capsule {
    /// The renal capsule: 15 MPa, 0.45, 0.05 mm, the lower end of what is given for it.
    fn default() -> Self {
        Self { young_modulus_pa: 15e6, poisson_ratio: 0.45, thickness_m: 5e-5 }
    }
}

/// A triangle of a membrane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangle {
    /// Its nodes, as indices of node slots, counterclockwise from outside.
    pub nodes: [u32; 3],
    /// Rest positions, m.
    rest: [DVec3; 3],
    gradients: [DVec3; 3],
    /// Twice its rest area, m2.
    double_area: f64,
    /// Rest area by thickness, m3.
    pub volume: f64,
    /// Shear modulus, Pa.
    pub mu: f64,
    /// Plane stress Lame parameter plus `mu`, Pa.
    pub lambda: f64,
}

/// Deformation of a triangle.
struct Strain {
    f: DMat3,
    /// Area by rest area.
    j: f64,
    /// Gradients of `j` by the three nodes.
    dj: [DVec3; 3],
    normal: DVec3,
    /// Edges opposite to the nodes, m.
    opposite: [DVec3; 3],
}

/// Largest tension in multiples of the shear modulus for which the tangent is exact.
const MOST: f64 = 5.0;

/// What a triangle has for the row of one of its nodes.
pub(crate) struct TriangleRow {
    /// N.
    pub force: DVec3,
    /// That for which the tangent is the tangent under a rotation, N.
    pub turned: DVec3,
    /// The other nodes and the blocks that join them, N/m.
    pub others: [(u32, DMat3); 2],
}

impl Triangle {
    /// A triangle with these rest positions, m.
    #[must_use]
    pub fn new(nodes: [u32; 3], rest: [DVec3; 3], capsule: Capsule) -> Self {
        let normal = (rest[1] - rest[0]).cross(rest[2] - rest[0]);
        let double_area = normal.length();
        let unit = normal / double_area;
        let gradients = std::array::from_fn(|i| unit.cross(rest[(i + 2) % 3] - rest[(i + 1) % 3]) / double_area);
        let (e, nu) = (capsule.young_modulus_pa, capsule.poisson_ratio);
        let mu = e / (2.0 * (1.0 + nu));
        let lambda = e * nu / (1.0 - nu * nu) + mu;
        Self { nodes, rest, gradients, double_area, volume: 0.5 * double_area * capsule.thickness_m, mu, lambda }
    }

    /// Its rest positions, m.
    #[must_use]
    pub fn rest(&self) -> [DVec3; 3] {
        self.rest
    }

    fn strain(&self, x: [DVec3; 3]) -> Strain {
        let columns = |axis: usize| (0..3).map(|i| x[i] * self.gradients[i][axis]).sum::<DVec3>();
        let normal = (x[1] - x[0]).cross(x[2] - x[0]);
        let unit = normal.normalize_or_zero();
        let opposite = std::array::from_fn(|i| x[(i + 2) % 3] - x[(i + 1) % 3]);
        Strain {
            f: DMat3::from_cols(columns(0), columns(1), columns(2)),
            j: normal.length() / self.double_area,
            dj: opposite.map(|u: DVec3| unit.cross(u) / self.double_area),
            normal: unit,
            opposite,
        }
    }

    fn pressure(&self, j: f64) -> f64 {
        self.lambda * (j - 1.0) - self.mu
    }

    /// Energy, J: zero at rest.
    #[must_use]
    pub fn energy(&self, x: [DVec3; 3]) -> f64 {
        let s = self.strain(x);
        let squares = s.f.x_axis.length_squared() + s.f.y_axis.length_squared() + s.f.z_axis.length_squared();
        let a = 1.0 + self.mu / self.lambda;
        self.volume * (self.mu / 2.0 * (squares - 2.0) + self.lambda / 2.0 * (s.j - 1.0) * (s.j + 1.0 - 2.0 * a))
    }

    /// Forces on the nodes, N.
    #[must_use]
    pub fn forces(&self, x: [DVec3; 3]) -> [DVec3; 3] {
        let s = self.strain(x);
        let p = self.pressure(s.j);
        std::array::from_fn(|i| (s.f * self.gradients[i] * self.mu + s.dj[i] * p) * -self.volume)
    }

    /// The tangent by pairs of nodes, N/m, with this part of the term of `d2J`.
    #[must_use]
    pub fn stiffness(&self, x: [DVec3; 3], geometric: f64) -> [[DMat3; 3]; 3] {
        let s = self.strain(x);
        let p = geometric * self.pressure(s.j);
        std::array::from_fn(|i| std::array::from_fn(|j| self.block(&s, p, i, j)))
    }

    fn block(&self, s: &Strain, p: f64, i: usize, j: usize) -> DMat3 {
        let outer = |a: DVec3, b: DVec3| DMat3::from_cols(a * b.x, a * b.y, a * b.z);
        let simple =
            DMat3::from_diagonal(DVec3::splat(self.mu * self.gradients[i].dot(self.gradients[j]))) + outer(s.dj[i], s.dj[j]) * self.lambda;
        let size = s.j * self.double_area;
        if p == 0.0 || size <= 0.0 {
            return simple * self.volume;
        }
        let across = DMat3::IDENTITY - outer(s.normal, s.normal);
        let mut second = skew(s.opposite[i]).transpose() * across * skew(s.opposite[j]) * (1.0 / size);
        if i != j {
            second += skew(s.normal) * if j == (i + 2) % 3 { 1.0 } else { -1.0 };
        }
        (simple + second * (p / self.double_area)) * self.volume
    }

    /// Force on one node, and what joins it to the other two in a tangent whose part that may be negative is left out: where the triangle is pressed together,
    /// and, when it is to be `convex`, where it is more than stretched.
    #[must_use]
    pub(crate) fn row(&self, x: [DVec3; 3], node: usize, convex: bool) -> TriangleRow {
        let s = self.strain(x);
        let p = self.pressure(s.j);
        // Positive for `-r mu <= p <= mu`, `r` the ratio of the stretches: by `r mu + p` across the triangle, by `mu - |p|` in it.
        let squares = s.f.x_axis.length_squared() + s.f.y_axis.length_squared() + s.f.z_axis.length_squared();
        let sum = (squares / s.j).max(2.0);
        let ratio = if s.j > 0.0 { 2.0 / (sum + (sum * sum - 4.0).sqrt()) } else { 0.0 };
        let kept = p.clamp(-ratio * self.mu, if convex { self.mu } else { MOST * self.mu });
        let force = |p: f64| (s.f * self.gradients[node] * self.mu + s.dj[node] * p) * -self.volume;
        let others = [(node + 1) % 3, (node + 2) % 3];
        TriangleRow { force: force(p), turned: force(kept), others: others.map(|j| (self.nodes[j], self.block(&s, kept, node, j))) }
    }

    /// Force on one node, N.
    #[must_use]
    pub(crate) fn force(&self, x: [DVec3; 3], node: usize) -> DVec3 {
        let s = self.strain(x);
        (s.f * self.gradients[node] * self.mu + s.dj[node] * self.pressure(s.j)) * -self.volume
    }

    /// Force on one node (N) and a positive definite bound of its own stiffness (N/m).
    #[must_use]
    pub fn at_node(&self, x: [DVec3; 3], node: usize) -> (DVec3, DMat3) {
        let s = self.strain(x);
        let p = self.pressure(s.j);
        let force = (s.f * self.gradients[node] * self.mu + s.dj[node] * p) * -self.volume;
        (force, self.block(&s, p.max(0.0), node, node))
    }

    /// `|F|`, `J - a` and their gradients by the nodes: the constraints of position-based dynamics, compliances `1 / (mu volume)`, `1 / (lambda volume)`.
    #[must_use]
    pub fn constraints(&self, x: [DVec3; 3]) -> ([f64; 2], [[DVec3; 3]; 2]) {
        let s = self.strain(x);
        let size = (s.f.x_axis.length_squared() + s.f.y_axis.length_squared() + s.f.z_axis.length_squared()).sqrt();
        let inverse = if size > 0.0 { 1.0 / size } else { 0.0 };
        ([size, s.j - 1.0 - self.mu / self.lambda], [self.gradients.map(|g| s.f * g * inverse), s.dj])
    }

    /// Whether a point of the rest shape lies on it, with a tolerance of a thousandth of its size.
    fn covers(&self, p: DVec3) -> bool {
        const TOLERANCE: f64 = 1e-3;
        let unit = (self.rest[1] - self.rest[0]).cross(self.rest[2] - self.rest[0]) / self.double_area;
        let off = (p - self.rest[0]).dot(unit).abs() / self.double_area.sqrt();
        off < TOLERANCE && (0..3).all(|i| self.gradients[i].dot(p - self.rest[(i + 1) % 3]) > -TOLERANCE)
    }

    fn centre(&self) -> DVec3 {
        (self.rest[0] + self.rest[1] + self.rest[2]) / 3.0
    }

    /// Whether both are parts of one face of the rest shape: one has the middle of the other, and they look the same way.
    fn coincides(&self, other: &Self) -> bool {
        let normal = |t: &Self| (t.rest[1] - t.rest[0]).cross(t.rest[2] - t.rest[0]) / t.double_area;
        normal(self).dot(normal(other)) > 0.999 && (self.covers(other.centre()) || other.covers(self.centre()))
    }
}

/// The membrane of an organ.
#[derive(Clone, Debug, Default)]
pub struct Membrane {
    capsule: Capsule,
    slots: Vec<Option<Triangle>>,
    free: Vec<u32>,
    of_tet: FxHashMap<TetId, SmallVec<[u32; 4]>>,
    of_node: Vec<SmallVec<[u32; 8]>>,
}

impl Membrane {
    /// A membrane on all of a mesh's surface.
    #[must_use]
    pub fn new(mesh: &TetMesh, capsule: Capsule) -> Self {
        let mut membrane = Self { capsule, ..Self::default() };
        membrane.of_node.resize(mesh.node_slots(), SmallVec::new());
        let boundary = Boundary::of(mesh);
        for (nodes, tet) in boundary.triangles.iter().zip(&boundary.tets) {
            membrane.insert(*tet, triangle(mesh, nodes.map(|n| n.0), capsule));
        }
        membrane
    }

    /// The part of a donor's membrane that a piece of it takes along: `mesh` is the piece. Its faces
    /// inherit where they lie on a triangle of the donor, so those that the cut opened have none.
    #[must_use]
    pub fn of_piece(donor: &Self, mesh: &TetMesh) -> Self {
        let mut membrane = Self { capsule: donor.capsule, ..Self::default() };
        membrane.of_node.resize(mesh.node_slots(), SmallVec::new());
        // By cells as large as the largest triangle, so that each face looks at its neighbourhood alone.
        let cell = donor.triangles().map(|t| (t.rest[0] - t.rest[1]).length().max((t.rest[0] - t.rest[2]).length())).fold(0.0, f64::max);
        if cell <= 0.0 {
            return membrane;
        }
        let key = |p: DVec3| (p / cell).floor().as_i64vec3();
        let mut cells: FxHashMap<_, Vec<&Triangle>> = FxHashMap::default();
        for t in donor.triangles() {
            cells.entry(key(t.centre())).or_default().push(t);
        }
        let boundary = Boundary::of(mesh);
        for (nodes, tet) in boundary.triangles.iter().zip(&boundary.tets) {
            let new = triangle(mesh, nodes.map(|n| n.0), donor.capsule);
            let middle = key(new.centre());
            let near = (0..27).filter_map(|i| cells.get(&(middle + bevy_math::I64Vec3::new(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1))));
            if near.flatten().any(|old| new.coincides(old)) {
                membrane.insert(*tet, new);
            }
        }
        membrane
    }

    /// Its triangles, in the order of their slots.
    pub fn triangles(&self) -> impl Iterator<Item = &Triangle> {
        self.slots.iter().flatten()
    }

    /// The triangles at a node, and which of their corners it is.
    pub fn around(&self, node: usize) -> impl Iterator<Item = (&Triangle, usize)> {
        let slots = self.of_node.get(node).map_or(&[][..], |s| s.as_slice());
        slots.iter().filter_map(move |s| {
            let triangle = self.slots[*s as usize].as_ref()?;
            Some((triangle, triangle.nodes.iter().position(|n| *n as usize == node)?))
        })
    }

    /// Rest area, m2.
    #[must_use]
    pub fn area(&self) -> f64 {
        self.triangles().map(|t| t.double_area / 2.0).sum()
    }

    /// Energy, J.
    #[must_use]
    pub fn energy(&self, positions: &[DVec3]) -> f64 {
        self.energy_by(|n| positions[n])
    }

    /// Energy where a node is at `position`, J.
    pub(crate) fn energy_by(&self, position: impl Fn(usize) -> DVec3) -> f64 {
        self.triangles().map(|t| t.energy(t.nodes.map(|n| position(n as usize)))).sum()
    }

    /// About what a node resists with when its neighbours stay, N/m.
    #[must_use]
    pub(crate) fn stiffness(&self, node: usize) -> f32 {
        let of = |(t, c): (&Triangle, usize)| t.volume * (t.mu + t.lambda) * t.gradients[c].length_squared();
        self.around(node).map(of).sum::<f64>() as f32
    }

    /// Adds the forces on the nodes, N.
    pub fn add_forces(&self, positions: &[DVec3], forces: &mut [DVec3]) {
        for t in self.triangles() {
            for (n, f) in t.nodes.iter().zip(t.forces(t.nodes.map(|n| positions[n as usize]))) {
                forces[*n as usize] += f;
            }
        }
    }

    /// Carries it over a topology change; `mesh` is the mesh after it. What the change removed goes; a new face inherits when it lies on one that went.
    pub fn adopt(&mut self, mesh: &TetMesh, delta: &TopologyDelta) {
        if self.of_node.len() < mesh.node_slots() {
            self.of_node.resize(mesh.node_slots(), SmallVec::new());
        }
        let mut gone: Vec<Triangle> = Vec::new();
        for tet in &delta.removed {
            for slot in self.of_tet.remove(tet).unwrap_or_default() {
                gone.extend(self.remove(slot));
            }
        }
        for tet in delta.reshaped(mesh.topology()) {
            for slot in self.of_tet.remove(&tet).unwrap_or_default() {
                if let Some(old) = self.remove(slot) {
                    self.insert(tet, triangle(mesh, old.nodes, self.capsule));
                }
            }
        }
        if gone.is_empty() {
            return;
        }
        for added in &delta.added {
            for (face, corners) in FACES.iter().enumerate() {
                if mesh.topology().neighbour(added.tet, face).is_none() {
                    let new = triangle(mesh, corners.map(|c| added.nodes[c].0), self.capsule);
                    if gone.iter().any(|old| new.coincides(old)) {
                        self.insert(added.tet, new);
                    }
                }
            }
        }
    }

    fn insert(&mut self, tet: TetId, triangle: Triangle) {
        let slot = self.free.pop().unwrap_or_else(|| {
            self.slots.push(None);
            self.slots.len() as u32 - 1
        });
        for n in triangle.nodes {
            self.of_node[n as usize].push(slot);
        }
        self.of_tet.entry(tet).or_default().push(slot);
        self.slots[slot as usize] = Some(triangle);
    }

    /// Takes a triangle out; its tetrahedron no longer names it.
    fn remove(&mut self, slot: u32) -> Option<Triangle> {
        let triangle = self.slots[slot as usize].take()?;
        for n in triangle.nodes {
            self.of_node[n as usize].retain(|s| *s != slot);
        }
        self.free.push(slot);
        Some(triangle)
    }
}

fn triangle(mesh: &TetMesh, nodes: [u32; 3], capsule: Capsule) -> Triangle {
    let at = |n: u32| {
        let p = mesh.rest(keyhole_tetmesh::NodeId(n));
        DVec3::new(p.x, p.y, p.z)
    };
    Triangle::new(nodes, nodes.map(at), capsule)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Force is minus the gradient of the energy, and the tangent that of minus the force, by central differences.
    #[test]
    fn derivatives() {
        let rest = [DVec3::ZERO, DVec3::new(1.0, 0.1, 0.2), DVec3::new(0.3, 0.9, -0.1)];
        let capsule = Capsule { young_modulus_pa: 1.0, poisson_ratio: 0.4, thickness_m: 1.0 };
        let t = Triangle::new([0, 1, 2], rest, capsule);
        assert!(t.energy(rest).abs() < 1e-15 && t.forces(rest).iter().all(|f| f.length() < 1e-15));
        let x = [DVec3::new(0.1, -0.2, 0.3), DVec3::new(1.4, 0.3, 0.1), DVec3::new(0.2, 1.3, 0.4)];
        let d = [DVec3::new(0.3, 0.5, -0.7), DVec3::new(-0.2, 0.4, 0.9), DVec3::new(0.6, -0.8, 0.1)];
        let h = 1e-5;
        let moved = |s: f64| std::array::from_fn(|i| x[i] + d[i] * (s * h));
        let slope = (t.energy(moved(1.0)) - t.energy(moved(-1.0))) / (2.0 * h);
        let work: f64 = t.forces(x).iter().zip(d).map(|(f, d)| f.dot(d)).sum();
        assert!((slope + work).abs() < 1e-9, "{slope} {work}");
        let k = t.stiffness(x, 1.0);
        let (ahead, behind) = (t.forces(moved(1.0)), t.forces(moved(-1.0)));
        for i in 0..3 {
            let exact: DVec3 = (0..3).map(|j| k[i][j] * d[j]).sum();
            assert!((exact + (ahead[i] - behind[i]) / (2.0 * h)).length() < 1e-8);
        }
    }

    /// Plane stress: stretched by a small strain with free sides, a strip pulls with `E` times strain and thins by Poisson's ratio.
    #[test]
    fn linearises_to_plane_stress() {
        let capsule = Capsule { young_modulus_pa: 3.0, poisson_ratio: 0.3, thickness_m: 0.5 };
        let rest = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let t = Triangle::new([0, 1, 2], rest, capsule);
        let e = 1e-6;
        let x = [DVec3::ZERO, DVec3::X * (1.0 + e), DVec3::Y * (1.0 - 0.3 * e)];
        let f = t.forces(x);
        // The force at a corner is stress times thickness times the length of the opposite edge's projection, halved.
        assert!((-f[1].x / (3.0 * e * 0.5 * 0.5) - 1.0).abs() < 1e-4, "{}", f[1].x);
        assert!(f[2].y.abs() < 1e-4 * f[1].x.abs());
    }
}
