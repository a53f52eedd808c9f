//! What tissue looks like: wet. Colours come with the vertices, see `buffers`.

use crate::sheet::Side;
use bevy::prelude::*;

/// The materials of all organs.
#[derive(Resource)]
pub struct TissueMaterials {
    skin: Handle<StandardMaterial>,
    inside: Handle<StandardMaterial>,
}

impl TissueMaterials {
    /// The material of a side.
    #[must_use]
    pub fn of(&self, side: Side) -> Handle<StandardMaterial> {
        match side {
            Side::Skin => self.skin.clone(),
            Side::Inside => self.inside.clone(),
        }
    }
}

impl FromWorld for TissueMaterials {
    fn from_world(world: &mut World) -> Self {
        let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
        // Capsule under a film of fluid: the film is the clearcoat.
        let skin = materials.add(StandardMaterial {
            perceptual_roughness: 0.5,
            reflectance: 0.45,
            clearcoat: 0.9,
            clearcoat_perceptual_roughness: 0.16,
            ..default()
        });
        // Parenchyma: matte, moist in places.
        let inside = materials.add(StandardMaterial {
            perceptual_roughness: 0.75,
            reflectance: 0.35,
            clearcoat: 0.35,
            clearcoat_perceptual_roughness: 0.38,
            ..default()
        });
        Self { skin, inside }
    }
}
