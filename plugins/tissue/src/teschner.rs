//! The paper's model: M. Teschner, B. Heidelberger, M. Mueller, M. Gross, "A versatile and robust model for geometrically complex deformable solids", CGI
//! 2004. Potentials `k C^2 / 2` of every edge's length, `C = (l - D0) / D0`, and every tetrahedron's signed volume, `C = (V - V0) / V0'`; forces damped
//! along the edges; Verlet steps. The area potential of surface triangles is [`crate::membrane`], with a material's constants.
//!
//! Its stiffnesses are scale-free, in N m, and mean no material. They are taken from one: `k_D = 15 mu V_e` with `V_e` a sixth of the volume of the
//! tetrahedra around the edge, `k_V = (K - 5 mu / 3) V` (`K` the bulk modulus). Springs alone have Poisson's ratio 1/4, so below it `k_V` is 0 and the ratio stays 1/4.
//! That is the linear material in the mean over directions; the springs of a mesh are not isotropic, and in large strain it is another material.
//!
//! Verlet is stable up to `2 / omega_max`: [`Teschner::limit_s`] finds it by power iteration over springs and volumes, for the whole mesh at first, for what a
//! topology change touched thereafter. A tick is divided into as many steps as that takes, and into more while volumes are stiffer than at rest
//! (that is not the paper's, whose users choose a step).

use crate::body::Body;
use crate::graph::EdgeGraph;
use crate::hold::Hold;
use crate::material::{MaterialError, NeoHookean};
use crate::membrane::Membrane;
use crate::motion::{drift, driven, inverse_masses};
use crate::press::Presses;
use bevy_math::{DVec3, Vec3};
use keyhole_tetmesh::{EDGES, NodeId, TetId, TetMesh, TopologyDelta};
use keyhole_whiteboard::{Contact, OrganMaterials, TissueState};

/// Settings of [`crate::TissueModel::Teschner`].
///
/// Limits, by `keyhole study stability` on a beam of 270 tetrahedra: the largest step of small motions is the predicted one within 2 %, 1 ms at 10 kPa and nu 0.45, 0.44 ms
/// at nu 0.49, 0.1 ms at 1 MPa, 0.06 ms with slivers of 1 degree. Slivers of 0.1 degrees and 1 GPa cost minutes a second. Collapsed to a line or a point it is still
/// turned inside out somewhere after 4 s, and a hundred cuts make slivers too thin to go on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TeschnerSettings {
    /// Length of a step as a part of the largest stable one. Default 0.8: `keyhole study stability` measures the limit of small motions
    /// within 2 % of the predicted one.
    pub part_of_limit: f32,
    /// A step that is taken whatever the limit, s: for finding out what happens. Default none.
    pub step_s: Option<f32>,
    /// Damping `k_d` of the springs by `k_D`, as a part of a step: a mode at the limit has a damping ratio of about this. Default 0.05; with more than 0.5 it adds energy.
    pub damping: f32,
}

impl Default for TeschnerSettings {
    fn default() -> Self {
        Self { part_of_limit: 0.8, step_s: None, damping: 0.05 }
    }
}

/// A tetrahedron whose volume is below this part of that of a regular one with its mean edge is flat: its volume potential is scaled by the latter.
const FLAT: f64 = 0.1;

/// Iterations of the power iteration over all of a mesh, and over what a topology change touched.
const ITERATIONS: usize = 200;

/// About the most steps of one tick: what wants more explodes.
const MOST_STEPS: f32 = 1e5;

#[derive(Clone, Copy, Debug, Default)]
struct Spring {
    /// Rest length, m.
    length: f32,
    /// `k_D`, N m: of all tetrahedra around the edge.
    stiffness: f64,
    /// From the first to the second node in the rest shape.
    direction: Vec3,
}

