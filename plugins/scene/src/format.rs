//! The scene format: what each field means, with unit and default. Unknown fields are refused.

pub use crate::suture::SceneSuture;
use keyhole_whiteboard::ScopeOptics;
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

/// A trocar.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScenePort {
    /// Name, unique among the ports.
    pub name: String,
    /// Where the shaft passes, m.
    pub position: Triple,
    /// Into the body; any length but 0. Yaw and pitch are measured from it.
    pub inward: Triple,
}

/// Which hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SceneHand {
    /// The left one.
    Left,
    /// The right one.
    Right,
}

/// What an instrument is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SceneInstrumentKind {
    /// Two jaws with blunt pads.
    Grasper,
    /// Cut as they close.
    Scissors,
    /// Cuts along its blade while the pedal is down.
    Hook,
    /// A pointed straight blade; cuts along its edge while the pedal is down.
    Scalpel,
    /// Sets a clip on what is between its jaws when they have closed.
    ClipApplier,
    /// Two short strong jaws for a needle and its thread.
    NeedleHolder,
    /// A tube that takes up blood that lies while the pedal is down.
    Suction,
}

/// When a blade cuts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SceneTrigger {
    /// While the pedal is down.
    Pedal,
    /// While the jaws close; the cut runs from where the blades cross to their tips.
    Closing,
}

/// What about an instrument cuts. What is left out is as the kind has it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SceneBlade {
    /// Length of the cutting line, mm; from 1 to 200. Default 18 for scissors, 16 for a hook, 14 for a scalpel.
    pub length_mm: Option<f32>,
    /// When it cuts. Default Closing for scissors, which alone can; Pedal for the others. Scissors with Pedal cut along their shut blades.
    pub trigger: Option<SceneTrigger>,
    /// Thickness of tissue that the edge takes away, mm; from 0, a cold blade, to 3. Default 0.
    pub kerf_mm: f32,
}

/// An instrument in a hand and a port.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneInstrument {
    /// What it is.
    pub kind: SceneInstrumentKind,
    /// Which hand holds it; each hand one instrument at most.
    pub hand: SceneHand,
    /// Name of the port that it is in; no two things share one.
    pub port: String,
    /// Initial angle to the port's right, degrees. Default 0.
    #[serde(default)]
    pub yaw_deg: f32,
    /// Initial angle upwards, degrees. Default 0.
    #[serde(default)]
    pub pitch_deg: f32,
    /// Initial distance from the port to the end of the shaft, m. Default 0.08.
    #[serde(default = "default_insertion")]
    pub insertion_m: f32,
    /// What the hand may exchange it for through its trocar, in turn; it goes to the end of the row itself. Default none.
    #[serde(default)]
    pub exchange: Vec<SceneInstrumentKind>,
    /// What about it cuts. Default as the kind has it; a grasper has none.
    #[serde(default)]
    pub blade: Option<SceneBlade>,
    /// The length of `blade` in metres, as scenes said it before `blade` was there; not both.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub blade_length_m: Option<f32>,
    /// The clips of a clip applier. Default twenty of titanium for vessels that are up to 8 mm wide when they are laid flat; no other instrument has any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clips: Option<crate::vessel::SceneClips>,
    /// What a suction takes up; no other instrument takes anything up.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub suction: Option<crate::vessel::SceneSuction>,
    /// Length of the shaft, m. Default 0.33.
    #[serde(default = "default_shaft_length")]
    pub shaft_length_m: f32,
    /// Radius of the shaft, m. Default 0.0025.
    #[serde(default = "default_shaft_radius")]
    pub shaft_radius_m: f32,
    /// Coulomb's coefficient of its surface but for the pads of its jaws, 0 to 2. Default 0.2.
    #[serde(default)]
    pub friction: Option<f32>,
}

/// The endoscope.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneEndoscope {
    /// Name of the port that it is in.
    pub port: String,
    /// Angle between shaft and direction of view, degrees: 0, 30, 45 or 70 are sold. Default 30.
    #[serde(default = "default_direction")]
    pub direction_of_view_deg: f32,
    /// Angle of view across the round picture, degrees. Default 70.
    #[serde(default = "default_angle")]
    pub angle_of_view_deg: f32,
    /// Initial angle to the port's right, degrees. Default 0.
    #[serde(default)]
    pub yaw_deg: f32,
    /// Initial angle upwards, degrees. Default 0.
    #[serde(default)]
    pub pitch_deg: f32,
    /// Initial distance from the port to its tip, m. Default 0.08.
    #[serde(default = "default_insertion")]
    pub insertion_m: f32,
    /// Coefficients k1 and k2 of barrel distortion: what the lens shows at radius r a pinhole shows at r (1 + k1 r^2 + k2 r^4) / (1 + k1 + k2), both as
    /// parts of the radius of the round picture. The rim is drawn in by (k1 + k2) / (1 + k1 + k2), which is 0.07 to 0.23 of laparoscopes. k1 from -0.3 to 1,
    /// k2 from -0.15 to 1, together from 0 to 1. Default (0.1364, 0): 12 %.
    #[serde(default = "default_distortion")]
    pub distortion: [f32; 2],
    /// Time in which a clean lens fogs over, s; above 0. A key cleans it. Default never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fogs_in_s: Option<f32>,
    /// Distance of the two lenses of a stereo endoscope, mm; above 0, at most 10. Default none: one lens.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stereo_base_mm: Option<f32>,
}

/// Release policy of cutting.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum SceneCutMethod {
    /// Hull at once, core once the blade has left.
    #[default]
    Hybrid,
    /// Everything at once.
    Progressive,
    /// Everything once the blade has left.
    NonProgressive,
}

