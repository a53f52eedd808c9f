//! Glue: appliers on the whiteboard set clips on the organs on it, and vessels bleed.

use crate::bleed::{ML_MIN, flow_ml_min};
use crate::hold::{UNTIL_S, attachments, close, is_between, most_pull_n, pull_n};
use crate::legs::{ALONG, body, catch};
use crate::locate::{at_rest, is_whole, position, weights};
use crate::lumen::{Closure, End, Lumen};
use crate::pool::{aspirate, collect, landing};
use crate::settings::ClipSettings;
use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_math::{Isometry3d, Vec3};
use bevy_time::{Fixed, Time};
use keyhole_tetmesh::{NodeId, TetId, TetMesh};
use keyhole_whiteboard::{
    Attachments, BleedReport, BleedSite, Clip, ClipApplier, ClipReport, ClipShape, FragmentDetached, GestureSystems, Gravity, HeldBy,
    InstrumentPose, JawPads, Jaws, RigidBody, RigidPose, SceneRequirements, SimulationIds, StateOf, StaticSurface, Suction, SuctionValve,
    TickSystems, TissueMesh, TissuePoint, TissueState, TopologyChanged, Vessel,
};

/// How far upstream of an opening a vessel is looked at to tell its direction, radii of its lumen.
const UPSTREAM: f64 = 3.0;

/// Sets and holds clips, lets vessels bleed and suctions aspirate in [`GestureSystems::Clip`]; carries both over topology changes in [`TickSystems::Collide`].
pub struct ClippingPlugin;

impl Plugin for ClippingPlugin {
    fn build(&self, app: &mut App) {
        let required = SceneRequirements::clipping;
        let gesture = (open_lumens, set_clips, press_clips, grip_clips, hold_clips, bleed, come_down, take_up).chain();
        app.init_resource::<ClipSettings>()
            .init_resource::<FreedFragments>()
            .register_required_components::<ClipApplier, Trigger>()
            .state::<Trigger>()
            .state::<OpenLumen>()
            .state_resource::<FreedFragments>()
            .add_observer(note_fragment.run_if(required))
            .add_systems(FixedUpdate, gesture.in_set(GestureSystems::Clip).run_if(required))
            .add_systems(FixedUpdate, (inherit, carry).chain().in_set(TickSystems::Collide).run_if(required));
    }
}

/// What the jaws of an applier were at. Written by clipping.
#[derive(Component, Clone, Copy, Debug, Default)]
struct Trigger {
    /// Widest angle since they were last closed, rad.
    widest_rad: f32,
}

/// The lumen of an organ's vessel. Written by clipping.
#[derive(Component, Clone)]
struct OpenLumen(Lumen);

/// Fragments that came free since topology changes were last looked at.
#[derive(Resource, Clone, Default)]
struct FreedFragments(Vec<FragmentDetached>);

fn note_fragment(detached: On<FragmentDetached>, mut freed: ResMut<FreedFragments>) {
    freed.0.push(detached.event().clone());
}

fn open_lumens(mut commands: Commands, organs: Query<(Entity, &TissueMesh, &Vessel), Without<OpenLumen>>) {
    for (organ, mesh, vessel) in &organs {
        if vessel.line.len() > 1 && vessel.radius_m > 0.0 {
            commands.entity(organ).insert(OpenLumen(Lumen::new(&mesh.0, vessel)));
        }
    }
}

