//! The scene format: what each field means, with unit and default. Unknown fields are refused.

mod demonstration;
mod instruments;
mod settings;

pub use crate::suture::SceneSuture;
pub use demonstration::*;
pub use instruments::*;
pub use settings::*;

use serde::{Deserialize, Serialize};

/// The version of the format that this program reads and writes.
pub const VERSION: u32 = 1;

/// A point or a direction of the world: Y up, right-handed.
pub type Triple = [f32; 3];

/// A scene: who lies on the table, what is in the ports, and what the demonstration does.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Version of the format: [`VERSION`].
    pub version: u32,
    /// Name, as shown in the menu.
    pub name: String,
    /// What the scene is for, in a sentence or two. Default empty.
    #[serde(default)]
    pub description: String,
    /// What the trainee is to do, step by step, a line each. Default none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub guidance: Vec<String>,
    /// What is to be reached, and what it is worth. Default none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub task: Option<crate::task::SceneTask>,
    /// Gravity, m/s2. Default (0, -9.81, 0).
    #[serde(default = "default_gravity")]
    pub gravity: Triple,
    /// Soft organs, one at least.
    pub organs: Vec<SceneOrgan>,
    /// Surfaces that cannot deform. Default none.
    #[serde(default)]
    pub anatomy: Vec<SceneAnatomy>,
    /// Trocars. Default none.
    #[serde(default)]
    pub ports: Vec<ScenePort>,
    /// Instruments, at most one a hand. Default none.
    #[serde(default)]
    pub instruments: Vec<SceneInstrument>,
    /// Needles with their threads. Default none.
    #[serde(default)]
    pub sutures: Vec<SceneSuture>,
    /// The endoscope. Default none: then there is only the global view.
    #[serde(default)]
    pub endoscope: Option<SceneEndoscope>,
    /// How cutting is done. Default: hybrid, minimal patterns, snapping at 0.2 of an edge.
    #[serde(default)]
    pub cut: SceneCut,
    /// How tissue is stepped.
    #[serde(default)]
    pub tissue: SceneTissue,
    /// What may touch what.
    #[serde(default)]
    pub collision: SceneCollision,
    /// What is performed when nobody is at the table. Default none.
    #[serde(default)]
    pub demonstration: Option<Demonstration>,
    /// Cameras outside the body.
    #[serde(default)]
    pub views: Views,
}

/// A soft organ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneOrgan {
    /// Name, unique among the organs.
    pub name: String,
    /// Tetrahedral mesh in metres, a VTU file, relative to the scene's file. Either this or `shape`.
    #[serde(default)]
    pub mesh: Option<String>,
    /// A simple shape in place of a file. Default none.
    #[serde(default)]
    pub shape: Option<SceneSolid>,
    /// Materials; the mesh's material 0 is the first.
    pub materials: Vec<SceneMaterial>,
    /// Where it lies. It is baked into the rest positions when the organ is spawned; everything else in a scene is in the world.
    #[serde(default)]
    pub transform: Placement,
    /// What holds it. Default nothing: it falls.
    #[serde(default)]
    pub attachments: Vec<Hold>,
    /// Coulomb's coefficient of its surface, 0 to 2; where two things touch it is the geometric mean of theirs. Default 0.1: moist.
    #[serde(default)]
    pub friction: Option<f32>,
    /// A vessel in it, which bleeds where it is cut and not clipped. Default none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vessel: Option<crate::vessel::SceneVessel>,
    /// Force at which a stitch tears out, per length of tissue between it and the surface in the direction of the pull, N/m; above 0. Default 300: soft parenchyma.
    #[serde(default)]
    pub tear_n_m: Option<f32>,
    /// Pressure of a grasper's pad beyond which the tissue is bruised, Pa; above 0. Default 250 000: bowel.
    #[serde(default)]
    pub bruise_pa: Option<f32>,
}

