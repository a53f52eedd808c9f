//! A stay: an instrument closes its jaws in tissue that has been lifted, and the tissue stays there. Closed on a stay, it takes it off again.

pub mod stay;

use bevy_app::prelude::*;
use bevy_ecs::prelude::*;
use bevy_math::Vec3;
use bevy_time::{Fixed, Time};
use keyhole_whiteboard::{
    Anchor, Attachment, Attachments, GestureSystems, InstrumentPose, Jaws, Organ, SceneRequirements, StateOf, TissueMesh, TissueState,
};
use stay::{Stay, tissue_at};

/// Puts on stays, in [`GestureSystems::Further`].
pub struct StayPlugin;

impl Plugin for StayPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<StaySettings>()
            .state::<StayApplier>()
            .state::<Stays>()
            .add_systems(FixedUpdate, (equip, put_stays).chain().in_set(GestureSystems::Further).run_if(SceneRequirements::instruments));
    }
}

/// How stays hold.
#[derive(Resource, Clone, Copy, Debug)]
pub struct StaySettings {
    /// m/N. Default 0.0005.
    pub compliance_m_n: f32,
    /// Force at which one pulls out, N. Default 2.
    pub strength_n: f32,
    /// How near to a stay the tip has to be to take it off, m. Default 0.003.
    pub reach_m: f32,
}

impl Default for StaySettings {
    fn default() -> Self {
        Self { compliance_m_n: 5e-4, strength_n: 2.0, reach_m: 0.003 }
    }
}

/// On an instrument: it puts on stays.
#[derive(Component, Clone, Copy, Debug)]
pub struct StayApplier {
    /// From the pivot of the jaws to their tips, m.
    pub length_m: f32,
    /// The angle at which the jaws are taken as closed, rad.
    pub closed_rad: f32,
    /// Whether they were closed in the last tick. Written by this crate.
    pub was_closed: bool,
}

/// On an organ: the stays in it. Written by this crate; for whoever draws or counts them.
#[derive(Component, Clone, Debug, Default)]
pub struct Stays(pub Vec<Stay>);

/// Gives every organ that has come its list.
fn equip(mut commands: Commands, organs: Query<Entity, (With<Organ>, Without<Stays>)>) {
    for organ in &organs {
        commands.entity(organ).insert(Stays::default());
    }
}

type Organs<'a> = (Entity, &'a TissueMesh, &'a TissueState, &'a mut Stays, &'a mut Attachments);

fn put_stays(
    mut tools: Query<(Entity, &InstrumentPose, &Jaws, &mut StayApplier)>,
    mut organs: Query<Organs>,
    settings: Res<StaySettings>,
    time: Res<Time<Fixed>>,
) {
    // The order of entities in a query may change; the result must not.
    let mut organs: Vec<_> = organs.iter_mut().filter(|(_, mesh, state, ..)| state.positions.len() == mesh.0.node_slots()).collect();
    organs.sort_by_key(|organ| organ.0);
    let mut tools: Vec<_> = tools.iter_mut().collect();
    tools.sort_by_key(|tool| tool.0);
    for (_, mesh, state, stays, _) in &mut organs {
        stays.0.retain_mut(|stay| stay.holds(&mesh.0, &state.positions, settings.compliance_m_n, settings.strength_n));
    }
    for (_, pose, jaws, applier) in &mut tools {
        let closed = jaws.angle_rad <= applier.closed_rad;
        let closes = closed && !applier.was_closed;
        applier.was_closed = closed;
        if !closes {
            continue;
        }
        let tip = Vec3::from(pose.now.transform_point(Vec3::new(0.0, 0.0, -applier.length_m)));
        let mut taken = false;
        for (_, _, _, stays, _) in &mut organs {
            let before = stays.0.len();
            stays.0.retain(|stay| stay.place.distance(tip) > settings.reach_m);
            taken |= stays.0.len() < before;
        }
        for (_, mesh, state, stays, _) in organs.iter_mut().filter(|_| !taken) {
            if let Some(point) = tissue_at(&mesh.0, &state.positions, tip) {
                stays.0.push(Stay { point, place: tip, force_n: Vec3::ZERO });
                break;
            }
        }
    }
    // An attachment that is put up for one tick only never has to be found again.
    let until_s = time.elapsed_secs_f64() + 0.5 * time.timestep().as_secs_f64();
    for (_, _, _, stays, attachments) in &mut organs {
        attachments.0.extend(stays.0.iter().map(|stay| Attachment {
            point: stay.point.clone(),
            anchor: Anchor::Space(stay.place),
            compliance_m_n: settings.compliance_m_n,
            until_s,
        }));
    }
}
