//! Glue: reads the whiteboard, calls the algorithms, writes the whiteboard.

use crate::adopt::adopt;
use crate::body::{Body, Momentum};
use crate::crumbs::{Light, is_crumb};
use crate::guard::Guard;
use crate::hold::Hold;
use crate::island::{self, Member};
use crate::model::ModelState;
use crate::settings::TissueSettings;
use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_math::Vec3;
use bevy_time::{Fixed, Time};
use keyhole_tetmesh::{NodeEdit, NodeId, TopologyDelta};
use keyhole_whiteboard::tick::running;
use keyhole_whiteboard::{
    Anchor, Attachments, Contacts, FragmentDetached, FreedFrom, Gravity, InstrumentPose, Obstacle, OrganMaterials, Rigidified,
    SceneRequirements, StateOf, TickSystems, TissueMesh, TissueState, TopologyChanged,
};
use rayon::prelude::*;

/// Soft tissue: gives every organ with a [`TissueMesh`] its [`TissueState`] and [`TissueBody`] before its first tick, carries both over
/// topology changes in [`TickSystems::Adopt`], and steps them in [`TickSystems::Tissue`].
pub struct TissuePlugin;

impl Plugin for TissuePlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<TissueSettings>()
            .init_resource::<TissueReport>()
            .init_resource::<FreedFragments>()
            .state::<TissueBody>()
            .state::<Quarantined>()
            .state_resource::<TissueReport>()
            .state_resource::<FreedFragments>()
            .add_observer(note_fragment.run_if(SceneRequirements::tissue))
            .add_systems(FixedUpdate, embody.before(TickSystems::Sense).run_if(running).run_if(SceneRequirements::tissue))
            .add_systems(FixedUpdate, (let_go, adopt_changes).chain().in_set(TickSystems::Adopt).run_if(SceneRequirements::tissue))
            .add_systems(FixedUpdate, (step_organs, leave).chain().in_set(TickSystems::Tissue).run_if(SceneRequirements::tissue));
    }
}

/// The body of an organ. Written by tissue.
#[derive(Component, Clone, Debug, Default)]
pub struct TissueBody {
    /// Elements and masses.
    pub body: Body,
    /// What the model keeps.
    pub model: ModelState,
    guard: Guard,
    /// Whether all of it is a crumb of the organ that it came from.
    crumb: bool,
    /// Whether it has left the theatre, and is no longer stepped.
    left: bool,
}

/// How many times the extent of an organ a fragment may be away from every organ: what has fallen so far is out of every view, and would fall for ever.
const AWAY: f32 = 10.0;

/// On an organ whose state became non-finite: it was put back to its last finite state and is no longer stepped. Written by tissue; who
/// removes it lets the organ go on.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct Quarantined {
    /// Simulated time at which it happened, s.
    pub time_s: f64,
    /// The first node that was not finite.
    pub node: NodeId,
}

/// What tissue has to report since the scene started. Written by tissue.
#[derive(Resource, Clone, Debug, Default, PartialEq)]
pub struct TissueReport {
    /// Topology changes adopted.
    pub adoptions: u64,
    /// Largest relative change of linear momentum that a topology change would have made, had it not been given back.
    pub momentum_jump: f64,
    /// Largest relative change of linear momentum that was left after it was given back: rounding.
    pub momentum_error: f64,
    /// Organs that were stepped, summed over the ticks.
    pub stepped: u64,
    /// Organs that slept, summed over the ticks.
    pub asleep: u64,
    /// Iterations of the implicit solver, summed over organs and ticks.
    pub iterations: u64,
    /// Fragments that have left the theatre.
    pub left: u64,
    /// Organs in quarantine, in the order they went there.
    pub quarantined: Vec<Entity>,
}

/// Fragments that came free since the last adoption.
#[derive(Resource, Clone, Default)]
struct FreedFragments(Vec<FragmentDetached>);

fn note_fragment(detached: On<FragmentDetached>, mut freed: ResMut<FreedFragments>) {
    freed.0.push(detached.event().clone());
}

/// Gives organs without a body their body, and their rest shape as state unless they come with one that fits.
fn embody(
    mut commands: Commands,
    organs: Query<(Entity, &TissueMesh, &OrganMaterials, Option<&TissueState>), Without<TissueBody>>,
    settings: Res<TissueSettings>,
) -> Result {
    for (organ, mesh, materials, state) in &organs {
        let body = Body::new(&mesh.0, materials)?;
        let model = ModelState::new(settings.model, settings.capsule, &body, &mesh.0, materials)?;
        let mut entity = commands.entity(organ);
        entity.insert(TissueBody { body, model, ..TissueBody::default() });
        if state.is_none_or(|s| s.positions.len() != mesh.0.node_slots() || s.velocities.len() != s.positions.len()) {
            entity.insert(TissueState::at_rest(&mesh.0));
        }
    }
    Ok(())
}