#[derive(Clone, Copy, Debug)]
struct Volume {
    nodes: [u32; 4],
    /// Signed rest volume, m3.
    rest: f32,
    /// What a change of it is compared with, m3.
    scale: f32,
    /// `k_V`, N m.
    stiffness: f32,
    /// What each of its edges has of `k_D`, N m.
    of_edge: f64,
    /// Gradients of the volume at rest by the nodes, m2.
    gradients: [Vec3; 4],
    /// One by the sum of their squares, 1/m4.
    softness: f32,
}

/// The springs and volumes of one organ.
#[derive(Clone, Debug, Default)]
pub struct Teschner {
    graph: EdgeGraph,
    springs: Vec<Spring>,
    volumes: Vec<Option<Volume>>,
    materials: Vec<NeoHookean>,
    limit_s: f32,
}

impl Teschner {
    /// The model of a mesh.
    ///
    /// # Errors
    /// When a material has constants that no material has.
    pub fn new(body: &Body, mesh: &TetMesh, materials: &OrganMaterials, membrane: Option<&Membrane>) -> Result<Self, MaterialError> {
        let materials = materials.0.iter().map(NeoHookean::of).collect::<Result<Vec<_>, _>>()?;
        let mut model = Self { materials, limit_s: f32::INFINITY, ..Self::default() };
        model.graph.reserve(mesh.tet_slots());
        let all: Vec<TetId> = mesh.iter().map(|(t, _)| t).collect();
        for tet in &all {
            model.insert(mesh, *tet);
        }
        model.limit_s = model.limit(body, &all, membrane);
        Ok(model)
    }

    /// The largest stable step of small motions, s: `2 / omega_max`, somewhat from above.
    #[must_use]
    pub fn limit_s(&self) -> f32 {
        self.limit_s
    }

    /// Carries it over a topology change. The limit never grows.
    pub fn adopt(&mut self, body: &Body, mesh: &TetMesh, delta: &TopologyDelta, membrane: Option<&Membrane>) {
        let reshaped = delta.reshaped(mesh.topology());
        for tet in delta.removed.iter().chain(&reshaped) {
            self.remove(*tet);
        }
        let fresh: Vec<TetId> = delta.added.iter().map(|a| a.tet).chain(reshaped).collect();
        for tet in &fresh {
            self.insert(mesh, *tet);
        }
        let mut around: Vec<TetId> =
            fresh.iter().flat_map(|t| mesh.corners(*t)).flat_map(|n| mesh.topology().around_node(n).iter().copied()).collect();
        around.sort_unstable();
        around.dedup();
        // Rest lengths of edges whose ends moved belong to their neighbours too.
        for tet in &around {
            self.measure(mesh, *tet);
        }
        self.limit_s = self.limit_s.min(self.limit(body, &around, membrane));
    }

    fn insert(&mut self, mesh: &TetMesh, tet: TetId) {
        let nodes = mesh.corners(tet);
        let p = mesh.points(tet).map(|p| DVec3::new(p.x, p.y, p.z));
        let volume = mesh.volume(tet);
        let edge = EDGES.iter().map(|&[i, j]| p[i].distance(p[j])).sum::<f64>() / 6.0;
        let regular = 2.0_f64.sqrt() / 12.0 * edge.powi(3);
        let material = self.materials[usize::from(mesh.tet(tet).material.0).min(self.materials.len() - 1)];
        let (mu, bulk) = (f64::from(material.mu), f64::from(material.lambda) - f64::from(material.mu) / 3.0);
        let (a, b, c) = (p[1] - p[0], p[2] - p[0], p[3] - p[0]);
        let g = [b.cross(c) / 6.0, c.cross(a) / 6.0, a.cross(b) / 6.0];
        let gradients = [-(g[0] + g[1] + g[2]), g[0], g[1], g[2]];
        let of_edge = 15.0 * mu * volume.abs() / 6.0;
        if self.volumes.len() <= tet.index() {
            self.volumes.resize(tet.index() + 1, None);
        }
        self.volumes[tet.index()] = Some(Volume {
            nodes: nodes.map(|n| n.0),
            rest: volume as f32,
            scale: if volume.abs() < FLAT * regular { regular } else { volume.abs() } as f32,
            stiffness: ((bulk - 5.0 * mu / 3.0).max(0.0) * volume.abs()) as f32,
            of_edge,
            gradients: gradients.map(|g| g.as_vec3()),
            softness: (1.0 / gradients.iter().map(|g| g.length_squared()).sum::<f64>()) as f32,
        });
        self.graph.insert(tet.index(), nodes.map(|n| n.0));
        self.springs.resize(self.graph.ends().len(), Spring::default());
        for slot in self.graph.of_element()[tet.index()] {
            self.springs[slot as usize].stiffness += of_edge;
        }
        self.measure(mesh, tet);
    }

