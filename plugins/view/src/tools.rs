//! Instruments, ports and the endoscope's shaft as they are drawn.

use crate::clips::ClipPart;
use crate::layers;
use crate::shading::{Look, SceneMaterial, Sides};
use crate::smoothing::Smoothing;
use crate::thread::{DrawnNeedle, DrawnThread};
use bevy::asset::RenderAssetUsages;
use bevy::light::NotShadowCaster;
use bevy::math::Isometry3d;
use bevy::mesh::{Indices, PrimitiveTopology};
use bevy::prelude::*;
use keyhole_whiteboard::{Blade, Endoscope, InstrumentPose, Jaws, PartMesh, Port, StateRestored, ToolModel};

/// What a drawn entity stands for: it goes when that is gone.
#[derive(Component, Clone, Copy, Debug)]
pub struct Draws(pub Entity);

/// A part of an instrument's model, by its index there.
#[derive(Component, Clone, Copy, Debug)]
pub struct DrawnPart(usize);

/// The glow of a blade.
#[derive(Component, Clone, Copy, Debug)]
pub struct BladeGlow;

/// The shaft of the endoscope.
#[derive(Component, Clone, Copy, Debug)]
pub struct ScopeShaft;

/// Length of the endoscope's shaft, m, and its radius, m: 10 mm scopes are 30 to 35 cm long.
const SCOPE_SHAFT: (f32, f32) = (0.32, 0.005);

/// Takes away what was drawn for entities that are gone.
pub fn drop_orphans(mut commands: Commands, drawn: Query<(Entity, &Draws)>, all: Query<()>) {
    for (entity, of) in &drawn {
        if !all.contains(of.0) {
            commands.entity(entity).despawn();
        }
    }
}

/// What is drawn of a state is drawn anew when another one has been put in its place. Ports and anatomy are no part of it.
pub fn drop_drawn(_: On<StateRestored>, mut commands: Commands, drawn: Query<Entity, OfState>) {
    for entity in &drawn {
        commands.entity(entity).despawn();
    }
}

type OfState = Or<(With<DrawnPart>, With<BladeGlow>, With<ScopeShaft>, With<ClipPart>, With<DrawnNeedle>, With<DrawnThread>)>;

/// Draws instruments whose model has come or changed, and those that are not drawn.
pub fn draw_tools(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<SceneMaterial>>,
    tools: Query<(Entity, Ref<ToolModel>)>,
    drawn: Query<(Entity, &Draws), With<DrawnPart>>,
) {
    for (tool, model) in &tools {
        let mine = || drawn.iter().filter(|(_, of)| of.0 == tool);
        if !model.is_changed() && mine().next().is_some() {
            continue;
        }
        mine().for_each(|(entity, _)| commands.entity(entity).despawn());
        for (index, part) in model.parts.iter().enumerate() {
            commands.spawn((
                Draws(tool),
                DrawnPart(index),
                Mesh3d(meshes.add(mesh_of(&part.mesh))),
                MeshMaterial3d(materials.add(SceneMaterial {
                    sides: Sides::Both,
                    // Without an environment to mirror, bare metal would be black.
                    ..SceneMaterial::lit(Look {
                        metallic: 0.55 * part.metallic,
                        roughness: 0.34,
                        reflectance: 0.6,
                        ..Look::of(part.colour)
                    })
                })),
                layers::shared(),
            ));
        }
    }
}

/// Moves the parts with the pose and the jaws.
pub fn move_tools(
    smoothing: Smoothing,
    tools: Query<(&ToolModel, &InstrumentPose, Option<&Jaws>)>,
    mut parts: Query<(&Draws, &DrawnPart, &mut Transform)>,
) {
    for (of, part, mut transform) in &mut parts {
        let Ok((model, pose, jaws)) = tools.get(of.0) else { continue };
        let Some(part) = model.parts.get(part.0) else { continue };
        let joint = part.joint.at(jaws.map_or(0.0, |j| j.angle_rad));
        *transform = Transform::from_isometry(between(pose, smoothing.fraction()) * joint);
    }
}

