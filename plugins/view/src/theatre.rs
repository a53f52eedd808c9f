//! Light and surroundings: the room of the global view, the light of the endoscope and the cavity that it lights.

use crate::eyes::{Eye, EyeOf};
use crate::framing::Framing;
use crate::layers;
use crate::optics::eye_pose;
use crate::organs::OrganViews;
use crate::shading::{Look, SceneMaterial, Shading, Sides};
use crate::smoothing::MotionSettings;
use bevy::light::cluster::GlobalClusterSettings;
use bevy::light::{CascadeShadowConfigBuilder, DirectionalLightShadowMap, NotShadowCaster};
use bevy::mesh::VertexAttributeValues;
use bevy::prelude::*;
use keyhole_whiteboard::Endoscope;

/// The light at the tip of the endoscope.
#[derive(Component)]
pub struct ScopeLight;

/// A light of the specimen's view: its turn from that of the eye.
#[derive(Component)]
pub struct SpecimenLamp(Quat);

/// Illuminance of the specimen's lamps, lx, and where they hang as its eye sees it: right, up, back. Colours are to be read off, whichever way it lies.
const SPECIMEN_LAMPS: [(f32, Vec3); 3] =
    [(1500.0, Vec3::new(0.2, 0.4, 1.0)), (900.0, Vec3::new(-1.0, 0.1, 0.6)), (900.0, Vec3::new(0.9, -0.5, 0.5))];

/// The wall of the abdominal cavity.
#[derive(Component)]
pub struct Cavity;

/// The drape under everything in the global view.
#[derive(Component)]
pub struct Drape;

/// Illuminance that the light of the endoscope's automatic gain aims at, at the nearest tissue in view, lx.
const SCOPE_ILLUMINANCE_LX: f32 = 3400.0;

/// The light leaves beside the lens, m.
const LIGHT_BESIDE_LENS: Vec3 = Vec3::new(0.0022, 0.0030, 0.0);

/// Time in which the automatic gain settles, s.
const GAIN_TIME_S: f32 = 0.25;

/// Sets the lights and the surroundings up. Which of the lights a view has is compiled into its pipelines, see `shading::Lights`: another light is one there too.
pub fn furnish(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<SceneMaterial>>,
    mut shadows: ResMut<DirectionalLightShadowMap>,
    clusters: Option<ResMut<GlobalClusterSettings>>,
) {
    shadows.size = 1024;
    // One light needs no clusters on the GPU, and on lavapipe (Mesa 22.3.6) they lost it: the laparoscopic view stayed dark.
    if let Some(mut clusters) = clusters {
        clusters.gpu_clustering = None;
    }
    let cascades = CascadeShadowConfigBuilder {
        num_cascades: 1,
        minimum_distance: 0.02,
        maximum_distance: 2.0,
        first_cascade_far_bound: 1.0,
        ..default()
    };
    let from = |x, y, z| Transform::from_xyz(x, y, z).looking_at(Vec3::ZERO, Vec3::Y);
    let lamp = |colour, illuminance, shadow_maps_enabled| DirectionalLight {
        color: colour,
        illuminance,
        shadow_maps_enabled,
        shadow_depth_bias: 0.002,
        shadow_normal_bias: 1.2,
        ..default()
    };
    commands.spawn((lamp(Color::srgb(1.0, 0.97, 0.92), 3400.0, true), cascades.build(), from(0.5, 1.0, 0.35), layers::global_only()));
    commands.spawn((lamp(Color::srgb(0.80, 0.90, 1.0), 1000.0, false), from(-0.9, 0.5, 0.1), layers::global_only()));
    // What was resected is looked at by itself, in even light from where it is looked at.
    for (illuminance, towards) in SPECIMEN_LAMPS {
        let lamp = lamp(Color::WHITE, illuminance, false);
        commands.spawn((SpecimenLamp(Quat::from_rotation_arc(Vec3::Z, towards.normalize())), lamp, layers::specimen_only()));
    }
    commands.spawn((
        ScopeLight,
        SpotLight {
            color: Color::srgb(1.0, 0.98, 0.95),
            intensity: 0.0,
            range: 1.0,
            radius: 0.0015,
            shadow_maps_enabled: true,
            shadow_depth_bias: 0.001,
            shadow_normal_bias: 1.5,
            shadow_map_near_z: 0.004,
            outer_angle: 0.95,
            inner_angle: 0.35,
            ..default()
        },
        layers::shared(),
    ));
    commands.spawn((
        Cavity,
        Mesh3d(meshes.add(cavity_mesh())),
        MeshMaterial3d(materials.add(SceneMaterial { shading: Shading::Unlit, sides: Sides::Back, ..default() })),
        NotShadowCaster,
        layers::scope_only(),
    ));
    commands.spawn((
        Drape,
        Mesh3d(meshes.add(Plane3d::default().mesh().size(1.0, 1.0))),
        MeshMaterial3d(materials.add(SceneMaterial {
            shading: Shading::Matt,
            ..SceneMaterial::lit(Look { roughness: 0.95, ..Look::of([0.020, 0.075, 0.080]) })
        })),
        NotShadowCaster,
        layers::global_only(),
    ));
}

