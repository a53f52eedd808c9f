//! Glue: ten times a second the goals of the task are looked for on the whiteboard.

use crate::task::drops::Carried;
use crate::task::goal::{Task, TaskStatus, Want};
use crate::task::judge::{REST_M_S, is_between, is_inside, is_round, off_circle_m};
use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_ecs::system::SystemParam;
use bevy_math::{DVec3, Vec3};
use bevy_time::{Fixed, Time};
use keyhole_tetmesh::OuterPlanes;
use keyhole_whiteboard::{
    Anchor, Attachments, Bites, BleedReport, Clip, Contacts, FreedFrom, Gravity, Hand, Instrument, JawPads, Knots, Obstacle, Organ,
    OrganMaterials, StateOf, TickCost, TickSystems, TissueMesh, TissueState,
};

/// Looks a second. What lasts shorter may not be seen.
const LOOKS_PER_S: f64 = 10.0;
/// The part of the lumen that a clip must close to count as across the whole vessel.
const WHOLE: f32 = 0.999;

/// Judges the task where there is one; where there is none, no system runs.
pub struct TaskPlugin;

impl Plugin for TaskPlugin {
    fn build(&self, app: &mut App) {
        let there_is_one = |task: Res<Task>| !task.goals.is_empty();
        app.init_resource::<Task>()
            .init_resource::<TaskStatus>()
            .init_resource::<Before>()
            .state_resource::<TaskStatus>()
            .state_resource::<Before>()
            .add_systems(FixedPreUpdate, begin.run_if(there_is_one).run_if(|cost: Res<TickCost>| cost.ticks == 0))
            .add_systems(FixedUpdate, judge.in_set(TickSystems::Assess).in_set(JudgeSystems).run_if(there_is_one));
    }
}

/// The task is judged here.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct JudgeSystems;

/// What is kept from look to look.
#[derive(Resource, Clone, Debug, Default)]
struct Before {
    /// The skin of the organs that something is to be cut out of, before anybody touched them.
    skins: Vec<(Entity, OuterPlanes)>,
    /// What may be dropped, by ascending organ.
    carried: Vec<(Entity, Carried)>,
}

