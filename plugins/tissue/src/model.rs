//! Every soft-tissue model behind one interface: positions and velocities in, positions and velocities out, with attachments, fixed nodes, gravity,
//! damping, materials by tetrahedron, and topology deltas.
//!
//! [`TissueModel`] says which; [`ModelState`] is what it keeps between ticks beside the [`Body`] that all share. `keyhole study trade` says what each costs
//! and how right it is, `keyhole study stability` what each survives.

use crate::body::Body;
use crate::hold::Hold;
use crate::island::{self, Member};
use crate::material::MaterialError;
use crate::membrane::{Capsule, Membrane};
use crate::settings::TissueSettings;
use crate::teschner::{Teschner, TeschnerSettings};
use crate::vbd::{Vbd, VbdSettings};
use crate::xpbd::{self, XpbdSettings};
use bevy_ecs::prelude::Entity;
use bevy_math::Vec3;
use keyhole_tetmesh::{TetMesh, TopologyDelta};
use keyhole_whiteboard::{Contact, OrganMaterials, TissueState};

/// A soft-tissue model with its settings.
///
/// What each survives is measured by `keyhole study stability`, with default settings, on a clamped beam of 60 x 30 x 30 mm in 270 tetrahedra: Young's modulus 10 Pa to
/// 1 GPa, Poisson's ratio 0 to 0.4999, ticks of 0.1 to 100 ms, mass ratios to 1e6, gravity to 1000 g, dihedral angles down to 0.01 degrees; all nodes in a plane, on a
/// line, in a point, scrambled or mirrored; pulled to ten times its length, a tool at 10 m/s. All stay finite and bounded in these but where it is said below.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum TissueModel {
    /// The simulator's own: implicit stages by Newton's method, right at rest and in motion with one substep. See [`crate::implicit`] and
    /// [`crate::TimeStepping`].
    ///
    /// Limits: none of these breaks it, and it comes back to its rest shape from every one within two seconds. What is tangled, or gains energy that nothing gave it, is
    /// taken out of it by [`crate::rescue`], whose way there is not that of the material.
    #[default]
    Implicit,
    /// The paper's: distance and volume potentials, explicit Verlet steps. See [`crate::teschner`].
    ///
    /// Limits: a second takes more than a second from 0.1 degrees of dihedral angle and from 1 GPa, for its steps shorten with stiffness and altitude; all nodes on a
    /// line or in a point stay tangled.
    Teschner(TeschnerSettings),
    /// Extended position-based dynamics with small steps. See [`crate::xpbd`].
    ///
    /// Limits, with the neo-Hookean block and 40 substeps: from 10 MPa it shakes with too much energy; with ticks of 1 ms (substeps of 25 microseconds) rounding
    /// leaves it 3 % off and with 0.1 ms it gains energy, as springs do; with ticks of 100 ms it is 4 % off; scrambled or mirrored it stays tangled, from where springs
    /// come back.
    Xpbd(XpbdSettings),
    /// Vertex block descent. See [`crate::vbd`].
    ///
    /// Limits, with 4 substeps of 20 sweeps: a Poisson's ratio of 0.4999 takes more than four seconds to come back; all nodes in a point, scrambled or mirrored stay tangled.
    Vbd(VbdSettings),
}

impl TissueModel {
    /// Its name, as in a scene and in the tables of a study.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Implicit => "implicit",
            Self::Teschner(_) => "teschner",
            Self::Xpbd(s) => match s.constraints {
                xpbd::Constraints::NeoHookean => "xpbd",
                xpbd::Constraints::DistanceVolume => "xpbd-springs",
            },
            Self::Vbd(_) => "vbd",
        }
    }
}

/// What a model keeps of one organ between ticks.
#[derive(Clone, Debug, Default)]
pub struct ModelState {
    model: TissueModel,
    kept: Kept,
    membrane: Option<Membrane>,
}

#[derive(Clone, Debug, Default)]
enum Kept {
    #[default]
    Nothing,
    Teschner(Teschner),
    Vbd(Vbd),
}

impl ModelState {
    /// The state of a model for an organ, with a capsule on its whole surface when there is one.
    ///
    /// # Errors
    /// When a material has constants that no material has.
    pub fn new(
        model: TissueModel,
        capsule: Option<Capsule>,
        body: &Body,
        mesh: &TetMesh,
        materials: &OrganMaterials,
    ) -> Result<Self, MaterialError> {
        Self::with(model, capsule.map(|c| Membrane::new(mesh, c)), body, mesh, materials)
    }

