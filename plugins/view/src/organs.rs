//! The organs as they are drawn: each follows its organ's topology and positions and owns two meshes, skin and opened inside.

use crate::bruises::tint;
use crate::buffers::{empty_mesh, node_normals, write_shape, write_topology};
use crate::depth::Depths;
use crate::fairing::{Fairing, FairingSettings};
use crate::layers;
use crate::materials::TissueMaterials;
use crate::outer::OuterPlanes;
use crate::paint::Paint;
use crate::sheet::{Side, Surface};
use crate::smoothing::Smoothing;
use bevy::camera::visibility::{NoAutoAabb, NoFrustumCulling};
use bevy::prelude::*;
use keyhole_whiteboard::{
    Bruises, FragmentDetached, Organ, OrganMaterials, SceneCleared, StateRestored, TissueMesh, TissueState, TopologyChanged,
};
use rustc_hash::FxHashMap;
use std::sync::Arc;

/// An organ as it is drawn.
struct OrganView {
    organ: Entity,
    planes: Arc<OuterPlanes>,
    surface: Surface,
    fairing: Fairing,
    /// Positions one tick ago and now, m, one a node slot.
    before: Vec<Vec3>,
    now: Vec<Vec3>,
    moving: bool,
    stale_shape: bool,
    stale_topology: bool,
    drawn: [Option<(Entity, Handle<Mesh>)>; 2],
}

/// All organs as they are drawn. Kept apart from the organs' entities, so that what is simulated is the same with and without a view.
#[derive(Resource, Default)]
pub struct OrganViews {
    views: Vec<OrganView>,
    /// The planes of every organ of the scene: freed fragments that are still to come have those of their donors, and an organ that was cut keeps what it had.
    planes: FxHashMap<Entity, Arc<OuterPlanes>>,
    normals: Vec<Vec3>,
    blend: Vec<Vec3>,
    faired: Vec<Vec3>,
}

impl OrganViews {
    /// Positions of all nodes of all organs' skins, m.
    pub fn skin_points(&self) -> impl Iterator<Item = Vec3> + '_ {
        self.views.iter().flat_map(|view| view.surface.sheet(Side::Skin).vertices().iter().map(|v| view.now[v.node.index()]))
    }
}

/// A freed fragment takes over the planes of its donor, whose original tetrahedra its own refer to.
pub fn inherit_planes(freed: On<FragmentDetached>, mut views: ResMut<OrganViews>) {
    if let Some(planes) = views.planes.get(&freed.donor).cloned() {
        views.planes.insert(freed.entity, planes);
    }
}

/// Another scene has other organs.
pub fn forget_planes(_: On<SceneCleared>, mut views: ResMut<OrganViews>) {
    views.planes.clear();
}

/// Organs that are what they were at another time are taken up anew.
pub fn drop_views(_: On<StateRestored>, mut commands: Commands, mut views: ResMut<OrganViews>) {
    for (entity, _) in views.views.drain(..).flat_map(|view| view.drawn).flatten() {
        commands.entity(entity).despawn();
    }
}

/// Takes up organs that have come and drops those that are gone.
pub fn adopt_organs(
    mut commands: Commands,
    mut views: ResMut<OrganViews>,
    organs: Query<(Entity, &TissueMesh, &TissueState), With<Organ>>,
) {
    let views = &mut *views;
    views.views.retain(|view| {
        let stays = organs.contains(view.organ);
        if !stays {
            view.drawn.iter().flatten().for_each(|(entity, _)| commands.entity(*entity).despawn());
        }
        stays
    });
    for (organ, mesh, state) in &organs {
        if state.positions.len() < mesh.0.node_slots() || views.views.iter().any(|v| v.organ == organ) {
            continue;
        }
        let planes = views.planes.entry(organ).or_insert_with(|| Arc::new(OuterPlanes::of(&mesh.0))).clone();
        let surface = Surface::of(&mesh.0, &planes);
        views.views.push(OrganView {
            organ,
            planes,
            surface,
            fairing: Fairing::default(),
            before: state.positions.clone(),
            now: state.positions.clone(),
            moving: false,
            stale_shape: true,
            stale_topology: true,
            drawn: [None, None],
        });
    }
}

/// Follows the topology changes of this tick. Organs that come in this tick are whole already.
pub fn follow_topology(mut changes: MessageReader<TopologyChanged>, mut views: ResMut<OrganViews>, meshes: Query<&TissueMesh>) {
    for change in changes.read() {
        let Some(view) = views.views.iter_mut().find(|v| v.organ == change.organ) else { continue };
        if let Ok(mesh) = meshes.get(change.organ) {
            view.surface.apply(&mesh.0, &view.planes, &change.delta);
            view.stale_topology = true;
        }
    }
}

