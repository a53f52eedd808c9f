//! The soft-tissue models as they are compared: each with the settings between which one would choose, run with a clock beside it.

use bevy_math::Vec3;
use keyhole_tetmesh::TetMesh;
use keyhole_tissue::{
    Body, Constraints, Hold, MaterialError, ModelState, TeschnerSettings, TimeStepping, TissueModel, TissueSettings, VbdSettings,
    XpbdSettings,
};
use keyhole_whiteboard::{OrganMaterials, TissueState};
use std::time::Instant;

/// A tick, s.
pub const TICK_S: f32 = 1.0 / 60.0;

/// A model with its settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contender {
    /// How it is stepped. Drag is that of the body it steps.
    pub settings: TissueSettings,
}

impl Contender {
    /// The simulator's own model with these substeps and this tolerance.
    #[must_use]
    pub fn implicit(substeps: u32, tolerance: f32) -> Self {
        Self { settings: TissueSettings { substeps, tolerance, ..Self::default_of_the_simulator().settings } }
    }

    /// The simulator's default.
    #[must_use]
    pub fn default_of_the_simulator() -> Self {
        Self { settings: TissueSettings { sleep: false, ..TissueSettings::default() } }
    }

    fn of(model: TissueModel) -> Self {
        Self { settings: TissueSettings { model, ..Self::default_of_the_simulator().settings } }
    }

    /// All that the trade study compares.
    #[must_use]
    pub fn all() -> Vec<Self> {
        let mut all: Vec<Self> =
            [(1, 0.5), (1, 0.1), (1, 0.01), (2, 0.1), (4, 0.01)].map(|(n, tolerance)| Self::implicit(n, tolerance)).into();
        let two_steps = |(n, tolerance)| Self {
            settings: TissueSettings { stepping: TimeStepping::TwoSteps, ..Self::implicit(n, tolerance).settings },
        };
        all.extend([(1, 0.5), (1, 0.1), (2, 0.1)].map(two_steps));
        let own = Self::default_of_the_simulator();
        if !all.contains(&own) {
            all.push(own);
        }
        let xpbd = |substeps, constraints| Self::of(TissueModel::Xpbd(XpbdSettings { substeps, constraints }));
        all.extend([10, 20, 40, 80].map(|n| xpbd(n, Constraints::NeoHookean)));
        all.extend([20, 40].map(|n| xpbd(n, Constraints::DistanceVolume)));
        let vbd = |(substeps, iterations)| Self::of(TissueModel::Vbd(VbdSettings { substeps, iterations, ..Default::default() }));
        all.extend([(1, 10), (1, 40), (2, 20), (4, 20)].map(vbd));
        all.push(Self::of(TissueModel::Teschner(TeschnerSettings::default())));
        all
    }

    /// One of each model, as it is by default.
    #[must_use]
    pub fn one_of_each() -> Vec<Self> {
        let springs = XpbdSettings { constraints: Constraints::DistanceVolume, ..XpbdSettings::default() };
        vec![
            Self::default_of_the_simulator(),
            Self::of(TissueModel::Xpbd(XpbdSettings::default())),
            Self::of(TissueModel::Xpbd(springs)),
            Self::of(TissueModel::Vbd(VbdSettings::default())),
            Self::of(TissueModel::Teschner(TeschnerSettings::default())),
        ]
    }

    /// The model's name.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.settings.model.name()
    }

    /// Its settings in short: substeps and tolerance, substeps, or substeps x iterations.
    #[must_use]
    pub fn setting(&self) -> String {
        match self.settings.model {
            TissueModel::Implicit => {
                let steps = if self.settings.stepping == TimeStepping::TwoSteps { ", two steps" } else { "" };
                format!("{} to {}{steps}", self.settings.substeps, self.settings.tolerance)
            }
            TissueModel::Xpbd(s) => s.substeps.to_string(),
            TissueModel::Vbd(s) => format!("{} x {}", s.substeps, s.iterations),
            TissueModel::Teschner(s) => format!("{} of the limit", s.part_of_limit),
        }
    }

    /// Both.
    #[must_use]
    pub fn full_name(&self) -> String {
        format!("{} {}", self.name(), self.setting())
    }
}

/// A body that a contender steps.
#[derive(Clone, Debug)]
pub struct Bout {
    /// The body.
    pub body: Body,
    /// What the model keeps.
    pub model: ModelState,
    /// Where it is.
    pub state: TissueState,
    settings: TissueSettings,
    /// Wall time of each tick so far, s.
    pub ticks_s: Vec<f64>,
}

impl Bout {
    /// A body at rest.
    ///
    /// # Errors
    /// When a material is none.
    pub fn new(contender: &Contender, mesh: &TetMesh, materials: &OrganMaterials, drag_1_s: f32) -> Result<Self, MaterialError> {
        let body = Body::new(mesh, materials)?;
        let settings = TissueSettings { drag_1_s, sleep: false, ..contender.settings };
        let model = ModelState::new(settings.model, settings.capsule, &body, mesh, materials)?;
        Ok(Self { body, model, state: TissueState::at_rest(mesh), settings, ticks_s: Vec::new() })
    }

    /// One tick of `dt` s.
    pub fn tick(&mut self, holds: &[Hold], gravity: Vec3, dt: f32) {
        let begin = Instant::now();
        self.model.step(&mut self.body, &mut self.state, holds, gravity, dt, &self.settings);
        self.ticks_s.push(begin.elapsed().as_secs_f64());
    }

    /// Whether all of it is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.state.positions.iter().chain(&self.state.velocities).all(|v| v.is_finite())
    }

    /// Wall time a simulated second, s: sixty times the lower decile of the ticks, for the machine may have been busy with something else in most.
    #[must_use]
    pub fn cost(&self) -> f64 {
        let mut ticks = self.ticks_s.clone();
        ticks.sort_by(f64::total_cmp);
        ticks.get(ticks.len() / 10).map_or(f64::NAN, |t| t / f64::from(TICK_S))
    }
}
