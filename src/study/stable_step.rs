//! The largest stable step of an explicit time integration, from the highest natural frequency of linear elasticity.
//!
//! Central differences are stable up to `2 / omega_max` (Courant, Friedrichs, Lewy 1928; Belytschko 1983). `omega_max^2` is the largest
//! eigenvalue of `M^-1 K` with lumped masses `M` and the stiffness `K` of linear tetrahedra, found by power iteration without assembling:
//! a displacement `u` gives each tetrahedron the gradient `sum u_i g_i^T`, its stress `sigma`, and its nodes the forces `-V sigma g_i`.
//!
//! The mode is a local one, so `K` is summed over the tetrahedra asked for and those that share a node with them, `M` over all. Leaving out
//! stiffness can only lower the frequency: the step is an upper bound, and what is left out has better shapes.

use keyhole_tetmesh::{DVec3, NodeId, TetId, TetMesh};
use keyhole_whiteboard::OrganMaterial;

/// The iteration ends when the eigenvalue has grown by less than this part of itself in [`WINDOW`] iterations...
pub const TOLERANCE: f64 = 1e-3;
/// ...which is looked at this often.
pub const WINDOW: usize = 10;
/// And after this many in any case.
pub const MAX_ITERATIONS: usize = 400;

/// Elastic constants of a homogeneous isotropic body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elastic {
    /// Lame's first parameter, Pa.
    pub lambda: f64,
    /// Shear modulus, Pa.
    pub mu: f64,
    /// Density, kg/m3.
    pub density: f64,
}

impl From<&OrganMaterial> for Elastic {
    fn from(m: &OrganMaterial) -> Self {
        // The shortest decimal that gives the f32: 0.45 means 0.45.
        let exact = |x: f32| x.to_string().parse().unwrap_or(f64::from(x));
        let (e, nu) = (exact(m.young_modulus_pa), exact(m.poisson_ratio));
        Self { lambda: e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), mu: e / (2.0 * (1.0 + nu)), density: exact(m.density_kg_m3) }
    }
}

/// Gradients of the four shape functions, 1/m, and the volume, m3.
fn shape(p: [DVec3; 4]) -> ([DVec3; 4], f64) {
    let [a, b, c] = [p[1] - p[0], p[2] - p[0], p[3] - p[0]];
    let six = a.dot(b.cross(c));
    let g = [b.cross(c) / six, c.cross(a) / six, a.cross(b) / six];
    ([-(g[0] + g[1] + g[2]), g[0], g[1], g[2]], six / 6.0)
}

/// Power iteration on one mesh after another, each starting from the mode of the last.
#[derive(Clone, Debug)]
pub struct Resonance {
    elastic: Elastic,
    /// The last mode by node slot.
    mode: Vec<DVec3>,
    state: u64,
}

struct Local {
    nodes: [u32; 4],
    gradients: [DVec3; 4],
    volume: f64,
}

impl Resonance {
    /// Starts from a mode that the seed makes.
    #[must_use]
    pub fn new(elastic: Elastic, seed: u64) -> Self {
        Self { elastic, mode: Vec::new(), state: seed }
    }

    /// The largest stable step (s) of the body around some tetrahedra; `None` without any.
    pub fn stable_step_s(&mut self, mesh: &TetMesh, along: &[TetId]) -> Option<f64> {
        let (locals, nodes) = self.region(mesh, along);
        if locals.is_empty() {
            return None;
        }
        let masses: Vec<f64> = nodes
            .iter()
            .map(|n| mesh.topology().around_node(*n).iter().map(|t| mesh.volume(*t)).sum::<f64>() * self.elastic.density / 4.0)
            .collect();
        let mut x = self.start(&nodes);
        let mut force = vec![DVec3::ZERO; nodes.len()];
        let (mut eigenvalue, mut before) = (0.0, 0.0);
        for iteration in 1..=MAX_ITERATIONS {
            let norm = x.iter().zip(&masses).map(|(u, m)| m * u.length_squared()).sum::<f64>().sqrt();
            if norm <= 0.0 {
                return None;
            }
            x.iter_mut().for_each(|u| *u /= norm);
            self.apply(&locals, &x, &mut force);
            eigenvalue = x.iter().zip(&force).map(|(u, f)| u.dot(*f)).sum();
            if iteration % WINDOW == 0 {
                if eigenvalue - before <= TOLERANCE * eigenvalue {
                    break;
                }
                before = eigenvalue;
            }
            for ((u, f), m) in x.iter_mut().zip(&force).zip(&masses) {
                *u = *f / *m;
            }
        }
        self.mode.clear();
        self.mode.resize(mesh.node_slots(), DVec3::ZERO);
        for (n, u) in nodes.iter().zip(&x) {
            self.mode[n.index()] = *u;
        }
        (eigenvalue > 0.0).then(|| 2.0 / eigenvalue.sqrt())
    }

