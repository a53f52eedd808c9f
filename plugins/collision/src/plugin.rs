//! Glue: what is on the whiteboard touches, and its contacts are written there.

use crate::anatomy::SolidSurface;
use crate::contacts::{MovedPart, Party, between_tissue, exempt, part, with_anatomy, with_tool_within, with_tools};
use crate::depth::Depths;
use crate::detect::{Body, Detector, Hit, mean_rest_edge_m};
use crate::folds::Folds;
use crate::fresh::FreshCuts;
use crate::meet::{Meeting, part_against_part, part_against_surface};
use crate::parts::{Moving, ToolParts};
use crate::rest::Rest;
use crate::settings::{CollisionSettings, SelfCollision};
use crate::shape::Shape;
use crate::tool::{Motion, ToolPart};
use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_math::Vec3;
use bevy_time::{Fixed, Time};
use keyhole_whiteboard::{
    Blade, Contact, Contacts, CuttingLine, FragmentDetached, FreedFrom, Grasp, Instrument, InstrumentPose, JawPads, Jaws, Obstacle, Port,
    SceneCleared, SceneRequirements, StateOf, StaticSurface, SurfaceFriction, TickSystems, TissueMesh, TissueState, ToolContacts,
    ToolModel, ToolTouch, ToolTouched, TopologyChanged,
};
use smallvec::SmallVec;

/// How near a surface has to be to be touched, as a part of what is near.
const TOUCHES: f32 = 0.2;

/// Writes the contacts of every organ, and those of instruments with each other and with anatomy, in [`TickSystems::Collide`].
pub struct CollisionPlugin;

impl Plugin for CollisionPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<CollisionSettings>()
            .init_resource::<Workspace>()
            .init_resource::<CollisionReport>()
            .add_message::<ToolTouched>()
            .state::<OrganShape>()
            .state::<ToolParts>()
            .no_state::<SolidAnatomy>()
            .no_state::<Seen>()
            .state_resource::<Workspace>()
            .state_resource::<CollisionReport>()
            .add_observer(|_: On<SceneCleared>, mut work: ResMut<Workspace>| *work = Workspace::default())
            .add_observer(follow_fragment.run_if(SceneRequirements::collision))
            .add_systems(
                FixedUpdate,
                (adopt_changes, prepare, find_tool_contacts, find_contacts, keep_jaws)
                    .chain()
                    .in_set(TickSystems::Collide)
                    .run_if(SceneRequirements::collision),
            );
    }
}

/// What collision has looked at since the scene started. Written by collision.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CollisionReport {
    /// Organs that were looked at, summed over the ticks.
    pub organs: u64,
    /// Organs that had not moved and were not looked at, summed over the ticks.
    pub at_rest: u64,
    /// Nodes whose nearest point of a piece of anatomy was looked for.
    pub nodes: u64,
    /// Faces that were held against a part of an instrument.
    pub faces: u64,
    /// Tetrahedra that were looked into, but for those of the organ itself.
    pub tets: u64,
}

/// What is kept from tick to tick: fresh cuts, and room.
#[derive(Resource, Clone, Default)]
struct Workspace {
    /// Solid anatomy with its friction, in order.
    solid: Vec<(Entity, f32)>,
    fresh: FreshCuts,
    detector: Detector,
    depths: Depths,
    hits: Vec<Hit>,
}

/// The shape of an organ.
#[derive(Component, Clone)]
struct OrganShape {
    shape: Shape,
    /// Mean length of its edges when it came, m.
    edge_m: f32,
    cut: bool,
    /// What looks for the organ in itself; there once it has been needed.
    folds: Option<Folds>,
    /// What is known of it while it does not move.
    rest: Option<Rest>,
}

/// Solid anatomy with its tree.
#[derive(Component)]
struct SolidAnatomy(SolidSurface);

/// Anatomy whose surface has been looked at, whether it could be used or not.
#[derive(Component)]
struct Seen;

fn follow_fragment(event: On<FragmentDetached>, mut work: ResMut<Workspace>) {
    work.fresh.move_to_fragment(event.donor, event.entity, &event.donor_nodes);
}

