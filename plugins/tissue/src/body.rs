//! A soft body: elements, lumped masses and colours of one organ. Positions and velocities live outside, in `TissueState`.

use crate::colouring::Colouring;
use crate::element::Element;
use crate::graph::EdgeGraph;
use crate::hold::Hold;
use crate::implicit::Implicit;
use crate::island::{self, Member};
use crate::material::{MaterialError, NeoHookean};
use crate::membrane::Membrane;
use crate::settings::TissueSettings;
use crate::sleep::Sleep;
use crate::xpbd::Xpbd;
use bevy_ecs::prelude::Entity;
use bevy_math::{DVec3, Vec3, Vec3A};
use keyhole_tetmesh::{NodeId, TetId, TetMesh};
use keyhole_whiteboard::{Contact, OrganMaterials, TissueState};

/// Everything about an organ that a time step needs and that only a topology change alters.
#[derive(Clone, Debug, Default)]
pub struct Body {
    /// Elements by tetrahedron slot; unused slots are [`Element::VACANT`].
    pub(crate) elements: Vec<Element>,
    /// Mass by node slot, kg: a quarter of each tetrahedron's.
    pub(crate) masses: Vec<f32>,
    /// Elements by colour.
    pub(crate) colouring: Colouring,
    /// Edges of the elements.
    pub(crate) graph: EdgeGraph,
    /// What the implicit solver keeps.
    pub(crate) implicit: Implicit,
    /// What position-based dynamics keeps.
    pub(crate) xpbd: Xpbd,
    /// Whether the body sleeps.
    pub(crate) sleep: Sleep,
    /// Constants and density (kg/m3) by material id.
    materials: Vec<(NeoHookean, f64)>,
    /// Rest position by node slot, m.
    rest: Vec<Vec3>,
}

/// Sums over the nodes of a body.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Momentum {
    /// kg.
    pub mass: f64,
    /// kg m/s.
    pub linear: DVec3,
    /// About the origin, kg m2/s.
    pub angular: DVec3,
    /// Sum of the magnitudes of the nodes' momenta, kg m/s: what a change of `linear` is to be compared with.
    pub scale: f64,
}

impl Momentum {
    /// Adds a node.
    pub fn add(&mut self, mass: f32, position: Vec3, velocity: Vec3) {
        let momentum = velocity.as_dvec3() * f64::from(mass);
        self.mass += f64::from(mass);
        self.linear += momentum;
        self.angular += position.as_dvec3().cross(momentum);
        self.scale += momentum.length();
    }

    /// The sum of both.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            mass: self.mass + other.mass,
            linear: self.linear + other.linear,
            angular: self.angular + other.angular,
            scale: self.scale + other.scale,
        }
    }
}

impl Body {
    /// The body of a mesh.
    ///
    /// # Errors
    /// When a material has constants that no material has.
    pub fn new(mesh: &TetMesh, materials: &OrganMaterials) -> Result<Self, MaterialError> {
        let materials =
            materials.0.iter().map(|m| Ok((NeoHookean::of(m)?, f64::from(m.density_kg_m3)))).collect::<Result<Vec<_>, MaterialError>>()?;
        let mut body = Self { materials, ..Self::default() };
        // Room to grow, so that the first cuts move no arrays.
        body.elements.reserve(2 * mesh.tet_slots());
        body.masses.reserve(2 * mesh.node_slots());
        body.rest.reserve(2 * mesh.node_slots());
        body.graph.reserve(2 * mesh.tet_slots());
        body.colouring.reserve(2 * mesh.tet_slots());
        body.elements.resize(mesh.tet_slots(), Element::VACANT);
        body.masses.resize(mesh.node_slots(), 0.0);
        for (tet, corners) in mesh.iter() {
            body.elements[tet.index()] = body.element(mesh, tet);
            body.colouring.insert(tet, corners, mesh.topology());
            body.graph.insert(tet.index(), corners.map(|n| n.0));
        }
        for node in mesh.nodes() {
            body.lump(mesh, node);
        }
        body.implicit.newton.build(mesh, &body.elements);
        Ok(body)
    }

