//! What to do with a mesh that is turned inside out somewhere.
//!
//! An inverted element can be in equilibrium with its neighbours, and going downhill does not take it out of there. Extended position-based
//! dynamics does: beams of 10 kPa scrambled at random come back to rest within three seconds. So a tick that starts with a tangled body is stepped by it.

use crate::body::Body;
use crate::settings::{Solver, TissueSettings};
use keyhole_whiteboard::TissueState;

/// Substeps of a tick of rescue for tissue of this shear modulus (Pa); their number goes with the speed of sound. At 3.4 kPa, 20 substeps bring a
/// scrambled beam back; at 340 kPa, 20 keep it shaking.
const SUBSTEPS: (f32, f32) = (20.0, 3400.0);

/// Most substeps of a tick of rescue: stiffer tissue than 70 kPa in shear may not come back.
const MOST_SUBSTEPS: f32 = 90.0;

/// A body is tangled when more than one in so many of its elements is inverted. A few may be a bridge of tissue about to be cut through, torn out of shape
/// by the weight of what hangs on it: with one inverted element as the mark, rescue shook the kidney's last bridge to pieces.
const TANGLED: usize = 400;

/// Whether a body is turned inside out.
#[must_use]
pub fn is_tangled(body: &Body, state: &TissueState) -> bool {
    let inverted = |e: &&crate::Element| e.deformation(e.indices().map(|i| state.positions[i])).determinant() <= 0.0;
    let used = || body.elements().iter().filter(|e| !e.is_empty());
    used().filter(inverted).count() * TANGLED > used().count()
}

/// The settings of a tick of rescue.
#[must_use]
pub fn settings(body: &Body, settings: &TissueSettings) -> TissueSettings {
    let stiffest = body.elements().iter().map(|e| e.material.mu).fold(0.0, f32::max);
    let (base, modulus) = SUBSTEPS;
    let wanted = (base * (stiffest / modulus).sqrt()).clamp(base, MOST_SUBSTEPS) as u32;
    TissueSettings { solver: Solver::Xpbd, substeps: settings.substeps.max(wanted), ..*settings }
}
