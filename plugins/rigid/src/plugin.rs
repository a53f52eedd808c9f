//! Glue: what is rigid on the whiteboard is moved by rapier.

use crate::fragment::{follow, freeze, node_masses};
use crate::settings::RigidSettings;
use crate::shape::build;
use crate::surface::{Bounds, OrganSurface, Taken};
use crate::tool::ToolParts;
use crate::view::sees;
use crate::world::{Motion, RigidWorld};
use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_math::Vec3;
use bevy_time::{Fixed, Time};
use keyhole_whiteboard::tick::running;
use keyhole_whiteboard::{
    Attachments, Endoscope, FreedFrom, Gravity, HeldBy, Instrument, InstrumentPose, Jaws, OrganMaterials, RigidBody, RigidFragments,
    RigidMass, RigidPose, RigidQuarantined, RigidReport, RigidShape, Rigidified, SceneCleared, SceneRequirements, StateOf, StaticSurface,
    SurfaceFriction, TickSystems, TissueMesh, TissueState, ToolModel, TopologyChanged,
};
use std::collections::BTreeMap;

/// Moves what is rigid in [`TickSystems::Rigid`], and makes fragments rigid there; makes them soft again before [`TickSystems::Collide`].
pub struct RigidPlugin;

impl Plugin for RigidPlugin {
    fn build(&self, app: &mut App) {
        let required = SceneRequirements::rigid;
        app.init_resource::<RigidSettings>()
            .init_resource::<Workspace>()
            .state::<TouchedSurface>()
            .state::<PushingParts>()
            .state::<Seen>()
            .state::<Free>()
            .state_resource::<Workspace>()
            .add_observer(|_: On<SceneCleared>, mut work: ResMut<Workspace>| *work = Workspace::default())
            .add_systems(FixedUpdate, soften.after(TickSystems::Adopt).before(TickSystems::Collide).run_if(running).run_if(required))
            .add_systems(
                FixedUpdate,
                (adopt_changes, rigidify, prepare, step, carry_tissue).chain().in_set(TickSystems::Rigid).run_if(required),
            );
    }
}

/// What is kept from tick to tick; nothing until something rigid is required.
#[derive(Resource, Clone, Default)]
struct Workspace {
    world: Option<Box<RigidWorld>>,
    /// What was taken of the surface of an organ near a body: by body, then organ.
    taken: BTreeMap<(Entity, Entity), Taken>,
}

/// The surface of an organ that rigid bodies may touch.
#[derive(Component, Clone)]
struct TouchedSurface(OrganSurface);

/// The parts of an instrument that push rigid bodies.
#[derive(Component, Clone)]
struct PushingParts(ToolParts);

/// A body or a surface that rigid has looked at, whether it could be used or not.
#[derive(Component, Clone)]
struct Seen;

/// For how long a fragment has been free of every hold, and out of view, s.
#[derive(Component, Clone, Copy, Debug, Default)]
struct Free {
    for_s: f32,
    unseen_s: f32,
}

/// Makes rigid organs soft that something holds or that were cut.
fn soften(
    mut commands: Commands,
    mut changes: MessageReader<TopologyChanged>,
    organs: Query<(Entity, &Attachments), With<Rigidified>>,
    mut report: ResMut<RigidReport>,
) {
    let cut: Vec<Entity> = changes.read().map(|c| c.organ).collect();
    for (organ, attachments) in &organs {
        if !attachments.0.is_empty() || cut.contains(&organ) {
            commands.entity(organ).remove::<(Rigidified, RigidBody, RigidMass, RigidPose, Free, Seen)>();
            report.softened += 1;
        }
    }
}

fn adopt_changes(
    mut changes: MessageReader<TopologyChanged>,
    mut organs: Query<(&TissueMesh, &mut TouchedSurface)>,
    mut work: ResMut<Workspace>,
) {
    for TopologyChanged { organ, delta } in changes.read() {
        if let Ok((mesh, mut surface)) = organs.get_mut(*organ) {
            surface.0.update(&mesh.0, delta);
        }
        work.taken.iter_mut().filter(|((_, of), _)| of == organ).for_each(|(_, taken)| taken.forget());
    }
}