    /// Elements by tetrahedron slot.
    #[must_use]
    pub fn elements(&self) -> &[Element] {
        &self.elements
    }

    /// Masses by node slot, kg; 0 for nodes that no tetrahedron uses.
    #[must_use]
    pub fn masses(&self) -> &[f32] {
        &self.masses
    }

    /// Rest positions by node slot, m.
    #[must_use]
    pub(crate) fn rest(&self) -> &[Vec3] {
        &self.rest
    }

    /// Hangs a weight of `mass_kg` on a node, which it is from then on heavier by. A topology change that touches the node takes it off.
    pub fn hang(&mut self, node: NodeId, mass_kg: f32) {
        if let Some(mass) = self.masses.get_mut(node.index()).filter(|m| **m > 0.0) {
            *mass += mass_kg;
        }
        self.wake();
    }

    /// Elements by colour.
    #[must_use]
    pub fn colouring(&self) -> &Colouring {
        &self.colouring
    }

    /// Steps the body over one tick of `dt` s under gravity (m/s2) by [`crate::implicit`], unless it sleeps; for all models see [`crate::ModelState::step`]. Nothing here looks whether the result is finite: see [`crate::Guard`].
    pub fn step(&mut self, state: &mut TissueState, holds: &[Hold], gravity: Vec3, dt: f32, settings: &TissueSettings) {
        self.step_with(None, state, holds, gravity, dt, settings);
    }

    /// The same with a capsule.
    pub fn step_with(
        &mut self,
        membrane: Option<&Membrane>,
        state: &mut TissueState,
        holds: &[Hold],
        gravity: Vec3,
        dt: f32,
        settings: &TissueSettings,
    ) {
        let organ = Entity::PLACEHOLDER;
        island::step(
            &mut [Member { organ, body: self, membrane, state, holds, contacts: &mut [], light: &mut [], crumb: false }],
            gravity,
            dt,
            settings,
        );
    }

    /// Whether a step would do nothing: the body has been still for half a second and nothing has changed since.
    #[must_use]
    pub fn is_asleep(&self, state: &TissueState, holds: &[Hold], gravity: Vec3) -> bool {
        self.sleep.holds_on(state, holds, gravity)
    }

    /// Whether a step would do nothing but repeat the forces at its contacts: it sleeps and touches what it touched when it fell asleep.
    pub(crate) fn rests(&mut self, state: &TissueState, holds: &[Hold], contacts: &[Contact], gravity: Vec3) -> bool {
        self.is_asleep(state, holds, gravity) && self.sleep.touches_alike(contacts)
    }

    /// Writes the forces of the last tick at its contacts down again.
    pub(crate) fn repeat_forces(&self, contacts: &mut [Contact]) {
        for contact in contacts {
            contact.force_n = self.implicit.grips.of(contact).unwrap_or(Vec3::ZERO);
        }
    }

    /// Wakes a body that sleeps: something is about to touch it. Holds that change and topology changes wake it by themselves.
    pub fn wake(&mut self) {
        self.sleep.wake();
    }

    /// The corners of the box around a body that sleeps, m.
    #[must_use]
    pub fn sleeping_bounds(&self) -> Option<(Vec3, Vec3)> {
        self.sleep.bounds()
    }

    /// Bytes that the implicit solver keeps for this body: everything that a body on its own has but masses and elements.
    #[must_use]
    pub fn solver_bytes(&self) -> usize {
        self.implicit.bytes() + self.masses.capacity() * 4
    }

    /// Iterations of conjugate gradients of the last tick of the implicit solver, and its substeps that had to be done carefully.
    #[must_use]
    pub fn solver_report(&self) -> (u32, u32) {
        (self.implicit.newton.iterations, self.implicit.careful)
    }

    /// Number of small and of large clusters of nodes of the implicit solver: the work of a step that is not in proportion to the mesh grows with the latter.
    #[must_use]
    pub fn solver_clusters(&self) -> (usize, usize) {
        self.implicit.newton.clusters.count()
    }

