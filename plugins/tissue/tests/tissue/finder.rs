//! Contacts by brute force: of nodes with a plane, of nodes with the tetrahedra of other bodies.

use bevy_ecs::prelude::Entity;
use bevy_math::{Mat3, Vec3};
use keyhole_tetmesh::{Boundary, NodeId, TetMesh};
use keyhole_tissue::beam::{beam_material, block};
use keyhole_tissue::{Body, Hold, Member, ModelState, TissueModel, TissueSettings, island};
use keyhole_whiteboard::{Contact, Contacts, Obstacle, OrganMaterial, OrganMaterials, TissuePoint, TissueState};
use smallvec::smallvec;

pub const DT: f32 = 1.0 / 60.0;

/// A half space that moves: solid below the plane.
#[derive(Clone, Copy, Debug)]
pub struct Ground {
    pub entity: Entity,
    pub point: Vec3,
    pub normal: Vec3,
    pub velocity: Vec3,
    pub friction: f32,
}

impl Ground {
    pub fn level(friction: f32) -> Self {
        Self { entity: entity(1000), point: Vec3::ZERO, normal: Vec3::Y, velocity: Vec3::ZERO, friction }
    }

    /// The nodes that are inside, or will be by the end of a tick at their velocity.
    pub fn find(&self, thing: &Thing, contacts: &mut Vec<Contact>) {
        for (i, (x, v)) in thing.state.positions.iter().zip(&thing.state.velocities).enumerate() {
            let gap = (*x - self.point).dot(self.normal);
            if gap <= 0.0 || gap <= -(*v - self.velocity).dot(self.normal) * DT {
                contacts.push(Contact {
                    point: smallvec![(NodeId(i as u32), 1.0)],
                    normal: self.normal,
                    depth_m: -gap,
                    surface_m: *x - self.normal * gap,
                    velocity_m_s: self.velocity,
                    friction: self.friction,
                    against: Obstacle::Instrument(self.entity),
                    force_n: Vec3::ZERO,
                });
            }
        }
    }
}

pub fn entity(index: u32) -> Entity {
    Entity::from_raw_u32(index).unwrap()
}

/// A body with everything that a tick needs.
#[derive(Clone, Debug)]
pub struct Thing {
    pub organ: Entity,
    pub mesh: TetMesh,
    pub body: Body,
    pub state: TissueState,
    pub holds: Vec<Hold>,
    pub contacts: Contacts,
    materials: OrganMaterials,
    surface: Vec<[NodeId; 3]>,
}

impl Thing {
    pub fn new(index: u32, mesh: TetMesh, young_modulus_pa: f32) -> Self {
        let material = OrganMaterial { young_modulus_pa, ..beam_material().0[0].clone() };
        let materials = OrganMaterials(vec![material]);
        let body = Body::new(&mesh, &materials).unwrap();
        let state = TissueState::at_rest(&mesh);
        let surface = Boundary::of(&mesh).triangles;
        Self { organ: entity(index), mesh, body, state, holds: Vec::new(), contacts: Contacts::default(), materials, surface }
    }

    /// A cube of 20 mm, its middle at a point.
    pub fn cube(index: u32, middle: Vec3, young_modulus_pa: f32) -> Self {
        let mut cube = Self::new(index, block([4, 4, 4], [0.02; 3]), young_modulus_pa);
        cube.shift(middle - Vec3::splat(0.01));
        cube
    }

    /// The state of a model for it.
    pub fn model(&self, model: TissueModel) -> ModelState {
        ModelState::new(model, None, &self.body, &self.mesh, &self.materials).unwrap()
    }

    pub fn shift(&mut self, by: Vec3) {
        self.state.positions.iter_mut().for_each(|x| *x += by);
    }

    pub fn mass(&self) -> f32 {
        self.body.masses().iter().sum()
    }

    pub fn velocity(&self) -> Vec3 {
        self.mean(&self.state.velocities)
    }

    pub fn middle(&self) -> Vec3 {
        self.mean(&self.state.positions)
    }

    fn mean(&self, of: &[Vec3]) -> Vec3 {
        let sum: bevy_math::DVec3 = self.body.masses().iter().zip(of).map(|(m, v)| v.as_dvec3() * f64::from(*m)).sum();
        (sum / self.body.masses().iter().map(|m| f64::from(*m)).sum::<f64>()).as_vec3()
    }

    /// Force on it from an obstacle, N.
    pub fn force_from(&self, obstacle: Entity) -> Vec3 {
        -self.contacts.wrench_on(obstacle, Vec3::ZERO).0
    }