    /// Rest lengths and directions of the edges of a tetrahedron.
    fn measure(&mut self, mesh: &TetMesh, tet: TetId) {
        for slot in self.graph.of_element()[tet.index()] {
            let [i, j] = self.graph.ends()[slot as usize].map(|n| mesh.rest(NodeId(n)));
            let spring = &mut self.springs[slot as usize];
            spring.length = i.distance(j) as f32;
            let d = (j - i).normalize_or_zero();
            spring.direction = Vec3::new(d.x as f32, d.y as f32, d.z as f32);
        }
    }

    fn remove(&mut self, tet: TetId) {
        let Some(volume) = self.volumes.get_mut(tet.index()).and_then(Option::take) else { return };
        let slots = self.graph.of_element()[tet.index()];
        self.graph.remove(tet.index(), volume.nodes);
        for slot in slots {
            let vacant = {
                let [i, j] = self.graph.ends()[slot as usize];
                i == j
            };
            let spring = &mut self.springs[slot as usize];
            // What is left of a sum of which parts were taken off may be rounding.
            spring.stiffness = if vacant { 0.0 } else { (spring.stiffness - volume.of_edge).max(0.0) };
        }
    }

    /// `2 / omega_max` of some tetrahedra, linearised at rest, by power iteration, s; infinite without any.
    fn limit(&self, body: &Body, tets: &[TetId], membrane: Option<&Membrane>) -> f32 {
        let volumes: Vec<&Volume> = tets.iter().filter_map(|t| self.volumes.get(t.index())?.as_ref()).collect();
        let mut slots: Vec<u32> = tets.iter().flat_map(|t| self.graph.of_element()[t.index()]).collect();
        slots.sort_unstable();
        slots.dedup();
        let mut nodes: Vec<u32> = volumes.iter().flat_map(|v| v.nodes).collect();
        nodes.sort_unstable();
        nodes.dedup();
        if nodes.is_empty() {
            return f32::INFINITY;
        }
        let local = |n: u32| nodes.binary_search(&n).ok();
        let mass: Vec<f64> = nodes.iter().map(|n| f64::from(body.masses()[*n as usize]).max(f64::MIN_POSITIVE)).collect();
        // Every potential is `k (b . x)^2 / 2` near rest: nodes and vectors b.
        let mut terms: Vec<([usize; 4], [DVec3; 4])> = Vec::with_capacity(slots.len() + volumes.len());
        for slot in slots {
            let spring = &self.springs[slot as usize];
            let [i, j] = self.graph.ends()[slot as usize];
            let (Some(i), Some(j)) = (local(i), local(j)) else { continue };
            let b = spring.direction.as_dvec3() * (spring.stiffness.sqrt() / f64::from(spring.length));
            terms.push(([i, j, i, i], [-b, b, DVec3::ZERO, DVec3::ZERO]));
        }
        for v in volumes {
            let k = f64::from(v.stiffness).sqrt() / f64::from(v.scale);
            let at = v.nodes.map(|n| local(n).unwrap_or(0));
            terms.push((at, v.gradients.map(|g| g.as_dvec3() * k)));
        }
        let triangles: Vec<_> = membrane
            .iter()
            .flat_map(|m| m.triangles())
            .filter_map(|t| {
                let at: Vec<usize> = t.nodes.iter().filter_map(|n| local(*n)).collect();
                <[usize; 3]>::try_from(at).ok().map(|at| (at, t.stiffness(t.rest(), 1.0)))
            })
            .collect();
        let mut seed = 1_u32;
        let mut random = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(seed >> 8) / f64::from(1 << 24) - 0.5
        };
        let mut x: Vec<DVec3> = nodes.iter().map(|_| DVec3::new(random(), random(), random())).collect();
        let mut force = vec![DVec3::ZERO; nodes.len()];
        let mut omega2 = 0.0;
        for _ in 0..ITERATIONS {
            let size = x.iter().zip(&mass).map(|(x, m)| m * x.length_squared()).sum::<f64>().sqrt();
            force.fill(DVec3::ZERO);
            x.iter_mut().for_each(|x| *x /= size);
            for (at, b) in &terms {
                let c: f64 = at.iter().zip(b).map(|(i, b)| b.dot(x[*i])).sum();
                for (i, b) in at.iter().zip(b) {
                    force[*i] += *b * c;
                }
            }
            for (at, k) in &triangles {
                for (i, row) in at.iter().zip(k) {
                    force[*i] += (0..3).map(|j| row[j] * x[at[j]]).sum::<DVec3>();
                }
            }
            let now: f64 = x.iter().zip(&force).map(|(x, f)| x.dot(*f)).sum();
            let settled = (now - omega2).abs() < 1e-5 * now;
            omega2 = now;
            if settled || now <= 0.0 {
                break;
            }
            for ((x, f), m) in x.iter_mut().zip(&force).zip(&mass) {
                *x = *f / *m;
            }
        }
        if omega2 > 0.0 { (2.0 / omega2.sqrt()) as f32 } else { f32::INFINITY }
    }

    /// Elastic forces (N) and those of damping `k_d = damping_s k_D`. Gives by how much the stiffest volume potential is stiffer than at rest: the
    /// squares of its gradients grow with the faces, and a strained one resists turning.
    fn forces(&self, state: &TissueState, membrane: Option<&Membrane>, damping_s: f32, forces: &mut [Vec3]) -> f32 {
        forces.fill(Vec3::ZERO);
        let mut stiffest = 1.0_f32;
        for ([i, j], spring) in self.graph.ends().iter().zip(&self.springs) {
            if i == j {
                continue;
            }
            let (i, j) = (*i as usize, *j as usize);
            let way = state.positions[j] - state.positions[i];
            let length = way.length();
            if length <= 0.0 {
                continue;
            }
            let unit = way / length;
            let rate = unit.dot(state.velocities[j] - state.velocities[i]) / spring.length;
            let strain = (length - spring.length) / spring.length;
            let pull = unit * (spring.stiffness as f32 * (strain + damping_s * rate) / spring.length);
            forces[i] += pull;
            forces[j] -= pull;
        }
        for v in self.volumes.iter().flatten().filter(|v| v.stiffness > 0.0) {
            let [p, q, r, s] = v.nodes.map(|n| state.positions[n as usize]);
            let (a, b, c) = (q - p, r - p, s - p);
            let (ga, gb, gc) = (b.cross(c) / 6.0, c.cross(a) / 6.0, a.cross(b) / 6.0);
            let strain = (a.dot(ga) - v.rest) / v.scale;
            let k = -v.stiffness * strain / v.scale;
            let sum = ga + gb + gc;
            let squares = sum.length_squared() + ga.length_squared() + gb.length_squared() + gc.length_squared();
            stiffest = stiffest.max(squares * v.softness + strain.abs());
            forces[v.nodes[0] as usize] -= sum * k;
            forces[v.nodes[1] as usize] += ga * k;
            forces[v.nodes[2] as usize] += gb * k;
            forces[v.nodes[3] as usize] += gc * k;
        }
        for t in membrane.iter().flat_map(|m| m.triangles()) {
            for (n, f) in t.nodes.iter().zip(t.forces(t.nodes.map(|n| state.positions[n as usize].as_dvec3()))) {
                forces[*n as usize] += f.as_vec3();
            }
        }
        stiffest
    }

    /// The elastic forces of a state, N.
    #[must_use]
    pub fn elastic_forces(&self, state: &TissueState) -> Vec<Vec3> {
        let mut forces = vec![Vec3::ZERO; state.positions.len()];
        self.forces(state, None, 0.0, &mut forces);
        forces
    }

    /// Steps a body over one tick of `dt` s under gravity (m/s2) with this drag (1/s), and writes the forces at its contacts down.
    pub fn step(
        &self,
        settings: &TeschnerSettings,
        body: &Body,
        membrane: Option<&Membrane>,
        state: &mut TissueState,
        holds: &[Hold],
        gravity: Vec3,
        dt: f32,
        drag_1_s: f32,
        contacts: &mut [Contact],
    ) {
        let mut presses = Presses::new(body, contacts, |i| state.positions[i]);
        // The rest of a tick in even steps, as long as the stiffest volume lets them be.
        let next = |stiffest: f32, rest: f32| {
            let wanted = settings.step_s.unwrap_or_else(|| (settings.part_of_limit * self.limit_s / stiffest.sqrt()).max(dt / MOST_STEPS));
            // A hundredth of a step is rounding.
            rest / (rest / wanted - 0.01).ceil().max(1.0)
        };
        let driven = driven(holds, &state.positions);
        let inverse = inverse_masses(body.masses(), &driven);
        let mut forces = vec![Vec3::ZERO; state.positions.len()];
        let kick = |state: &mut TissueState, forces: &[Vec3], time: f32| {
            for ((v, f), w) in state.velocities.iter_mut().zip(forces).zip(&inverse) {
                if *w > 0.0 {
                    *v += (*f * *w + gravity) * time;
                }
            }
        };
        // Kick and drift in turn, the first and the last kick half ones: velocities at the ends of a tick are those of the paper's central difference.
        let guess = settings.step_s.unwrap_or(settings.part_of_limit * self.limit_s).min(dt);
        let mut h = next(self.forces(state, membrane, settings.damping * guess, &mut forces), dt);
        kick(state, &forces, h / 2.0);
        let mut rest = dt;
        while rest > 0.0 {
            let left = if h >= rest { 0.0 } else { rest - h };
            let s = 1.0 - left / dt;
            if drag_1_s > 0.0 {
                let drift = drift(body.masses(), &state.velocities, holds);
                let decay = (-drag_1_s * h).exp();
                for v in &mut state.velocities {
                    *v = drift + (*v - drift) * decay;
                }
            }
            for ((x, v), w) in state.positions.iter_mut().zip(&state.velocities).zip(&inverse) {
                if *w > 0.0 {
                    *x += *v * h;
                }
            }
            for (i, from, to) in &driven {
                state.positions[*i] = from.lerp(*to, s);
                state.velocities[*i] = (*to - *from) / dt;
            }
            for hold in holds.iter().filter(|hold| hold.fixes().is_none()) {
                let moved = hold.step(hold.gap(s, Vec3::ZERO, |i| state.positions[i]), h, |i| inverse[i]);
                for (n, weight) in &hold.point {
                    let moved = moved * (inverse[n.index()] * weight);
                    state.positions[n.index()] += moved;
                    state.velocities[n.index()] += moved / h;
                }
            }
            if !presses.is_empty() {
                let TissueState { positions, velocities } = &mut *state;
                let place = std::cell::RefCell::new((positions, velocities));
                let shift = |i: usize, by: Vec3| {
                    let (positions, velocities) = &mut *place.borrow_mut();
                    positions[i] += by;
                    velocities[i] += by / h;
                };
                presses.push_out(h, s * dt, |i| (place.borrow().0[i], inverse[i]), shift);
            }
            let stiffest = self.forces(state, membrane, settings.damping * h, &mut forces);
            if !stiffest.is_finite() {
                return;
            }
            let after = if left > 0.0 { next(stiffest, left) } else { 0.0 };
            kick(state, &forces, (h + after) / 2.0);
            (h, rest) = (after, left);
        }
        presses.write(contacts, dt);
    }
}
