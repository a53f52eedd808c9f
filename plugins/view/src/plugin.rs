//! The plugin of the view.

use crate::anatomy::{AnatomyBounds, draw_anatomy};
use crate::blood::{Blood, DrawnBlood, bleeds, draw_blood, flow_blood};
use crate::clips::{draw_clips, move_clips};
use crate::eyes::{ScopeFog, SpecimenView, ViewLayout, aim_eyes, arrange_window, fog_lens, open_window_eyes, spare_software, switch_view};
use crate::fairing::FairingSettings;
use crate::framing::{Framing, frame_scene};
use crate::materials::TissueMaterials;
use crate::optics::Lens;
use crate::orbit::{OrbitSettings, OrbitState, claim_mouse, follow_framing, orbit};
use crate::organs::{
    OrganViews, adopt_organs, draw_organs, drop_views, follow_topology, forget_planes, inherit_planes, record_positions, switch_fairing,
};
use crate::paint::Paint;
use crate::pictures::{build_darkroom, develop};
use crate::shading::SceneMaterial;
use crate::smoke::{Smoke, SmokeSettings, smoke};
use crate::smoothing::MotionSettings;
use crate::theatre::{furnish, light_scope, light_specimen, surround};
use crate::thread::{draw_sutures, move_sutures};
use crate::tools::{draw_fittings, draw_tools, drop_drawn, drop_orphans, move_fittings, move_tools};
use bevy::app::RunFixedMainLoopSystems;
use bevy::asset::embedded_asset;
use bevy::camera::CameraUpdateSystems;
use bevy::core_pipeline::fullscreen_material::FullscreenMaterialPlugin;
use bevy::input::InputSystems;
use bevy::prelude::*;
use bevy::transform::TransformSystems;
use keyhole_whiteboard::{GlobalView, KeyMap, PointerClaims, TickSystems, ViewMode};

/// Draws the whiteboard: both views, in the window if there is one, and as pictures. Needs `DefaultPlugins` (with or without a window) and
/// the whiteboard before it. Nothing that it does is read by the simulation.
#[derive(Clone, Copy, Debug)]
pub struct ViewPlugin {
    /// Size of pictures, pixels. Default 1280 x 720.
    pub picture_size: UVec2,
}

impl Default for ViewPlugin {
    fn default() -> Self {
        Self { picture_size: UVec2::new(1280, 720) }
    }
}

/// The keys of the view.
const KEYS: [(&str, &str); 7] = [
    ("V", "global or laparoscopic view; with an inset they change places"),
    ("I", "the other view as an inset, or without"),
    ("T", "laparoscopic view in stereo, side by side, or single"),
    ("L", "clean the lens of the endoscope"),
    ("B", "cut surfaces smoothed, or bare as the mesh has them"),
    ("middle mouse button", "global view: turn the camera; with Shift: move it"),
    ("Ctrl + wheel", "global view: distance of the camera"),
];

impl Plugin for ViewPlugin {
    fn build(&self, app: &mut App) {
        embedded_asset!(app, "optics.wgsl");
        embedded_asset!(app, "shading.wgsl");
        app.init_resource::<KeyMap>().world_mut().resource_mut::<KeyMap>().push_all(&KEYS);
        build_darkroom(app, self.picture_size);
        app.add_plugins((FullscreenMaterialPlugin::<Lens>::default(), MaterialPlugin::<SceneMaterial>::default()))
            // Beside what the cameras show.
            .insert_resource(ClearColor(Color::BLACK))
            .init_resource::<ViewMode>()
            .init_resource::<ViewLayout>()
            .init_resource::<ScopeFog>()
            .init_resource::<GlobalView>()
            .init_resource::<Paint>()
            .init_resource::<SpecimenView>()
            .init_resource::<SmokeSettings>()
            .init_resource::<Smoke>()
            .init_resource::<PointerClaims>()
            .init_resource::<OrganViews>()
            .init_resource::<FairingSettings>()
            .init_resource::<TissueMaterials>()
            .init_resource::<AnatomyBounds>()
            .init_resource::<Framing>()
            .init_resource::<Blood>()
            .init_resource::<OrbitSettings>()
            .init_resource::<OrbitState>()
            .insert_resource(MotionSettings::Blend)
            .add_observer(inherit_planes)
            .add_observer(forget_planes)
            .add_observer(drop_views)
            .add_observer(drop_drawn)
            .add_systems(Startup, (furnish, open_window_eyes))
            .add_systems(PreUpdate, claim_mouse.after(InputSystems))
            .add_systems(RunFixedMainLoop, adopt_organs.in_set(RunFixedMainLoopSystems::BeforeFixedMainLoop))
            .add_systems(FixedUpdate, (follow_topology, adopt_organs, record_positions).chain().in_set(TickSystems::Publish))
            .add_systems(FixedUpdate, flow_blood.in_set(TickSystems::Publish).run_if(bleeds))
            .add_systems(Update, (draw_clips.after(drop_orphans), draw_blood.run_if(bleeds.or_else(any_with_component::<DrawnBlood>))))
            .add_systems(PostUpdate, move_clips.before(TransformSystems::Propagate).before(CameraUpdateSystems))
            .add_systems(
                Update,
                (
                    (drop_orphans, draw_anatomy, draw_tools, draw_fittings).chain(),
                    (switch_fairing, draw_organs, frame_scene).chain(),
                    (switch_view, fog_lens, develop, arrange_window, spare_software).chain(),
                ),
            )
            .add_systems(Update, (draw_sutures.after(drop_orphans), move_sutures).chain())
            .add_systems(
                PostUpdate,
                ((follow_framing, surround), orbit, aim_eyes, light_specimen, light_scope, smoke, move_tools, move_fittings)
                    .chain()
                    .before(TransformSystems::Propagate)
                    .before(CameraUpdateSystems),
            );
    }
}