/// Jaws that have closed set a clip on the organ of which they have most between them, or drop it where there is none.
fn set_clips(
    mut commands: Commands,
    mut appliers: Query<(Entity, &mut ClipApplier, &mut Trigger, &InstrumentPose, &Jaws)>,
    organs: Query<(Entity, &TissueMesh, &TissueState, Option<&OpenLumen>)>,
    time: Res<Time<Fixed>>,
    mut ids: ResMut<SimulationIds>,
    mut report: ResMut<ClipReport>,
) {
    let mut ordered: Vec<_> = appliers.iter_mut().collect();
    ordered.sort_unstable_by_key(|a| a.0);
    for (_, mut applier, mut trigger, pose, jaws) in ordered {
        let open_rad = trigger.widest_rad;
        if jaws.angle_rad > applier.closed_rad {
            trigger.widest_rad = open_rad.max(jaws.angle_rad);
            continue;
        }
        if open_rad <= 0.0 {
            continue;
        }
        trigger.widest_rad = 0.0;
        if applier.clips == 0 {
            continue;
        }
        applier.clips -= 1;
        let shape = applier.shape;
        let caught =
            organs.iter().filter(|(_, mesh, state, _)| state.positions.len() == mesh.0.node_slots()).map(|(organ, mesh, state, lumen)| {
                // Where the jaws were when the tissue was last where it is.
                (organ, catch(&mesh.0, &state.positions, &pose.before, &applier, open_rad), lumen)
            });
        let best = caught.filter(|c| !c.1.is_empty()).max_by_key(|c| (c.1.len(), std::cmp::Reverse(c.0)));
        let now = pose.now * Isometry3d::from_xyz(0.0, 0.0, -applier.crown_m);
        let Some((organ, pairs, lumen)) = best else {
            let before = pose.before * Isometry3d::from_xyz(0.0, 0.0, -applier.crown_m);
            let linear_m_s = Vec3::from(now.translation - before.translation) / time.timestep().as_secs_f32();
            ids.spawn(&mut commands, (shape, rigid(&shape), RigidPose { linear_m_s, ..RigidPose::at_rest(now) }));
            report.dropped += 1;
            continue;
        };
        let closes = lumen.and_then(|l| l.0.closure(&pairs, shape.leg_m / ALONG as f32)).map_or(0.0, |c| c.closes as f32);
        report.set += 1;
        report.misplaced += u32::from(closes < 1.0);
        ids.spawn(&mut commands, (shape, Clip { organ, pose: now, pairs, closes, held: None, pull_n: Vec3::ZERO }));
    }
}

fn rigid(shape: &ClipShape) -> RigidBody {
    RigidBody { shape: body(shape), density_kg_m3: shape.density_kg_m3 }
}

type Loose<'a> = (Entity, &'a ClipShape, &'a RigidPose, Option<&'a HeldBy>);

/// Clips press, and follow their tissue to where it is now: before anything takes hold of them there.
fn press_clips(
    settings: Res<ClipSettings>,
    time: Res<Time<Fixed>>,
    mut clips: Query<(&ClipShape, &mut Clip)>,
    organs: Query<(&TissueMesh, &TissueState)>,
) {
    let dt_s = time.timestep().as_secs_f32();
    for (shape, mut clip) in &mut clips {
        if let Ok((mesh, state)) = organs.get(clip.organ) {
            close(&mut clip, shape, &mesh.0, &state.positions, dt_s, &settings);
        }
    }
}

/// Graspers take hold of clips between their jaws, and let go of them.
fn grip_clips(
    mut commands: Commands,
    settings: Res<ClipSettings>,
    graspers: Query<(Entity, &InstrumentPose, &Jaws, &JawPads)>,
    mut clips: Query<(&ClipShape, &mut Clip)>,
    loose: Query<Loose, Without<Clip>>,
) {
    let opens = |tool: Entity| graspers.get(tool).map_or(true, |(_, _, jaws, _)| jaws.angle_rad > 1.5 * settings.grip_rad);
    let mut closed: Vec<_> = graspers.iter().filter(|g| g.2.angle_rad <= settings.grip_rad).collect();
    closed.sort_unstable_by_key(|g| g.0);
    let grip = |frame: &Isometry3d, shape: &ClipShape| {
        closed.iter().find_map(|(tool, pose, jaws, pads)| {
            let local = pose.before.inverse() * *frame;
            is_between(pads, jaws.angle_rad, &local, shape).then_some((*tool, local))
        })
    };
    for (shape, mut clip) in &mut clips {
        match clip.held {
            Some((tool, _)) if opens(tool) => (clip.held, clip.pull_n) = (None, Vec3::ZERO),
            None if !closed.is_empty() => {
                if let Some(held) = grip(&clip.pose, shape) {
                    clip.held = Some(held);
                }
            }
            _ => {}
        }
    }
    for (entity, shape, pose, held) in &loose {
        match held {
            Some(by) if opens(by.instrument) => {
                commands.entity(entity).remove::<HeldBy>();
            }
            None => {
                if let Some((instrument, local)) = grip(&pose.now, shape) {
                    commands.entity(entity).insert(HeldBy { instrument, local });
                }
            }
            Some(_) => {}
        }
    }
}