fn adopt_changes(
    mut changes: MessageReader<TopologyChanged>,
    mut organs: Query<(&TissueMesh, &mut OrganShape)>,
    mut work: ResMut<Workspace>,
) {
    for TopologyChanged { organ, delta } in changes.read() {
        work.fresh.adopt(*organ, delta);
        if let Ok((mesh, mut known)) = organs.get_mut(*organ) {
            let OrganShape { shape, cut, folds, rest, .. } = &mut *known;
            *rest = None;
            let touched = shape.update(&mesh.0, delta);
            if let Some(folds) = folds {
                folds.update(&mesh.0, shape, delta, &touched);
            }
            *cut = true;
        }
    }
}

/// Gives everything that is new on the whiteboard what collision needs of it.
fn prepare(
    mut commands: Commands,
    organs: Query<(Entity, &TissueMesh, Has<FreedFrom>), Without<OrganShape>>,
    tools: Query<(Entity, &Instrument, &ToolModel, &Jaws), Or<(Without<ToolParts>, Changed<ToolModel>)>>,
    surfaces: Query<(Entity, &StaticSurface), Without<Seen>>,
) {
    for (organ, mesh, cut) in &organs {
        let (shape, edge_m) = (Shape::of(&mesh.0), mean_rest_edge_m(&mesh.0));
        commands.entity(organ).insert(OrganShape { shape, edge_m, cut, folds: None, rest: None });
    }
    for (tool, instrument, model, jaws) in &tools {
        let parts = ToolParts::new(instrument, model, jaws.angle_rad);
        // One that was exchanged for another kind goes on counting what the hand touches.
        commands.entity(tool).insert(parts).insert_if_new(ToolContacts::default());
    }
    for (entity, surface) in &surfaces {
        commands.entity(entity).insert(Seen);
        match SolidSurface::new(surface) {
            Ok(solid) => {
                commands.entity(entity).insert(SolidAnatomy(solid));
            }
            Err(error) => tracing::error!("anatomy {entity} is not solid, tissue passes through it: {error}"),
        }
    }
}

/// Its blade, and whether it has an edge.
type Edge<'a> = (Option<&'a Blade>, Has<CuttingLine>);

