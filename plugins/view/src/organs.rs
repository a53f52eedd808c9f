//! The organs as they are drawn: each follows its organ's topology and positions and owns two meshes, skin and opened inside.

use crate::buffers::{empty_mesh, write_shape, write_topology};
use crate::layers;
use crate::materials::TissueMaterials;
use crate::outer::OuterPlanes;
use crate::sheet::{Side, Surface};
use crate::smoothing::Smoothing;
use bevy::camera::visibility::{NoAutoAabb, NoFrustumCulling};
use bevy::prelude::*;
use keyhole_whiteboard::{FragmentDetached, Organ, OrganMaterials, TissueMesh, TissueState, TopologyChanged};
use rustc_hash::FxHashMap;
use std::sync::Arc;

/// An organ as it is drawn.
struct OrganView {
    organ: Entity,
    planes: Arc<OuterPlanes>,
    surface: Surface,
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
    /// Planes for organs that are still to come: freed fragments.
    inherited: FxHashMap<Entity, Arc<OuterPlanes>>,
    scratch: Vec<Vec3>,
    blend: Vec<Vec3>,
}

impl OrganViews {
    /// Positions of all nodes of all organs' skins, m.
    pub fn skin_points(&self) -> impl Iterator<Item = Vec3> + '_ {
        self.views.iter().flat_map(|view| view.surface.sheet(Side::Skin).vertices().iter().map(|v| view.now[v.node.index()]))
    }
}

/// A freed fragment takes over the planes of its donor, whose original tetrahedra its own refer to.
pub fn inherit_planes(freed: On<FragmentDetached>, mut views: ResMut<OrganViews>) {
    let planes = views.views.iter().find(|v| v.organ == freed.donor).map(|v| v.planes.clone());
    if let Some(planes) = planes.or_else(|| views.inherited.get(&freed.donor).cloned()) {
        views.inherited.insert(freed.entity, planes);
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
        let planes = views.inherited.remove(&organ).unwrap_or_else(|| Arc::new(OuterPlanes::of(&mesh.0)));
        let surface = Surface::of(&mesh.0, &planes);
        views.views.push(OrganView {
            organ,
            planes,
            surface,
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

/// Writes what has changed into the meshes.
pub fn draw_organs(
    mut commands: Commands,
    mut views: ResMut<OrganViews>,
    mut meshes: ResMut<Assets<Mesh>>,
    tissue_materials: Res<TissueMaterials>,
    smoothing: Smoothing,
    organs: Query<(&TissueMesh, &OrganMaterials)>,
) {
    let OrganViews { views, scratch, blend, .. } = &mut *views;
    for view in views {
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
                write_topology(&mut drawn, sheet, side, &mesh.0, materials);
                commands.entity(*entity).insert(Visibility::Inherited);
            }
            write_shape(&mut drawn, sheet, positions, scratch);
        }
        view.stale_topology = false;
        // While it moves, the blend changes with every frame.
        view.stale_shape = view.moving;
    }
}