    /// The tetrahedra asked for and those that share a node with them, and their nodes.
    fn region(&self, mesh: &TetMesh, along: &[TetId]) -> (Vec<Local>, Vec<NodeId>) {
        let mut chosen: Vec<TetId> =
            along.iter().flat_map(|t| mesh.corners(*t)).flat_map(|n| mesh.topology().around_node(n).iter().copied()).collect();
        chosen.sort_unstable();
        chosen.dedup();
        let mut nodes: Vec<NodeId> = chosen.iter().flat_map(|t| mesh.corners(*t)).collect();
        nodes.sort_unstable();
        nodes.dedup();
        let mut index = vec![0_u32; mesh.node_slots()];
        for (i, n) in nodes.iter().enumerate() {
            index[n.index()] = i as u32;
        }
        let local = |t: &TetId| {
            let (gradients, volume) = shape(mesh.points(*t));
            Local { nodes: mesh.corners(*t).map(|n| index[n.index()]), gradients, volume }
        };
        (chosen.iter().map(local).collect(), nodes)
    }

    /// The last mode with something of every other one in it, so that none is missed.
    fn start(&mut self, nodes: &[NodeId]) -> Vec<DVec3> {
        let known = |n: &NodeId| self.mode.get(n.index()).copied().unwrap_or(DVec3::ZERO);
        let largest = nodes.iter().map(|n| known(n).length()).fold(0.0, f64::max);
        let noise = if largest > 0.0 { 0.02 * largest } else { 1.0 };
        let mut state = self.state;
        let x = nodes
            .iter()
            .map(|n| {
                let mut random = || 2.0 * super::strokes::uniform(&mut state) - 1.0;
                known(n) + noise * DVec3::new(random(), random(), random())
            })
            .collect();
        self.state = state;
        x
    }

