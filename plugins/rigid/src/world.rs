//! Rapier's world around the rigid bodies of a scene: what is in it, and one tick of it.
//!
//! Bodies are dynamic, or kinematic while an instrument holds them. Anatomy is fixed. The parts of instruments are kinematic bodies, and so are the
//! pieces of tissue's surface that are near a body ([`crate::surface`]): tissue carries what lies on it and does not feel it.

use crate::convert::{from_rapier, length_to_rapier, pose_from_rapier, pose_to_rapier, to_rapier, turn_from_rapier, turn_to_rapier};
use crate::shape::Built;
use bevy_ecs::entity::Entity;
use bevy_math::{Isometry3d, Vec3};
use keyhole_whiteboard::RigidPose;
use rapier3d::dynamics::{CoefficientCombineRule, RigidBodyBuilder, RigidBodyHandle, RigidBodyType, SpringCoefficients};
use rapier3d::geometry::{ColliderBuilder, ColliderHandle, SharedShape, SolverFlags, TriMesh, TriMeshFlags};
use rapier3d::pipeline::{ActiveHooks, CollisionPipeline, PairFilterContext, PhysicsHooks, PhysicsPipeline, PhysicsWorld};
use std::collections::BTreeMap;

/// Largest speed of a body, m/s: a guard of rapier's, far above any in a theatre.
const MOST_SPEED_M_S: f32 = 400.0;

/// Natural frequency of a contact in those of rapier's substeps. Measured: a clip sinks 7 micrometres into the floor that it lies on; at rapier's own 60 Hz
/// it is 104.
const CONTACT_FREQUENCY: f32 = 0.5;

/// Damping ratio of a contact: from 1 to 10 friction and rest are the same within 1 %.
const CONTACT_DAMPING: f32 = 5.0;

/// Everything rigid of a scene.
pub struct RigidWorld {
    physics: PhysicsWorld,
    bodies: BTreeMap<Entity, Member>,
    tools: BTreeMap<Entity, Vec<RigidBodyHandle>>,
    anatomy: BTreeMap<Entity, ColliderHandle>,
    /// By the body that they are near, and the organ whose surface they are.
    pieces: BTreeMap<(Entity, Entity), RigidBodyHandle>,
}

#[derive(Clone)]
struct Member {
    handle: RigidBodyHandle,
    collider: ColliderHandle,
    reach_m: f32,
    last: RigidPose,
    lost: bool,
}

impl Clone for RigidWorld {
    /// The same bodies with the same memory of their contacts. Rapier's pipelines are room to work in, and are made anew.
    fn clone(&self) -> Self {
        let of = &self.physics;
        let physics = PhysicsWorld {
            gravity: of.gravity,
            integration_parameters: of.integration_parameters,
            physics_pipeline: PhysicsPipeline::new(),
            collision_pipeline: CollisionPipeline::new(),
            islands: of.islands.clone(),
            broad_phase: of.broad_phase.clone(),
            narrow_phase: of.narrow_phase.clone(),
            bodies: of.bodies.clone(),
            colliders: of.colliders.clone(),
            impulse_joints: of.impulse_joints.clone(),
            multibody_joints: of.multibody_joints.clone(),
            soft_bodies: of.soft_bodies.clone(),
            ccd_solver: of.ccd_solver.clone(),
        };
        Self { physics, bodies: self.bodies.clone(), tools: self.tools.clone(), anatomy: self.anatomy.clone(), pieces: self.pieces.clone() }
    }
}

/// A piece of the surface of tissue as it is at the end of a tick, that moves evenly during the tick.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Piece {
    /// Vertices at the tick's end, m.
    pub vertices: Vec<Vec3>,
    /// Triangles, counter-clockwise from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Its velocity, m/s.
    pub velocity_m_s: Vec3,
    /// Coulomb's coefficient.
    pub friction: f32,
}

/// Where a body is at the beginning and at the end of a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// At the beginning.
    pub from: Isometry3d,
    /// At the end.
    pub to: Isometry3d,
}

impl Motion {
    fn at(&self, part: f32) -> Isometry3d {
        let turn = self.from.rotation.slerp(self.to.rotation, part);
        Isometry3d::new(self.from.translation.lerp(self.to.translation, part), turn)
    }
}

