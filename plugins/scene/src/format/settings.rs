//! How a scene is cut, stepped, and what may touch what.

use serde::{Deserialize, Serialize};

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