/// Puts the surroundings around the scene when it has changed.
pub fn surround(
    framing: Res<Framing>,
    mut cavity: Single<&mut Transform, (With<Cavity>, Without<Drape>)>,
    mut drape: Single<&mut Transform, (With<Drape>, Without<Cavity>)>,
) {
    if framing.is_changed() {
        let radius = 3.0 * framing.radius_m;
        **cavity = Transform::from_translation(framing.focus).with_scale(Vec3::splat(radius.max(0.13)));
        let below = Vec3::new(framing.focus.x, framing.floor_m - 0.08 * framing.radius_m, framing.focus.z);
        **drape = Transform::from_translation(below).with_scale(Vec3::splat(40.0 * framing.radius_m));
    }
}

/// Carries the lamps with the eye that looks at the specimen.
pub fn light_specimen(eyes: Query<(&Eye, &Transform), Without<SpecimenLamp>>, mut lamps: Query<(&SpecimenLamp, &mut Transform)>) {
    let Some((_, eye)) = eyes.iter().find(|(eye, _)| matches!(eye.shows, EyeOf::Specimen(_))) else { return };
    for (lamp, mut transform) in &mut lamps {
        let rotation = eye.rotation * lamp.0;
        transform.set_if_neq(Transform { rotation, ..*transform });
    }
}

/// Carries the light with the endoscope and sets it by the distance of what is in view, as the camera's automatic gain would.
pub fn light_scope(
    endoscopes: Query<&Endoscope>,
    organs: Res<OrganViews>,
    motion: Res<MotionSettings>,
    time: Res<Time<Real>>,
    mut light: Single<(&mut Transform, &mut SpotLight), With<ScopeLight>>,
) {
    let (transform, spot) = &mut *light;
    let Some(endoscope) = endoscopes.iter().next() else {
        spot.intensity = 0.0;
        return;
    };
    let eye = eye_pose(endoscope);
    **transform = Transform::from_isometry(eye);
    transform.translation += eye.rotation * LIGHT_BESIDE_LENS;
    let cosine = (0.6 * endoscope.angle_of_view_rad / 2.0).cos();
    let nearest = organs
        .skin_points()
        .map(|p| p - Vec3::from(eye.translation))
        .filter(|to| to.dot(eye.rotation * Vec3::NEG_Z) > cosine * to.length())
        .map(Vec3::length)
        .fold(0.20, f32::min)
        .max(0.015);
    let wanted = SCOPE_ILLUMINANCE_LX * 4.0 * std::f32::consts::PI * nearest * nearest;
    let settled = match *motion {
        MotionSettings::Blend => 1.0 - (-time.delta_secs() / GAIN_TIME_S).exp(),
        MotionSettings::Newest => 1.0,
    };
    spot.intensity += settled * (wanted - spot.intensity);
}

/// A unit ball with folds, coloured like peritoneum over fat, its shading baked in for a light near the middle: the wall fills the picture,
/// and unlit it costs a fifth of what it would cost lit. An icosphere has no poles.
fn cavity_mesh() -> Mesh {
    let mut mesh = Sphere::new(1.0).mesh().ico(40).unwrap_or_else(|_| Sphere::new(1.0).mesh().uv(96, 64));
    let mut colours = Vec::new();
    if let Some(VertexAttributeValues::Float32x3(points)) = mesh.attribute_mut(Mesh::ATTRIBUTE_POSITION) {
        for point in points.iter_mut() {
            let p = Vec3::from_array(*point);
            let wave = |f: f32, d: Vec3, s: f32| (f * p.dot(d) + s).sin();
            let fold = wave(7.0, Vec3::new(0.7, 0.5, 0.2), 0.0) * wave(9.0, Vec3::new(-0.3, 0.8, 0.6), 1.0);
            let fine = wave(31.0, Vec3::new(0.2, 0.9, -0.4), 0.4) * wave(27.0, Vec3::new(0.8, -0.1, 0.6), 2.0);
            *point = (p * (1.0 + 0.05 * fold + 0.006 * fine)).to_array();
            let fat = (0.25 + 0.6 * fold + 0.12 * fine).clamp(0.0, 1.0);
            let c = Vec3::new(0.130, 0.030, 0.024).lerp(Vec3::new(0.150, 0.070, 0.032), 0.7 * fat);
            // What bulges towards the middle is nearer to the light.
            colours.push(c * (1.0 - 0.35 * fold + 0.07 * fine));
        }
    }
    let colours: Vec<[f32; 4]> = colours.into_iter().map(|c| c.extend(1.0).to_array()).collect();
    mesh.with_inserted_attribute(Mesh::ATTRIBUTE_COLOR, colours)
}
