//! Smoke where the hook burns: soft discs that rise from the blade, grow and fade. They face the camera that draws; of two that draw at once, the
//! main one. Nothing that is simulated knows of them.

use crate::eyes::{Eye, WindowEye};
use crate::layers;
use crate::shading::{SceneMaterial, Shading, Sides};
use bevy::asset::RenderAssetUsages;
use bevy::camera::visibility::{NoAutoAabb, NoFrustumCulling};
use bevy::light::{NotShadowCaster, NotShadowReceiver};
use bevy::mesh::{Indices, PrimitiveTopology};
use bevy::prelude::*;
use keyhole_whiteboard::{Blade, CutStatus, Instrument, InstrumentKind, InstrumentPose, SimulationControl};

/// How much smoke there is.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct SmokeSettings {
    /// Puffs a second while a hook cuts. Default 30; 0 for none.
    pub puffs_1_s: f32,
    /// How long a puff is seen, s. Default 1.8.
    pub life_s: f32,
    /// Speed at which it rises, m/s. Default 0.02.
    pub rise_m_s: f32,
    /// Radius when it comes and when it goes, m. Default 2 and 14 mm.
    pub radius_m: [f32; 2],
    /// How much of what is behind it a fresh puff hides, 0 to 1. Default 0.20.
    pub opacity: f32,
}

impl Default for SmokeSettings {
    fn default() -> Self {
        Self { puffs_1_s: 30.0, life_s: 1.8, rise_m_s: 0.02, radius_m: [0.002, 0.014], opacity: 0.20 }
    }
}

#[derive(Clone, Copy, Debug)]
struct Puff {
    at: Vec3,
    drift: Vec3,
    age_s: f32,
}

/// The puffs.
#[derive(Resource, Debug, Default)]
pub struct Smoke {
    puffs: Vec<Puff>,
    /// Puffs that are due, of which the whole ones come.
    due: f32,
    /// How many have come: where along the blade the next one does, and whereto it drifts, is a matter of that.
    count: u32,
    drawn: Option<(Entity, Handle<Mesh>)>,
}

/// Nearer to the camera than this a puff is not drawn, m: it would fill the picture.
const NEAREST_M: f32 = 0.012;

/// A part of 1 that goes on by the golden section: evenly spread, whatever their number.
fn spread(count: u32, by: f32) -> f32 {
    (count as f32 * by).fract()
}

impl Smoke {
    /// Lets time go by: puffs rise, old ones go.
    fn age(&mut self, dt_s: f32, settings: &SmokeSettings) {
        for puff in &mut self.puffs {
            puff.age_s += dt_s;
            puff.at += puff.drift * dt_s;
        }
        self.puffs.retain(|puff| puff.age_s < settings.life_s);
    }

    /// Lets what is due of a blade that burns come, from `heel` to `tip` (m).
    fn burn(&mut self, dt_s: f32, heel: Vec3, tip: Vec3, settings: &SmokeSettings) {
        self.due += settings.puffs_1_s * dt_s;
        while self.due >= 1.0 {
            self.due -= 1.0;
            self.count = self.count.wrapping_add(1) % 65_536;
            let turn = std::f32::consts::TAU * spread(self.count, 0.754_877_7);
            let drift = settings.rise_m_s * Vec3::new(0.35 * turn.cos(), 1.0, 0.35 * turn.sin());
            self.puffs.push(Puff { at: heel.lerp(tip, spread(self.count, 0.618_034)), drift, age_s: 0.0 });
        }
    }