type Body<'a> =
    (Entity, &'a Organ, &'a TissueMesh, &'a TissueState, &'a Attachments, &'a Contacts, &'a OrganMaterials, Option<&'a FreedFrom>);

/// Before a scene's first tick.
fn begin(task: Res<Task>, mut status: ResMut<TaskStatus>, mut before: ResMut<Before>, organs: Query<Body>) {
    let wanted = |name: &str| task.goals.iter().any(|g| matches!(&g.want, Want::CutOut { organ, .. } if organ == name));
    let skins = organs.iter().filter(|(_, organ, .., freed)| freed.is_none() && wanted(&organ.name));
    *before =
        Before { skins: skins.map(|(entity, _, TissueMesh(mesh), ..)| (entity, OuterPlanes::of(mesh))).collect(), carried: Vec::new() };
    *status = TaskStatus::default();
}

/// All that goals are about.
#[derive(SystemParam)]
struct Board<'w, 's> {
    organs: Query<'w, 's, Body<'static>>,
    tools: Query<'w, 's, (&'static Hand, Has<JawPads>), With<Instrument>>,
    clips: Query<'w, 's, &'static Clip>,
    sutures: Query<'w, 's, (&'static Bites, &'static Knots)>,
    bleeding: Res<'w, BleedReport>,
    gravity: Res<'w, Gravity>,
}

fn judge(
    task: Res<Task>,
    mut status: ResMut<TaskStatus>,
    mut before: ResMut<Before>,
    cost: Res<TickCost>,
    time: Res<Time<Fixed>>,
    board: Board,
) {
    let dt_s = time.timestep().as_secs_f64();
    let ticks_per_look = (1.0 / (LOOKS_PER_S * dt_s)).round().max(1.0) as u64;
    // The tick that runs is not counted yet.
    let tick = cost.ticks + 1;
    if !tick.is_multiple_of(ticks_per_look) {
        return;
    }
    let found: Vec<bool> = task.goals.iter().map(|goal| board.is_met(&goal.want, &before)).collect();
    status.take(&task, &found, tick as f64 * dt_s);
    status.off_circle_m = task.goals.iter().find_map(|goal| board.off_circle_m(&goal.want, &before));
    if board.tools.iter().any(|(_, pads)| pads) {
        let drops = board.drops(&mut before.carried);
        *status.drops.get_or_insert(0) += drops;
    }
}

fn mean(vectors: impl ExactSizeIterator<Item = Vec3>) -> DVec3 {
    let count = vectors.len().max(1) as f64;
    vectors.map(|v| v.as_dvec3()).sum::<DVec3>() / count
}

impl Board<'_, '_> {
    fn organ(&self, name: &str) -> Option<Body<'_>> {
        self.organs.iter().find(|(_, organ, .., freed)| freed.is_none() && organ.name == name)
    }

    /// The organ that something was a part of before anything was cut.
    fn origin(&self, mut entity: Entity) -> Entity {
        while let Ok((.., Some(freed))) = self.organs.get(entity) {
            entity = freed.donor;
        }
        entity
    }

    /// The hands whose jaws hold an organ, the left one first: their pads are on it, or they push it from opposite sides.
    fn hands(&self, attachments: &Attachments, contacts: &Contacts) -> Vec<Hand> {
        let holds = |hand: &Hand| {
            let is_tool = |tool: Entity| self.tools.get(tool).is_ok_and(|(of, pads)| pads && of == hand);
            let by_pads = || attachments.0.iter().any(|a| matches!(a.anchor, Anchor::Tool { instrument, .. } if is_tool(instrument)));
            let pushed = contacts.0.iter().filter(|c| c.force_n != Vec3::ZERO);
            let ways = || {
                pushed.filter(|c| matches!(c.against, Obstacle::Instrument(tool) if is_tool(tool))).map(|c| c.normal).collect::<Vec<_>>()
            };
            by_pads() || is_between(&ways())
        };
        [Hand::Left, Hand::Right].into_iter().filter(holds).collect()
    }

    fn is_let_go_and_at_rest(&self, body: &Body) -> bool {
        let (.., state, attachments, contacts, _, _) = body;
        self.hands(attachments, contacts).is_empty() && mean(state.velocities.iter().copied()).length() < REST_M_S
    }

    fn is_met(&self, want: &Want, before: &Before) -> bool {
        match want {
            Want::Held { organ, hands, in_air } => self.organ(organ).is_some_and(|(_, _, _, _, attachments, contacts, ..)| {
                let pushed = || contacts.0.iter().any(|c| matches!(c.against, Obstacle::Anatomy(_)) && c.force_n != Vec3::ZERO);
                let holding = self.hands(attachments, contacts);
                holding.len() == hands.len() && hands.iter().all(|h| holding.contains(h)) && !(*in_air && pushed())
            }),
            Want::Round { organ, pegs } => self.organ(organ).is_some_and(|body| {
                let points = || body.3.positions.iter().map(|p| p.as_dvec3()).collect::<Vec<_>>();
                self.is_let_go_and_at_rest(&body) && pegs.iter().any(|peg| is_round(&points(), *peg))
            }),
            Want::Lies { organ, part, inside, at_rest } => self.organ(organ).is_some_and(|body| {
                let (_, _, TissueMesh(mesh), state, ..) = body;
                let of_part = |n: &_| part.is_none_or(|part| is_inside(mesh.rest(*n), part));
                let points: Vec<Vec3> = mesh.nodes().filter(of_part).map(|n| state.position(n)).collect();
                (!at_rest || self.is_let_go_and_at_rest(&body)) && !points.is_empty() && is_inside(mean(points.into_iter()), *inside)
            }),
            Want::CutThrough { organ, pieces } => self.organ(organ).is_some_and(|(entity, ..)| self.pieces(entity).count() >= *pieces),
            Want::Removed { organ, material } => self.organ(organ).is_some_and(|(_, _, TissueMesh(mesh), _, _, _, materials, _)| {
                mesh.iter().all(|(tet, _)| materials.get(mesh.tet(tet).material).name != *material)
            }),
            Want::CutOut { within_m, .. } => self.off_circle_m(want, before).is_some_and(|off| off <= *within_m),
            Want::Clipped { organ, clips } => self.organ(organ).is_some_and(|(entity, ..)| {
                let whole = self.clips.iter().filter(|c| c.closes >= WHOLE && self.origin(c.organ) == entity);
                whole.count() >= *clips
            }),
            Want::BloodBelow { ml } => self.bleeding.lost_ml <= *ml,
            Want::Sutured { organs } => self.sutures.iter().any(|(bites, _)| {
                let through =
                    |name: &String| self.organ(name).is_some_and(|(entity, ..)| bites.held.iter().any(|b| self.origin(b.organ) == entity));
                organs.iter().all(through)
            }),
            Want::Knotted { throws, hold_n } => {
                self.sutures.iter().any(|(_, knots)| knots.tied.iter().any(|k| k.throws.len() >= *throws && f64::from(k.hold_n) >= *hold_n))
            }
        }
    }

    fn pieces(&self, of: Entity) -> impl Iterator<Item = Body<'_>> {
        self.organs.iter().filter(move |(entity, .., freed)| freed.is_some() && self.origin(*entity) == of)
    }

    /// Of the piece that is nearest to the circle.
    fn off_circle_m(&self, want: &Want, before: &Before) -> Option<f64> {
        let Want::CutOut { organ, circle, .. } = want else { return None };
        let (entity, ..) = self.organ(organ)?;
        let (_, skin) = before.skins.iter().find(|(of, _)| *of == entity)?;
        self.pieces(entity).filter_map(|(_, _, TissueMesh(piece), ..)| off_circle_m(piece, skin, circle)).min_by(f64::total_cmp)
    }

    /// What was dropped since the last look, of the organs that nothing but jaws holds.
    fn drops(&self, carried: &mut Vec<(Entity, Carried)>) -> u32 {
        let up = -self.gravity.0.as_dvec3().normalize_or_zero();
        let mut drops = 0;
        for body in &self.organs {
            let (entity, _, _, state, attachments, contacts, _, freed) = body;
            let place = carried.binary_search_by_key(&entity, |(organ, _)| *organ);
            let by_tools = attachments.0.iter().all(|a| matches!(a.anchor, Anchor::Tool { .. }) || a.is_tie());
            let held = || !self.hands(attachments, contacts).is_empty();
            if freed.is_some() || !by_tools || (place.is_err() && !held()) {
                continue;
            }
            let place = place.unwrap_or_else(|place| {
                carried.insert(place, (entity, Carried::default()));
                place
            });
            let height_m = mean(state.positions.iter().copied()).dot(up);
            drops += u32::from(carried[place].1.see(held(), height_m, self.is_let_go_and_at_rest(&body)));
        }
        drops
    }
}
