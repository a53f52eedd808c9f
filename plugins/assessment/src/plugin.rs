//! Glue: what is on the whiteboard at the end of a tick goes into the sums of the session.

use crate::metrics::{Margin, Piece, Resection, ViewCone, Volumes};
use crate::results::{Measured, Results, TaskResult, record};
use crate::session::{MetricSettings, Resected, Sample, Session, ToolSample};
use crate::task::plugin::JudgeSystems;
use crate::task::{Task, TaskPlugin, TaskStatus};
use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_math::Vec3;
use bevy_time::{Fixed, Time};
use keyhole_tetmesh::{MaterialId, OuterPlanes};
use keyhole_whiteboard::{
    BleedReport, ClipApplier, ClipReport, Contacts, CuttingLine, Endoscope, FreedFrom, Grasp, GraspReport, Hand, Instrument,
    InstrumentPose, JawPads, Needle, Organ, OrganMaterials, Port, SceneCleared, SceneRequirements, StateOf, Suction, SutureReport,
    TickCost, TickSystems, TissueMesh, ToolContacts, Vessel,
};

/// Measures a session where the scene requires it; where it does not, no system runs and nothing is allocated. A scene that is started over is a new session.
pub struct AssessmentPlugin;

/// What is a matter of choice.
#[derive(Resource, Clone, Debug, PartialEq)]
pub struct AssessmentSettings {
    /// In the metrics.
    pub metrics: MetricSettings,
    /// Name of the materials that are tumour. Default `tumour`.
    pub tumour: String,
}

impl Default for AssessmentSettings {
    fn default() -> Self {
        Self { metrics: MetricSettings::default(), tumour: "tumour".into() }
    }
}

/// Whether the vessels that supply what is operated on are clamped; `None`, as by default, where there is nothing to clamp. Written, before
/// [`TickSystems::Assess`], by whoever simulates it.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct Clamped(pub Option<bool>);

/// The session that is being measured.
#[derive(Resource, Clone, Debug, Default)]
pub struct Assessment {
    session: Option<Box<Ongoing>>,
}

impl Assessment {
    /// The figures so far but for those of a resection, which take a look at every tetrahedron; none before the first tick.
    #[must_use]
    pub fn figures(&self) -> Vec<Measured> {
        self.session.as_ref().map_or_else(Vec::new, |ongoing| ongoing.sums.figures(None))
    }
}

#[derive(Clone, Debug)]
struct Ongoing {
    sums: Session,
    sample: Sample,
    organs: Vec<Before>,
}

/// An organ with a tumour as it was.
#[derive(Clone, Debug)]
struct Before {
    organ: Entity,
    volumes: Volumes,
    skin: OuterPlanes,
}

impl Plugin for AssessmentPlugin {
    fn build(&self, app: &mut App) {
        app.add_plugins(TaskPlugin)
            .init_resource::<AssessmentSettings>()
            .init_resource::<Clamped>()
            .init_resource::<Assessment>()
            .state_resource::<Clamped>()
            .state_resource::<Assessment>()
            .add_observer(|_: On<SceneCleared>, mut assessment: ResMut<Assessment>| *assessment = Assessment::default())
            .add_systems(FixedPreUpdate, begin.run_if(SceneRequirements::assessment).run_if(|cost: Res<TickCost>| cost.ticks == 0))
            .add_systems(FixedUpdate, measure.in_set(TickSystems::Assess).after(JudgeSystems).run_if(SceneRequirements::assessment));
    }
}

