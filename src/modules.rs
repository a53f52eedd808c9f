//! The modules that a scene may require: the plugin of each, and whether a scene asks for it.

use bevy::prelude::*;
use keyhole_assessment::AssessmentPlugin;
use keyhole_clipping::ClippingPlugin;
use keyhole_collision::CollisionPlugin;
use keyhole_cutting::CuttingPlugin;
use keyhole_grasping::GraspingPlugin;
use keyhole_instruments::InstrumentsPlugin;
use keyhole_rigid::RigidPlugin;
use keyhole_suturing::SuturingPlugin;
use keyhole_tissue::TissuePlugin;
use keyhole_whiteboard::SceneRequirements;
use serde::{Deserialize, Serialize};

/// A module of the simulation. One that a scene does not require does not run and allocates nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Module {
    /// Trocars, tools, hands.
    Instruments,
    /// Jaws on tissue; required with instruments.
    Grasping,
    /// Clips and bleeding.
    Clipping,
    /// Needle and thread.
    Suturing,
    /// Blades.
    Cutting,
    /// Contacts.
    Collision,
    /// Soft tissue.
    Tissue,
    /// Rigid bodies.
    Rigid,
    /// Metrics.
    Assessment,
}

impl Module {
    /// All, in the order in which their plugins are added.
    pub const ALL: [Self; 9] = [
        Self::Instruments,
        Self::Grasping,
        Self::Clipping,
        Self::Suturing,
        Self::Cutting,
        Self::Collision,
        Self::Tissue,
        Self::Rigid,
        Self::Assessment,
    ];

    /// Its name in lower case, as its folder has it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Instruments => "instruments",
            Self::Grasping => "grasping",
            Self::Clipping => "clipping",
            Self::Suturing => "suturing",
            Self::Cutting => "cutting",
            Self::Collision => "collision",
            Self::Tissue => "tissue",
            Self::Rigid => "rigid",
            Self::Assessment => "assessment",
        }
    }

    /// What says whether it is required; two modules may share it.
    fn flag(self, requirements: &mut SceneRequirements) -> &mut bool {
        match self {
            Self::Instruments | Self::Grasping => &mut requirements.instruments,
            Self::Clipping => &mut requirements.clipping,
            Self::Suturing => &mut requirements.suturing,
            Self::Cutting => &mut requirements.cutting,
            Self::Collision => &mut requirements.collision,
            Self::Tissue => &mut requirements.tissue,
            Self::Rigid => &mut requirements.rigid,
            Self::Assessment => &mut requirements.assessment,
        }
    }

    /// Whether it is required.
    #[must_use]
    pub fn is_required(self, mut requirements: SceneRequirements) -> bool {
        *self.flag(&mut requirements)
    }

    /// Requires it where it is not required, and the other way round.
    pub fn toggle(self, requirements: &mut SceneRequirements) {
        let flag = self.flag(requirements);
        *flag = !*flag;
    }

    /// Adds its plugin.
    pub fn add(self, app: &mut App) {
        match self {
            Self::Instruments => app.add_plugins(InstrumentsPlugin),
            Self::Grasping => app.add_plugins(GraspingPlugin),
            Self::Clipping => app.add_plugins(ClippingPlugin),
            Self::Suturing => app.add_plugins(SuturingPlugin),
            Self::Cutting => app.add_plugins(CuttingPlugin),
            Self::Collision => app.add_plugins(CollisionPlugin),
            Self::Tissue => app.add_plugins(TissuePlugin),
            Self::Rigid => app.add_plugins(RigidPlugin),
            Self::Assessment => app.add_plugins(AssessmentPlugin),
        };
    }
}
