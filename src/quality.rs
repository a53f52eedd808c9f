//! How much care is taken of the tissue's motion: what the start screen offers, with what it costs in `plugins/hud/src/costs.csv`.

use bevy::prelude::*;
use keyhole_tissue::{TimeStepping, TissueModel, TissueSettings};

/// Chosen on the start screen; a scene keeps it when it is started over.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Quality {
    /// As the scene says.
    #[default]
    Scene,
    /// Four substeps a tick, each solved ten times as well.
    Fine,
    /// One substep of two stages a tick.
    Default,
    /// One substep of one stage a tick.
    Fast,
}

impl Quality {
    /// All, in the order of the start screen.
    pub const ALL: [Self; 4] = [Self::Scene, Self::Fine, Self::Default, Self::Fast];

    /// Its name in the file of costs.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Scene => "as the scene says",
            Self::Fine => "fine",
            Self::Default => "default",
            Self::Fast => "fast",
        }
    }

    /// Changes the settings of a scene's tissue to this quality.
    pub fn apply(self, settings: &mut TissueSettings) {
        let own = TissueSettings::default();
        let implicit = |stepping, substeps, tolerance| TissueSettings {
            model: TissueModel::Implicit,
            stepping,
            substeps,
            tolerance,
            iterations: own.iterations,
            ..*settings
        };
        *settings = match self {
            Self::Scene => *settings,
            Self::Fine => implicit(TimeStepping::TwoStages, 4, 0.01),
            Self::Default => implicit(TimeStepping::TwoStages, 1, own.tolerance),
            Self::Fast => implicit(TimeStepping::TwoSteps, 1, own.tolerance),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use keyhole_hud::costs::choices;

    /// What the start screen offers is what there is, in its order.
    #[test]
    fn every_quality_says_what_it_costs() {
        assert!(choices("quality").map(|c| c.name).eq(Quality::ALL.map(Quality::name)));
        let mut settings = TissueSettings { drag_1_s: 7.0, ..TissueSettings::default() };
        Quality::Fast.apply(&mut settings);
        assert_eq!((settings.stepping, settings.drag_1_s), (TimeStepping::TwoSteps, 7.0));
    }
}