/// A piece of tissue's surface touches the body that it was taken for, and no other: pieces of neighbours overlap.
struct OwnPieces;

impl PhysicsHooks for OwnPieces {
    fn filter_contact_pair(&self, context: &PairFilterContext) -> Option<SolverFlags> {
        let of = |handle: ColliderHandle| context.colliders.get(handle).map_or(0, |c| c.user_data);
        (of(context.collider1) == of(context.collider2)).then_some(SolverFlags::COMPUTE_RIGID_IMPULSES)
    }
}

impl Default for RigidWorld {
    fn default() -> Self {
        Self::new()
    }
}

impl RigidWorld {
    /// An empty world.
    #[must_use]
    pub fn new() -> Self {
        let mut physics = PhysicsWorld::new();
        let parameters = &mut physics.integration_parameters;
        // A contact that is taken over from the step before is wrong by up to half a millimetre.
        parameters.contact_recycling = false;
        parameters.normalized_max_linear_velocity = length_to_rapier(MOST_SPEED_M_S);
        Self { physics, bodies: BTreeMap::new(), tools: BTreeMap::new(), anatomy: BTreeMap::new(), pieces: BTreeMap::new() }
    }

    /// Bodies that are moved: neither held nor asleep nor lost.
    #[must_use]
    pub fn awake(&self) -> usize {
        self.bodies.values().filter(|m| self.moves(m)).count()
    }

    fn moves(&self, member: &Member) -> bool {
        !member.lost && self.physics.bodies.get(member.handle).is_some_and(|b| b.is_dynamic() && !b.is_sleeping())
    }

