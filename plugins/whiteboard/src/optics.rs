//! What the lens of an endoscope does to its picture. Never read by the simulation.

use bevy_ecs::prelude::*;

/// The optics of an endoscope, beside its `Endoscope`; one without them has the default ones. Written by the scene.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct ScopeOptics {
    /// Coefficients k1 and k2 of barrel distortion: what the lens shows at radius `r` a pinhole shows at `r (1 + k1 r^2 + k2 r^4) / (1 + k1 + k2)`,
    /// both as parts of the radius of the round picture (the odd polynomial of Brown 1966, towards the pinhole, rim on rim). At the rim the picture
    /// is smaller by `(k1 + k2) / (1 + k1 + k2)` than one with the magnification of its middle would be.
    pub distortion: [f32; 2],
    /// Time in which a clean lens fogs over, s; `None`: it never does.
    pub fogs_in_s: Option<f32>,
    /// Distance of the two lenses of a stereo endoscope, m; `None` for one lens.
    pub stereo_base_m: Option<f32>,
}

impl ScopeOptics {
    /// Distortion at the rim by default, a part of the radius: laparoscopes measure 0.07 to 0.23 (doi 10.1089/end.2012.0140).
    pub const DISTORTION: f32 = 0.12;

    /// The coefficients of a lens with one coefficient and so much distortion at the rim, a part of the radius, below 1.
    #[must_use]
    pub fn one_coefficient(distortion: f32) -> [f32; 2] {
        [distortion / (1.0 - distortion), 0.0]
    }

    /// How much smaller the rim is than with the magnification of the middle, as a part.
    #[must_use]
    pub fn distortion_at_rim(&self) -> f32 {
        let sum = self.distortion[0] + self.distortion[1];
        sum / (1.0 + sum)
    }
}

impl Default for ScopeOptics {
    fn default() -> Self {
        Self { distortion: Self::one_coefficient(Self::DISTORTION), fogs_in_s: None, stereo_base_m: None }
    }
}
