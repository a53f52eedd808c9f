//! The tube of a suction: steel all the way, its end rounded and open, with side holes behind it.

use crate::model::{Profile, Ring, append};
use bevy_math::Vec3;
use keyhole_whiteboard::{Joint, PartMesh, Suction, ToolPart};

/// Radius of the tube and of its bore, of that of the shaft.
const TUBE: f32 = 0.9;
const BORE: f32 = 0.62;

const STEEL: [f32; 3] = [0.62, 0.63, 0.65];
const DARK: [f32; 3] = [0.015, 0.012, 0.012];

/// The tube on a shaft of this radius (m).
pub(crate) fn tube(r: f32) -> Vec<ToolPart> {
    let mouth = Suction::default().mouth_m;
    let round = |along: f32, radius: f32| Ring { z: -along, half_x: radius, half_y: radius, offset: Vec3::ZERO };
    let outer = TUBE * r;
    let tube = Profile::Round.loft(&[
        round(-0.3 * r, outer),
        round(mouth - 0.3 * r, outer),
        round(mouth - 0.1 * r, 0.96 * outer),
        round(mouth, 0.8 * outer),
    ]);
    // What is seen of the bore and of the side holes: dark discs that stand out from the steel by a hair.
    let hair = 0.01 * r;
    let mut holes = Profile::Round.loft(&[round(mouth - 0.2 * r, BORE * r), round(mouth + hair, BORE * r)]);
    for row in 0..3u8 {
        for side in 0..4u8 {
            let angle = std::f32::consts::FRAC_PI_2 * (f32::from(side) + 0.5 * f32::from(row % 2));
            append(&mut holes, &side_hole(mouth - (1.2 + 0.9 * f32::from(row)) * r, angle, outer + hair, 0.26 * r));
        }
    }
    let part = |name, mesh, colour, metallic| ToolPart { name, mesh, joint: Joint::Fixed, colour, metallic };
    vec![part("tube", tube, STEEL, 1.0), part("holes", holes, DARK, 0.0)]
}

/// A round plug across the tube's wall: its middle `along` m from the frame's origin and at this angle about the tube (rad), its outer end `out` m from the axis.
fn side_hole(along: f32, angle: f32, out: f32, radius: f32) -> PartMesh {
    let disc = |z: f32| Ring { z, half_x: radius, half_y: radius, offset: Vec3::ZERO };
    let mut mesh = Profile::Round.loft(&[disc(0.5 * out), disc(out)]);
    let (sin, cos) = angle.sin_cos();
    // The plug's axis is turned from Z to the tube's radius, its X to the tube's axis: right-handed.
    let turn = |v: [f32; 3]| Vec3::new(v[2] * cos - v[1] * sin, v[2] * sin + v[1] * cos, -v[0]);
    for v in &mut mesh.vertices {
        *v = (turn(*v) - along * Vec3::Z).to_array();
    }
    for n in &mut mesh.normals {
        *n = turn(*n).to_array();
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tube ends where it takes blood up, and its holes are in its wall.
    #[test]
    fn the_mouth_that_is_drawn_is_the_mouth_that_aspirates() {
        let r = 0.0025;
        let parts = tube(r);
        let ends = |part: &ToolPart| part.mesh.vertices.iter().map(|v| -v[2]).fold(0.0, f32::max);
        assert!((ends(&parts[0]) - Suction::default().mouth_m).abs() < 1e-6);
        assert!((ends(&parts[1]) - Suction::default().mouth_m).abs() < 0.02 * r);
        let widest = parts[1].mesh.vertices.iter().map(|v| v[0].hypot(v[1])).fold(0.0, f32::max);
        assert!(widest < 1.0 * r && widest > TUBE * r, "{widest}");
    }
}
