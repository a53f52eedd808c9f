//! Glue: blades on the whiteboard cut the organs on it.

use crate::course::BladeId;
use crate::cutter::{Cutter, Operations};
use crate::fragment::{self, Fragment};
use crate::material_map::{MaterialMap, Tissue, WorldLine};
use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_time::{Fixed, Time};
use keyhole_whiteboard::{
    Anchor, Attachment, Attachments, Blade, CutSettings, CutStatus, FragmentDetached, FreedFrom, InstrumentPose, Organ, OrganMaterials,
    SceneRequirements, SimulationIds, StateOf, TickSystems, TissueMesh, TissueState, TopologyChanged,
};
use std::collections::BTreeMap;

/// Cuts organs with active blades, in [`TickSystems::Cut`].
pub struct CuttingPlugin;

impl Plugin for CuttingPlugin {
    fn build(&self, app: &mut App) {
        let systems = (prepare_organs, detach_fragments, cut_organs, send_changes).chain();
        app.state::<OrganCutter>().add_systems(FixedUpdate, systems.in_set(TickSystems::Cut).run_if(SceneRequirements::cutting));
    }
}

/// The cutter of an organ and what it knows of the blades in it.
#[derive(Component, Clone)]
struct OrganCutter {
    cutter: Cutter,
    /// The blades that cut, each with its memory.
    blades: BTreeMap<Entity, MaterialMap>,
    /// A stroke has ended: pieces may have come free.
    look_for_fragments: bool,
}

fn prepare_organs(mut commands: Commands, organs: Query<(Entity, &TissueMesh), Without<OrganCutter>>) {
    for (organ, mesh) in &organs {
        let cutter = Cutter::new(&mesh.0);
        commands.entity(organ).insert(OrganCutter { cutter, blades: BTreeMap::new(), look_for_fragments: false });
    }
}

/// Frees the pieces that the strokes ended in the last tick cut off. A tick later, so that the donor's state has every node.
fn detach_fragments(
    mut commands: Commands,
    mut organs: Query<(Entity, &Organ, &OrganMaterials, &Attachments, &mut TissueMesh, &mut OrganCutter)>,
    mut status: ResMut<CutStatus>,
    mut ids: ResMut<SimulationIds>,
    time: Res<Time<Fixed>>,
) {
    let mut ordered: Vec<_> = organs.iter_mut().filter(|o| o.5.look_for_fragments).collect();
    ordered.sort_by_key(|o| o.0);
    for (donor, organ, materials, attachments, mut mesh, mut state) in ordered {
        state.look_for_fragments = false;
        // What a hand holds does not tell which piece is the organ.
        let stays = |a: &&Attachment| a.until_s.is_infinite() && matches!(a.anchor, Anchor::Space(_));
        let held: Vec<_> = attachments.0.iter().filter(stays).flat_map(|a| a.point.iter().map(|(n, _)| *n)).collect();
        for Fragment { mesh, donor_nodes } in fragment::detach(&mut mesh.0, &mut state.cutter, &held) {
            status.fragments += 1;
            let name = format!("{} piece {}", organ.name, status.fragments);
            let freed = FreedFrom { donor, time_s: time.elapsed_secs_f64() };
            let entity = ids.spawn(&mut commands, (Organ { name }, materials.clone(), TissueMesh(mesh), freed));
            commands.trigger(FragmentDetached { entity, donor, donor_nodes });
        }
    }
}

fn cut_organs(
    mut organs: Query<(Entity, &mut TissueMesh, &TissueState, &mut OrganCutter)>,
    blades: Query<(Entity, &InstrumentPose, &Blade)>,
    settings: Res<CutSettings>,
    time: Res<Time<Fixed>>,
    mut status: ResMut<CutStatus>,
) {
    let mut active: Vec<_> = blades.iter().filter(|(_, _, blade)| blade.active).collect();
    active.sort_by_key(|b| b.0);
    let mut cutting = false;
    let mut organs: Vec<_> = organs.iter_mut().collect();
    organs.sort_by_key(|o| o.0);
    for (_, mut mesh, state, mut organ) in organs {
        let organ = &mut *organ;
        let tissue = Tissue { positions: &state.positions, velocities: &state.velocities, dt_s: time.delta_secs() };
        // A blade that stops in the tissue ends its stroke; it goes on with it when it begins again near where it stopped.
        let mut stops = false;
        organ.blades.retain(|blade, map| {
            let cuts = active.iter().any(|a| a.0 == *blade);
            stops |= !cuts && map.has_begun();
            cuts
        });
        if stops {
            organ.end_stroke(&mut mesh, &mut status);
        }
        organ.cutter.set_settings(*settings);
        for (entity, pose, blade) in &active {
            organ.cutter.set_kerf(BladeId(entity.to_bits()), f64::from(blade.kerf_m));
            cutting |= organ.cut(*entity, &mut mesh, tissue, world_line(pose, blade), &mut status);
        }
    }
    if status.cutting != cutting {
        status.cutting = cutting;
    }
}

fn send_changes(mut organs: Query<(Entity, &mut TissueMesh)>, mut changes: MessageWriter<TopologyChanged>) {
    let mut ordered: Vec<_> = organs.iter_mut().filter(|o| o.1.0.has_delta()).collect();
    ordered.sort_by_key(|o| o.0);
    for (organ, mut mesh) in ordered {
        changes.write(TopologyChanged { organ, delta: mesh.0.take_delta() });
    }
}

impl OrganCutter {
    /// Moves a blade to its line. Returns whether it is in the tissue.
    fn cut(&mut self, blade: Entity, mesh: &mut Mut<TissueMesh>, tissue: Tissue, line: WorldLine, status: &mut CutStatus) -> bool {
        let map = self.blades.entry(blade).or_default();
        let (steps, left) = map.steps(&mesh.0, &self.cutter, tissue, line);
        let is_in = map.has_begun();
        for step in steps {
            count(status, self.cutter.advance(&mut mesh.0, BladeId(blade.to_bits()), &step).operations);
        }
        if left {
            self.blades.remove(&blade);
            self.end_stroke(mesh, status);
        }
        is_in
    }

    fn end_stroke(&mut self, mesh: &mut Mut<TissueMesh>, status: &mut CutStatus) {
        if self.cutter.is_cutting() {
            count(status, self.cutter.end_stroke(&mut mesh.0).operations);
        }
        if self.cutter.take_has_cut() {
            status.strokes += 1;
            self.look_for_fragments = true;
        }
    }
}

fn count(status: &mut CutStatus, operations: Operations) {
    status.deleted += operations.deleted;
    status.created += operations.created;
    status.updated += operations.updated;
    status.deferred += operations.deferred;
}

fn world_line(pose: &InstrumentPose, blade: &Blade) -> WorldLine {
    WorldLine { tip: pose.now.transform_point(blade.tip).as_dvec3(), heel: pose.now.transform_point(blade.heel).as_dvec3() }
}
