//! The legs of a clip: what is between them when they close, how they press, and where the clip is.

use crate::locate::{rest, weights};
use bevy_math::{DVec3, Isometry3d, Mat3, Quat, Vec3};
use keyhole_tetmesh::{FACES, TetId, TetMesh};
use keyhole_whiteboard::{ClipApplier, ClipPair, ClipShape, RigidShape, TissuePoint};

/// Pieces along a leg.
pub const ALONG: usize = 12;
/// Pieces across a leg.
pub const ACROSS: usize = 2;

/// Part of the way through its tetrahedron by which a point of a wall is inside of it.
const INSET: f64 = 0.02;

/// The middles of the pieces of a leg: along it from the crown, and across, m.
pub fn pieces(shape: &ClipShape) -> impl Iterator<Item = (f32, f32)> {
    let shape = *shape;
    (0..ALONG * ACROSS).map(move |i| {
        let middle = |at: usize, count: usize| (at as f32 + 0.5) / count as f32;
        (middle(i / ACROSS, ALONG) * shape.leg_m, (middle(i % ACROSS, ACROSS) - 0.5) * shape.wire_m)
    })
}

/// What the jaws of an applier close a clip on: for each piece of its legs that has tissue between the jaws, the outermost two points of it. The frame of
/// the instrument is at `pose`, the jaws were open by `open_rad`, the tissue is at `positions` (m, by node slot). Where tissue reaches beyond the jaws the
/// legs do not get around it, and nothing is caught.
#[must_use]
pub fn catch(mesh: &TetMesh, positions: &[Vec3], pose: &Isometry3d, applier: &ClipApplier, open_rad: f32) -> Vec<ClipPair> {
    let up = (pose.rotation * Vec3::Y).as_dvec3();
    let columns: Vec<(f32, f32, DVec3, f64)> = pieces(&applier.shape)
        .map(|(along, across)| {
            let from_pivot = applier.crown_m + along;
            let from = Vec3::from(pose.transform_point(Vec3::new(across, 0.0, -from_pivot))).as_dvec3();
            (along, across, from, f64::from(from_pivot * open_rad.sin()))
        })
        .collect();
    let (low, high) = columns.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), (_, _, from, half)| {
        let ends = [*from - up * *half, *from + up * *half];
        (low.min(ends[0]).min(ends[1]), high.max(ends[0]).max(ends[1]))
    });
    // By column: where the line enters the first tetrahedron and leaves the last, and which they are.
    let mut spans: Vec<Option<[(f64, f64, TetId); 2]>> = vec![None; columns.len()];
    for (tet, nodes) in mesh.iter() {
        let at = nodes.map(|n| positions[n.index()].as_dvec3());
        let (least, most) = at.iter().fold((at[0], at[0]), |(l, h), c| (l.min(*c), h.max(*c)));
        if least.cmpgt(high).any() || most.cmplt(low).any() {
            continue;
        }
        for ((_, _, from, _), span) in columns.iter().zip(&mut spans) {
            let Some((enters, leaves)) = crossing(at, *from, up) else { continue };
            let this = (enters, leaves, tet);
            *span = Some(span.map_or([this; 2], |[first, last]| {
                [if this.0 < first.0 { this } else { first }, if this.1 > last.1 { this } else { last }]
            }));
        }
    }
    let pairs = columns.iter().zip(spans).filter_map(|((along, across, from, half), span)| {
        let [first, last] = span?;
        if first.0 <= -*half || last.1 >= *half {
            return None;
        }
        let point = |(enters, leaves, tet): (f64, f64, TetId), part: f64| -> Option<(TissuePoint, DVec3)> {
            let nodes = mesh.corners(tet);
            let x = *from + up * (enters + part * (leaves - enters));
            let found = weights(nodes.map(|n| positions[n.index()].as_dvec3()), x)?;
            Some((nodes.into_iter().zip(found.map(|w| w as f32)).collect(), x))
        };
        let ((lower, below), (upper, above)) = (point(first, INSET)?, point(last, 1.0 - INSET)?);
        let rest = [rest(mesh, &upper), rest(mesh, &lower)];
        let apart_m = above.distance(below) as f32;
        Some(ClipPair { upper, lower, rest, along_m: *along, across_m: *across, apart_m, pinch_n: 0.0 })
    });
    pairs.collect()
}

/// Where a line enters and leaves a tetrahedron, in units of its direction.
fn crossing(corners: [DVec3; 4], from: DVec3, way: DVec3) -> Option<(f64, f64)> {
    let (mut enters, mut leaves) = (f64::NEG_INFINITY, f64::INFINITY);
    for [i, j, k] in FACES {
        let normal = (corners[j] - corners[i]).cross(corners[k] - corners[i]);
        let (speed, behind) = (normal.dot(way), normal.dot(corners[i] - from));
        if speed > 0.0 {
            leaves = leaves.min(behind / speed);
        } else if speed < 0.0 {
            enters = enters.max(behind / speed);
        } else if behind < 0.0 {
            return None;
        }
    }
    (enters < leaves).then_some((enters, leaves))
}

/// How far apart legs hold two points that are `distance_m` apart, after a tick in which they may close by `closes_m`: no nearer than the closed
/// gap, and no nearer than where each piece presses with the most that its part of the legs bears. The second is the force with which it presses, N.
#[must_use]
pub fn press(apart_m: f32, distance_m: f32, closes_m: f32, shape: &ClipShape, compliance_m_n: f32) -> (f32, f32) {
    let most = shape.most_pinch_n / (ALONG * ACROSS) as f32;
    let gives = distance_m - most * compliance_m_n;
    let apart = (apart_m - closes_m).max(shape.gap_m).max(gives);
    (apart, ((distance_m - apart) / compliance_m_n).max(0.0))
}

/// Where a clip is whose pieces hold points at these places: the frame that fits them. `before` stands where a direction cannot be told.
#[must_use]
pub fn fit(pieces: &[(f32, f32, Vec3, Vec3)], before: &Isometry3d) -> Isometry3d {
    let count = pieces.len().max(1) as f32;
    let middle = |p: &(f32, f32, Vec3, Vec3)| (p.2 + p.3) / 2.0;
    let centre: Vec3 = pieces.iter().map(middle).sum::<Vec3>() / count;
    let along: f32 = pieces.iter().map(|p| p.0).sum::<f32>() / count;
    let across: f32 = pieces.iter().map(|p| p.1).sum::<f32>() / count;
    let up = pieces.iter().map(|p| p.2 - p.3).sum::<Vec3>().try_normalize().unwrap_or(before.rotation * Vec3::Y);
    let out: Vec3 = pieces.iter().map(|p| (middle(p) - centre) * (p.0 - along)).sum();
    let back = |v: Vec3| (-v).reject_from_normalized(up).try_normalize();
    let z = back(out).or_else(|| back(before.rotation * Vec3::NEG_Z)).unwrap_or_else(|| up.any_orthonormal_vector());
    let rotation = Quat::from_mat3(&Mat3::from_cols(up.cross(z), up, z));
    Isometry3d::new(centre - rotation * Vec3::new(across, 0.0, -along), rotation)
}

/// The closed clip as a body of its own.
#[must_use]
pub fn body(shape: &ClipShape) -> RigidShape {
    let half = (shape.gap_m + shape.wire_m) / 2.0;
    let points = vec![
        Vec3::new(0.0, half, -shape.leg_m),
        Vec3::new(0.0, half, 0.0),
        Vec3::new(0.0, -half, 0.0),
        Vec3::new(0.0, -half, -shape.leg_m),
    ];
    RigidShape::Wire { points, radius_m: shape.wire_m / 2.0 }
}