/// Makes fragments rigid that the scene wants so.
fn rigidify(
    mut commands: Commands,
    policy: Res<RigidFragments>,
    settings: Res<RigidSettings>,
    time: Res<Time<Fixed>>,
    mut fragments: Query<
        (Entity, &TissueMesh, &TissueState, &OrganMaterials, &Attachments, Option<&mut Free>),
        (With<FreedFrom>, Without<Rigidified>),
    >,
    scopes: Query<&Endoscope>,
    mut report: ResMut<RigidReport>,
) {
    if policy.lighter_than_kg.is_none() && policy.unseen_for_s.is_none() {
        return;
    }
    let dt_s = time.timestep().as_secs_f32();
    for (organ, mesh, state, materials, attachments, free) in &mut fragments {
        let Some(mut free) = free else {
            commands.entity(organ).insert(Free::default());
            continue;
        };
        // A fragment that has no state yet, or was cut in this very tick.
        if !attachments.0.is_empty() || state.positions.len() != mesh.0.node_slots() || state.positions.is_empty() {
            *free = Free::default();
            continue;
        }
        free.for_s += dt_s;
        if free.for_s < settings.settle_s {
            continue;
        }
        let (centre, radius) = ball_around(&state.positions);
        free.unseen_s = if scopes.iter().any(|s| sees(s, centre, radius)) { 0.0 } else { free.unseen_s + dt_s };
        let masses = node_masses(&mesh.0, materials);
        let light = policy.lighter_than_kg.is_some_and(|least| masses.iter().sum::<f64>() < f64::from(least));
        if !light && policy.unseen_for_s.is_none_or(|long| free.unseen_s < long) {
            continue;
        }
        let Some(frozen) = freeze(&masses, state) else { continue };
        let points = OrganSurface::of(&mesh.0).nodes().iter().map(|n| frozen.local[n.index()]).collect();
        let density_kg_m3 = materials.0.first().map_or(1000.0, |m| m.density_kg_m3);
        let body = RigidBody { shape: RigidShape::Hull(points), density_kg_m3 };
        // One that has no hull stays soft, and is not asked again before it has been held.
        if build(&body.shape, body.density_kg_m3, Some(&frozen.mass)).is_err() {
            free.for_s = f32::NEG_INFINITY;
            continue;
        }
        commands.entity(organ).insert((body, frozen.mass, frozen.pose, Rigidified { local: frozen.local }));
        report.rigidified += 1;
    }
}

/// Centre and radius of a ball that has all points, m.
fn ball_around(points: &[Vec3]) -> (Vec3, f32) {
    let (low, high) = points.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), x| (low.min(*x), high.max(*x)));
    ((low + high) / 2.0, (high - low).length() / 2.0)
}

/// Takes into rapier's world what is new on the whiteboard, and out of it what is gone.
fn prepare(
    mut commands: Commands,
    settings: Res<RigidSettings>,
    mut work: ResMut<Workspace>,
    bodies: Query<(Entity, &RigidBody, &RigidPose, Option<&RigidMass>, Option<&SurfaceFriction>), Without<Seen>>,
    surfaces: Query<(Entity, &StaticSurface, Option<&SurfaceFriction>), Without<Seen>>,
    tools: Query<(Entity, &Instrument, &ToolModel, &Jaws, &InstrumentPose, Option<&SurfaceFriction>), Without<PushingParts>>,
    organs: Query<(Entity, &TissueMesh), Without<TouchedSurface>>,
    there: Query<Entity, Or<(With<RigidBody>, With<StaticSurface>, With<PushingParts>)>>,
    mut report: ResMut<RigidReport>,
) {
    let work = &mut *work;
    let world = work.world.get_or_insert_with(Box::default);
    world.retain(|entity| there.contains(entity));
    let friction = |own: Option<&SurfaceFriction>, of_kind: f32| own.map_or(of_kind, |f| f.0);
    let mut new: Vec<_> = bodies.iter().collect();
    new.sort_unstable_by_key(|b| b.0);
    for (entity, body, pose, mass, own) in new {
        commands.entity(entity).insert(Seen);
        match build(&body.shape, body.density_kg_m3, mass) {
            Ok(built) => world.insert_body(entity, &built, pose, friction(own, settings.body_friction)),
            Err(error) => {
                tracing::error!("rigid body {entity} is not moved: {error}");
                report.refused.push(entity);
            }
        }
    }
    let mut new: Vec<_> = surfaces.iter().collect();
    new.sort_unstable_by_key(|s| s.0);
    for (entity, surface, own) in new {
        commands.entity(entity).insert(Seen);
        let put = world.insert_anatomy(entity, &surface.vertices, &surface.triangles, friction(own, settings.anatomy_friction));
        if let Err(error) = put {
            tracing::error!("anatomy {entity} is not solid, rigid bodies pass through it: {error}");
        }
    }
    let mut new: Vec<_> = tools.iter().collect();
    new.sort_unstable_by_key(|t| t.0);
    for (entity, instrument, model, jaws, pose, own) in new {
        let parts = ToolParts::of(instrument, model, jaws.angle_rad);
        world.insert_tool(entity, &parts.placed(pose), friction(own, settings.instrument_friction));
        commands.entity(entity).insert(PushingParts(parts));
    }
    for (organ, mesh) in &organs {
        commands.entity(organ).insert(TouchedSurface(OrganSurface::of(&mesh.0)));
    }
}