/// Where cutting puts face points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum SceneCutPattern {
    /// Only where the front pierces a face.
    #[default]
    Minimal,
    /// On every face that the sheet runs through.
    Symmetric,
}

/// Settings of cutting.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SceneCut {
    /// Release policy. Default Hybrid.
    pub method: SceneCutMethod,
    /// Pattern in the hull. Default Minimal.
    pub hull: SceneCutPattern,
    /// Pattern in the core. Default Minimal.
    pub core: SceneCutPattern,
    /// A crossing within this fraction of its edge's end moves the node instead; from 0 (never) to 0.4. Default 0.2.
    pub snap: f64,
}

impl Default for SceneCut {
    fn default() -> Self {
        Self { method: SceneCutMethod::Hybrid, hull: SceneCutPattern::Minimal, core: SceneCutPattern::Minimal, snap: 0.2 }
    }
}

/// Which organs may touch themselves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum SceneSelfCollision {
    /// Those that have been cut, and fragments: flaps fold over.
    #[default]
    OnceCut,
    /// All.
    Always,
    /// None.
    Never,
}

/// What may touch what.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SceneCollision {
    /// Whether anything touches at all: without, tools pass through tissue unless they grasp or cut it. Default yes.
    pub on: bool,
    /// Which organs may touch themselves. Default OnceCut.
    pub itself: SceneSelfCollision,
}

impl Default for SceneCollision {
    fn default() -> Self {
        Self { on: true, itself: SceneSelfCollision::OnceCut }
    }
}

/// Which soft-tissue model steps the organs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum SceneTissueModel {
    /// The simulator's own.
    #[default]
    Implicit,
    /// The paper's: springs and volumes, explicit; it takes as many steps as its stability asks for.
    Teschner,
    /// Extended position-based dynamics, neo-Hookean.
    Xpbd,
    /// The same with springs and volumes.
    XpbdSprings,
    /// Vertex block descent.
    Vbd,
}

/// How the model Implicit steps in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum SceneTimeStepping {
    /// Two stages a substep.
    #[default]
    TwoStages,
    /// One stage a substep and the state before it: cheaper, and swinging is damped more.
    TwoSteps,
}

/// The capsule of every organ: a thin stiff membrane on its surface, cut with it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneCapsule {
    /// Young's modulus, Pa; above 0. The renal capsule's is about 15 MPa.
    pub young_modulus_pa: f64,
    /// Poisson's ratio, 0 to 0.5.
    pub poisson_ratio: f64,
    /// Thickness, mm; above 0. The renal capsule's is 0.05 to 0.1.
    pub thickness_mm: f64,
}

/// Settings of the tissue's time stepping.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SceneTissue {
    /// Substeps a tick, 1 to 1000. Default: what suits the model, 1 for Implicit, 40 for Xpbd and XpbdSprings, 4 for Vbd. Teschner takes as many as its stability
    /// asks for, whatever is said here.
    pub substeps: Option<u32>,
    /// The model. Default Implicit.
    pub model: SceneTissueModel,
    /// How the model Implicit steps in time; the others take no notice of it. Default TwoStages.
    pub stepping: SceneTimeStepping,
    /// A capsule. Default none.
    pub capsule: Option<SceneCapsule>,
    /// Whether the organs' meshes are the shapes in which gravity and what holds them rigidly have left them, as in a scan: the rest shape is then the one that
    /// hangs so. Found when the scene starts, in seconds to a minute an organ. Default no.
    pub prestress: bool,
}

/// Keyframes that the scene performs by itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Demonstration {
    /// How long it lasts, s; above 0.
    pub seconds: f64,
    /// What each hand does. Default nothing.
    #[serde(default)]
    pub hands: Vec<HandScript>,
    /// What the endoscope looks at. Default: it stays.
    #[serde(default)]
    pub view: Vec<ViewKeyframe>,
}

/// Keyframes of a hand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandScript {
    /// Which hand; it must hold an instrument.
    pub hand: SceneHand,
    /// In order of time, each after the one before.
    pub keys: Vec<HandKeyframe>,
}

/// Where a hand has the tip of its tool at a time. Between keyframes the tip follows a smooth curve; the shaft always passes its port.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandKeyframe {
    /// Seconds from the start.
    pub time_s: f64,
    /// The tip of the blade, or the middle of the jaws, m.
    pub tip: Triple,
    /// Roll about the shaft, degrees. Default 0.
    #[serde(default)]
    pub roll_deg: f32,
    /// Jaws, 0 open to 1 closed. Default 0.
    #[serde(default)]
    pub grip: f32,
    /// Whether the pedal is down from here to the next keyframe. Default false.
    #[serde(default)]
    pub active: bool,
}

/// What the endoscope looks at, from how far.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewKeyframe {
    /// Seconds from the start.
    pub time_s: f64,
    /// The middle of the picture, m.
    pub target: Triple,
    /// From the tip of the endoscope to the target, m; above 0.
    pub distance_m: f32,
}

/// Cameras outside the body.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Views {
    /// The whole theatre, as it is seen at first. Default: from the front and above, so far away that all organs are in the picture.
    pub global: Option<Camera>,
}

/// A camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Where it is, m.
    pub eye: Triple,
    /// What it looks at, m.
    pub target: Triple,
}

fn default_gravity() -> Triple {
    [0.0, -9.81, 0.0]
}

fn default_insertion() -> f32 {
    0.08
}

fn default_shaft_length() -> f32 {
    0.33
}

fn default_shaft_radius() -> f32 {
    0.0025
}

fn default_direction() -> f32 {
    30.0
}

fn default_angle() -> f32 {
    70.0
}

fn default_distortion() -> [f32; 2] {
    ScopeOptics::default().distortion
}