/// Lets go of the attachments whose time has come.
fn let_go(mut organs: Query<&mut Attachments>, time: Res<Time<Fixed>>) {
    let now_s = time.elapsed_secs_f64();
    for mut attachments in &mut organs {
        if attachments.0.iter().any(|a| a.until_s <= now_s) {
            attachments.expire(now_s);
        }
    }
}

/// Adopts every topology change; fragments take their share of the donor's state and attachments.
fn adopt_changes(
    mut commands: Commands,
    mut changes: MessageReader<TopologyChanged>,
    mut freed: ResMut<FreedFragments>,
    mut report: ResMut<TissueReport>,
    mut organs: Query<(&TissueMesh, &mut TissueState, &mut TissueBody, &mut Attachments)>,
    fragments: Query<(&TissueMesh, &OrganMaterials)>,
) -> Result {
    let mut waiting = std::mem::take(&mut freed.0);
    for TopologyChanged { organ, delta } in changes.read() {
        // An organ that was cut before its first tick gets its body from the mesh as it is.
        let Ok((mesh, mut state, mut body, mut attachments)) = organs.get_mut(*organ) else { continue };
        let (mine, others): (Vec<_>, Vec<_>) = waiting.into_iter().partition(|f| f.donor == *organ);
        waiting = others;

        let (removals, rest): (Vec<NodeEdit>, Vec<NodeEdit>) =
            delta.nodes.iter().cloned().partition(|e| matches!(e, NodeEdit::Removed { .. }));
        attachments.remap(&TopologyDelta { nodes: rest, ..Default::default() });
        let held: Vec<Attachments> = mine.iter().map(|f| attachments.split_off(&f.donor_nodes)).collect();
        attachments.remap(&TopologyDelta { nodes: removals, ..Default::default() });

        let mut pieces = Vec::new();
        for (fragment, mut held) in mine.iter().zip(held) {
            let Ok((mesh, materials)) = fragments.get(fragment.entity) else { continue };
            held.keep_areas(&mesh.0);
            let own = Body::new(&mesh.0, materials)?;
            let model = body.model.of_piece(&own, &mesh.0, materials)?;
            pieces.push((fragment, held, (own, model), TissueState::default()));
        }
        let adopted = adopt(&mut body.body, &mut state, &mesh.0, delta, |donor| {
            let mut departed = Momentum::default();
            for (fragment, _, (body, _), state) in &mut pieces {
                *state = inherit(donor, &fragment.donor_nodes);
                for ((m, x), v) in body.masses().iter().zip(&state.positions).zip(&state.velocities) {
                    departed.add(*m, *x, *v);
                }
            }
            departed
        });
        let TissueBody { body: adopter, model, crumb: whole_crumb, .. } = &mut *body;
        model.adopt(adopter, &mesh.0, delta);
        let (whole_crumb, adopter_slots) = (*whole_crumb, adopter.masses().len());
        report.adoptions += 1;
        report.momentum_jump = report.momentum_jump.max(adopted.relative_jump());
        report.momentum_error = report.momentum_error.max(adopted.relative_error());
        for (fragment, held, (body, model), mut state) in pieces {
            let crumb = is_crumb_of(&body, adopter_slots, whole_crumb, &model);
            for v in &mut state.velocities {
                *v += adopted.given_back;
            }
            commands.entity(fragment.entity).insert((TissueBody { body, model, crumb, ..TissueBody::default() }, state, held));
        }
    }
    // A fragment whose donor sent nothing this tick: its nodes are still the donor's.
    for fragment in waiting {
        let Ok((mesh, materials)) = fragments.get(fragment.entity) else { continue };
        let Ok((_, donor, donor_body, mut attachments)) = organs.get_mut(fragment.donor) else { continue };
        let mut held = attachments.split_off(&fragment.donor_nodes);
        held.keep_areas(&mesh.0);
        let state = inherit(&donor, &fragment.donor_nodes);
        let body = Body::new(&mesh.0, materials)?;
        let model = donor_body.model.of_piece(&body, &mesh.0, materials)?;
        let crumb = is_crumb_of(&body, donor_body.body.masses().len(), donor_body.crumb, &model);
        commands.entity(fragment.entity).insert((TissueBody { body, model, crumb, ..TissueBody::default() }, state, held));
    }
    Ok(())
}

/// Whether a piece is a crumb of a donor with so many slots of nodes, which may be one itself.
fn is_crumb_of(piece: &Body, donor_slots: usize, of_crumb: bool, model: &ModelState) -> bool {
    model.is_solved_together() && (of_crumb || is_crumb(piece.masses().len(), donor_slots))
}