/// Before a scene's first tick: what it is before anybody touches it.
fn begin(
    mut assessment: ResMut<Assessment>,
    settings: Res<AssessmentSettings>,
    time: Res<Time<Fixed>>,
    organs: Query<(Entity, &TissueMesh, &OrganMaterials), (With<Organ>, Without<FreedFrom>)>,
) {
    // The clock of ticks stands while the simulation is paused before its first one.
    if assessment.session.as_ref().is_some_and(|s| s.sums.ticks() == 0 && s.organs.iter().all(|b| organs.contains(b.organ))) {
        return;
    }
    let mut before = Vec::new();
    for (organ, TissueMesh(mesh), materials) in &organs {
        let is_tumour = |m| is_tumour(materials, &settings.tumour, m);
        let volumes = Volumes::of(mesh, is_tumour);
        if volumes.tumour_m3 > 0.0 {
            before.push(Before { organ, volumes, skin: OuterPlanes::of(mesh) });
        }
    }
    before.sort_unstable_by_key(|b| b.organ);
    let sums = Session::new(time.timestep().as_secs_f64(), settings.metrics);
    assessment.session = Some(Box::new(Ongoing { sums, sample: Sample::default(), organs: before }));
}

fn is_tumour(materials: &OrganMaterials, name: &str, material: MaterialId) -> bool {
    materials.get(material).name == name
}

type Tool<'a> =
    (Entity, &'a Instrument, &'a Hand, &'a Port, &'a InstrumentPose, Option<&'a CuttingLine>, Option<&'a JawPads>, Option<&'a Grasp>);

fn measure(
    mut assessment: ResMut<Assessment>,
    (clamped, task): (Res<Clamped>, Res<TaskStatus>),
    (bleeding, clips): (Res<BleedReport>, Res<ClipReport>),
    (grasping, suturing): (Option<Res<GraspReport>>, Option<Res<SutureReport>>),
    (appliers, pads, needles, suctions): (
        Query<(), With<ClipApplier>>,
        Query<(), With<JawPads>>,
        Query<(), With<Needle>>,
        Query<(), With<Suction>>,
    ),
    vessels: Query<(), With<Vessel>>,
    tools: Query<Tool>,
    contacts: Query<&ToolContacts>,
    scopes: Query<&Endoscope>,
    organs: Query<&Contacts, With<Organ>>,
) {
    let Some(ongoing) = &mut assessment.session else { return };
    let sample = &mut ongoing.sample;
    sample.tools.clear();
    for (entity, instrument, hand, port, pose, line, pads, grasp) in &tools {
        let reach_m = line.map(|l| l.line.reach_m()).or(pads.map(|p| (p.from_m + p.to_m) / 2.0)).unwrap_or(0.0);
        let contact: Vec3 = organs.iter().map(|contacts| contacts.wrench_on(entity, Vec3::ZERO).0).sum();
        let held = grasp.filter(|g| g.points > 0);
        let pull = held.map_or(Vec3::ZERO, |g| g.pull_n);
        sample.tools.push(ToolSample {
            hand: *hand,
            port: port.position.as_dvec3(),
            shaft_end: Vec3::from(pose.now.translation).as_dvec3(),
            tip: (pose.now * Vec3::new(0.0, 0.0, -reach_m)).as_dvec3(),
            radius_m: f64::from(instrument.shaft_radius_m),
            grip_n: held.map(|g| f64::from(g.pinch_n)),
            tissue_n: f64::from((contact + pull).length()),
        });
    }
    let touched = |entity: &Entity| tools.contains(*entity);
    sample.tools_touch = contacts.iter().map(|c| c.touching.iter().any(touched)).reduce(|one, other| one || other);
    sample.view = scopes.iter().next().map(view_cone);
    sample.blood_lost_ml = (!vessels.is_empty()).then_some(bleeding.lost_ml);
    // It may have gone back to the tray.
    sample.aspirated_ml = (!suctions.is_empty() || bleeding.aspirated_ml > 0.0).then_some(bleeding.aspirated_ml);
    sample.clip_errors = (!appliers.is_empty()).then_some(clips.misplaced + clips.dropped + clips.slipped);
    sample.bruised_m2 = grasping.filter(|_| !pads.is_empty()).map(|report| f64::from(report.bruised_m2));
    sample.stitches_torn = suturing.filter(|_| !needles.is_empty()).map(|report| report.torn);
    (sample.dropped, sample.off_circle_m) = (task.drops, task.off_circle_m);
    sample.clamped = clamped.0;
    ongoing.sums.push(&ongoing.sample);
}

fn view_cone(scope: &Endoscope) -> ViewCone {
    let eye = scope.eye_pose();
    ViewCone {
        tip: Vec3::from(eye.translation).as_dvec3(),
        direction: (eye.rotation * Vec3::NEG_Z).as_dvec3(),
        half_angle_rad: f64::from(scope.angle_of_view_rad) / 2.0,
        right: (eye.rotation * Vec3::X).as_dvec3(),
    }
}

/// What a session has come to.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The figures, and how the task stands. Scene, trainee and time are left to whoever knows them.
    pub results: Results,
    /// The surface that was cut, all pieces together.
    pub margin: Option<Margin>,
    /// The same of each piece that came free with tumour in it, by its entity: distances at its nodes, to be drawn on it.
    pub pieces: Vec<(Entity, Margin)>,
}