    /// The state of the same model for a piece that has come off an organ, with its part of the capsule. This is the organ's state before it adopts
    /// that the piece has gone.
    ///
    /// # Errors
    /// When a material has constants that no material has.
    pub fn of_piece(&self, body: &Body, mesh: &TetMesh, materials: &OrganMaterials) -> Result<Self, MaterialError> {
        Self::with(self.model, self.membrane.as_ref().map(|m| Membrane::of_piece(m, mesh)), body, mesh, materials)
    }

    fn with(
        model: TissueModel,
        membrane: Option<Membrane>,
        body: &Body,
        mesh: &TetMesh,
        materials: &OrganMaterials,
    ) -> Result<Self, MaterialError> {
        let kept = match model {
            TissueModel::Implicit | TissueModel::Xpbd(_) => Kept::Nothing,
            TissueModel::Teschner(_) => Kept::Teschner(Teschner::new(body, mesh, materials, membrane.as_ref())?),
            TissueModel::Vbd(_) => Kept::Vbd(Vbd::new(body, mesh)),
        };
        Ok(Self { model, kept, membrane })
    }

    /// The model that it is the state of.
    #[must_use]
    pub fn model(&self) -> TissueModel {
        self.model
    }

    /// The capsule, as far as it has not been cut away.
    #[must_use]
    pub fn membrane(&self) -> Option<&Membrane> {
        self.membrane.as_ref()
    }

    /// The largest stable step of an explicit model, s: see [`Teschner::limit_s`].
    #[must_use]
    pub fn step_limit_s(&self) -> Option<f32> {
        match &self.kept {
            Kept::Teschner(t) => Some(t.limit_s()),
            Kept::Nothing | Kept::Vbd(_) => None,
        }
    }

    /// Carries it over a topology change, at a cost that depends on the change; `body` and `mesh` are those after it.
    pub fn adopt(&mut self, body: &Body, mesh: &TetMesh, delta: &TopologyDelta) {
        if let Some(membrane) = &mut self.membrane {
            membrane.adopt(mesh, delta);
        }
        match &mut self.kept {
            Kept::Nothing => {}
            Kept::Teschner(t) => t.adopt(body, mesh, delta, self.membrane.as_ref()),
            Kept::Vbd(v) => v.adopt(body, mesh, delta),
        }
    }

    /// Whether bodies that touch are solved as one system: [`crate::island::step`]. With the other models each goes by itself.
    #[must_use]
    pub fn is_solved_together(&self) -> bool {
        self.model == TissueModel::Implicit
    }

    /// Steps a body that touches nothing over one tick of `dt` s under gravity (m/s2). Of the settings only damping counts, but for [`TissueModel::Implicit`].
    pub fn step(&mut self, body: &mut Body, state: &mut TissueState, holds: &[Hold], gravity: Vec3, dt: f32, settings: &TissueSettings) {
        self.step_touching(body, state, holds, &mut [], gravity, dt, settings);
    }

    /// The same with contacts, the forces of which it writes down. Organs that it touches are obstacles; by [`TissueModel::Implicit`] those that touch are better stepped
    /// together: [`crate::island::step`].
    pub fn step_touching(
        &mut self,
        body: &mut Body,
        state: &mut TissueState,
        holds: &[Hold],
        contacts: &mut [Contact],
        gravity: Vec3,
        dt: f32,
        settings: &TissueSettings,
    ) {
        let membrane = self.membrane.as_ref();
        let drag = settings.drag_1_s;
        match (&self.model, &mut self.kept) {
            (TissueModel::Teschner(s), Kept::Teschner(t)) => t.step(s, body, membrane, state, holds, gravity, dt, drag, contacts),
            (TissueModel::Vbd(s), Kept::Vbd(v)) => v.step(s, body, membrane, state, holds, gravity, dt, drag, contacts),
            (TissueModel::Xpbd(s), _) => xpbd::step_with(s, body, membrane, state, holds, gravity, dt, drag, contacts),
            _ => {
                let organ = Entity::PLACEHOLDER;
                island::step(
                    &mut [Member { organ, body, membrane, state, holds, contacts, light: &mut [], crumb: false }],
                    gravity,
                    dt,
                    settings,
                );
            }
        }
    }
}