/// Draws blades that have come, ports and endoscopes.
pub fn draw_fittings(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<SceneMaterial>>,
    blades: Query<Entity, Added<Blade>>,
    ports: Query<(Entity, &Port), Added<Port>>,
    scopes: Query<Entity, Added<Endoscope>>,
    glows: Query<(Entity, &Draws), With<BladeGlow>>,
) {
    for blade in &blades {
        // An instrument that was exchanged may have had another one.
        glows.iter().filter(|(_, of)| of.0 == blade).for_each(|(glow, _)| commands.entity(glow).despawn());
        commands.spawn((
            Draws(blade),
            BladeGlow,
            Mesh3d(meshes.add(Cylinder::new(1.0, 1.0))),
            MeshMaterial3d(materials.add(SceneMaterial::lit(Look { glow: Vec4::new(6.0, 2.6, 0.7, 0.0), ..Look::of([0.0; 3]) }))),
            Visibility::Hidden,
            NotShadowCaster,
            layers::shared(),
        ));
    }
    for (entity, port) in &ports {
        let facing = Quat::from_rotation_arc(Vec3::NEG_Y, port.inward.normalize_or(Vec3::NEG_Y));
        let plastic = materials.add(SceneMaterial::lit(Look { roughness: 0.4, ..Look::of([0.10, 0.16, 0.30]) }));
        let parts = [(meshes.add(Torus::new(0.0065, 0.0105)), Vec3::ZERO), (meshes.add(Torus::new(0.0062, 0.0078)), Vec3::Y * 0.006)];
        for (mesh, offset) in parts {
            commands.spawn((
                Draws(entity),
                Mesh3d(mesh),
                MeshMaterial3d(plastic.clone()),
                Transform { translation: port.position + facing * offset, rotation: facing, ..default() },
                layers::shared(),
            ));
        }
    }
    for scope in &scopes {
        let (length, radius) = SCOPE_SHAFT;
        commands.spawn((
            Draws(scope),
            ScopeShaft,
            // A cylinder's axis is Y and its origin its middle.
            Mesh3d(
                meshes.add(
                    Cylinder::new(radius, length)
                        .mesh()
                        .build()
                        .rotated_by(Quat::from_rotation_x(std::f32::consts::FRAC_PI_2))
                        .translated_by(Vec3::Z * (length / 2.0)),
                ),
            ),
            MeshMaterial3d(materials.add(SceneMaterial::lit(Look { metallic: 0.5, roughness: 0.3, ..Look::of([0.30, 0.31, 0.33]) }))),
            layers::global_only(),
        ));
    }
}

/// Moves the shaft of the endoscope and the glow of the blades.
pub fn move_fittings(
    smoothing: Smoothing,
    scopes: Query<&Endoscope>,
    blades: Query<(&Blade, &InstrumentPose)>,
    mut shafts: Query<(&Draws, &mut Transform), (With<ScopeShaft>, Without<BladeGlow>)>,
    mut glows: Query<(&Draws, &mut Transform, &mut Visibility), (With<BladeGlow>, Without<ScopeShaft>)>,
) {
    for (of, mut transform) in &mut shafts {
        if let Ok(scope) = scopes.get(of.0) {
            *transform = Transform::from_isometry(scope.pose);
        }
    }
    for (of, mut transform, mut visibility) in &mut glows {
        let Ok((blade, pose)) = blades.get(of.0) else { continue };
        visibility.set_if_neq(if blade.active { Visibility::Inherited } else { Visibility::Hidden });
        let pose = between(pose, smoothing.fraction());
        let (tip, heel) = (pose * blade.tip, pose * blade.heel);
        let along = tip - heel;
        *transform = Transform {
            translation: (tip + heel) / 2.0,
            rotation: Quat::from_rotation_arc(Vec3::Y, along.normalize_or(Vec3::Y)),
            scale: Vec3::new(0.025 * along.length(), along.length(), 0.025 * along.length()),
        };
    }
}

/// The pose between the last two ticks.
fn between(pose: &InstrumentPose, fraction: f32) -> Isometry3d {
    let translation = pose.before.translation.lerp(pose.now.translation, fraction);
    Isometry3d { translation, rotation: pose.before.rotation.slerp(pose.now.rotation, fraction) }
}

fn mesh_of(part: &PartMesh) -> Mesh {
    Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::RENDER_WORLD)
        .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, part.vertices.clone())
        .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, part.normals.clone())
        .with_inserted_indices(Indices::U32(part.indices.clone()))
}
