//! Settings of the time stepping, in physical units.

use crate::membrane::Capsule;
use crate::model::TissueModel;
use bevy_ecs::prelude::*;

/// How [`TissueModel::Implicit`] steps in time. Both are of the second order of the substep and damp what is too fast for it; both rest in the same shape.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum TimeStepping {
    /// Two stages a substep (Alexander 1977): a mode that the substep resolves is hardly damped by it.
    #[default]
    TwoStages,
    /// One stage a substep, and the state a substep before (backward differentiation of second order): about half the cost, and more damping by the
    /// method itself.
    TwoSteps,
}

/// How tissue is stepped. Written by the scene or the command line.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct TissueSettings {
    /// Which soft-tissue model. Default [`TissueModel::Implicit`], which the fields below are about; the other models have settings of their own and take
    /// of these only the drag.
    pub model: TissueModel,
    /// A thin stiff membrane on the surface of every organ. Default none.
    pub capsule: Option<Capsule>,
    /// How [`TissueModel::Implicit`] steps in time. Default [`TimeStepping::TwoStages`].
    pub stepping: TimeStepping,
    /// Substeps of one tick of [`TissueModel::Implicit`]; 0 counts as 1. Default 1: see the table in the crate's documentation.
    pub substeps: u32,
    /// Rate at which every velocity decays, 1/s, as in a viscous fluid around the organ: the mass-proportional part of Rayleigh damping, a
    /// mode of angular frequency w has damping ratio `drag / 2w`. Of a body that nothing holds it damps the motion about its mean, so that a
    /// piece falls freely. Default 4: a damping ratio of 0.16 at 2 Hz, about half the
    /// loss tangent of soft organs; 0 in vacuum.
    pub drag_1_s: f32,
    /// Viscosity of the tissue as a time, s: the stiffness-proportional part of Rayleigh damping, a mode of angular frequency w has damping
    /// ratio `viscosity w / 2`; it takes no momentum. [`TissueModel::Implicit`] uses at least a twentieth of a substep; the other
    /// models have no other damping than drag and that of their steps, and ignore it. Default 1 ms.
    pub viscosity_s: f32,
    /// Share of the residual at which conjugate gradients stop, for [`TissueModel::Implicit`]. No equilibrium depends on it, motion
    /// does. Default 0.1: the tip of a dropped beam is never further than 3 % of its sag from its way with 16 substeps and a tolerance of 1e-5.
    pub tolerance: f32,
    /// Most iterations of conjugate gradients a substep. Default 50.
    pub iterations: u32,
    /// Whether a body that has been still for half a second is left alone until something about it changes. Default true.
    pub sleep: bool,
}

impl Default for TissueSettings {
    fn default() -> Self {
        Self {
            model: TissueModel::default(),
            capsule: None,
            stepping: TimeStepping::default(),
            substeps: 1,
            drag_1_s: 4.0,
            viscosity_s: 0.001,
            tolerance: 0.1,
            iterations: 50,
            sleep: true,
        }
    }
}
