//! How cutting is to be done, and how it goes.

use bevy_ecs::prelude::*;

/// When a crossing becomes effective: the only difference between the paper's three methods.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum CutMethod {
    /// Hull at once, core once the blade has left: the paper's method.
    #[default]
    Hybrid,
    /// Everything at once.
    Progressive,
    /// Everything once the blade has left.
    NonProgressive,
}

/// Where the kernel puts face points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum CutPattern {
    /// Only where the front pierces a face (Mor & Kanade 2000; Nakao 2002).
    #[default]
    Minimal,
    /// On every face that the sheet runs through (Bielser & Gross 2000).
    Symmetric,
}

/// Settings of cutting. Written by the command line, the scene and the HUD; takes effect with the next stroke.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct CutSettings {
    /// Release policy.
    pub method: CutMethod,
    /// Pattern in the hull.
    pub hull: CutPattern,
    /// Pattern in the core.
    pub core: CutPattern,
    /// A settled crossing within this fraction of its edge's end moves that node onto the sheet instead; 0 never. In [0, 0.4].
    pub snap: f64,
}

impl Default for CutSettings {
    /// The paper's hybrid method with minimal patterns; snapping at 0.2 of an edge (Serby, Harders, Szekely 2001).
    fn default() -> Self {
        Self { method: CutMethod::Hybrid, hull: CutPattern::Minimal, core: CutPattern::Minimal, snap: 0.2 }
    }
}

/// What cutting has done since the scene started. Written by cutting.
#[derive(Resource, Clone, Debug, Default, PartialEq)]
pub struct CutStatus {
    /// Whether a blade is in tissue.
    pub cutting: bool,
    /// Tetrahedra removed, whether of the original mesh or children.
    pub deleted: u64,
    /// Tetrahedra created.
    pub created: u64,
    /// Children changed in place because a face point moved.
    pub updated: u64,
    /// Events taken back because they would have made a tetrahedron that is not positive.
    pub deferred: u64,
    /// Pieces that came free.
    pub fragments: u32,
    /// Strokes that ended.
    pub strokes: u32,
}
