//! Contacts: where an organ touches something, and what came of it. And what it may touch besides organs and instruments.

use crate::TissuePoint;
use bevy_ecs::prelude::*;
use bevy_math::Vec3;

/// What a point of tissue is in contact with.
#[derive(Clone, Debug, PartialEq)]
pub enum Obstacle {
    /// Anatomy that cannot deform: an entity with a [`StaticSurface`].
    Anatomy(Entity),
    /// An instrument: its shaft, its jaws or its blade.
    Instrument(Entity),
    /// Another organ, a fragment included. The other organ lists the same contact from its side: the points swapped, the normal reversed, the
    /// depth the same. A solver that treats one organ after the other takes half of the depth from each.
    Organ {
        /// The other organ.
        organ: Entity,
        /// Its point, in its nodes.
        point: TissuePoint,
    },
    /// The organ itself, folded over: this point of it. Listed once; what the contact does to `point` it does to this one in reverse.
    Own(TissuePoint),
}

impl Obstacle {
    /// The entity, if it is not the organ itself.
    #[must_use]
    pub fn entity(&self) -> Option<Entity> {
        match self {
            Self::Anatomy(entity) | Self::Instrument(entity) | Self::Organ { organ: entity, .. } => Some(*entity),
            Self::Own(_) => None,
        }
    }
}

/// A point of tissue that is inside an obstacle, or will be before the tick is over.
///
/// With `x` the point as it moves over a tick of `dt` s, at the time `t` from its beginning, the gap between tissue and obstacle is
/// `(x(t) - surface_m - velocity_m_s t) . normal`, at the beginning `-depth_m`. A solver lets no gap be negative at the tick's end, and pulls at
/// none that is positive.
#[derive(Clone, Debug, PartialEq)]
pub struct Contact {
    /// The point of the organ.
    pub point: TissuePoint,
    /// Unit vector from the obstacle to the tissue: the way out.
    pub normal: Vec3,
    /// How far the point is behind the obstacle's surface, along the normal, at the beginning of the tick, m: positive inside, negative while it is
    /// still outside.
    pub depth_m: f32,
    /// The point of the obstacle's surface where the tissue's point belongs, at the beginning of the tick, m.
    pub surface_m: Vec3,
    /// Velocity of the obstacle there, constant over the tick, m/s.
    pub velocity_m_s: Vec3,
    /// Coulomb's coefficient, the same at rest and sliding; 0 is frictionless.
    pub friction: f32,
    /// What the point is in contact with.
    pub against: Obstacle,
    /// Mean force of the obstacle on the tissue over the tick, friction included, N; zero until the organ has been stepped. Written by tissue.
    pub force_n: Vec3,
}

/// The contacts of an organ in this tick, in an order that depends on nothing but the state of the scene. Written by collision in each tick, but for
/// [`Contact::force_n`].
#[derive(Component, Clone, Debug, Default, PartialEq)]
pub struct Contacts(pub Vec<Contact>);

impl Contacts {
    /// Force (N) that the organ's contacts put on an obstacle, and torque (N m) about a point (m) that moves with the tick's beginning.
    #[must_use]
    pub fn wrench_on(&self, obstacle: Entity, about: Vec3) -> (Vec3, Vec3) {
        let mine = self.0.iter().filter(|c| c.against.entity() == Some(obstacle));
        mine.fold((Vec3::ZERO, Vec3::ZERO), |(force, torque), c| (force - c.force_n, torque - (c.surface_m - about).cross(c.force_n)))
    }
}

/// Where a part of an instrument is against another instrument or against anatomy, or near it.
#[derive(Clone, Debug, PartialEq)]
pub struct ToolTouch {
    /// The instrument's point at the end of the tick, m.
    pub point: Vec3,
    /// Unit vector from the obstacle to the instrument: the way out.
    pub normal: Vec3,
    /// How far the point is behind the obstacle's surface along the normal, m; negative while it is still outside. Of two instruments each lists
    /// the same, from its side: one that gives way gives half.
    pub depth_m: f32,
    /// Anatomy or another instrument.
    pub against: Obstacle,
}

/// What the rigid parts of an instrument are against besides tissue, at the end of the tick. Written by collision in each tick; an instrument that
/// collision does not look at has none.
#[derive(Component, Clone, Debug, Default, PartialEq)]
pub struct ToolContacts {
    /// All that is near, in an order that depends on nothing but the state of the scene.
    pub near: Vec<ToolTouch>,
    /// The instruments and the anatomy that are touched now, ascending.
    pub touching: Vec<Entity>,
    /// How often a touch has begun since the scene started.
    pub begun: u64,
}

/// An instrument has begun to touch another one, or anatomy. Written by collision; two instruments write one each.
#[derive(Message, Clone, Copy, Debug, PartialEq, Eq)]
pub struct ToolTouched {
    /// The instrument.
    pub instrument: Entity,
    /// What it touches.
    pub against: Entity,
}

/// A surface of anatomy that cannot deform, in the world: solid behind it. Closed, or open, as a piece of the abdominal wall: then it ends at its border.
/// Written by the scene.
#[derive(Component, Clone, Debug, Default, PartialEq)]
pub struct StaticSurface {
    /// Vertices, m.
    pub vertices: Vec<Vec3>,
    /// Triangles, counter-clockwise as seen from where tissue may be: of a cavity that holds tissue, as seen from inside the cavity.
    pub triangles: Vec<[u32; 3]>,
}

/// Coulomb's coefficient of the surface of an organ, an instrument or anatomy. Where two things touch it is the geometric mean of theirs; what has
/// none is as its kind's setting in collision says. Written by the scene.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct SurfaceFriction(pub f32);

#[cfg(test)]
mod tests {
    use super::*;
    use keyhole_tetmesh::NodeId;

    #[test]
    fn what_the_tissue_does_to_an_obstacle_is_what_it_does_to_the_tissue_in_reverse() {
        let mut world = World::new();
        let (tool, other) = (world.spawn_empty().id(), world.spawn_empty().id());
        let at = |entity, surface_m, force_n| Contact {
            point: std::iter::once((NodeId(0), 1.0)).collect(),
            normal: Vec3::Y,
            depth_m: 0.0,
            surface_m,
            velocity_m_s: Vec3::ZERO,
            friction: 0.0,
            against: Obstacle::Instrument(entity),
            force_n,
        };
        let contacts = Contacts(vec![at(tool, Vec3::X, 2.0 * Vec3::Y), at(other, Vec3::X, Vec3::Z), at(tool, -Vec3::X, 3.0 * Vec3::Y)]);
        // Torque about the origin: X x -2 Y - X x -3 Y = Z.
        assert_eq!(contacts.wrench_on(tool, Vec3::ZERO), (-5.0 * Vec3::Y, Vec3::Z));
    }
}
