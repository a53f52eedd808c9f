//! A part of an instrument whose middle is inside tissue. The triangles of the surface no longer tell where it came from: those that it has passed
//! look away from it. All of the part goes out one way, the one of 26 in its own frame on which the last of it is out soonest, and the tissue around
//! its middle is pushed the other way.

use crate::detect::Hit;
use crate::tool::{Motion, ToolPart};
use crate::walk::Deformed;
use bevy_math::Vec3;

/// A way out is kept from tick to tick until another one is shorter by so much: this part of it.
const KEPT: f32 = 0.75;

/// A point of tissue in the middle of a part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sunk {
    /// Where it is: the tetrahedron, and the weights of its corners.
    pub hit: Hit,
    /// Unit vector, the way that the tissue goes.
    pub normal: Vec3,
    /// How far, m.
    pub depth_m: f32,
    /// The point itself, m.
    pub at: Vec3,
    /// Velocity of the part there, m/s.
    pub velocity_m_s: Vec3,
}

/// The 26 ways in the frame of a part: to the faces, edges and corners of a cube.
fn ways() -> impl Iterator<Item = Vec3> {
    let all = (0..27).map(|i| Vec3::new((i % 3) as f32 - 1.0, (i / 3 % 3) as f32 - 1.0, (i / 9) as f32 - 1.0));
    all.filter_map(Vec3::try_normalize)
}

/// What a part pushes whose points `hits` (their nodes count along [`ToolPart::spine`], as the part is when the tick begins) are inside `tissue`. `last` is the way out,
/// in the part's frame, of the tick before; it is left at the one of this tick.
pub fn push_out(part: &ToolPart, motion: &Motion, tissue: Deformed, hits: &[Hit], last: &mut Option<Vec3>) -> Vec<Sunk> {
    // A point may be in several tetrahedra where tissue lies in itself; the first counts.
    let inside: Vec<(Vec3, Hit)> = hits
        .chunk_by(|a, b| a.node == b.node)
        .filter_map(|same| part.spine().get(same[0].node.index()).map(|local| (motion.from * *local, same[0])))
        .collect();
    let finite = tissue.positions.iter().filter(|p| p.is_finite());
    let (low, high) = finite.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(*p), high.max(*p)));
    let reach_m = low.distance(high);
    let length = |(at, hit): &(Vec3, Hit), way: Vec3| tissue.exit(hit.tet, *at, *at + way * reach_m).map(|exit| exit.part * reach_m);
    let longest = |local: Vec3| {
        let way = motion.from.rotation * local;
        inside.iter().filter_map(|point| length(point, way)).max_by(f32::total_cmp).map(|length| (length, local))
    };
    let best = ways().filter_map(longest).min_by(|a, b| a.0.total_cmp(&b.0));
    let kept = last.and_then(longest);
    let chosen = match (kept, best) {
        (Some(kept), Some(best)) if best.0 >= KEPT * kept.0 => Some(kept),
        _ => best,
    };
    *last = chosen.map(|(_, local)| local);
    let Some((_, local)) = chosen else { return Vec::new() };
    let way = motion.from.rotation * local;
    let sunk = |point: &(Vec3, Hit)| {
        let (at, hit) = *point;
        let depth_m = length(point, way)? + part.radius_m();
        Some(Sunk { hit, normal: -way, depth_m, at, velocity_m_s: motion.velocity_of(at) })
    };
    inside.iter().filter_map(sunk).collect()
}