/// A simple shape of tetrahedra, its middle at the origin. Its material is 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum SceneSolid {
    /// A block along the axes.
    Block {
        /// Its sides, m; above 0.
        size: Triple,
        /// Cells along each side, 1 to 200; six tetrahedra a cell.
        cells: [u32; 3],
    },
    /// A tube along Y; a short one is a ring.
    Tube {
        /// Its length, m; above 0.
        length: f32,
        /// Outer radius, m.
        outer_radius: f32,
        /// Radius of the hole, m; above 0 and below the outer one.
        inner_radius: f32,
        /// Cells along, around (3 at least) and through the wall, up to 200; six tetrahedra a cell.
        cells: [u32; 3],
    },
}

/// Elastic material and colours.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneMaterial {
    /// Name: `kidney`, `tumour`.
    pub name: String,
    /// Young's modulus, Pa; above 0.
    pub young_modulus_pa: f32,
    /// Poisson's ratio, from 0 to below 0.5.
    pub poisson_ratio: f32,
    /// Density, kg/m3; above 0.
    pub density_kg_m3: f32,
    /// Colour where it is cut, linear RGB from 0 to 1.
    pub inside: Triple,
    /// Colour of the outer surface, linear RGB from 0 to 1.
    pub surface: Triple,
}

/// A rigid placement: first turned, then moved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Placement {
    /// Translation, m. Default zero.
    #[serde(default)]
    pub translation: Triple,
    /// Rotation, degrees: about the world's X axis, then Y, then Z. Default zero.
    #[serde(default)]
    pub rotation_deg: Triple,
}

/// Nodes of an organ held in place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hold {
    /// Every node of the organ whose rest position, after the transform, is in here.
    pub region: Region,
    /// Compliance of each node's attachment, m/N; 0 holds rigidly. Default 0.
    #[serde(default)]
    pub compliance_m_n: f32,
    /// Time since the scene started at which it lets go, s; above 0. Default never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f32>,
}

/// A part of space, m, in the world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Region {
    /// A ball.
    Sphere {
        /// Its middle, m.
        centre: Triple,
        /// Its radius, m; above 0.
        radius: f32,
    },
    /// All that lies on the side of a plane that its normal points to.
    HalfSpace {
        /// A point of the plane, m.
        point: Triple,
        /// Towards the inside; any length but 0.
        normal: Triple,
    },
    /// An axis-aligned box.
    Box {
        /// Lowest corner, m.
        min: Triple,
        /// Highest corner, m.
        max: Triple,
    },
}

/// A surface that is seen, cannot deform, and may be solid.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneAnatomy {
    /// Name, unique among the anatomy.
    pub name: String,
    /// glTF file (.glb or .gltf), relative to the scene's file. Either this or `shape`.
    #[serde(default)]
    pub path: Option<String>,
    /// A simple shape in place of a file. Default none.
    #[serde(default)]
    pub shape: Option<SceneSurface>,
    /// Linear RGB from 0 to 1.
    pub colour: Triple,
    /// Where it lies.
    #[serde(default)]
    pub transform: Placement,
    /// Whether tissue and instruments touch it; otherwise it is only seen. A solid surface is closed, its triangles counter-clockwise as seen from where tissue
    /// may be. Default no.
    #[serde(default)]
    pub solid: bool,
    /// Coulomb's coefficient of a solid surface, 0 to 2. Default 0.2.
    #[serde(default)]
    pub friction: Option<f32>,
}

/// A simple surface, its middle at the origin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum SceneSurface {
    /// A box along the axes.
    Box {
        /// Its sides, m; above 0.
        size: Triple,
    },
    /// A cylinder along Y.
    Cylinder {
        /// Its radius, m; above 0.
        radius: f32,
        /// Its height, m; above 0.
        height: f32,
    },
    /// A ball.
    Sphere {
        /// Its radius, m; above 0.
        radius: f32,
    },
}

fn default_gravity() -> Triple {
    [0.0, -9.81, 0.0]
}