    /// Edges of the elements.
    #[must_use]
    pub fn graph(&self) -> &EdgeGraph {
        &self.graph
    }

    /// Elastic forces on the nodes, N.
    #[must_use]
    pub fn forces(&self, state: &TissueState) -> Vec<Vec3> {
        let x: Vec<Vec3A> = state.positions.iter().map(|x| Vec3A::from(*x)).collect();
        self.implicit.newton.forces(&x).into_iter().map(Vec3::from).collect()
    }

    /// Momentum of the whole body.
    #[must_use]
    pub fn momentum(&self, state: &TissueState) -> Momentum {
        let mut sum = Momentum::default();
        for ((m, x), v) in self.masses.iter().zip(&state.positions).zip(&state.velocities) {
            if *m > 0.0 {
                sum.add(*m, *x, *v);
            }
        }
        sum
    }

    /// Elastic energy of the whole body, J.
    #[must_use]
    pub fn elastic_energy(&self, state: &TissueState) -> f64 {
        let at = |e: &Element| e.energy(e.indices().map(|i| state.positions[i]));
        self.elements.iter().filter(|e| !e.is_empty()).map(at).sum()
    }

    /// Kinetic energy of the whole body, J.
    #[must_use]
    pub fn kinetic_energy(&self, state: &TissueState) -> f64 {
        let of = |(m, v): (&f32, &Vec3)| if *m > 0.0 { f64::from(*m) * v.as_dvec3().length_squared() / 2.0 } else { 0.0 };
        self.masses.iter().zip(&state.velocities).map(of).sum()
    }

    /// The element of a tetrahedron of `mesh`.
    pub(crate) fn element(&self, mesh: &TetMesh, tet: TetId) -> Element {
        let (constants, _) = self.material(mesh, tet);
        let rest = mesh.points(tet).map(|p| DVec3::new(p.x, p.y, p.z));
        Element::new(mesh.corners(tet).map(|n| n.0), rest, constants)
    }

    /// Lumps the mass of a node anew. Summed in ascending order of tetrahedron, so that the history of the mesh does not matter.
    pub(crate) fn lump(&mut self, mesh: &TetMesh, node: NodeId) {
        let mut around = mesh.topology().around_node(node).to_vec();
        around.sort_unstable();
        let mass: f64 = around.iter().map(|t| self.material(mesh, *t).1 * mesh.volume(*t) / 4.0).sum();
        self.masses[node.index()] = mass as f32;
        if self.rest.len() <= node.index() {
            self.rest.resize(self.masses.len(), Vec3::ZERO);
        }
        self.rest[node.index()] = mesh.rest(node).as_vec3();
    }

    /// A length of the body of this mass (kg): the edge of the cube of its volume, m.
    pub(crate) fn size(&self, mass: f64) -> f64 {
        self.materials.first().map_or(0.0, |(_, density)| (mass / density).cbrt())
    }

    /// The nodes that there are but for those of crumbs, ascending.
    pub(crate) fn nodes(&self) -> Vec<u32> {
        let crumbs = &self.implicit.newton.crumbs;
        let is = |(n, mass): (usize, &f32)| (*mass > 0.0 && !crumbs.contains(n)).then_some(n as u32);
        self.masses.iter().enumerate().filter_map(is).collect()
    }

    /// About the mean length of its edges, m.
    pub(crate) fn usual_edge(&self) -> f32 {
        let (nodes, mass) = self.masses.iter().filter(|m| **m > 0.0).fold((0, 0.0), |(n, sum), m| (n + 1, sum + f64::from(*m)));
        (self.size(mass) / f64::from(nodes.max(1)).cbrt()) as f32
    }

    fn material(&self, mesh: &TetMesh, tet: TetId) -> (NeoHookean, f64) {
        let id = usize::from(mesh.tet(tet).material.0);
        self.materials[id.min(self.materials.len() - 1)]
    }
}