    /// Kinetic and elastic energy, J.
    pub fn energy(&self) -> f64 {
        self.body.kinetic_energy(&self.state) + self.body.elastic_energy(&self.state)
    }

    /// The weights of a point in the tetrahedron that it is in.
    fn inside(&self, x: Vec3) -> Option<TissuePoint> {
        self.mesh.iter().find_map(|(_, corners)| {
            let [a, b, c, d] = corners.map(|n| self.state.position(n));
            let w = Mat3::from_cols(b - a, c - a, d - a).inverse() * (x - a);
            let all = [1.0 - w.x - w.y - w.z, w.x, w.y, w.z];
            all.iter().all(|w| *w >= 0.0).then(|| corners.into_iter().zip(all).collect())
        })
    }

    /// How far it is from a point inside to the surface along a unit vector, m.
    fn way_out(&self, x: Vec3, direction: Vec3) -> Option<f32> {
        let hit = |nodes: &[NodeId; 3]| {
            let [a, b, c] = nodes.map(|n| self.state.position(n));
            let w = Mat3::from_cols(b - a, c - a, -direction).inverse() * (x - a);
            (w.x >= -1e-4 && w.y >= -1e-4 && w.x + w.y <= 1.0002 && w.z >= 0.0).then_some(w.z)
        };
        self.surface.iter().filter_map(hit).min_by(f32::total_cmp)
    }
}

/// The nodes of each thing that are in another, with `axis` or its reverse as the way out: from the middle of the other to the node's own thing's.
pub fn find_between(things: &mut [Thing], axis: Vec3, friction: f32) {
    for a in 0..things.len() {
        for b in (0..things.len()).filter(|b| *b != a) {
            let normal = if (things[a].middle() - things[b].middle()).dot(axis) > 0.0 { axis } else { -axis };
            let low = things[b].state.positions.iter().fold(Vec3::INFINITY, |l, x| l.min(*x));
            let high = things[b].state.positions.iter().fold(Vec3::NEG_INFINITY, |h, x| h.max(*x));
            for node in 0..things[a].state.positions.len() {
                let at = things[a].state.positions[node];
                if at.cmplt(low).any() || at.cmpgt(high).any() {
                    continue;
                }
                let Some(inside) = things[b].inside(at) else { continue };
                let Some(depth_m) = things[b].way_out(at, normal) else { continue };
                let own: TissuePoint = smallvec![(NodeId(node as u32), 1.0)];
                let velocity = |t: &Thing, p: &TissuePoint| p.iter().map(|(n, w)| t.state.velocities[n.index()] * *w).sum::<Vec3>();
                let contact = |point: &TissuePoint, normal: Vec3, velocity_m_s, other: (Entity, &TissuePoint)| Contact {
                    point: point.clone(),
                    normal,
                    depth_m,
                    surface_m: at + normal * depth_m,
                    velocity_m_s,
                    friction,
                    against: Obstacle::Organ { organ: other.0, point: other.1.clone() },
                    force_n: Vec3::ZERO,
                };
                let mine = contact(&own, normal, velocity(&things[b], &inside), (things[b].organ, &inside));
                let theirs = contact(&inside, -normal, velocity(&things[a], &own), (things[a].organ, &own));
                things[a].contacts.0.push(mine);
                things[b].contacts.0.push(theirs);
            }
        }
    }
}

/// A tick of all things as one island.
pub fn tick(things: &mut [Thing], grounds: &[Ground], axis: Option<(Vec3, f32)>, gravity: Vec3, settings: &TissueSettings) {
    for thing in things.iter_mut() {
        let mut contacts = std::mem::take(&mut thing.contacts.0);
        contacts.clear();
        grounds.iter().for_each(|g| g.find(thing, &mut contacts));
        thing.contacts.0 = contacts;
    }
    if let Some((axis, friction)) = axis {
        find_between(things, axis, friction);
    }
    let mut members: Vec<Member<'_>> = things
        .iter_mut()
        .map(|t| Member {
            organ: t.organ,
            body: &mut t.body,
            membrane: None,
            state: &mut t.state,
            holds: &t.holds,
            contacts: &mut t.contacts.0,
            light: &mut [],
            crumb: false,
        })
        .collect();
    island::step(&mut members, gravity, DT, settings);
    assert!(things.iter().all(|t| t.state.positions.iter().all(|x| x.is_finite())));
}
