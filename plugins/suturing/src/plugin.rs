//! Glue: needles on the whiteboard go through the organs on it.

use crate::grips::Jaw;
use crate::settings::SutureSettings;
use crate::stitch::{Suture, Works};
use crate::tissue::Tissue;
use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_time::{Fixed, Time};
use keyhole_whiteboard::{
    Anchor, Attachment, Attachments, Bites, GestureSystems, Gravity, InstrumentPose, JawPads, Jaws, Knots, Needle, SceneRequirements,
    StateOf, SutureReport, TearResistance, Thread, TissueMesh, TissueState,
};

/// Needle and thread, in [`GestureSystems::Suture`].
pub struct SuturingPlugin;

impl Plugin for SuturingPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<SutureSettings>()
            .init_resource::<SutureReport>()
            .register_required_components::<Needle, Strung>()
            .state::<Strung>()
            .state::<Watch>()
            .state_resource::<SutureReport>()
            .add_systems(FixedUpdate, suture.in_set(GestureSystems::Suture).run_if(SceneRequirements::suturing));
    }
}

/// What a suture keeps. Written by suturing.
#[derive(Component, Clone, Debug, Default)]
struct Strung(Works);

/// What jaws were at; on jaws that a tick with a needle has seen. Written by suturing.
#[derive(Component, Clone, Copy, Debug, Default)]
struct Watch {
    /// Their angle in the last tick, rad; none before the first.
    angle_rad: Option<f32>,
    /// The angle from which they have been closing, rad.
    widest_rad: f32,
}

type Needles<'a> = (Entity, &'a mut Needle, &'a mut Thread, &'a mut Bites, &'a mut Knots, &'a mut Strung);
type Organs<'a> = (Entity, &'a TissueMesh, &'a TissueState, Option<&'a TearResistance>, &'a mut Attachments);

fn suture(
    mut commands: Commands,
    mut needles: Query<Needles>,
    mut organs: Query<Organs>,
    mut tools: Query<(Entity, &JawPads, &InstrumentPose, &Jaws, Option<&mut Watch>)>,
    settings: Res<SutureSettings>,
    gravity: Res<Gravity>,
    time: Res<Time<Fixed>>,
    mut report: ResMut<SutureReport>,
) {
    let dt_s = time.timestep().as_secs_f64();
    let mut jaws: Vec<Jaw> = Vec::new();
    for (instrument, pads, pose, now, known) in &mut tools {
        let watch = known.as_deref().copied().unwrap_or_default();
        let before_rad = watch.angle_rad.unwrap_or(now.angle_rad);
        let widest_rad = if now.angle_rad >= before_rad { now.angle_rad.max(before_rad) } else { watch.widest_rad.max(before_rad) };
        let watch = Watch { angle_rad: Some(now.angle_rad), widest_rad };
        match known {
            Some(mut known) => *known = watch,
            None => {
                commands.entity(instrument).insert(watch);
            }
        }
        jaws.push(Jaw { instrument, pads: *pads, pose: pose.now, angle_rad: now.angle_rad, before_rad, widest_rad });
    }
    jaws.sort_by_key(|j| j.instrument);
    let mut organs: Vec<_> = organs.iter_mut().filter(|(_, mesh, state, ..)| state.positions.len() == mesh.0.node_slots()).collect();
    organs.sort_by_key(|o| o.0);
    let mut needles: Vec<_> = needles.iter_mut().collect();
    needles.sort_by_key(|n| n.0);
    let tissues: Vec<Tissue> = organs
        .iter()
        .map(|(organ, mesh, state, tear, _)| Tissue {
            organ: *organ,
            mesh: &mesh.0,
            positions: &state.positions,
            tear_n_m: tear.map_or(settings.tear_n_m, |t| t.0),
        })
        .collect();
    for (_, needle, thread, bites, knots, works) in &mut needles {
        let works = &mut works.0;
        let (refused, torn) = (works.chain.refused, bites.torn.len());
        Suture { needle, thread, bites, knots, works }.tick(&tissues, &jaws, &settings, gravity.0, dt_s);
        if works.chain.refused > refused {
            if report.refused == 0 {
                tracing::warn!(
                    "a thread stood still for {} substeps: what it is pulled by is farther away than it is long",
                    works.chain.refused - refused
                );
            }
            report.refused += works.chain.refused - refused;
        }
        report.torn += (bites.torn.len() - torn) as u64;
    }
    drop(tissues);
    // They are made anew in each tick: those of this one end before the next is over.
    let until_s = time.elapsed_secs_f64() + 0.5 * dt_s;
    for (_, _, _, bites, ..) in &needles {
        for bite in &bites.held {
            let Some((.., attachments)) = organs.iter_mut().find(|o| o.0 == bite.organ) else { continue };
            attachments.0.extend(bite.holes.iter().map(|hole| Attachment {
                point: hole.point.clone(),
                anchor: Anchor::Space(hole.anchor),
                compliance_m_n: settings.compliance_m_n,
                until_s,
            }));
        }
    }
}
