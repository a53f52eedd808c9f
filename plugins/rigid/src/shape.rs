//! From the shape that the whiteboard has to what rapier collides, with errors for shapes that enclose nothing.

use crate::convert::{from_rapier, length_to_rapier, matrix_to_rapier, to_rapier};
use crate::mass::Mass;
use bevy_math::{Mat3, Vec3};
use keyhole_whiteboard::{RigidMass, RigidShape};
use rapier3d::dynamics::MassProperties;
use rapier3d::geometry::SharedShape;
use rapier3d::math::Pose;
use rapier3d::parry::transformation::try_convex_hull;
use thiserror::Error;

/// Part of its length below which the thickness of a hull is none.
const FLAT: f32 = 1e-4;

/// Why a shape cannot be a rigid body.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ShapeError {
    /// A point is not finite.
    #[error("point {0} is not finite")]
    NotFinite(usize),
    /// There are not enough points.
    #[error("{given} points, but {needed} are needed")]
    TooFew {
        /// How many there are.
        given: usize,
        /// How many there have to be.
        needed: usize,
    },
    /// All points are in a plane.
    #[error("the points are {thickness_m} m thick and {length_m} m long: a hull needs points that are not all in a plane")]
    Flat {
        /// Extent across the plane that they are nearly in, m.
        thickness_m: f32,
        /// Largest extent, m.
        length_m: f32,
    },
    /// A radius or a density is no positive number.
    #[error("the {0} is {1}, but has to be a number above zero")]
    NotPositive(&'static str, f32),
    /// A bar of a wire has no length.
    #[error("points {0} and {1} of the wire are the same: leave one out", index, index + 1)]
    NoLength {
        /// The first of the two.
        index: usize,
    },
    /// A triangle names a vertex that is not there.
    #[error("triangle {triangle} names vertex {vertex}, but there are {vertices}: number vertices from 0")]
    NoVertex {
        /// Place of the triangle in the list.
        triangle: usize,
        /// The vertex that it names.
        vertex: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// The triangles are no closed surface.
    #[error("the edge from vertex {0} to vertex {1} has no triangle on one of its sides, or more than one: close the surface")]
    NotClosed(u32, u32),
    /// The surface is turned inside out.
    #[error("the surface encloses {0} m3: order its triangles counter-clockwise as seen from outside")]
    InsideOut(f64),
    /// Mass or inertia make no body.
    #[error("mass {mass_kg} kg with inertia {inertia:?} kg m2 make no body: both have to be finite and above zero")]
    NoMass {
        /// The mass, kg.
        mass_kg: f32,
        /// The inertia, kg m2.
        inertia: Mat3,
    },
}

/// A body that rapier can collide.
#[derive(Clone)]
pub struct Built {
    pub(crate) shape: SharedShape,
    /// Mass, centre and inertia in the body's frame.
    pub mass: RigidMass,
}

/// Builds a shape of a density (kg/m3); `mass` in place of its own.
///
/// # Errors
/// When the shape encloses nothing, or the mass is none.
pub fn build(shape: &RigidShape, density_kg_m3: f32, mass: Option<&RigidMass>) -> Result<Built, ShapeError> {
    positive("density", density_kg_m3)?;
    let density = f64::from(density_kg_m3);
    let (built, own) = match shape {
        RigidShape::Hull(points) => {
            let (vertices, triangles) = hull(points)?;
            let own = of_inside(&vertices, &triangles, density)?;
            let points = vertices.iter().map(|v| to_rapier(*v)).collect();
            let flat = || thickness(&vertices);
            (SharedShape::convex_mesh(points, &triangles).ok_or_else(flat)?, own)
        }
        RigidShape::Wire { points, radius_m } => {
            positive("radius", *radius_m)?;
            check_points(points, 2)?;
            if let Some(index) = points.windows(2).position(|p| p[0] == p[1]) {
                return Err(ShapeError::NoLength { index });
            }
            let own = Mass::of_bars(&doubles(points), f64::from(*radius_m), density);
            let bar = |p: &[Vec3]| SharedShape::capsule(to_rapier(p[0]), to_rapier(p[1]), length_to_rapier(*radius_m));
            let mut bars: Vec<_> = points.windows(2).map(|p| (Pose::IDENTITY, bar(p))).collect();
            let shape = if bars.len() == 1 { bars.swap_remove(0).1 } else { SharedShape::compound(bars) };
            (shape, own)
        }
        RigidShape::Solid { vertices, triangles } => {
            check_points(vertices, 4)?;
            check_closed(vertices.len(), triangles)?;
            let flat = thickness(vertices);
            if matches!(flat, ShapeError::Flat { thickness_m, length_m } if thickness_m <= FLAT * length_m) {
                return Err(flat);
            }
            let own = of_inside(vertices, triangles, density)?;
            let points: Vec<_> = vertices.iter().map(|v| to_rapier(*v)).collect();
            (SharedShape::convex_decomposition(&points, triangles), own)
        }
    };
    let own = RigidMass { mass_kg: own.mass_kg as f32, centre: own.centre.as_vec3(), inertia_kg_m2: own.inertia.as_mat3() };
    let mass = mass.copied().unwrap_or(own);
    let moments = mass.inertia_kg_m2;
    let fine = mass.mass_kg > 0.0
        && mass.mass_kg.is_finite()
        && mass.centre.is_finite()
        && moments.is_finite()
        && (0..3).all(|i| moments.col(i)[i] > 0.0);
    if !fine {
        return Err(ShapeError::NoMass { mass_kg: mass.mass_kg, inertia: moments });
    }
    Ok(Built { shape: built, mass })
}

impl Built {
    /// What rapier calls it. The inertia is made diagonal in units of its own: that of a clip is 1e-10 kg m2.
    pub(crate) fn properties(&self) -> MassProperties {
        let RigidMass { mass_kg, centre, inertia_kg_m2 } = self.mass;
        let unit = inertia_kg_m2.x_axis.x + inertia_kg_m2.y_axis.y + inertia_kg_m2.z_axis.z;
        let scaled = MassProperties::with_inertia_matrix(to_rapier(centre), 1.0, matrix_to_rapier(inertia_kg_m2 * unit.recip()));
        let frame = scaled.principal_inertia_local_frame;
        let unit = length_to_rapier(length_to_rapier(unit));
        MassProperties::with_principal_inertia_frame(to_rapier(centre), mass_kg, scaled.principal_inertia() * unit, frame)
    }

    /// From the origin of the body's frame to its furthest point, or further, m.
    #[must_use]
    pub fn reach_m(&self) -> f32 {
        let local = self.shape.compute_local_aabb();
        from_rapier(local.mins).abs().max(from_rapier(local.maxs).abs()).length()
    }
}

/// The convex hull of points: its vertices (m) and triangles.
fn hull(points: &[Vec3]) -> Result<(Vec<Vec3>, Vec<[u32; 3]>), ShapeError> {
    check_points(points, 4)?;
    let flat = thickness(points);
    if matches!(flat, ShapeError::Flat { thickness_m, length_m } if thickness_m <= FLAT * length_m) {
        return Err(flat);
    }
    let points: Vec<_> = points.iter().map(|p| to_rapier(*p)).collect();
    let (vertices, triangles) = try_convex_hull(&points).map_err(|_| flat)?;
    Ok((vertices.into_iter().map(from_rapier).collect(), triangles))
}

fn of_inside(vertices: &[Vec3], triangles: &[[u32; 3]], density: f64) -> Result<Mass, ShapeError> {
    let own = Mass::of_inside(&doubles(vertices), triangles, density);
    if own.mass_kg > 0.0 { Ok(own) } else { Err(ShapeError::InsideOut(own.mass_kg / density)) }
}

fn doubles(points: &[Vec3]) -> Vec<bevy_math::DVec3> {
    points.iter().map(|p| p.as_dvec3()).collect()
}

fn positive(what: &'static str, value: f32) -> Result<(), ShapeError> {
    if value > 0.0 && value.is_finite() { Ok(()) } else { Err(ShapeError::NotPositive(what, value)) }
}

fn check_points(points: &[Vec3], needed: usize) -> Result<(), ShapeError> {
    if let Some(broken) = points.iter().position(|p| !p.is_finite()) {
        return Err(ShapeError::NotFinite(broken));
    }
    if points.len() < needed { Err(ShapeError::TooFew { given: points.len(), needed }) } else { Ok(()) }
}

fn check_closed(vertices: usize, triangles: &[[u32; 3]]) -> Result<(), ShapeError> {
    let missing = |t: &[u32; 3]| t.iter().copied().find(|v| *v as usize >= vertices);
    if let Some((triangle, vertex)) = triangles.iter().enumerate().find_map(|(i, t)| missing(t).map(|v| (i, v))) {
        return Err(ShapeError::NoVertex { triangle, vertex, vertices });
    }
    let mut directed: Vec<(u32, u32)> = triangles.iter().flat_map(|[a, b, c]| [(*a, *b), (*b, *c), (*c, *a)]).collect();
    directed.sort_unstable();
    let twice = directed.windows(2).find(|e| e[0] == e[1]).map(|e| e[0]);
    let open = directed.iter().find(|(a, b)| directed.binary_search(&(*b, *a)).is_err());
    match twice.or(open.copied()) {
        Some((a, b)) => Err(ShapeError::NotClosed(a, b)),
        None => Ok(()),
    }
}

/// How thick points are that may be all in a plane: from the longest line among them, and the plane of that and the furthest point from it.
fn thickness(points: &[Vec3]) -> ShapeError {
    let furthest = |measure: &dyn Fn(Vec3) -> f32| {
        points.iter().copied().map(|p| (measure(p), p)).fold((0.0, Vec3::ZERO), |most, p| if p.0 > most.0 { p } else { most })
    };
    let first = points.first().copied().unwrap_or_default();
    let (_, from) = furthest(&|p| p.distance(first));
    let (length_m, to) = furthest(&|p| p.distance(from));
    let along = (to - from).normalize_or_zero();
    let (_, beside) = furthest(&|p| (p - from).reject_from_normalized(along).length());
    let normal = along.cross(beside - from).normalize_or_zero();
    let (thickness_m, _) = furthest(&|p| (p - from).dot(normal).abs());
    ShapeError::Flat { thickness_m, length_m }
}
