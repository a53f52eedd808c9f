//! A piece of tissue that graspers come down on, and the ways of hands that lift it.

use bevy::math::Vec3;

/// Height of the tissue's upper face, m.
pub const TOP: f32 = 0.02;
/// How far below it the middle of the pads takes hold, m.
pub const DEEP: f32 = 0.008;

/// Where a hand has the point between its pads (m), and its grip, at a time (s).
pub type Key = (f64, Vec3, f32);

/// Down to the tissue with open jaws, closed, and up by this much (m) in `seconds`.
pub fn pull_up(x: f32, by: f32, seconds: f64) -> [Key; 5] {
    let place = |y: f32| Vec3::new(x, y, 0.0);
    [
        (0.0, place(TOP + 0.03), 0.0),
        (0.5, place(TOP - DEEP), 0.0),
        (1.0, place(TOP - DEEP), 1.0),
        (1.5, place(TOP - DEEP), 1.0),
        (1.5 + seconds, place(TOP - DEEP + by), 1.0),
    ]
}