    /// `K x`.
    fn apply(&self, locals: &[Local], x: &[DVec3], force: &mut [DVec3]) {
        force.fill(DVec3::ZERO);
        let Elastic { lambda, mu, .. } = self.elastic;
        for l in locals {
            // Columns of the displacement gradient: d u / d x, d u / d y, d u / d z.
            let mut columns = [DVec3::ZERO; 3];
            for (n, g) in l.nodes.iter().zip(&l.gradients) {
                let u = x[*n as usize];
                columns[0] += u * g.x;
                columns[1] += u * g.y;
                columns[2] += u * g.z;
            }
            let [a, b, c] = columns;
            let pressure = lambda * (a.x + b.y + c.z);
            let [xy, xz, yz] = [mu * (a.y + b.x), mu * (a.z + c.x), mu * (b.z + c.y)];
            let stress = [
                DVec3::new(pressure + 2.0 * mu * a.x, xy, xz) * l.volume,
                DVec3::new(xy, pressure + 2.0 * mu * b.y, yz) * l.volume,
                DVec3::new(xz, yz, pressure + 2.0 * mu * c.z) * l.volume,
            ];
            for (n, g) in l.nodes.iter().zip(&l.gradients) {
                force[*n as usize] += stress[0] * g.x + stress[1] * g.y + stress[2] * g.z;
            }
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use keyhole_tetmesh::DVec3;

    fn kidney() -> Elastic {
        Elastic::from(&OrganMaterial::default())
    }

    fn all(mesh: &TetMesh) -> Vec<TetId> {
        mesh.iter().map(|(t, _)| t).collect()
    }

    /// A regular tetrahedron of edge a, centred: g_i = x_i / s with s I = sum x_i x_i^T, s = a^2 / 2. A displacement u_i = A x_i with symmetric A
    /// has the forces -V sigma(A) x_i / s, so it is a mode when sigma(A) = (omega^2 m s / V) A with m = rho V / 4. The stiffest is A = I,
    /// sigma = (3 lambda + 2 mu) I: omega^2 = 8 (3 lambda + 2 mu) / (rho a^2).
    #[test]
    fn a_regular_tetrahedron_breathes_at_its_closed_form() {
        let a = 0.004;
        let h = a / 8.0_f64.sqrt();
        let nodes = vec![DVec3::new(h, h, h), DVec3::new(-h, h, -h), DVec3::new(h, -h, -h), DVec3::new(-h, -h, h)];
        let mesh = TetMesh::new(nodes, &[[0, 1, 2, 3]], &[]);
        assert!(mesh.volume(TetId(0)) > 0.0);
        let e = kidney();
        let step = Resonance::new(e, 1).stable_step_s(&mesh, &all(&mesh)).unwrap();
        let omega = (8.0 * (3.0 * e.lambda + 2.0 * e.mu) / (e.density * a * a)).sqrt();
        assert!((step * omega / 2.0 - 1.0).abs() < 1e-3, "{step} against {}", 2.0 / omega);
    }

    /// Cubes of five tetrahedra each, mirrored in turn so that they fit, the nodes moved a little.
    fn lattice(n: usize, shake: f64) -> TetMesh {
        let id = |x: usize, y: usize, z: usize| ((z * (n + 1) + y) * (n + 1) + x) as u32;
        let mut state = 3;
        let mut nodes = Vec::new();
        for i in 0..(n + 1).pow(3) {
            let p = DVec3::new((i % (n + 1)) as f64, (i / (n + 1) % (n + 1)) as f64, (i / (n + 1).pow(2)) as f64);
            let mut random = || shake * (super::super::strokes::uniform(&mut state) - 0.5);
            nodes.push((p + DVec3::new(random(), random(), random())) * 0.005);
        }
        let mut tets: Vec<[u32; 4]> = Vec::new();
        for c in 0..n.pow(3) {
            let (x, y, z) = (c % n, c / n % n, c / (n * n));
            let v = |k: usize| id(x + (k & 1), y + (k >> 1 & 1), z + (k >> 2));
            let five = [[0, 1, 2, 4], [3, 2, 1, 7], [5, 4, 7, 1], [6, 7, 4, 2], [1, 2, 4, 7]];
            // The other way round: all corners mirrored along x.
            let flip = usize::from((x + y + z) % 2 == 1);
            for t in five {
                let mut t = t.map(|k: usize| v(k ^ flip));
                if keyhole_tetmesh::quality::volume(t.map(|n| nodes[n as usize])) < 0.0 {
                    t.swap(0, 1);
                }
                tets.push(t);
            }
        }
        TetMesh::new(nodes, &tets, &[])
    }

    /// All eigenvalues of a symmetric matrix by cyclic rotations (Jacobi 1846).
    fn eigenvalues(mut a: Vec<Vec<f64>>) -> Vec<f64> {
        let n = a.len();
        let off = |a: &[Vec<f64>]| (0..n).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| a[i][j].powi(2)).sum::<f64>();
        let trace: f64 = (0..n).map(|i| a[i][i].powi(2)).sum();
        while off(&a) > 1e-24 * trace {
            for p in 0..n {
                for q in p + 1..n {
                    if a[p][q] == 0.0 {
                        continue;
                    }
                    let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                    let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
                    let c = 1.0 / t.hypot(1.0);
                    let s = t * c;
                    for row in &mut a {
                        (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
                    }
                    let (upper, lower) = a.split_at_mut(q);
                    for (x, y) in upper[p].iter_mut().zip(&mut lower[0]) {
                        (*x, *y) = (c * *x - s * *y, s * *x + c * *y);
                    }
                }
            }
        }
        (0..n).map(|i| a[i][i]).collect()
    }

    #[test]
    fn jacobi_gives_known_eigenvalues() {
        // -1, 2, -1 along the diagonal: 2 - 2 cos(k pi / (n + 1)).
        let n = 12;
        let chain = (0..n).map(|i| (0..n).map(|j: usize| [2.0, -1.0, 0.0][j.abs_diff(i).min(2)]).collect()).collect();
        let mut found = eigenvalues(chain);
        found.sort_by(f64::total_cmp);
        for (k, value) in (1..).zip(found) {
            let exact = 2.0 - 2.0 * (f64::from(k) * std::f64::consts::PI / (n as f64 + 1.0)).cos();
            assert!((value - exact).abs() < 1e-12);
        }
    }

    #[test]
    fn power_iteration_agrees_with_all_eigenvalues_of_the_assembled_matrix() {
        let mesh = lattice(3, 0.5);
        let e = kidney();
        let resonance = Resonance::new(e, 1);
        let (locals, nodes) = resonance.region(&mesh, &all(&mesh));
        let size = 3 * nodes.len();
        let masses: Vec<f64> =
            nodes.iter().map(|n| mesh.topology().around_node(*n).iter().map(|t| mesh.volume(*t)).sum::<f64>() * e.density / 4.0).collect();
        // B^T D B in Voigt's notation, every entry: not the code under test.
        let mut k = vec![vec![0.0; size]; size];
        let normal = |i: usize, j: usize| e.lambda + if i == j { 2.0 * e.mu } else { 0.0 };
        let d = |i: usize, j: usize| {
            if i < 3 && j < 3 {
                normal(i, j)
            } else if i == j {
                e.mu
            } else {
                0.0
            }
        };
        for l in &locals {
            let b: Vec<[f64; 6]> = l
                .gradients
                .iter()
                .flat_map(|g| [[g.x, 0.0, 0.0, g.y, 0.0, g.z], [0.0, g.y, 0.0, g.x, g.z, 0.0], [0.0, 0.0, g.z, 0.0, g.y, g.x]])
                .collect();
            for i in 0..12 {
                for j in 0..12 {
                    let entry: f64 = (0..36).map(|n| b[i][n / 6] * d(n / 6, n % 6) * b[j][n % 6]).sum();
                    k[3 * l.nodes[i / 3] as usize + i % 3][3 * l.nodes[j / 3] as usize + j % 3] += entry * l.volume;
                }
            }
        }
        for i in 0..size {
            for j in 0..size {
                k[i][j] /= (masses[i / 3] * masses[j / 3]).sqrt();
            }
        }
        let largest = eigenvalues(k).into_iter().fold(0.0, f64::max);
        let step = Resonance::new(e, 7).stable_step_s(&mesh, &all(&mesh)).unwrap();
        let exact = 2.0 / largest.sqrt();
        // From above, and close.
        assert!(step >= exact * (1.0 - 1e-9) && step < 1.01 * exact, "{step} against {exact}");
        let part = Resonance::new(e, 7).stable_step_s(&mesh, &[TetId(0)]).unwrap();
        assert!(part >= exact, "a part of the stiffness gives no smaller step");
    }

    #[test]
    fn the_step_grows_with_the_size_and_nothing_has_none() {
        let mesh = lattice(2, 0.3);
        let double = TetMesh::new(
            mesh.rest_positions().iter().map(|p| *p * 2.0).collect(),
            &mesh.iter().map(|(_, c)| c.map(|n| n.0)).collect::<Vec<_>>(),
            &[],
        );
        let step = |m: &TetMesh| Resonance::new(kidney(), 2).stable_step_s(m, &all(m)).unwrap();
        assert!((step(&double) / step(&mesh) - 2.0).abs() < 1e-9);
        assert_eq!(Resonance::new(kidney(), 2).stable_step_s(&mesh, &[]), None);
    }
}