    fn write(&self, mesh: &mut Mesh, camera: &Transform, settings: &SmokeSettings) {
        let (right, up) = (camera.rotation * Vec3::X, camera.rotation * Vec3::Y);
        let (mut points, mut colours, mut uvs, mut indices) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for puff in self.puffs.iter().filter(|p| p.at.distance(camera.translation) > NEAREST_M) {
            let part = puff.age_s / settings.life_s;
            let radius = settings.radius_m[0] + (settings.radius_m[1] - settings.radius_m[0]) * part.sqrt();
            let first = points.len() as u32;
            for [x, y] in [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]] {
                points.push((puff.at + radius * (x * right + y * up)).to_array());
                colours.push([0.62, 0.60, 0.58, settings.opacity * (1.0 - part)]);
                uvs.push([0.5 * (x + 1.0), 0.5 * (y + 1.0)]);
            }
            indices.extend([0, 1, 2, 0, 2, 3].map(|i| first + i));
        }
        let normals = vec![(camera.rotation * Vec3::Z).to_array(); points.len()];
        mesh.insert_attribute(Mesh::ATTRIBUTE_POSITION, points);
        mesh.insert_attribute(Mesh::ATTRIBUTE_NORMAL, normals);
        mesh.insert_attribute(Mesh::ATTRIBUTE_COLOR, colours);
        mesh.insert_attribute(Mesh::ATTRIBUTE_UV_0, uvs);
        mesh.insert_indices(Indices::U32(indices));
    }
}

/// Lets smoke rise from hooks that cut, and draws it.
pub fn smoke(
    mut commands: Commands,
    mut smoke: ResMut<Smoke>,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<SceneMaterial>>,
    settings: Res<SmokeSettings>,
    time: Res<Time<Virtual>>,
    control: Res<SimulationControl>,
    cutting: Res<CutStatus>,
    blades: Query<(&Instrument, &InstrumentPose, &Blade)>,
    eyes: Query<(&Camera, &Transform, Option<&WindowEye>), With<Eye>>,
) {
    let dt_s = if control.paused { 0.0 } else { time.delta_secs() };
    smoke.age(dt_s, &settings);
    for (_, pose, blade) in blades.iter().filter(|(i, _, b)| i.kind == InstrumentKind::Hook && b.active && cutting.cutting) {
        smoke.burn(dt_s, pose.now * blade.heel, pose.now * blade.tip, &settings);
    }
    if smoke.puffs.is_empty() {
        if let Some((entity, _)) = smoke.drawn.take() {
            commands.entity(entity).despawn();
        }
        return;
    }
    // A picture's eye comes before the window's.
    let camera = eyes.iter().filter(|(camera, ..)| camera.is_active).min_by_key(|(.., of_window)| of_window.map_or(0, |e| 1 + *e as u8));
    let Some((_, camera, _)) = camera else { return };
    if smoke.drawn.is_none() {
        let mesh = meshes.add(Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default()));
        let material = materials.add(SceneMaterial { shading: Shading::Disc, sides: Sides::Both, ..default() });
        let seen = (NoFrustumCulling, NoAutoAabb, NotShadowCaster, NotShadowReceiver, layers::shared());
        let entity = commands.spawn((Name::new("smoke"), Mesh3d(mesh.clone()), MeshMaterial3d(material), seen)).id();
        smoke.drawn = Some((entity, mesh));
    }
    if let Some(mut mesh) = smoke.drawn.as_ref().and_then(|(_, handle)| meshes.get_mut(handle)) {
        smoke.write(&mut mesh, camera, &settings);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As many puffs come as the rate says, on the blade; in time all have gone, and none has sunk.
    #[test]
    fn smoke_comes_at_its_rate_and_goes() {
        let (settings, mut smoke) = (SmokeSettings::default(), Smoke::default());
        let (heel, tip) = (Vec3::ZERO, Vec3::new(0.02, 0.0, 0.0));
        for _ in 0..60 {
            smoke.burn(1.0 / 60.0, heel, tip, &settings);
        }
        assert!((smoke.puffs.len() as f32 - settings.puffs_1_s).abs() <= 1.0);
        assert!(smoke.puffs.iter().all(|p| (0.0..=0.02).contains(&p.at.x) && p.at.y == 0.0 && p.at.z == 0.0));
        smoke.age(0.5 * settings.life_s, &settings);
        let risen = 0.5 * settings.life_s * settings.rise_m_s;
        assert!(smoke.puffs.iter().all(|p| (p.at.y - risen).abs() < 1e-6) && !smoke.puffs.is_empty());
        smoke.age(settings.life_s, &settings);
        assert!(smoke.puffs.is_empty());
    }
}
