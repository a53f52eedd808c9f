//! Coulomb's law at a point of a pad.

use bevy_math::Vec3;

/// What a pad does to a point of tissue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hold {
    /// Force with which the pad presses, N.
    pub normal_n: f32,
    /// What it does in all, friction included, N.
    pub force_n: Vec3,
    /// How far the pad's point has to move along the pad, m, for friction to hold what is left; zero while it holds.
    pub slide_m: Vec3,
}

/// Of an attachment's force on the tissue (N) by a pad with the normal `inward`, held with a compliance (m/N).
///
/// With `N` the force along the normal and `T` the one across, `T` is at most `friction N`: the point slides by the compliance times what is beyond.
/// `None` where the pad would have to pull.
#[must_use]
pub fn hold(force_n: Vec3, inward: Vec3, friction: f32, compliance_m_n: f32) -> Option<Hold> {
    let normal_n = force_n.dot(inward);
    if normal_n < 0.0 {
        return None;
    }
    let across = force_n - normal_n * inward;
    let (most, pull) = (friction * normal_n, across.length());
    let beyond = if pull > most { across * (1.0 - most / pull) } else { Vec3::ZERO };
    Some(Hold { normal_n, force_n: force_n - beyond, slide_m: -beyond * compliance_m_n })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// After the slide the attachment's force is on the cone of friction, in the direction it had across the pad.
        #[test]
        fn friction_holds_no_more_than_its_coefficient(x in -9f32..9.0, y in -9f32..9.0, z in -9f32..9.0, mu in 0f32..2.0) {
            let (force, inward, compliance) = (Vec3::new(x, y, z), Vec3::NEG_Y, 1e-3);
            match hold(force, inward, mu, compliance) {
                None => prop_assert!(y > 0.0),
                Some(found) => {
                    prop_assert_eq!(found.normal_n, -y);
                    prop_assert!(found.slide_m.dot(inward).abs() < 1e-9);
                    let left = found.force_n;
                    prop_assert!(left.distance(force + found.slide_m / compliance) < 1e-4);
                    let across = Vec3::new(left.x, 0.0, left.z);
                    prop_assert!(across.length() <= mu * found.normal_n + 1e-4);
                    let before = Vec3::new(x, 0.0, z);
                    if before.length() > mu * found.normal_n {
                        prop_assert!((across.length() - mu * found.normal_n).abs() < 1e-4);
                        prop_assert!(across.dot(before) >= 0.0);
                    } else {
                        prop_assert_eq!(found.slide_m, Vec3::ZERO);
                    }
                }
            }
        }
    }

    #[test]
    fn three_newtons_hold_a_pull_of_five() {
        let mu = crate::GraspSettings::default().friction;
        let of_each_jaw = |pull: f32| hold(Vec3::new(pull / 2.0, -3.0, 0.0), Vec3::NEG_Y, mu, 1e-3).unwrap();
        assert_eq!(of_each_jaw(4.9).slide_m, Vec3::ZERO);
        assert!(of_each_jaw(5.1).slide_m.x < 0.0);
    }
}
