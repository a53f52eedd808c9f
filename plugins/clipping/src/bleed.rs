//! What flows out of an opened vessel.
//!
//! The heart and the vessels before the cut are a resistance `R = p / supply` (Poiseuille: flow is proportional to pressure), the opening is an orifice
//! (Torricelli, with the contraction of a free jet): `p = R Q + rho / 2 (Q / (c A))^2`. A small opening bleeds in proportion to its area; of a large one
//! flows what the supply gives. Pressure is constant: what is lost does not lower it.

use keyhole_whiteboard::VesselEnd;

/// Density of blood, kg/m3 (T. Kenner, "The measurement of blood density and its meaning", Basic Research in Cardiology 84, 1989).
pub const BLOOD_KG_M3: f64 = 1060.0;

/// Contraction of a free jet from a slit, pi / (pi + 2) (G. Kirchhoff, "Zur Theorie freier Fluessigkeitsstrahlen", 1869); of a round hole it is measured
/// about the same.
pub const CONTRACTION: f64 = std::f64::consts::PI / (std::f64::consts::PI + 2.0);

/// Cubic metres a second in a ml/min.
pub const ML_MIN: f64 = 1e-6 / 60.0;

/// Flow from an end of a vessel through an opening of this area (m2), ml/min.
#[must_use]
pub fn flow_ml_min(end: &VesselEnd, area_m2: f64) -> f64 {
    let (pressure, supply) = (f64::from(end.pressure_pa), f64::from(end.supply_ml_min) * ML_MIN);
    if !(pressure > 0.0 && supply > 0.0 && area_m2 > 0.0) {
        return 0.0;
    }
    // The flow were it the opening alone; in its units k x2 + x = 1 with x the part of the supply.
    let jet = CONTRACTION * area_m2 * (2.0 * pressure / BLOOD_KG_M3).sqrt();
    let k = (supply / jet).powi(2);
    let part = 2.0 / (1.0 + (1.0 + 4.0 * k).sqrt());
    part * supply / ML_MIN
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// By hand: 100 mmHg are 13 332 Pa, behind which a jet leaves at 5.015 m/s; through 1 mm2, contracted to 0.611, 183.9 ml/min.
    #[test]
    fn a_small_hole_in_an_artery() {
        let aorta = VesselEnd { pressure_pa: 13_332.0, supply_ml_min: 1e6 };
        assert!((flow_ml_min(&aorta, 1e-6) - 183.9).abs() < 0.1, "{}", flow_ml_min(&aorta, 1e-6));
        let half = flow_ml_min(&aorta, 0.5e-6) / flow_ml_min(&aorta, 1e-6);
        assert!((half - 0.5).abs() < 1e-3, "{half}");
        let small = VesselEnd { supply_ml_min: 50.0, ..aorta };
        assert!((flow_ml_min(&small, 1e-3) - 50.0).abs() < 1e-3);
        assert_eq!(flow_ml_min(&small, 0.0), 0.0);
        assert_eq!(flow_ml_min(&VesselEnd::default(), 1e-6), 0.0);
    }

    proptest! {
        /// The pressure is used up by resistance and jet; more area never bleeds less, and no more than the supply.
        #[test]
        fn pressure_is_used_up(pressure_pa in 100f32..2e4, supply_ml_min in 1f32..1e4, area in 1e-9f64..1e-4) {
            let end = VesselEnd { pressure_pa, supply_ml_min };
            let flow = flow_ml_min(&end, area);
            let resistance = f64::from(pressure_pa) / f64::from(supply_ml_min);
            let jet = flow * ML_MIN / (CONTRACTION * area);
            let used = resistance * flow + BLOOD_KG_M3 / 2.0 * jet * jet;
            prop_assert!((used / f64::from(pressure_pa) - 1.0).abs() < 1e-9, "{used}");
            prop_assert!(flow <= f64::from(supply_ml_min) && flow_ml_min(&end, 2.0 * area) >= flow);
        }
    }
}