    /// The bodies that nothing holds, ascending: where they are, and how far they reach from their frame's origin, m.
    pub fn free_bodies(&self) -> impl Iterator<Item = (Entity, &RigidPose, f32)> + '_ {
        let free = |m: &Member| !m.lost && self.physics.bodies.get(m.handle).is_some_and(|b| b.is_dynamic());
        self.bodies.iter().filter(move |(_, m)| free(m)).map(|(entity, m)| (*entity, &m.last, m.reach_m))
    }

    /// Puts a body where it is, with its velocities.
    pub fn insert_body(&mut self, body: Entity, built: &Built, at: &RigidPose, friction: f32) {
        self.remove_body(body);
        let mine = u128::from(body.to_bits());
        let rigid = RigidBodyBuilder::dynamic()
            .pose(pose_to_rapier(at.now))
            .linvel(to_rapier(at.linear_m_s))
            .angvel(turn_to_rapier(at.angular_rad_s))
            .additional_mass_properties(built.properties())
            .allow_fast_rotation(true)
            .gyroscopic_forces_enabled(true)
            .ccd_enabled(true);
        let collider = with_friction(ColliderBuilder::new(built.shape.clone()).density(0.0), friction).user_data(mine);
        let (handle, collider) = self.physics.insert(rigid, collider);
        self.bodies.insert(body, Member { handle, collider, reach_m: built.reach_m(), last: *at, lost: false });
    }

    /// Takes a body off, and the pieces of tissue that were there for it.
    pub fn remove_body(&mut self, body: Entity) {
        if let Some(member) = self.bodies.remove(&body) {
            self.physics.remove_body(member.handle);
        }
        let gone: Vec<_> = self.pieces.keys().copied().filter(|k| k.0 == body).collect();
        for (body, organ) in gone {
            self.remove_piece(body, organ);
        }
    }

    /// Keeps the bodies, instruments and anatomy that `stays` says, and takes all others off.
    pub fn retain(&mut self, stays: impl Fn(Entity) -> bool) {
        let gone: Vec<Entity> = self.bodies.keys().copied().filter(|e| !stays(*e)).collect();
        for body in gone {
            self.remove_body(body);
        }
        let gone: Vec<Entity> = self.tools.keys().copied().filter(|e| !stays(*e)).collect();
        for part in gone.into_iter().flat_map(|tool| self.tools.remove(&tool).unwrap_or_default()).collect::<Vec<_>>() {
            self.physics.remove_body(part);
        }
        let gone: Vec<Entity> = self.anatomy.keys().copied().filter(|e| !stays(*e)).collect();
        for entity in gone {
            if let Some(collider) = self.anatomy.remove(&entity) {
                self.physics.remove_collider(collider);
            }
        }
    }

    /// Puts anatomy that does not move: a surface of triangles, counter-clockwise from where bodies may be. Gives what is wrong with it, if anything is.
    ///
    /// # Errors
    /// When no tree can be built of the triangles.
    pub fn insert_anatomy(&mut self, entity: Entity, vertices: &[Vec3], triangles: &[[u32; 3]], friction: f32) -> Result<(), String> {
        let shape = surface(vertices, triangles)?;
        let collider = with_friction(ColliderBuilder::new(shape), friction);
        if let Some(old) = self.anatomy.insert(entity, self.physics.insert_collider(collider, None)) {
            self.physics.remove_collider(old);
        }
        Ok(())
    }

    /// Puts the parts of an instrument, each at a pose of its own.
    pub(crate) fn insert_tool(&mut self, tool: Entity, parts: &[(SharedShape, Isometry3d)], friction: f32) {
        let handles = parts.iter().map(|(shape, at)| {
            let body = RigidBodyBuilder::kinematic_position_based().pose(pose_to_rapier(*at));
            self.physics.insert(body, with_friction(ColliderBuilder::new(shape.clone()), friction)).0
        });
        let handles = handles.collect();
        self.tools.insert(tool, handles);
    }

    /// Puts a piece of tissue's surface near a body in the place of the one that was there.
    ///
    /// # Errors
    /// When no tree can be built of the triangles: then there is no piece.
    pub fn set_piece(&mut self, body: Entity, organ: Entity, piece: &Piece, dt_s: f32) -> Result<(), String> {
        self.remove_piece(body, organ);
        if piece.triangles.is_empty() {
            return Ok(());
        }
        let shape = surface(&piece.vertices, &piece.triangles)?;
        let rigid = RigidBodyBuilder::kinematic_velocity_based()
            .translation(to_rapier(-piece.velocity_m_s * dt_s))
            .linvel(to_rapier(piece.velocity_m_s));
        let collider = with_friction(ColliderBuilder::new(shape), piece.friction)
            .user_data(u128::from(body.to_bits()))
            .active_hooks(ActiveHooks::FILTER_CONTACT_PAIRS);
        self.pieces.insert((body, organ), self.physics.insert(rigid, collider).0);
        Ok(())
    }

    /// A piece of tissue stays where it is for a tick.
    pub fn rest_piece(&mut self, body: Entity, organ: Entity) {
        if let Some(rigid) = self.pieces.get(&(body, organ)).and_then(|h| self.physics.bodies.get_mut(*h))
            && rigid.linvel() != to_rapier(Vec3::ZERO)
        {
            rigid.set_linvel(to_rapier(Vec3::ZERO), false);
            rigid.set_position(pose_to_rapier(Isometry3d::IDENTITY), false);
        }
    }

    /// Takes a piece of tissue off.
    pub fn remove_piece(&mut self, body: Entity, organ: Entity) {
        if let Some(handle) = self.pieces.remove(&(body, organ)) {
            self.physics.remove_body(handle);
        }
    }

    /// A tick of `dt_s` under gravity (m/s2). Held bodies and the parts of instruments go where they are told. Gives the bodies that left the finite
    /// numbers: each is back where it was last finite, and no longer moved.
    pub fn tick(
        &mut self,
        dt_s: f32,
        steps: u32,
        gravity: Vec3,
        held: &BTreeMap<Entity, Motion>,
        tools: &BTreeMap<Entity, Vec<Motion>>,
    ) -> Vec<Entity> {
        self.physics.gravity = to_rapier(gravity);
        let parameters = &mut self.physics.integration_parameters;
        parameters.dt = dt_s / steps.max(1) as f32;
        let substeps_hz = parameters.num_solver_iterations as f32 / parameters.dt;
        let softness = SpringCoefficients::new(CONTACT_FREQUENCY * substeps_hz, CONTACT_DAMPING);
        (parameters.contact_softness, parameters.static_contact_softness) = (softness, softness);
        self.hold(held);
        for step in 1..=steps.max(1) {
            let part = step as f32 / steps.max(1) as f32;
            let holding = held.iter().filter_map(|(body, motion)| Some((self.bodies.get(body)?.handle, motion)));
            let parts = tools.iter().filter_map(|(tool, motions)| Some(self.tools.get(tool)?.iter().copied().zip(motions))).flatten();
            for (handle, motion) in holding.chain(parts) {
                if let Some(rigid) = self.physics.bodies.get_mut(handle)
                    && (motion.from != motion.to || *rigid.position() != pose_to_rapier(motion.to))
                {
                    rigid.set_next_kinematic_position(pose_to_rapier(motion.at(part)));
                }
            }
            self.physics.step_with_events(&OwnPieces, &());
        }
        self.read_back(held, dt_s)
    }

    /// Bodies that are held become kinematic, those let go dynamic again with the velocities of their last tick.
    fn hold(&mut self, held: &BTreeMap<Entity, Motion>) {
        for (entity, member) in &mut self.bodies {
            let Some(rigid) = self.physics.bodies.get_mut(member.handle).filter(|_| !member.lost) else { continue };
            match held.get(entity) {
                Some(motion) if rigid.is_dynamic() => {
                    rigid.set_body_type(RigidBodyType::KinematicPositionBased, true);
                    rigid.set_position(pose_to_rapier(motion.from), true);
                    // What is between jaws does not push them apart.
                    if let Some(collider) = self.physics.colliders.get_mut(member.collider) {
                        collider.set_enabled(false);
                    }
                }
                None if rigid.is_kinematic() => {
                    rigid.set_body_type(RigidBodyType::Dynamic, true);
                    rigid.set_linvel(to_rapier(member.last.linear_m_s), true);
                    rigid.set_angvel(turn_to_rapier(member.last.angular_rad_s), true);
                    if let Some(collider) = self.physics.colliders.get_mut(member.collider) {
                        collider.set_enabled(true);
                    }
                }
                _ => {}
            }
        }
    }

    fn read_back(&mut self, held: &BTreeMap<Entity, Motion>, dt_s: f32) -> Vec<Entity> {
        let mut broken = Vec::new();
        for (entity, member) in self.bodies.iter_mut().filter(|(_, m)| !m.lost) {
            let Some(rigid) = self.physics.bodies.get_mut(member.handle) else { continue };
            let before = member.last.now;
            let now = pose_from_rapier(rigid.position());
            let (mut linear_m_s, mut angular_rad_s) = (from_rapier(rigid.linvel()), turn_from_rapier(rigid.angvel()));
            let centre = from_rapier(rigid.local_center_of_mass());
            if let Some(motion) = held.get(entity) {
                linear_m_s = (motion.to * centre - motion.from * centre) / dt_s;
                angular_rad_s = (motion.to.rotation * motion.from.rotation.inverse()).to_scaled_axis() / dt_s;
            }
            let finite = rigid.is_enabled()
                && now.rotation.is_finite()
                && now.translation.is_finite()
                && linear_m_s.is_finite()
                && angular_rad_s.is_finite();
            if finite {
                member.last = RigidPose { now, before, linear_m_s, angular_rad_s, asleep: rigid.is_sleeping() };
            } else {
                rigid.set_enabled(false);
                member.lost = true;
                member.last = RigidPose { linear_m_s: Vec3::ZERO, angular_rad_s: Vec3::ZERO, before, asleep: true, ..member.last };
                broken.push(*entity);
            }
        }
        broken
    }

    /// Where a body is and how it moves.
    #[must_use]
    pub fn pose(&self, body: Entity) -> Option<&RigidPose> {
        self.bodies.get(&body).map(|m| &m.last)
    }

    /// Wakes a body that sleeps.
    pub fn wake(&mut self, body: Entity) {
        if let Some(member) = self.bodies.get(&body) {
            self.physics.wake_up(member.handle, true);
        }
    }
}

/// Restitution is zero wherever things touch, and friction the geometric mean of both sides.
fn with_friction(collider: ColliderBuilder, friction: f32) -> ColliderBuilder {
    collider.friction(friction).friction_combine_rule(CoefficientCombineRule::GeometricMean).restitution(0.0)
}

/// A surface that pushes to its outer side alone.
fn surface(vertices: &[Vec3], triangles: &[[u32; 3]]) -> Result<SharedShape, String> {
    let vertices = vertices.iter().map(|v| to_rapier(*v)).collect();
    let mesh = TriMesh::with_flags(vertices, triangles.to_vec(), TriMeshFlags::ORIENTED).map_err(|error| error.to_string())?;
    Ok(SharedShape::new(mesh))
}
