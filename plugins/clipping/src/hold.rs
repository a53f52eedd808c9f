//! What a clip does to its tissue as attachments, what pulls at it, and when it comes off.

use crate::legs::{ACROSS, ALONG, fit, press};
use crate::locate::{is_whole, position};
use crate::settings::ClipSettings;
use bevy_math::{Isometry3d, Vec3};
use keyhole_tetmesh::TetMesh;
use keyhole_whiteboard::{Anchor, Attachment, Clip, ClipShape, JawPads};

/// The time (s) until which attachments of clips last: no other gesture's do. A clip tells its own from it, and holds nothing to its place.
pub const UNTIL_S: f64 = 1e18;

/// Compliance of a piece of the legs, m/N.
#[must_use]
pub fn compliance_m_n(settings: &ClipSettings) -> f32 {
    (ALONG * ACROSS) as f32 / settings.stiffness_n_m
}

/// A tick of `dt_s` of a clip on tissue at these positions (m, by node slot): its legs press, and its frame follows. Pieces whose tissue is no longer there
/// or no longer in one piece are lost.
pub fn close(clip: &mut Clip, shape: &ClipShape, mesh: &TetMesh, positions: &[Vec3], dt_s: f32, settings: &ClipSettings) {
    let compliance = compliance_m_n(settings);
    let mut places = Vec::with_capacity(clip.pairs.len());
    clip.pairs.retain_mut(|pair| {
        let whole = is_whole(mesh, &pair.upper) && is_whole(mesh, &pair.lower);
        let Some((upper, lower)) = position(&pair.upper, positions).zip(position(&pair.lower, positions)).filter(|_| whole) else {
            return false;
        };
        (pair.apart_m, pair.pinch_n) = press(pair.apart_m, upper.distance(lower), settings.closing_m_s * dt_s, shape, compliance);
        places.push((pair.along_m, pair.across_m, upper, lower));
        true
    });
    if !places.is_empty() {
        clip.pose = fit(&places, &clip.pose);
    }
}

/// The attachments that do what a clip does: each wall is tied to the other, and where an instrument has hold of the clip (its frame at `held`) to that.
#[must_use]
pub fn attachments(clip: &Clip, positions: &[Vec3], held: Option<&Isometry3d>, settings: &ClipSettings) -> Vec<Attachment> {
    let compliance_m_n = compliance_m_n(settings);
    let mut list = Vec::with_capacity(clip.pairs.len() * 3);
    for pair in &clip.pairs {
        let Some((upper, lower)) = position(&pair.upper, positions).zip(position(&pair.lower, positions)) else { continue };
        // Along the line between the two: what it does to both has no moment.
        let up = (upper - lower).try_normalize().unwrap_or(clip.pose.rotation * Vec3::Y);
        let tie = Attachment::tie(&pair.upper, &pair.lower, up * pair.apart_m, compliance_m_n);
        list.extend(tie.map(|t| Attachment { until_s: UNTIL_S, ..t }));
        let Some(frame) = held else { continue };
        for (point, place) in [&pair.upper, &pair.lower].into_iter().zip(places(pair.along_m, pair.across_m, pair.apart_m)) {
            let anchor = Anchor::Space(frame.transform_point(place).into());
            // Two of them hold what one tie does.
            list.push(Attachment { point: point.clone(), anchor, compliance_m_n: 2.0 * compliance_m_n, until_s: UNTIL_S });
        }
    }
    list
}

/// The upper and the lower point of a piece in the clip's frame, m.
fn places(along_m: f32, across_m: f32, apart_m: f32) -> [Vec3; 2] {
    [0.5, -0.5].map(|side| Vec3::new(across_m, side * apart_m, -along_m))
}

/// Force with which what holds a clip at a frame pulls it and its tissue, N.
#[must_use]
pub fn pull_n(clip: &Clip, positions: &[Vec3], held: &Isometry3d, settings: &ClipSettings) -> Vec3 {
    let compliance = 2.0 * compliance_m_n(settings);
    let of_piece = |pair: &keyhole_whiteboard::ClipPair| {
        let points = [&pair.upper, &pair.lower].into_iter().zip(places(pair.along_m, pair.across_m, pair.apart_m));
        points.filter_map(|(p, place)| Some(Vec3::from(held.transform_point(place)) - position(p, positions)?)).sum::<Vec3>()
    };
    clip.pairs.iter().map(of_piece).sum::<Vec3>() / compliance
}

/// The most that a clip can be pulled with, N: both legs hold by Coulomb's law what they press on.
#[must_use]
pub fn most_pull_n(clip: &Clip, shape: &ClipShape) -> f32 {
    2.0 * shape.friction * clip.pinch_n()
}

/// Whether a clip is between the jaws of an instrument: the clip's frame is at `local` in that of the instrument, whose jaws are `angle_rad` off the axis.
#[must_use]
pub fn is_between(pads: &JawPads, angle_rad: f32, local: &Isometry3d, shape: &ClipShape) -> bool {
    [0.0, 0.25, 0.5, 0.75, 1.0].into_iter().any(|part| {
        let p = local.transform_point(Vec3::NEG_Z * (part * shape.leg_m));
        let room = -p.z * angle_rad.sin() + pads.closed_gap_m + shape.wire_m;
        (pads.from_m..=pads.to_m).contains(&-p.z) && p.x.abs() <= pads.half_width_m + shape.wire_m && p.y.abs() <= room
    })
}
