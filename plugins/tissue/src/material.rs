//! Elastic constants: from Young's modulus and Poisson's ratio to what the energy takes.

use keyhole_whiteboard::OrganMaterial;

/// Constants of the stable neo-Hookean energy without logarithm (Smith, de Goes, Kim 2018; Macklin & Mueller 2021),
///
/// `psi(F) = mu/2 (tr F'F - 3) + lambda/2 (det F - a)^2`, `a = 1 + mu / lambda`, in J/m3.
///
/// It linearises to the Lame parameters `mu` and `lambda - mu`, so `lambda` here is Lame's plus `mu`; leaving that out makes the bulk
/// modulus 1.9 times too small at a Poisson ratio of 0.3.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeoHookean {
    /// Shear modulus, Pa.
    pub mu: f32,
    /// Lame's first parameter plus `mu`, Pa.
    pub lambda: f32,
}

/// An elastic constant that no material has.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MaterialError {
    /// Young's modulus or density.
    #[error("material `{name}`: {what} is {value}, expected a finite number above 0; correct it in the scene")]
    NotPositive {
        /// Name of the material.
        name: String,
        /// Which quantity.
        what: &'static str,
        /// Its value in SI units.
        value: f32,
    },
    /// Poisson's ratio.
    #[error("material `{name}`: Poisson's ratio is {value}, expected 0 <= nu < 0.5; soft organs have 0.45 to 0.49")]
    Poisson {
        /// Name of the material.
        name: String,
        /// Its value.
        value: f32,
    },
}

impl NeoHookean {
    /// The constants of a material.
    ///
    /// # Errors
    /// When Young's modulus or the density is not above 0, or Poisson's ratio is outside [0, 0.5).
    pub fn of(material: &OrganMaterial) -> Result<Self, MaterialError> {
        for (what, value) in [("Young's modulus (Pa)", material.young_modulus_pa), ("density (kg/m3)", material.density_kg_m3)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(MaterialError::NotPositive { name: material.name.clone(), what, value });
            }
        }
        let nu = f64::from(material.poisson_ratio);
        if !(0.0..0.5).contains(&nu) {
            return Err(MaterialError::Poisson { name: material.name.clone(), value: material.poisson_ratio });
        }
        let e = f64::from(material.young_modulus_pa);
        let mu = e / (2.0 * (1.0 + nu));
        let lame = e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu));
        Ok(Self { mu: mu as f32, lambda: (lame + mu) as f32 })
    }

    /// The determinant at which the volumetric term vanishes, `1 + mu / lambda`.
    #[must_use]
    pub fn a(self) -> f32 {
        1.0 + self.mu / self.lambda
    }
}