type Touched<'a> = (Entity, &'a TissueState, &'a TouchedSurface, Option<&'a SurfaceFriction>);

fn step(
    mut commands: Commands,
    time: Res<Time<Fixed>>,
    gravity: Res<Gravity>,
    settings: Res<RigidSettings>,
    mut work: ResMut<Workspace>,
    mut report: ResMut<RigidReport>,
    mut bodies: Query<(Entity, &mut RigidPose), With<Seen>>,
    held: Query<(Entity, &HeldBy), With<RigidBody>>,
    mut tools: Query<(Entity, &InstrumentPose, &Jaws, Option<&mut PushingParts>), With<Instrument>>,
    organs: Query<Touched, Without<Rigidified>>,
) {
    let dt_s = time.timestep().as_secs_f32();
    let Workspace { world: Some(world), taken } = &mut *work else { return };
    let held: BTreeMap<Entity, Motion> = held
        .iter()
        .filter_map(|(body, by)| {
            let (_, pose, ..) = tools.get(by.instrument).ok()?;
            Some((body, Motion { from: pose.before * by.local, to: pose.now * by.local }))
        })
        .collect();
    let motions: BTreeMap<Entity, Vec<Motion>> =
        tools.iter_mut().filter_map(|(tool, pose, jaws, parts)| Some((tool, parts?.0.moved(pose, jaws.angle_rad)))).collect();
    touch_tissue(world, taken, &organs, &settings, gravity.0, dt_s);
    let broken = world.tick(dt_s, settings.steps, gravity.0, &held, &motions);
    report.awake = world.awake() as u32;
    for body in broken {
        tracing::error!("rigid body {body} left the finite numbers; it is back where it was last finite and no longer moved");
        report.quarantined.push(body);
        commands.entity(body).insert(RigidQuarantined { time_s: time.elapsed_secs_f64() });
    }
    for (entity, mut pose) in &mut bodies {
        if let Some(now) = world.pose(entity) {
            pose.set_if_neq(*now);
        }
    }
}

/// The tissue of rigid organs goes where they go.
fn carry_tissue(mut organs: Query<(&Rigidified, &RigidPose, &mut TissueState), Changed<RigidPose>>) {
    for (frozen, pose, mut state) in &mut organs {
        follow(&frozen.local, pose, &mut state);
    }
}

/// Puts the surfaces of organs into rapier's world where a body may touch them in this tick.
fn touch_tissue(
    world: &mut RigidWorld,
    taken: &mut BTreeMap<(Entity, Entity), Taken>,
    organs: &Query<Touched, Without<Rigidified>>,
    settings: &RigidSettings,
    gravity: Vec3,
    dt_s: f32,
) {
    let bodies: Vec<(Entity, RigidPose, f32)> = world.free_bodies().map(|(e, pose, reach)| (e, *pose, reach)).collect();
    taken.retain(|(body, organ), _| {
        let stays = bodies.iter().any(|b| b.0 == *body) && organs.contains(*organ);
        if !stays {
            world.remove_piece(*body, *organ);
        }
        stays
    });
    if bodies.is_empty() {
        return;
    }
    let mut organs: Vec<_> = organs.iter().map(|o| (bounds(&o.1.positions), o)).collect();
    organs.sort_unstable_by_key(|o| o.1.0);
    for (body, pose, reach) in &bodies {
        let (low, high) = swept(pose, *reach, gravity, dt_s);
        for (around, (organ, state, surface, own)) in &organs {
            let key = (*body, *organ);
            let near = around.0.cmple(high).all() && around.1.cmpge(low).all();
            if !near {
                if taken.remove(&key).is_some() {
                    world.remove_piece(*body, *organ);
                }
                continue;
            }
            let friction = own.map_or(settings.tissue_friction, |f| f.0);
            match surface.0.take(taken.entry(key).or_default(), state, (low, high), *reach, friction) {
                None => world.rest_piece(*body, *organ),
                Some(piece) => {
                    if let Err(error) = world.set_piece(*body, *organ, &piece, dt_s) {
                        tracing::warn!("rigid body {body} does not feel organ {organ} in this tick: {error}");
                    }
                    if pose.asleep {
                        world.wake(*body);
                    }
                }
            }
        }
    }
}

fn bounds(points: &[Vec3]) -> Bounds {
    points.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), x| (low.min(*x), high.max(*x)))
}

/// A box around all places where a body may be during a tick.
fn swept(pose: &RigidPose, reach: f32, gravity: Vec3, dt_s: f32) -> Bounds {
    let from = Vec3::from(pose.now.translation);
    let to = from + pose.linear_m_s * dt_s + gravity * dt_s * dt_s;
    (from.min(to) - reach, from.max(to) + reach)
}