/// Clips slip off where they are pulled too hard, and put what they do into the attachments of their organs.
fn hold_clips(
    mut commands: Commands,
    settings: Res<ClipSettings>,
    mut clips: Query<(Entity, &ClipShape, &mut Clip)>,
    tools: Query<&InstrumentPose>,
    mut organs: Query<(&TissueState, &mut Attachments)>,
    mut report: ResMut<ClipReport>,
) {
    for (_, mut list) in &mut organs {
        if list.0.iter().any(|a| a.until_s == UNTIL_S) {
            list.0.retain(|a| a.until_s != UNTIL_S);
        }
    }
    let mut ordered: Vec<_> = clips.iter_mut().collect();
    ordered.sort_unstable_by_key(|c| c.0);
    for (entity, shape, mut clip) in ordered {
        let Ok((state, mut list)) = organs.get_mut(clip.organ) else {
            commands.entity(entity).despawn();
            continue;
        };
        let held = clip.held.and_then(|(tool, local)| tools.get(tool).ok().map(|pose| (pose.before * local, pose.now * local)));
        clip.pull_n = held.map_or(Vec3::ZERO, |(before, _)| pull_n(&clip, &state.positions, &before, &settings));
        if clip.pairs.is_empty() || clip.pull_n.length() > most_pull_n(&clip, shape) {
            let at = held.map_or(clip.pose, |(_, now)| now);
            let mut entity = commands.entity(entity);
            entity.remove::<Clip>().insert((rigid(shape), RigidPose::at_rest(at)));
            if let Some((instrument, local)) = clip.held {
                entity.insert(HeldBy { instrument, local });
            }
            report.slipped += 1;
            continue;
        }
        list.0.extend(attachments(&clip, &state.positions, held.as_ref().map(|h| &h.1), &settings));
    }
}

/// Blood flows out of what is open.
fn bleed(
    time: Res<Time<Fixed>>,
    organs: Query<(Entity, &TissueMesh, &TissueState, &Vessel, &OpenLumen)>,
    mut clips: Query<(&ClipShape, &mut Clip)>,
    mut report: ResMut<BleedReport>,
) {
    let mut sites = Vec::new();
    let mut ordered: Vec<_> = organs.iter().collect();
    ordered.sort_unstable_by_key(|o| o.0);
    for (organ, mesh, state, vessel, lumen) in ordered {
        let mut closures: Vec<Closure> = Vec::new();
        for (shape, mut clip) in clips.iter_mut().filter(|c| c.1.organ == organ) {
            let found = lumen.0.closure(&clip.pairs, shape.leg_m / ALONG as f32).unwrap_or_default();
            if clip.closes != found.closes as f32 {
                clip.closes = found.closes as f32;
            }
            closures.push(found);
        }
        for (end, source) in [(End::Near, &vessel.near), (End::Far, &vessel.far)] {
            let openings = lumen.0.openings(&closures, end);
            let area: f64 = openings.iter().map(|o| o.area_m2).sum();
            let flow = flow_ml_min(source, area);
            sites.extend(openings.iter().filter(|_| flow > 0.0).filter_map(|opening| {
                let back_m = opening.along_m + if end == End::Near { -UPSTREAM } else { UPSTREAM } * f64::from(vessel.radius_m);
                let at = place(&lumen.0, opening.along_m, end, &mesh.0, &state.positions)?;
                let towards = at - place(&lumen.0, back_m, end, &mesh.0, &state.positions)?;
                Some(BleedSite {
                    organ,
                    at,
                    towards: towards.try_normalize().unwrap_or(Vec3::NEG_Y),
                    area_m2: opening.area_m2 as f32,
                    rate_ml_min: (flow * opening.area_m2 / area) as f32,
                })
            }));
        }
    }
    let rate: f64 = sites.iter().map(|s| f64::from(s.rate_ml_min)).sum();
    if rate > 0.0 || !report.sites.is_empty() {
        report.lost_ml += rate * ML_MIN * 1e6 * time.timestep().as_secs_f64();
        report.rate_ml_min = rate as f32;
        report.sites = sites;
    }
}

