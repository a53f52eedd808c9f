//! Settings of collision.

use crate::detect::Grading;
use bevy_ecs::prelude::Resource;

/// Which organs may meet themselves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SelfCollision {
    /// Those that have been cut, and fragments: flaps fold over.
    #[default]
    OnceCut,
    /// All.
    Always,
    /// None.
    Never,
}

/// Settings of collision. Written by the app; takes effect with the next tick.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct CollisionSettings {
    /// Size of the cells. Default hierarchical.
    pub grading: Grading,
    /// Which organs may meet themselves. Default those that have been cut.
    pub self_collision: SelfCollision,
    /// Coulomb's coefficient of tissue where an organ says nothing. Default 0.1: moist.
    pub tissue_friction: f32,
    /// Coulomb's coefficient of an instrument that says nothing. Default 0.2.
    pub instrument_friction: f32,
    /// Coulomb's coefficient of anatomy that says nothing. Default 0.2.
    pub anatomy_friction: f32,
    /// How deep in anatomy a node is still found, m. Default 10 mm.
    pub anatomy_reach_m: f32,
    /// How near an instrument's part is to tissue that it touches from where it is, and not only from where it is going, m. Default 0.5 mm.
    pub tool_near_m: f32,
    /// How near another instrument or anatomy has to be to an instrument to be listed in its `ToolContacts`, m; so much more as both moved in the tick. Default
    /// 10 mm: what a hand does in a tick at 0.6 m/s.
    pub tool_margin_m: f32,
}

impl Default for CollisionSettings {
    fn default() -> Self {
        Self {
            grading: Grading::default(),
            self_collision: SelfCollision::default(),
            tissue_friction: 0.1,
            instrument_friction: 0.2,
            anatomy_friction: 0.2,
            anatomy_reach_m: 0.01,
            tool_near_m: 0.0005,
            tool_margin_m: 0.01,
        }
    }
}