/// What the session has come to so far; `None` where the scene does not require to be assessed, or no tick has run.
pub fn outcome(world: &mut World) -> Option<Outcome> {
    let mut freed: Vec<(Entity, FreedFrom)> = world.query::<(Entity, &FreedFrom)>().iter(world).map(|(e, f)| (e, *f)).collect();
    freed.sort_unstable_by_key(|(entity, _)| *entity);
    let ongoing = world.resource::<Assessment>().session.as_deref()?;
    let tumour = &world.resource::<AssessmentSettings>().tumour;
    let mut resected: Option<Resected> = None;
    let mut margins = Vec::new();
    for Before { organ, volumes, skin } in &ongoing.organs {
        let Some(materials) = world.get::<OrganMaterials>(*organ) else { continue };
        let is_tumour = |m| is_tumour(materials, tumour, m);
        let ours = freed.iter().map(|(entity, _)| *entity).filter(|entity| origin(*entity, &freed) == *organ);
        let of_piece = |entity: Entity, freed| world.get::<TissueMesh>(entity).map(|TissueMesh(mesh)| (entity, Piece { mesh, freed }));
        let pieces: Vec<(Entity, Piece)> = of_piece(*organ, false).into_iter().chain(ours.filter_map(|e| of_piece(e, true))).collect();
        let plain: Vec<Piece> = pieces.iter().map(|(_, piece)| *piece).collect();
        let of_organ = Resection::of(*volumes, &plain, is_tumour);
        for (entity, piece) in pieces.iter().filter(|(_, piece)| piece.freed) {
            margins.extend(Margin::of(piece.mesh, skin, is_tumour).map(|margin| (*entity, margin)));
        }
        let sum = resected.get_or_insert_with(|| Resected { volumes: Resection::default(), margin: None });
        sum.volumes.add(&of_organ);
    }
    let margin = Margin::joined(margins.iter().map(|(_, margin)| margin));
    if let Some(resected) = &mut resected {
        resected.margin.clone_from(&margin);
    }
    let figures = ongoing.sums.figures(resected.as_ref());
    let results = Results {
        format: record::FORMAT,
        program: env!("CARGO_PKG_VERSION").into(),
        task: TaskResult::of(world.resource::<Task>(), world.resource::<TaskStatus>(), &figures),
        figures,
        margin: resected.as_ref().and_then(Resected::summary),
        ..Results::default()
    };
    Some(Outcome { results, margin, pieces: margins })
}

/// The organ that a piece was a part of before anything was cut.
fn origin(mut entity: Entity, freed: &[(Entity, FreedFrom)]) -> Entity {
    // A piece is freed after its donor: no more steps than there are pieces.
    for _ in freed {
        match freed.binary_search_by_key(&entity, |(e, _)| *e) {
            Ok(i) => entity = freed[i].1.donor,
            Err(_) => break,
        }
    }
    entity
}