/// What flows in this tick comes down.
fn come_down(time: Res<Time<Fixed>>, gravity: Res<Gravity>, anatomy: Query<(Entity, &StaticSurface)>, mut report: ResMut<BleedReport>) {
    if report.sites.is_empty() {
        return;
    }
    let mut ordered: Vec<_> = anatomy.iter().collect();
    ordered.sort_unstable_by_key(|a| a.0);
    let surfaces: Vec<&StaticSurface> = ordered.into_iter().map(|a| a.1).collect();
    let BleedReport { sites, pools, gone_ml, .. } = &mut *report;
    for site in sites {
        let ml = f64::from(site.rate_ml_min) * ML_MIN * 1e6 * time.timestep().as_secs_f64();
        match landing(&surfaces, site.at, site.speed_m_s() * site.towards, gravity.0) {
            Some((at, normal)) => collect(pools, at, normal, ml),
            None => *gone_ml += ml,
        }
    }
}

/// Open suctions take up what is in their reach.
fn take_up(time: Res<Time<Fixed>>, suctions: Query<(Entity, &InstrumentPose, &Suction, &SuctionValve)>, mut report: ResMut<BleedReport>) {
    let mut open: Vec<_> = suctions.iter().filter(|s| s.3.open).collect();
    if open.is_empty() || report.pools.is_empty() {
        return;
    }
    open.sort_unstable_by_key(|s| s.0);
    let report = &mut *report;
    for (_, pose, suction, _) in open {
        let mouth = pose.now * Vec3::new(0.0, 0.0, -suction.mouth_m);
        let most_ml = f64::from(suction.most_ml_s) * time.timestep().as_secs_f64();
        report.aspirated_ml += aspirate(&mut report.pools, mouth, suction.reach_m, most_ml);
    }
}

/// Where a place of a vessel's centre line is in the world, m.
fn place(lumen: &Lumen, along_m: f64, end: End, mesh: &TetMesh, positions: &[Vec3]) -> Option<Vec3> {
    let point = |(tet, rest): (TetId, Vec3)| {
        let found = weights(mesh.points(tet), rest.as_dvec3())?;
        let point: TissuePoint = mesh.corners(tet).into_iter().zip(found.map(|w| w as f32)).collect();
        position(&point, positions)
    };
    let all: Vec<Vec3> = lumen.places(along_m, end).into_iter().filter_map(point).collect();
    (!all.is_empty()).then(|| all.iter().sum::<Vec3>() / all.len() as f32)
}

/// A piece that has come free with a part of a vessel has that part from now on.
fn inherit(mut commands: Commands, freed: Res<FreedFragments>, donors: Query<(&Vessel, &OpenLumen)>, meshes: Query<&TissueMesh>) {
    for fragment in &freed.0 {
        let (Ok((vessel, lumen)), Ok(mesh)) = (donors.get(fragment.donor), meshes.get(fragment.entity)) else { continue };
        let lumen = lumen.0.of_fragment(&mesh.0);
        if lumen.is_somewhere() {
            commands.entity(fragment.entity).insert((vessel.clone(), OpenLumen(lumen)));
        }
    }
}

