//! Glue: jaws on the whiteboard take hold of the organs on it.

use crate::bruise::{cell_area_m2, follow, mark, severity, worsens};
use crate::friction;
use crate::locate::{is_whole, position, stretch, tissue_at};
use crate::pads::{CELLS, Jaw, PadPoint, centres};
use crate::settings::GraspSettings;
use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_math::Vec3;
use keyhole_whiteboard::{
    Anchor, Attachment, Attachments, Bruises, FragmentDetached, GestureSystems, Grasp, GraspReport, InstrumentPose, JawPads, Jaws, Organ,
    PinchLimit, SceneRequirements, StateOf, TickSystems, TissueMesh, TissuePoint, TissueState, TopologyChanged,
};

/// Jaws with pads hold tissue, in [`GestureSystems::Grasp`].
pub struct GraspingPlugin;

impl Plugin for GraspingPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<GraspSettings>()
            .init_resource::<GraspReport>()
            .register_required_components::<JawPads, Grip>()
            .add_observer(lose_pads)
            .add_observer(inherit.run_if(SceneRequirements::instruments))
            .state::<Grip>()
            .state_resource::<GraspReport>()
            .add_systems(FixedUpdate, (prepare, grasp).chain().in_set(GestureSystems::Grasp).run_if(SceneRequirements::instruments))
            .add_systems(FixedUpdate, follow_cuts.in_set(TickSystems::Adopt).run_if(SceneRequirements::instruments));
    }
}

/// What the jaws were at in the last tick. Written by grasping.
#[derive(Component, Clone, Copy, Debug, Default)]
struct Grip {
    /// Their angle from the shaft's axis, rad.
    angle_rad: f32,
    /// Their angle when they first had hold from both sides, rad; zero before.
    touched_rad: f32,
    /// Cells that have bruised something since the jaws last held nothing.
    bruising: [bool; CELLS],
}

/// Sums over the points of a grasp.
#[derive(Default)]
struct Tally {
    grasp: Grasp,
    cells: [bool; CELLS],
    /// Points on each jaw.
    jaws: [u32; 2],
    /// Pressure of each cell, N.
    pressed_n: [f32; CELLS],
    /// Organ, cell and tissue of each point.
    pressed: Vec<(Entity, usize, TissuePoint)>,
}

type Tool<'a> = (Entity, &'a JawPads, &'a InstrumentPose, &'a Jaws, &'a mut Grip, &'a mut Grasp);
type Tissue<'a> = (Entity, &'a TissueMesh, &'a TissueState, &'a mut Attachments);

/// Pads that are gone hold nothing any more.
fn lose_pads(gone: On<Remove, JawPads>, mut organs: Query<&mut Attachments>) {
    for mut attachments in &mut organs {
        if attachments.0.iter().any(|a| tool_point(a, gone.entity).is_some()) {
            attachments.0.retain(|a| tool_point(a, gone.entity).is_none());
        }
    }
}

/// Gives organs what says where they are bruised.
fn prepare(mut commands: Commands, organs: Query<Entity, (With<Organ>, Without<Bruises>)>) {
    for organ in &organs {
        commands.entity(organ).insert(Bruises::default());
    }
}

/// A piece that comes free takes its bruises along.
fn inherit(freed: On<FragmentDetached>, organs: Query<&Bruises>, mut commands: Commands) {
    let Ok(donor) = organs.get(freed.donor) else { return };
    if donor.by_node.is_empty() {
        return;
    }
    let by_node = freed.donor_nodes.iter().map(|n| donor.by_node.get(n.index()).copied().unwrap_or(0.0)).collect();
    commands.entity(freed.entity).insert(Bruises { by_node });
}

/// Bruises go with the tissue that was cut.
fn follow_cuts(mut changes: MessageReader<TopologyChanged>, mut organs: Query<&mut Bruises>) {
    for change in changes.read() {
        if let Ok(mut bruises) = organs.get_mut(change.organ)
            && !bruises.by_node.is_empty()
        {
            follow(&mut bruises, &change.delta);
        }
    }
}

fn grasp(
    mut tools: Query<Tool>,
    mut organs: Query<Tissue>,
    mut marks: Query<(Option<&PinchLimit>, &mut Bruises)>,
    settings: Res<GraspSettings>,
    mut report: ResMut<GraspReport>,
) {
    let mut tools: Vec<_> = tools.iter_mut().collect();
    tools.sort_by_key(|t| t.0);
    let mut organs: Vec<_> = organs.iter_mut().collect();
    organs.sort_by_key(|o| o.0);
    for (instrument, pads, pose, jaws, mut grip, mut grasp) in tools {
        let (before_rad, now_rad) = (grip.angle_rad, jaws.angle_rad);
        grip.angle_rad = now_rad;
        let takes = now_rad < before_rad || (grasp.takes && now_rad <= before_rad);
        if !takes && grasp.points == 0 {
            grasp.set_if_neq(Grasp::default());
            continue;
        }
        let compliance = CELLS as f32 / settings.stiffness_n_m;
        let mut tally = Tally { grasp: Grasp { takes, ..Grasp::default() }, ..Tally::default() };
        for (organ, mesh, state, attachments) in &mut organs {
            if attachments.0.iter().all(|a| tool_point(a, instrument).is_none()) {
                continue;
            }
            attachments.0.retain_mut(|a| {
                let Some(local) = tool_point(a, instrument) else { return true };
                if !is_whole(&mesh.0, &a.point) || stretch(&mesh.0, &state.positions, &a.point) > settings.most_stretch {
                    return false;
                }
                let pad = Vec3::from(pose.before.transform_point(local));
                let force = (pad - position(&a.point, &state.positions)) / compliance;
                let force = pose.before.rotation.inverse() * force;
                let Some((point, cell)) = tally.hold(local, force, pads, before_rad, &settings) else { return false };
                tally.pressed.push((*organ, cell, a.point.clone()));
                a.anchor = Anchor::Tool { instrument, local: point.place(pads, now_rad) };
                true
            });
        }
        if takes {
            take_hold(instrument, &mut tally, pads, pose, now_rad, &settings, &mut organs);
        }
        tally.grasp.pinch_n /= 2.0;
        tally.grasp.pull_n = pose.before.rotation * tally.grasp.pull_n;
        tally.grasp.points = tally.jaws.iter().sum();
        if tally.grasp.points == 0 {
            grip.touched_rad = 0.0;
        } else if tally.jaws.iter().all(|points| *points > 0) {
            if grip.touched_rad <= 0.0 {
                grip.touched_rad = now_rad;
            }
            let full = if tally.grasp.pinch_n >= settings.most_pinch_n { now_rad } else { 0.0 };
            tally.grasp.least_angle_rad = full.max(settings.least_thickness * grip.touched_rad);
        }
        grasp.set_if_neq(tally.grasp);
        if tally.grasp.points == 0 {
            grip.bruising = [false; CELLS];
        } else {
            bruise(&tally, pads, &mut grip.bruising, &mut marks, &settings, &mut report);
        }
    }
}

