//! When two things that move touch first: conservative advancement (B. Mirtich, "Impulse-based dynamic simulation of rigid body systems", 1996).
//!
//! Nothing comes nearer to another thing by more than both together go. From a distance the time can go on by as much as they need for it at least,
//! again and again, and no touch is missed: neither that of a fast tool nor that of one that turns.

/// Steps after which what is still coming nearer counts as touching: it grazes.
const STEPS: usize = 128;

/// The part of the tick, 0 to 1, at which the distance (m) is first not more than `near_m`. `distance` is that at a part of the tick, and `way_m` the most by
/// which it can shrink over the whole. `None` if it does not, or where the distance is not a number.
pub(crate) fn first_touch(way_m: f32, near_m: f32, distance: impl Fn(f32) -> Option<f32>) -> Option<f32> {
    let mut part = 0.0;
    for _ in 0..STEPS {
        let apart = distance(part).filter(|d| d.is_finite())?;
        if apart <= near_m {
            return Some(part);
        }
        // Not all the way: at half of what is near it is found to touch.
        part += (apart - 0.5 * near_m) / way_m;
        if part.is_nan() || part > 1.0 {
            return None;
        }
    }
    Some(part)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_touch_is_neither_missed_nor_early() {
        // A bound of the speed that is four times too large costs steps alone.
        for factor in [1.0, 4.0] {
            let touch = first_touch(factor * 0.1, 1e-4, |t| Some((0.03 - 0.1 * t).abs()));
            assert!(touch.is_some_and(|t| (t - 0.3).abs() < 1e-3), "{touch:?}");
            assert_eq!(first_touch(factor * 0.02, 1e-4, |t| Some(0.03 - 0.02 * t)), None);
        }
        assert_eq!(first_touch(0.0, 1e-4, |_| Some(1.0)), None, "what does not move");
        assert_eq!(first_touch(1.0, 1e-4, |_| Some(f32::NAN)), None);
    }
}