/// Carries lumens and clips over topology changes: a piece of a clip whose tetrahedron was cut goes to the one that has its place in the rest shape; a clip
/// whose tissue came free goes with the fragment.
fn carry(
    mut changes: MessageReader<TopologyChanged>,
    mut freed: ResMut<FreedFragments>,
    mut clips: Query<(Entity, &mut Clip)>,
    mut organs: Query<(&TissueMesh, &TissueState, &mut Attachments, Option<&mut OpenLumen>)>,
    tools: Query<&InstrumentPose>,
    settings: Res<ClipSettings>,
) {
    let mut touched: Vec<Entity> = Vec::new();
    for fragment in std::mem::take(&mut freed.0) {
        for (_, mut clip) in clips.iter_mut().filter(|c| c.1.organ == fragment.donor) {
            go_with(&mut clip, &fragment);
        }
        touched.extend([fragment.donor, fragment.entity]);
    }
    for TopologyChanged { organ, delta } in changes.read() {
        let Ok((mesh, .., lumen)) = organs.get_mut(*organ) else { continue };
        if let Some(mut lumen) = lumen {
            lumen.0.update(&mesh.0, delta);
        }
        let added: Vec<TetId> = delta.added.iter().map(|a| a.tet).filter(|t| mesh.0.contains(*t)).collect();
        for (_, mut clip) in clips.iter_mut().filter(|c| c.1.organ == *organ) {
            clip.pairs.retain_mut(|pair| {
                let rest = pair.rest;
                [&mut pair.upper, &mut pair.lower].into_iter().zip(rest).all(|(point, rest)| settle(point, rest, &mesh.0, &added))
            });
        }
        touched.push(*organ);
    }
    touched.sort_unstable();
    touched.dedup();
    let mut ordered: Vec<_> = clips.iter().collect();
    ordered.sort_unstable_by_key(|c| c.0);
    for organ in touched {
        let Ok((_, state, mut list, _)) = organs.get_mut(organ) else { continue };
        list.0.retain(|a| a.until_s != UNTIL_S);
        for (_, clip) in ordered.iter().filter(|c| c.1.organ == organ) {
            let held = clip.held.and_then(|(tool, local)| tools.get(tool).ok().map(|pose| pose.now * local));
            list.0.extend(attachments(clip, &state.positions, held.as_ref(), &settings));
        }
    }
}

/// Finds a point again whose tetrahedron was cut; whether it is there.
fn settle(point: &mut TissuePoint, rest: Vec3, mesh: &TetMesh, added: &[TetId]) -> bool {
    if is_whole(mesh, point) {
        return true;
    }
    match at_rest(mesh, added.iter().copied(), rest) {
        Some((_, there)) => {
            *point = there;
            true
        }
        None => false,
    }
}

/// A clip goes to where most of its pieces are; those that are not there, or are cut in two, are lost.
fn go_with(clip: &mut Clip, fragment: &FragmentDetached) {
    let there = |n: NodeId| fragment.donor_nodes.binary_search(&n).ok().map(|i| NodeId(i as u32));
    let of_fragment = |point: &TissuePoint| point.iter().map(|(n, w)| there(*n).map(|n| (n, *w))).collect::<Option<TissuePoint>>();
    let moved: Vec<_> = clip
        .pairs
        .iter()
        .filter_map(|p| Some((of_fragment(&p.upper)?, of_fragment(&p.lower)?, p)))
        .map(|(upper, lower, p)| keyhole_whiteboard::ClipPair { upper, lower, ..p.clone() })
        .collect();
    let gone = |point: &TissuePoint| point.iter().all(|(n, _)| there(*n).is_some());
    if 2 * moved.len() > clip.pairs.len() {
        (clip.organ, clip.pairs) = (fragment.entity, moved);
    } else {
        clip.pairs.retain(|p| !gone(&p.upper) && !gone(&p.lower));
    }
}
