//! What to do with a mesh that is turned inside out somewhere.
//!
//! An inverted element can be in equilibrium with its neighbours, and going downhill does not take it out of there. Extended position-based
//! dynamics does: beams of 10 kPa scrambled at random come back to rest within three seconds. So a tick that starts with a tangled body is stepped by it.

use crate::body::Body;
use crate::settings::{Solver, TissueSettings};

/// Substeps of a tick of rescue for tissue of this shear modulus (Pa); their number goes with the speed of sound. At 3.4 kPa, 20 substeps bring a
/// scrambled beam back; at 340 kPa, 20 keep it shaking.
const SUBSTEPS: (f32, f32) = (20.0, 3400.0);

/// Most substeps of a tick of rescue: stiffer tissue than 70 kPa in shear may not come back.
const MOST_SUBSTEPS: f32 = 90.0;

/// The settings of a tick of rescue.
#[must_use]
pub fn settings(body: &Body, settings: &TissueSettings) -> TissueSettings {
    let stiffest = body.elements().iter().map(|e| e.material.mu).fold(0.0, f32::max);
    let (base, modulus) = SUBSTEPS;
    let wanted = (base * (stiffest / modulus).sqrt()).clamp(base, MOST_SUBSTEPS) as u32;
    TissueSettings { solver: Solver::Xpbd, substeps: settings.substeps.max(wanted), ..*settings }
}