fn find_contacts(
    time: Res<Time<Fixed>>,
    settings: Res<CollisionSettings>,
    mut work: ResMut<Workspace>,
    mut report: ResMut<CollisionReport>,
    mut organs: Query<(Entity, &TissueMesh, Ref<TissueState>, &mut OrganShape, &mut Contacts, Option<&SurfaceFriction>)>,
    mut tools: Query<(Entity, &InstrumentPose, &Jaws, &mut ToolParts, Edge, Option<(&JawPads, &Grasp)>, Option<&SurfaceFriction>)>,
    anatomy: Query<(Entity, &SolidAnatomy, Option<&SurfaceFriction>)>,
) {
    let dt_s = time.timestep().as_secs_f32();
    let Workspace { solid: known_solid, fresh, detector, depths, hits } = &mut *work;
    let mut solid: Vec<_> =
        anatomy.iter().map(|(entity, surface, friction)| (entity, surface, friction.map_or(settings.anatomy_friction, |f| f.0))).collect();
    solid.sort_unstable_by_key(|s| s.0);
    let alike = |(a, b): (&(Entity, &SolidAnatomy, f32), &(Entity, f32))| (a.0, a.2) == *b;
    let keeps = !settings.is_changed() && solid.len() == known_solid.len() && solid.iter().zip(&*known_solid).all(alike);
    if !keeps {
        *known_solid = solid.iter().map(|s| (s.0, s.2)).collect();
    }
    let mut ordered: Vec<_> = organs.iter_mut().collect();
    ordered.sort_unstable_by_key(|o| o.0);
    let mut parties = Vec::with_capacity(ordered.len());
    let mut contacts: Vec<&mut Vec<Contact>> = Vec::with_capacity(ordered.len());
    let mut rests: Vec<&mut Option<Rest>> = Vec::with_capacity(ordered.len());
    hits.clear();
    for (organ, mesh, state, known, list, friction) in &mut ordered {
        list.0.clear();
        // An organ whose state has not caught up with its mesh touches nothing.
        if state.positions.len().min(state.velocities.len()) < known.shape.roles().len() {
            continue;
        }
        let OrganShape { shape, edge_m, cut, folds, rest } = &mut **known;
        let meets_itself = match settings.self_collision {
            SelfCollision::OnceCut => *cut,
            SelfCollision::Always => true,
            SelfCollision::Never => false,
        };
        let party = Party {
            organ: *organ,
            topology: mesh.0.topology(),
            shape,
            positions: &state.positions,
            velocities: &state.velocities,
            edge_m: *edge_m,
            friction: friction.map_or(settings.tissue_friction, |f| f.0),
        };
        let (place, still) = (parties.len() as u16, keeps && !state.is_changed());
        if let Some(rest) = rest.as_ref().filter(|rest| still && rest.holds(party.friction)) {
            hits.extend(rest.own(place));
            report.at_rest += 1;
        } else {
            let mut own: &[Hit] = &[];
            if meets_itself {
                own = folds.get_or_insert_with(|| Folds::of(&mesh.0, shape)).detect(shape, &state.positions, place);
                hits.extend_from_slice(own);
            }
            *rest = still.then(|| Rest::of(&party, own, dt_s));
            report.organs += 1;
        }
        parties.push(party);
        contacts.push(&mut list.0);
        rests.push(rest);
    }
    let mut tools: Vec<_> = tools.iter_mut().collect();
    tools.sort_unstable_by_key(|t| t.0);
    let mut moving = Vec::new();
    for (entity, pose, jaws, tool, (blade, has_edge), grasp, friction) in &mut tools {
        let pads = grasp.filter(|(_, grasp)| grasp.grips()).map(|(pads, _)| *pads);
        let cutting = *has_edge && blade.is_some_and(|b| b.active);
        let friction = friction.map_or(settings.instrument_friction, |f| f.0);
        let angles = [tool.angle_rad, jaws.angle_rad];
        for part in tool.parts.iter_mut().filter(|p| !(p.cuts && cutting)) {
            let motion = part.motion(pose, angles, dt_s);
            moving.push(part.in_tick(*entity, motion, friction, pads));
        }
    }
    // The middles of tools are looked for in tissue like the nodes of other organs.
    let organs = parties.len();
    let bodies: Vec<Body> = parties.iter().map(Party::body).chain(moving.iter().map(|m| m.middle)).collect();
    hits.extend_from_slice(detector.detect(&bodies, settings.grading));
    hits.sort_unstable_by_key(Hit::key);
    let within = hits.split_off(hits.partition_point(|h| usize::from(h.node_body) < organs));
    let held = exempt(hits, &parties, fresh);
    part(fresh, &parties, &held);
    between_tissue(hits, &parties, depths, &mut contacts);

    report.tets += detector.looked_into() as u64;
    for ((party, list), rest) in parties.iter().zip(&mut contacts).zip(rests) {
        match rest.as_ref().and_then(|rest| rest.anatomy.as_ref()) {
            Some(known) => list.extend_from_slice(known),
            None => {
                let from = list.len();
                for (entity, surface, friction) in &solid {
                    with_anatomy(party, (*entity, &surface.0), *friction, settings.anatomy_reach_m, dt_s, list);
                    report.nodes += party.shape.roles().len() as u64;
                }
                if let Some(rest) = rest {
                    rest.anatomy = Some(list[from..].to_vec());
                }
            }
        }
        let meets = |m: &&Moving| rest.as_ref().is_none_or(|rest| rest.meets(m.part.swept_box(&m.motion, settings.tool_near_m)));
        let near: SmallVec<[MovedPart; 8]> = moving.iter().filter(meets).map(Moving::moved).collect();
        if !near.is_empty() {
            report.faces += with_tools(party, &near, settings.tool_near_m, list) as u64;
        }
    }
    for (at, moving) in moving.iter_mut().enumerate() {
        let own = |h: &Hit| usize::from(h.node_body) == organs + at;
        let mine = &within[within.partition_point(|h| usize::from(h.node_body) < organs + at)..];
        let mine = &mine[..mine.partition_point(own)];
        let mine: SmallVec<[Hit; 16]> = mine.iter().filter(|h| !moving.is_padded(h.node.index())).copied().collect();
        let before = std::mem::take(moving.ways);
        for hits in mine.chunk_by(|a, b| a.tet_body == b.tet_body) {
            let place = usize::from(hits[0].tet_body);
            let party = &parties[place];
            let mut way = before.iter().find(|(organ, _)| *organ == party.organ).map(|(_, way)| *way);
            with_tool_within(party, moving.moved(), hits, &mut way, contacts[place]);
            moving.ways.extend(way.map(|way| (party.organ, way)));
        }
    }
}