/// Takes down where the nodes are after this tick.
pub fn record_positions(mut views: ResMut<OrganViews>, states: Query<&TissueState>) {
    for view in &mut views.views {
        let Ok(state) = states.get(view.organ) else { continue };
        std::mem::swap(&mut view.before, &mut view.now);
        view.now.clear();
        view.now.extend_from_slice(&state.positions);
        // A node that has just come has been where it is.
        let known = view.before.len().min(view.now.len());
        view.before.truncate(known);
        view.before.extend_from_slice(&view.now[known..]);
        view.moving = view.before != view.now;
        view.stale_shape |= view.moving;
    }
}

/// The key that shows the opened surface as the mesh has it.
pub fn switch_fairing(keys: Res<ButtonInput<KeyCode>>, mut settings: ResMut<FairingSettings>) {
    if keys.just_pressed(KeyCode::KeyB) {
        settings.enabled = !settings.enabled;
    }
}

/// Writes what has changed into the meshes.
pub fn draw_organs(
    mut commands: Commands,
    mut views: ResMut<OrganViews>,
    mut meshes: ResMut<Assets<Mesh>>,
    tissue_materials: Res<TissueMaterials>,
    smoothing: Smoothing,
    fairing: Res<FairingSettings>,
    paint: Res<Paint>,
    organs: Query<(&TissueMesh, &OrganMaterials)>,
    bruises: Query<Ref<Bruises>>,
) {
    let OrganViews { views, normals, blend, faired, .. } = &mut *views;
    for view in views {
        let bruises = bruises.get(view.organ).ok();
        view.stale_topology |=
            fairing.is_changed() || paint.is_changed() || bruises.as_ref().is_some_and(|b| b.is_changed() && !b.by_node.is_empty());
        if !view.stale_shape && !view.stale_topology {
            continue;
        }
        let Ok((mesh, materials)) = organs.get(view.organ) else { continue };
        if view.now.len() < mesh.0.node_slots() {
            // The positions of added nodes are not there before the tick has ended.
            continue;
        }
        let positions = if view.moving && smoothing.fraction() < 1.0 {
            blend.clear();
            blend.extend(view.before.iter().zip(&view.now).map(|(before, now)| before.lerp(*now, smoothing.fraction())));
            &*blend
        } else {
            &view.now
        };
        for (slot, side) in [Side::Skin, Side::Inside].into_iter().enumerate() {
            let sheet = view.surface.sheet(side);
            if sheet.indices().is_empty() {
                if let Some((entity, _)) = &view.drawn[slot] {
                    commands.entity(*entity).insert(Visibility::Hidden);
                }
                continue;
            }
            let fresh = view.drawn[slot].is_none();
            let (entity, handle) = view.drawn[slot].get_or_insert_with(|| {
                let handle = meshes.add(empty_mesh());
                let material = tissue_materials.of(side);
                let entity = commands.spawn((
                    Mesh3d(handle.clone()),
                    MeshMaterial3d(material),
                    Transform::IDENTITY,
                    NoFrustumCulling,
                    NoAutoAabb,
                    layers::shared(),
                ));
                (entity.id(), handle)
            });
            let Some(mut drawn) = meshes.get_mut(&*handle) else { continue };
            if view.stale_topology || fresh {
                let mut depths = Depths::default();
                if side == Side::Inside {
                    view.fairing = Fairing::of(sheet, view.surface.sheet(Side::Skin));
                    depths = Depths::of(&view.fairing, |node| mesh.0.rest(node));
                }
                write_topology(&mut drawn, sheet, side, &mesh.0, materials, &depths);
                bruises.as_deref().into_iter().for_each(|bruises| tint(&mut drawn, sheet, bruises));
                let painted = paint.of(view.organ);
                if let Some(painted) = painted.filter(|_| side == Side::Inside) {
                    painted.write(&mut drawn, sheet);
                }
                let seen = if painted.is_some() { layers::shared().union(&layers::specimen_only()) } else { layers::shared() };
                commands.entity(*entity).insert((Visibility::Inherited, seen));
            }
            if side == Side::Skin || !fairing.enabled {
                node_normals(sheet, positions, normals);
                write_shape(&mut drawn, sheet, positions, normals);
                continue;
            }
            view.fairing.show(positions, &fairing, faired);
            node_normals(sheet, faired, normals);
            view.fairing.soften(normals);
            write_shape(&mut drawn, sheet, faired, normals);
        }
        view.stale_topology = false;
        // While it moves, the blend changes with every frame.
        view.stale_shape = view.moving;
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use crate::paint::PaintedCut;
    use crate::shading::SceneMaterial;
    use crate::smoothing::MotionSettings;
    use crate::testing::{block, parted};
    use bevy::ecs::system::RunSystemOnce;
    use bevy::math::DVec3;
    use bevy::mesh::VertexAttributeValues;
    use keyhole_whiteboard::OrganMaterial;

    /// The places of the vertices of the mesh that is drawn for a side, by node.
    fn drawn(world: &World, side: usize) -> FxHashMap<usize, Vec3> {
        let view = &world.resource::<OrganViews>().views[0];
        let (_, handle) = view.drawn[side].as_ref().unwrap();
        let mesh = world.resource::<Assets<Mesh>>().get(handle).unwrap();
        let Some(VertexAttributeValues::Float32x3(points)) = mesh.attribute(Mesh::ATTRIBUTE_POSITION) else { panic!("no positions") };
        let sheet = view.surface.sheet([Side::Skin, Side::Inside][side]);
        let used = (0..points.len()).filter(|slot| sheet.is_used(*slot));
        used.map(|slot| (sheet.vertices()[slot].node.index(), Vec3::from_array(points[slot]))).collect()
    }

    /// A cut opens in an organ that moves: the skin is drawn where the tissue is, the inside joins it without a gap and is smoother than it is,
    /// and the tissue knows nothing of it. The key takes it back.
    #[test]
    fn fairing_changes_what_is_drawn_of_the_inside_and_nothing_else() {
        let edge = 0.005;
        let mut mesh = block([6, 5, 4], edge);
        let mut world = World::new();
        world.init_resource::<Assets<Mesh>>();
        world.init_resource::<Assets<SceneMaterial>>();
        world.init_resource::<TissueMaterials>();
        world.init_resource::<OrganViews>();
        world.init_resource::<FairingSettings>();
        world.init_resource::<Paint>();
        world.init_resource::<Time<Fixed>>();
        world.insert_resource(MotionSettings::Newest);
        world.init_resource::<ButtonInput<KeyCode>>();
        let state = |mesh: &keyhole_tetmesh::TetMesh| TissueState {
            positions: mesh.rest_positions().iter().map(|p| 1.1 * p.as_vec3() + Vec3::Y).collect(),
            velocities: vec![Vec3::ZERO; mesh.node_slots()],
        };
        let (organ, materials) = (Organ { name: "organ".into() }, OrganMaterials(vec![OrganMaterial::default()]));
        let organ = world.spawn((organ, materials, state(&mesh), TissueMesh(mesh.clone()))).id();
        world.run_system_once(adopt_organs).unwrap();
        parted(&mut mesh, DVec3::new(3.0, 2.5, 2.0) * edge, DVec3::new(0.8, 0.5, 0.3).normalize());
        let delta = mesh.take_delta();
        let cut = state(&mesh);
        world.entity_mut(organ).insert((TissueMesh(mesh), cut.clone()));
        world.init_resource::<Messages<TopologyChanged>>();
        world.write_message(TopologyChanged { organ, delta });
        for system in [World::register_system(&mut world, follow_topology), World::register_system(&mut world, record_positions)] {
            world.run_system(system).unwrap();
        }
        world.run_system_once(draw_organs).unwrap();
        let moved =
            |from: &FxHashMap<usize, Vec3>| from.iter().filter(|(n, p)| **p != cut.positions[**n]).map(|(n, _)| *n).collect::<Vec<_>>();
        let (skin, inside) = (drawn(&world, 0), drawn(&world, 1));
        assert!(moved(&skin).is_empty());
        assert!(moved(&inside).len() > 10 && moved(&inside).iter().all(|n| !skin.contains_key(n)));
        assert!(inside.keys().any(|n| skin.contains_key(n)), "they share a rim");
        assert_eq!(*world.get::<TissueState>(organ).unwrap(), cut);
        world.resource_mut::<ButtonInput<KeyCode>>().press(KeyCode::KeyB);
        world.run_system_once(switch_fairing).unwrap();
        world.run_system_once(draw_organs).unwrap();
        assert!(moved(&drawn(&world, 1)).is_empty());
        // What is painted is seen on the opened inside, and only where it was painted.
        let node = *inside.keys().min().unwrap();
        let red = [1.0, 0.0, 0.0];
        let painted = PaintedCut { organ, colours: vec![(keyhole_tetmesh::NodeId(node as u32), red)] };
        world.insert_resource(Paint(vec![painted]));
        world.run_system_once(draw_organs).unwrap();
        let view = &world.resource::<OrganViews>().views[0];
        for (slot, side) in [Side::Skin, Side::Inside].into_iter().enumerate() {
            let mesh = world.resource::<Assets<Mesh>>().get(&view.drawn[slot].as_ref().unwrap().1).unwrap();
            let Some(VertexAttributeValues::Float32x4(colours)) = mesh.attribute(Mesh::ATTRIBUTE_COLOR) else { panic!("no colours") };
            let sheet = view.surface.sheet(side);
            let red = colours.iter().zip(sheet.vertices()).filter(|(c, _)| c[..3] == red).map(|(_, v)| v.node.index());
            assert_eq!(red.collect::<Vec<_>>(), if side == Side::Inside { vec![node] } else { vec![] });
        }
    }
}
