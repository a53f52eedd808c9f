//! Shapes that are bodies, and shapes that are none.

use bevy_math::{Mat3, Vec3};
use keyhole_rigid::shape::{ShapeError, build};
use keyhole_whiteboard::{RigidMass, RigidShape};
use proptest::prelude::*;

fn error(shape: &RigidShape) -> String {
    build(shape, 1000.0, None).err().map_or(String::new(), |e| e.to_string())
}

#[test]
fn what_encloses_nothing_is_refused_with_a_reason() {
    let flat = vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::X + Vec3::Y];
    assert!(error(&RigidShape::Hull(flat.clone())).contains("not all in a plane"));
    assert!(error(&RigidShape::Hull(vec![Vec3::ONE; 9])).contains("not all in a plane"));
    assert!(error(&RigidShape::Hull(vec![Vec3::ZERO, Vec3::X])).contains("4 are needed"));
    assert!(error(&RigidShape::Hull(vec![Vec3::ZERO, Vec3::X, Vec3::NAN, Vec3::Z])).contains("point 2 is not finite"));
    assert!(error(&RigidShape::Wire { points: vec![Vec3::X, Vec3::X], radius_m: 0.1 }).contains("are the same"));
    assert!(error(&RigidShape::Wire { points: vec![Vec3::X, Vec3::Y], radius_m: 0.0 }).contains("radius is 0"));
    let vertices = vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
    let closed = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
    let solid = |triangles: Vec<[u32; 3]>| RigidShape::Solid { vertices: vertices.clone(), triangles };
    assert!(build(&solid(closed.clone()), 1000.0, None).is_ok());
    assert!(error(&solid(closed[1..].to_vec())).contains("close the surface"));
    assert!(error(&solid(closed.iter().map(|[a, b, c]| [*a, *c, *b]).collect())).contains("counter-clockwise"));
    assert!(error(&solid(vec![[0, 1, 9]; 4])).contains("vertex 9"));
    assert!(matches!(build(&solid(closed.clone()), f32::NAN, None), Err(ShapeError::NotPositive("density", _))));
    let massless = RigidMass { mass_kg: 1.0, centre: Vec3::ZERO, inertia_kg_m2: Mat3::ZERO };
    assert!(matches!(build(&solid(closed), 1.0, Some(&massless)), Err(ShapeError::NoMass { .. })));
}

proptest! {
    /// Whatever points there are: a body, or an error; never a panic, and never a body without mass.
    #[test]
    fn no_points_make_it_panic(points in proptest::collection::vec((-1i8..2, -1i8..2, -1i8..2), 0..9), scale in 1e-4f32..1.0, thin in 0f32..1.0) {
        let points: Vec<Vec3> =
            points.into_iter().map(|(x, y, z)| Vec3::new(f32::from(x), f32::from(y), f32::from(z) * thin.powi(9)) * scale).collect();
        for shape in [RigidShape::Hull(points.clone()), RigidShape::Wire { points, radius_m: scale * 0.1 }] {
            if let Ok(built) = build(&shape, 4500.0, None) {
                prop_assert!(built.mass.mass_kg > 0.0 && built.reach_m() > 0.0);
            }
        }
    }
}

/// A half circle of wire, 13 mm across as a needle's: mass is that of its length, its centre at 2 r / pi above the line of its ends.
#[test]
fn a_needle_weighs_what_its_wire_does() {
    let (radius, wire) = (0.0065f32, 0.0003f32);
    let points = (0..=48).map(|i| (i as f32 / 48.0 * std::f32::consts::PI).sin_cos()).map(|(s, c)| radius * Vec3::new(c, s, 0.0)).collect();
    let built = build(&RigidShape::Wire { points, radius_m: wire }, 7900.0, None).unwrap();
    let mass = 7900.0 * std::f32::consts::PI * wire * wire * std::f32::consts::PI * radius;
    assert!((built.mass.mass_kg / mass - 1.0).abs() < 1e-3, "{} {mass}", built.mass.mass_kg);
    assert!(built.mass.centre.distance(Vec3::Y * radius * 2.0 / std::f32::consts::PI) < 1e-3 * radius);
}