/// The state of a fragment whose nodes were these nodes of the donor.
fn inherit(donor: &TissueState, nodes: &[NodeId]) -> TissueState {
    TissueState {
        positions: nodes.iter().map(|n| donor.positions[n.index()]).collect(),
        velocities: nodes.iter().map(|n| donor.velocities[n.index()]).collect(),
    }
}

/// An organ in its tick.
struct Job<'a> {
    organ: Entity,
    /// The least of the organs that it touches, directly or by others.
    island: Entity,
    state: Mut<'a, TissueState>,
    body: Mut<'a, TissueBody>,
    contacts: Mut<'a, Contacts>,
    /// How many of the contacts, the first ones, are with no crumb.
    firm: usize,
    holds: Vec<Hold>,
    asleep: bool,
    fault: Option<NodeId>,
}

/// Steps every organ that is not in quarantine. Those that touch each other are one job; jobs are independent of each other, so they may run on any number
/// of threads.
fn step_organs(
    mut commands: Commands,
    time: Res<Time<Fixed>>,
    gravity: Res<Gravity>,
    settings: Res<TissueSettings>,
    mut report: ResMut<TissueReport>,
    tools: Query<&InstrumentPose>,
    mut organs: Query<
        (Entity, &mut TissueState, &mut TissueBody, &Attachments, &mut Contacts),
        (Without<Quarantined>, Without<Rigidified>),
    >,
) {
    let dt = time.timestep().as_secs_f32();
    let moving: Vec<(Vec3, Vec3)> =
        tools.iter().filter(|p| p.now != p.before).map(|p| (p.before.translation.into(), p.now.translation.into())).collect();
    for (_, _, mut body, ..) in &mut organs {
        let near = body.body.sleeping_bounds().is_some_and(|bounds| moving.iter().any(|path| comes_near(*path, bounds)));
        if near {
            body.body.wake();
        }
    }
    let mut jobs: Vec<Job<'_>> = organs
        .iter_mut()
        .filter(|(_, _, body, ..)| !body.left)
        .map(|(organ, state, body, attachments, contacts)| {
            let holds = resolve(attachments, &tools, &body.body);
            let firm = contacts.0.len();
            Job { organ, island: organ, state, body, contacts, firm, holds, asleep: false, fault: None }
        })
        .collect();
    set_crumbs_apart(&mut jobs);
    join(&mut jobs);
    let islands: Vec<&mut [Job<'_>]> = jobs.chunk_by_mut(|a, b| a.island == b.island).collect();
    islands.into_par_iter().for_each(|island| step_island(island, gravity.0, dt, &settings));
    for Job { organ, body, asleep, fault, .. } in &jobs {
        if *asleep {
            report.asleep += 1;
        } else {
            report.stepped += 1;
            report.iterations += u64::from(body.body.solver_report().0);
        }
        let Some(node) = fault else { continue };
        tracing::error!(
            "organ {organ}: node {} left the finite numbers; the organ is back at its last finite state and frozen. More substeps or a \
             softer material may help",
            node.0
        );
        report.quarantined.push(*organ);
        commands.entity(*organ).insert(Quarantined { time_s: time.elapsed_secs_f64(), node: *node });
    }
}

/// Stops fragments that nothing holds and that are far from every organ where they are.
fn leave(
    mut fragments: Query<(Entity, &mut TissueState, &mut TissueBody, &Attachments), With<FreedFrom>>,
    organs: Query<&TissueState, Without<FreedFrom>>,
    mut report: ResMut<TissueReport>,
) {
    if fragments.is_empty() {
        return;
    }
    let boxes: Vec<(Vec3, Vec3)> = organs.iter().filter_map(|state| around(&state.positions)).collect();
    for (fragment, mut state, mut body, attachments) in &mut fragments {
        let Some((low, high)) = around(&state.positions).filter(|_| !body.left && attachments.0.is_empty()) else { continue };
        let is_away = |(l, h): &(Vec3, Vec3)| (low - *h).max(*l - high).max_element() > AWAY * (*h - *l).max_element();
        if boxes.iter().all(is_away) {
            tracing::info!("fragment {fragment} has left the theatre; it stays where it is");
            state.velocities.fill(Vec3::ZERO);
            body.left = true;
            report.left += 1;
        }
    }
}

/// The corners of the box around points, m.
fn around(points: &[Vec3]) -> Option<(Vec3, Vec3)> {
    let first = *points.first()?;
    Some(points.iter().fold((first, first), |(low, high), p| (low.min(*p), high.max(*p))))
}

/// Brings the contacts with crumbs behind the others: what is solved knows nothing of them.
fn set_crumbs_apart(jobs: &mut [Job<'_>]) {
    let mut light = Light::default();
    for job in jobs.iter().filter(|job| job.body.model.is_solved_together()) {
        light.add(job.organ, job.body.crumb, &job.body.body.implicit.newton.crumbs);
    }
    if light.is_empty() {
        return;
    }
    light.sort();
    for Job { organ, contacts, firm, .. } in jobs {
        contacts.0.sort_by_key(|c| light.touches(*organ, c));
        *firm = contacts.0.partition_point(|c| !light.touches(*organ, c));
    }
}

/// Brings organs that are to be solved together one after the other.
fn join(jobs: &mut [Job<'_>]) {
    jobs.sort_unstable_by_key(|job| job.organ);
    let mut least: Vec<usize> = (0..jobs.len()).collect();
    let root = |least: &[usize], mut at: usize| {
        while least[at] != at {
            at = least[at];
        }
        at
    };
    for (at, job) in jobs.iter().enumerate().filter(|(_, job)| job.body.model.is_solved_together()) {
        for contact in &job.contacts.0[..job.firm] {
            let Obstacle::Organ { organ, .. } = &contact.against else { continue };
            let Ok(other) = jobs.binary_search_by_key(organ, |job| job.organ) else { continue };
            if jobs[other].body.model.is_solved_together() {
                let (a, b) = (root(&least, at), root(&least, other));
                least[a.max(b)] = a.min(b);
            }
        }
    }
    let islands: Vec<Entity> = (0..jobs.len()).map(|at| jobs[root(&least, at)].organ).collect();
    for (job, island) in jobs.iter_mut().zip(islands) {
        job.island = island;
    }
    jobs.sort_by_key(|job| (job.island, job.organ));
}

/// Steps organs that touch each other.
fn step_island(jobs: &mut [Job<'_>], gravity: Vec3, dt: f32, settings: &TissueSettings) {
    let rests = |job: &mut Job<'_>| {
        let body = &mut job.body.bypass_change_detection().body;
        body.rests(&job.state, &job.holds, &job.contacts.0[..job.firm], gravity)
    };
    if jobs.iter_mut().all(rests) {
        for Job { body, contacts, asleep, .. } in jobs.iter_mut() {
            *asleep = true;
            if !contacts.0.is_empty() {
                body.body.repeat_forces(&mut contacts.0);
            }
        }
        return;
    }
    for Job { state, body, fault, .. } in &mut *jobs {
        // What comes in broken is not stepped: what goes out would name the wrong node.
        *fault = body.guard.check(state);
    }
    let mut members: Vec<Member<'_>> = Vec::new();
    for Job { organ, state, body, contacts, holds, firm, .. } in jobs.iter_mut().filter(|job| job.fault.is_none()) {
        let TissueBody { body, model, crumb, .. } = &mut **body;
        if model.is_solved_together() {
            let membrane = model.membrane();
            let (contacts, light) = contacts.0.split_at_mut(*firm);
            members.push(Member { organ: *organ, body, membrane, state, holds, contacts, light, crumb: *crumb });
        } else {
            model.step_touching(body, state, holds, &mut contacts.0, gravity, dt, settings);
        }
    }
    island::step(&mut members, gravity, dt, settings);
    for Job { state, body, fault, .. } in jobs.iter_mut().filter(|job| job.fault.is_none()) {
        *fault = body.guard.check(state);
    }
}

/// Whether the way of a tool's tip in a tick leads past a box: nearer than its own extent.
fn comes_near((from, to): (Vec3, Vec3), (low, high): (Vec3, Vec3)) -> bool {
    let margin = Vec3::splat((high - low).max_element());
    from.min(to).cmple(high + margin).all() && from.max(to).cmpge(low - margin).all()
}

/// Attachments with their anchors in the world; one whose instrument or node is gone holds nothing.
fn resolve(attachments: &Attachments, tools: &Query<&InstrumentPose>, body: &Body) -> Vec<Hold> {
    let there = |node: &NodeId| body.masses().get(node.index()).is_some_and(|m| *m > 0.0);
    let resolved = attachments.0.iter().filter(|a| !a.point.is_empty() && a.point.iter().all(|(n, _)| there(n))).filter_map(|a| {
        let (from, to) = match &a.anchor {
            Anchor::Space(p) => (*p, *p),
            Anchor::Tool { instrument, local } => {
                let pose = tools.get(*instrument).ok()?;
                let place = |p: &bevy_math::Isometry3d| Vec3::from(p.transform_point(*local));
                (place(&pose.before), place(&pose.now))
            }
        };
        Some(Hold { point: a.point.clone(), from, to, compliance_m_n: a.compliance_m_n })
    });
    resolved.collect()
}
