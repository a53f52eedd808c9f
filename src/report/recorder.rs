//! Watches an app from outside, after each update, and sums up at the end. The simulation never knows.

use crate::report::bleeding::Bleeding;
use crate::report::cost::Costs;
use crate::report::digest::digest;
use crate::report::summary::{Cut, Cutting, Fragment, MeshSize, MomentumChange, Summary};
use crate::simulation::TICKS_PER_SECOND;
use crate::theatre::Theatre;
use bevy::math::DVec3;
use bevy::prelude::*;
use keyhole_tissue::{Quarantined, TissueBody, TissueReport};
use keyhole_whiteboard::{Attachments, Contacts, CutSettings, CutStatus, FreedFrom, Gravity, Organ, TickCost, TissueMesh, TissueState};

/// Ticks between two entries of a fragment's path.
const TICKS_PER_ENTRY: u64 = TICKS_PER_SECOND as u64 / 10;

/// What has been seen so far.
#[derive(Debug, Default)]
pub struct Recorder {
    costs: Costs,
    size_before: (usize, usize),
    ticks: u64,
    paths: Vec<Path>,
}

/// The way of a freed fragment.
#[derive(Debug)]
struct Path {
    organ: Entity,
    came_tick: u64,
    /// Since when nothing holds it, and where and how fast it was then.
    start_tick: u64,
    start: DVec3,
    velocity: DVec3,
    off_m: f64,
    fragment: Fragment,
}

/// Mass (kg), centre of mass (m) and its velocity (m/s).
struct Motion {
    mass: f64,
    centre: DVec3,
    velocity: DVec3,
}

impl Recorder {
    /// A recorder of an app before its first tick.
    pub fn new(world: &mut World) -> Self {
        Self { size_before: size(world), ..Self::default() }
    }

    /// Takes down a tick that has just ended.
    pub fn record(&mut self, world: &mut World) {
        let cost = world.resource::<TickCost>();
        self.ticks = cost.ticks;
        self.costs.record(cost);
        self.follow_fragments(world);
    }

    /// The costs so far.
    #[must_use]
    pub fn costs(&self) -> &Costs {
        &self.costs
    }

    /// Everything so far, in the state that the world is in.
    pub fn summary(&self, world: &mut World) -> Summary {
        let (tets_after, nodes_after) = size(world);
        let (tets_before, nodes_before) = self.size_before;
        let mut frozen = world.query_filtered::<&Organ, With<Quarantined>>();
        let quarantined = frozen.iter(world).map(|o| o.name.clone()).collect();
        let digest = digest(world);
        let bleeding = Bleeding::of(world);
        let status = world.resource::<CutStatus>();
        let tissue = world.resource::<TissueReport>();
        let mut summary = Summary {
            scene: world.resource::<Theatre>().scene.name.clone(),
            ticks: self.ticks,
            simulated_s: self.ticks as f64 / TICKS_PER_SECOND,
            cutting: Cutting::from(world.resource::<CutSettings>()),
            mesh: MeshSize { tets_before, tets_after, nodes_before, nodes_after },
            cut: Cut {
                deleted: status.deleted,
                created: status.created,
                updated: status.updated,
                deferred: status.deferred,
                strokes: status.strokes,
                fragments: status.fragments,
            },
            fragments: self.paths.iter().map(|p| p.fragment.clone()).collect(),
            momentum: MomentumChange { largest_jump: tissue.momentum_jump, largest_error: tissue.momentum_error },
            bleeding,
            quarantined,
            digest,
            ..Summary::default()
        };
        summary.set_costs(&self.costs);
        summary
    }

    fn follow_fragments(&mut self, world: &mut World) {
        let gravity = world.resource::<Gravity>().0.as_dvec3();
        let mut fragments = world.query::<(Entity, &Organ, &FreedFrom, &TissueBody, &TissueState, &Attachments, &Contacts)>();
        let mut found: Vec<_> = fragments.iter(world).collect();
        found.sort_unstable_by_key(|(entity, ..)| *entity);
        for (organ, name, freed, body, state, attachments, contacts) in found {
            let Some(motion) = motion(body.body.masses(), state) else { continue };
            let now_s = self.ticks as f64 / TICKS_PER_SECOND;
            let path = match self.paths.iter().position(|p| p.organ == organ) {
                Some(i) => &mut self.paths[i],
                None => {
                    let fragment = Fragment { name: name.name.clone(), freed_at_s: freed.time_s, mass_kg: motion.mass, ..default() };
                    let (start, velocity) = (motion.centre, motion.velocity);
                    self.paths.push(Path { organ, start_tick: self.ticks, start, velocity, off_m: 0.0, came_tick: self.ticks, fragment });
                    let last = self.paths.len() - 1;
                    &mut self.paths[last]
                }
            };
            path.fragment.held = !attachments.0.is_empty();
            if path.fragment.held {
                // It falls from where it is let go.
                (path.start_tick, path.start, path.velocity, path.off_m) = (self.ticks, motion.centre, motion.velocity, 0.0);
                path.fragment.touched_at_s = None;
            } else if path.fragment.touched_at_s.is_none() && contacts.0.iter().any(|c| c.force_n != Vec3::ZERO) {
                path.fragment.touched_at_s = Some(now_s);
            }
            let t = (self.ticks - path.start_tick) as f64 / TICKS_PER_SECOND;
            let free_fall = path.start + path.velocity * t + gravity * (t * t / 2.0);
            if path.fragment.touched_at_s.is_none() {
                path.off_m = path.off_m.max(motion.centre.distance(free_fall));
            }
            path.fragment.speed_m_s = motion.velocity.length();
            path.fragment.mass_kg = motion.mass;
            path.fragment.off_free_fall_m = (!path.fragment.held).then_some(path.off_m);
            path.fragment.fallen_m = (motion.centre - path.start).dot(gravity.normalize_or_zero());
            if (self.ticks - path.came_tick).is_multiple_of(TICKS_PER_ENTRY) {
                let c = motion.centre;
                path.fragment.centre_of_mass.push([now_s, c.x, c.y, c.z]);
            }
        }
    }
}

/// `None` without mass.
fn motion(masses: &[f32], state: &TissueState) -> Option<Motion> {
    let (mut mass, mut moment, mut momentum) = (0.0, DVec3::ZERO, DVec3::ZERO);
    for ((m, x), v) in masses.iter().zip(&state.positions).zip(&state.velocities) {
        let m = f64::from(*m);
        // A slot without mass is vacant; what is in it means nothing.
        if m > 0.0 {
            mass += m;
            moment += m * x.as_dvec3();
            momentum += m * v.as_dvec3();
        }
    }
    (mass > 0.0).then(|| Motion { mass, centre: moment / mass, velocity: momentum / mass })
}

/// Tetrahedra and nodes of all organs.
fn size(world: &mut World) -> (usize, usize) {
    let mut meshes = world.query::<&TissueMesh>();
    meshes.iter(world).fold((0, 0), |(tets, nodes), m| (tets + m.0.tet_count(), nodes + m.0.node_count()))
}