/// Marks what is under cells that press too hard, and counts.
fn bruise(
    tally: &Tally,
    pads: &JawPads,
    bruising: &mut [bool; CELLS],
    marks: &mut Query<(Option<&PinchLimit>, &mut Bruises)>,
    settings: &GraspSettings,
    report: &mut GraspReport,
) {
    let area_m2 = cell_area_m2(pads);
    for (organ, cell, point) in &tally.pressed {
        let pressure_pa = tally.pressed_n[*cell] / area_m2;
        report.most_pa = report.most_pa.max(pressure_pa);
        let Ok((limit, mut bruises)) = marks.get_mut(*organ) else { continue };
        let bad = severity(pressure_pa, limit.map_or(settings.bruise_pa, |l| l.0));
        if bad <= 0.0 {
            continue;
        }
        report.bruising += u64::from(bruising.iter().all(|b| !b));
        report.bruised_m2 += if bruising[*cell] { 0.0 } else { area_m2 };
        bruising[*cell] = true;
        if worsens(&bruises, point, bad) {
            mark(&mut bruises, point, bad);
        }
    }
}

/// Where an attachment holds its point in the frame of this instrument, m.
fn tool_point(attachment: &Attachment, of: Entity) -> Option<Vec3> {
    match attachment.anchor {
        Anchor::Tool { instrument, local } if instrument == of => Some(local),
        Anchor::Tool { .. } | Anchor::Space(_) => None,
    }
}

impl Tally {
    /// Where a point that is held at `local` (m) with a force on the tissue (N, both in the instrument's frame) is held from now on, and in which cell; `None` where it is lost.
    fn hold(&mut self, local: Vec3, force_n: Vec3, pads: &JawPads, angle_rad: f32, settings: &GraspSettings) -> Option<(PadPoint, usize)> {
        let was = PadPoint::at(local, angle_rad);
        let compliance = CELLS as f32 / settings.stiffness_n_m;
        let hold = friction::hold(force_n, was.jaw.inward(angle_rad), settings.friction, compliance)?;
        let point = PadPoint::at(local + hold.slide_m, angle_rad);
        let cell = point.cell(pads)?;
        self.cells[cell] = true;
        self.pressed_n[cell] += hold.normal_n;
        self.jaws[usize::from(was.jaw == Jaw::Lower)] += 1;
        self.grasp.pinch_n += hold.normal_n;
        self.grasp.pull_n -= hold.force_n;
        self.grasp.sliding += u32::from(hold.slide_m != Vec3::ZERO);
        Some((point, cell))
    }
}

/// Cells that hold nothing take hold of the tissue that they are inside of.
fn take_hold(
    instrument: Entity,
    tally: &mut Tally,
    pads: &JawPads,
    pose: &InstrumentPose,
    angle_rad: f32,
    settings: &GraspSettings,
    organs: &mut [(Entity, &TissueMesh, &TissueState, Mut<Attachments>)],
) {
    let compliance_m_n = CELLS as f32 / settings.stiffness_n_m;
    let mut empty: Vec<PadPoint> = centres(pads).zip(tally.cells).filter(|(_, held)| !held).map(|(point, _)| point).collect();
    for (_, mesh, state, attachments) in organs {
        // An organ that has no state yet, or was cut in this very tick.
        if empty.is_empty() || state.positions.len() != mesh.0.node_slots() {
            continue;
        }
        // Where the pads were when the tissue was last where it is.
        let places: Vec<Vec3> = empty.iter().map(|p| pose.before.transform_point(p.place(pads, angle_rad)).into()).collect();
        let mut found = tissue_at(&mesh.0, &state.positions, &places).into_iter();
        empty.retain(|point| {
            let bears = |tissue: &TissuePoint| stretch(&mesh.0, &state.positions, tissue) <= settings.most_stretch;
            let Some(tissue) = found.next().flatten().filter(bears) else { return true };
            let anchor = Anchor::Tool { instrument, local: point.place(pads, angle_rad) };
            attachments.0.push(Attachment { point: tissue, anchor, compliance_m_n, until_s: f64::INFINITY });
            tally.jaws[usize::from(point.jaw == Jaw::Lower)] += 1;
            false
        });
    }
}
