//! Settings of the time stepping, in physical units.

use bevy_ecs::prelude::*;

/// Which model steps the tissue.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Solver {
    /// Extended position-based dynamics with small steps: see [`crate::xpbd`].
    #[default]
    Xpbd,
}

/// How tissue is stepped. Written by the scene or the command line.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct TissueSettings {
    /// The model.
    pub solver: Solver,
    /// Substeps of one tick; 0 counts as 1. Default: see the table in the crate's documentation.
    pub substeps: u32,
    /// Rate at which every velocity decays, 1/s, as in a viscous fluid around the organ (the mass-proportional part of Rayleigh damping: a
    /// mode of angular frequency w has damping ratio `drag / 2w`). Default 0: an organ in vacuum keeps its momentum.
    pub drag_1_s: f32,
}

impl Default for TissueSettings {
    fn default() -> Self {
        Self { solver: Solver::default(), substeps: 20, drag_1_s: 0.0 }
    }
}
