//! What tissue looks like: wet. Colours come with the vertices, see `buffers`.

use crate::shading::{Look, SceneMaterial};
use crate::sheet::Side;
use bevy::prelude::*;

/// The materials of all organs.
#[derive(Resource)]
pub struct TissueMaterials {
    skin: Handle<SceneMaterial>,
    inside: Handle<SceneMaterial>,
}

impl TissueMaterials {
    /// The material of a side.
    #[must_use]
    pub fn of(&self, side: Side) -> Handle<SceneMaterial> {
        match side {
            Side::Skin => self.skin.clone(),
            Side::Inside => self.inside.clone(),
        }
    }
}

impl FromWorld for TissueMaterials {
    fn from_world(world: &mut World) -> Self {
        let mut materials = world.resource_mut::<Assets<SceneMaterial>>();
        // Capsule under a film of fluid: the film is the clearcoat.
        let skin =
            materials.add(SceneMaterial::coated(Look { roughness: 0.5, reflectance: 0.45, coat: 0.9, coat_roughness: 0.16, ..default() }));
        // Parenchyma: matte under a film of blood that glistens.
        let inside =
            materials.add(SceneMaterial::coated(Look { roughness: 0.7, reflectance: 0.4, coat: 0.7, coat_roughness: 0.3, ..default() }));
        Self { skin, inside }
    }
}