/// Instruments against each other and against anatomy.
fn find_tool_contacts(
    time: Res<Time<Fixed>>,
    settings: Res<CollisionSettings>,
    mut tools: Query<(Entity, &InstrumentPose, &Jaws, &ToolParts, Option<&Port>, &mut ToolContacts)>,
    anatomy: Query<(Entity, &SolidAnatomy)>,
    mut touched: MessageWriter<ToolTouched>,
) {
    let dt_s = time.timestep().as_secs_f32();
    let mut solid: Vec<_> = anatomy.iter().collect();
    solid.sort_unstable_by_key(|s| s.0);
    let mut tools: Vec<_> = tools.iter_mut().collect();
    tools.sort_unstable_by_key(|t| t.0);
    let moving: Vec<Vec<(&ToolPart, Motion)>> = tools
        .iter()
        .map(|(_, pose, jaws, tool, ..)| {
            tool.parts.iter().map(|p| (&p.part, p.motion(pose, [tool.angle_rad, jaws.angle_rad], dt_s))).collect()
        })
        .collect();
    let way_m = |part: &(&ToolPart, Motion)| part.1.way_m(part.0.reach_m());
    let mut near: Vec<Vec<ToolTouch>> = vec![Vec::new(); tools.len()];
    let touch = |m: Meeting, against| ToolTouch { point: m.point, normal: m.normal, depth_m: m.depth_m, against };
    for (i, parts) in moving.iter().enumerate() {
        // A shaft goes through the wall where its port is.
        let (pose, port) = (tools[i].1.now, tools[i].4);
        let free = |p: Vec3| port.is_none_or(|port| (p - port.position).dot(pose.rotation * Vec3::NEG_Z) > settings.sleeve_m);
        for part in parts {
            let margin_m = settings.tool_margin_m + way_m(part);
            for (entity, surface) in &solid {
                let met = part_against_surface(part.0, &part.1, &surface.0, margin_m, settings.anatomy_reach_m, free);
                near[i].extend(met.into_iter().map(|m| touch(m, Obstacle::Anatomy(*entity))));
            }
            for (j, others) in moving.iter().enumerate().skip(i + 1) {
                for other in others {
                    let met = part_against_part((part.0, &part.1), (other.0, &other.1), margin_m + way_m(other));
                    near[i].extend(met.map(|m| touch(m, Obstacle::Instrument(tools[j].0))));
                    near[j].extend(met.map(|m| touch(m.mirrored(), Obstacle::Instrument(tools[i].0))));
                }
            }
        }
    }
    for ((instrument, .., contacts), near) in tools.iter_mut().zip(near) {
        let before = std::mem::take(&mut contacts.touching);
        // A touch begins where surfaces meet, and is over once they are apart: one that stops at a wall does not begin again and again.
        let touches = |t: &&ToolTouch| {
            let known = t.against.entity().is_some_and(|e| before.binary_search(&e).is_ok());
            t.depth_m > if known { -settings.tool_near_m } else { -TOUCHES * settings.tool_near_m }
        };
        let mut touching: Vec<Entity> = near.iter().filter(touches).filter_map(|t| t.against.entity()).collect();
        touching.sort_unstable();
        touching.dedup();
        for against in touching.iter().filter(|e| before.binary_search(e).is_err()) {
            contacts.begun += 1;
            touched.write(ToolTouched { instrument: *instrument, against: *against });
        }
        (contacts.near, contacts.touching) = (near, touching);
    }
}

/// The jaws as they are at the end of this tick are those at the beginning of the next.
fn keep_jaws(mut tools: Query<(&Jaws, &mut ToolParts)>) {
    for (jaws, mut tool) in &mut tools {
        tool.angle_rad = jaws.angle_rad;
    }
}
