//! Surfaces of tools: lofts of rings along an axis and bent tubes, flat-shaded and closed.

use bevy_math::Vec3;
use keyhole_whiteboard::PartMesh;

/// Corners around a ring.
const SIDES: usize = 20;

/// A cross section of a loft.
#[derive(Clone, Copy)]
pub(crate) struct Ring {
    /// Place along Z, m.
    pub z: f32,
    /// Half width, m.
    pub half_x: f32,
    /// Half height, m.
    pub half_y: f32,
    /// Shift of its middle, m.
    pub offset: Vec3,
}

/// The outline of a loft's cross sections.
#[derive(Clone, Copy)]
pub(crate) enum Profile {
    /// An ellipse.
    Round,
    /// A rectangle with rounded corners (a superellipse of degree 6).
    Slab,
}

impl Profile {
    /// The point of the unit outline at corner `k`, counter-clockwise seen from +Z.
    fn corner(self, k: usize) -> (f32, f32) {
        let (sin, cos) = (std::f32::consts::TAU * k as f32 / SIDES as f32).sin_cos();
        match self {
            Self::Round => (cos, sin),
            Self::Slab => {
                let radius = (cos.abs().powi(6) + sin.abs().powi(6)).powf(-1.0 / 6.0);
                (radius * cos, radius * sin)
            }
        }
    }

    /// The closed surface through the rings, in order of Z either way, with flat ends.
    pub(crate) fn loft(self, rings: &[Ring]) -> PartMesh {
        let mut rings = rings.to_vec();
        rings.sort_by(|a, b| a.z.total_cmp(&b.z));
        let loops: Vec<Vec<Vec3>> = rings
            .iter()
            .map(|ring| {
                let at = |(x, y): (f32, f32)| ring.offset + Vec3::new(x * ring.half_x, y * ring.half_y, ring.z);
                (0..SIDES).map(|k| at(self.corner(k))).collect()
            })
            .collect();
        skin(&loops)
    }
}

/// A round closed tube along a path of at least two points.
pub(crate) fn tube(path: &[Vec3], radius: f32) -> PartMesh {
    let n = path.len();
    let loops: Vec<Vec<Vec3>> = (0..n)
        .map(|i| {
            let along = (path[(i + 1).min(n - 1)] - path[i.saturating_sub(1)]).normalize_or(Vec3::Z);
            // Paths here lie in a plane x = const, so X is always across.
            let (x, y) = (Vec3::X, along.cross(Vec3::X).normalize_or(Vec3::Y));
            let shrink = if i + 1 == n { 0.5 } else { 1.0 };
            let corner = |k: usize| Profile::Round.corner(k);
            (0..SIDES).map(|k| path[i] + shrink * radius * (corner(k).0 * x + corner(k).1 * y)).collect()
        })
        .collect();
    skin(&loops)
}

/// Adds one surface to another.
pub(crate) fn append(to: &mut PartMesh, from: &PartMesh) {
    let base = to.vertices.len() as u32;
    to.vertices.extend_from_slice(&from.vertices);
    to.normals.extend_from_slice(&from.normals);
    to.indices.extend(from.indices.iter().map(|i| base + i));
}

/// Skins loops that are counter-clockwise about the direction from the first to the last; both ends are closed by fans. Normals are smooth
/// around a loop and sharp along it, as on a turned part.
fn skin(loops: &[Vec<Vec3>]) -> PartMesh {
    let mut mesh = PartMesh::default();
    for pair in loops.windows(2) {
        let (low, high) = (&pair[0], &pair[1]);
        let base = mesh.vertices.len() as u32;
        for k in 0..SIDES {
            let (next, last) = ((k + 1) % SIDES, (k + SIDES - 1) % SIDES);
            let around = (low[next] - low[last]) + (high[next] - high[last]);
            let normal = around.cross(high[k] - low[k]).normalize_or(Vec3::Z);
            for p in [low[k], high[k]] {
                mesh.vertices.push(p.to_array());
                mesh.normals.push(normal.to_array());
            }
        }
        for k in 0..SIDES as u32 {
            let next = (k + 1) % SIDES as u32;
            let [a, b, c, d] = [base + 2 * k, base + 2 * next, base + 2 * next + 1, base + 2 * k + 1];
            mesh.indices.extend([a, b, c, a, c, d]);
        }
    }
    if let (Some(first), Some(last)) = (loops.first(), loops.last()) {
        cap(&mut mesh, first.iter().rev().copied());
        cap(&mut mesh, last.iter().copied());
    }
    mesh
}

fn cap(mesh: &mut PartMesh, outline: impl Iterator<Item = Vec3>) {
    let points: Vec<Vec3> = outline.collect();
    let normal = (0..SIDES).map(|k| points[k].cross(points[(k + 1) % SIDES])).sum::<Vec3>().normalize_or(Vec3::Z);
    let base = mesh.vertices.len() as u32;
    for p in &points {
        mesh.vertices.push(p.to_array());
        mesh.normals.push(normal.to_array());
    }
    for k in 1..SIDES as u32 - 1 {
        mesh.indices.extend([base, base + k, base + k + 1]);
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn corner(mesh: &PartMesh, i: u32) -> Vec3 {
        Vec3::from_array(mesh.vertices[i as usize])
    }

    /// Six times the volume inside, by the divergence theorem.
    pub(crate) fn signed_volume(mesh: &PartMesh) -> f32 {
        mesh.indices.chunks_exact(3).map(|t| corner(mesh, t[0]).dot(corner(mesh, t[1]).cross(corner(mesh, t[2])))).sum()
    }

    /// Every edge, by its ends' places, is used as often one way as the other.
    pub(crate) fn assert_closed(name: &str, mesh: &PartMesh) {
        let bits = |i: u32| mesh.vertices[i as usize].map(f32::to_bits);
        let mut edges: BTreeMap<_, i32> = BTreeMap::new();
        for t in mesh.indices.chunks_exact(3) {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                let (a, b) = (bits(a), bits(b));
                *edges.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
            }
        }
        assert!(edges.values().all(|n| *n == 0), "{name} is open");
    }

    pub(crate) fn assert_normals_point_out(name: &str, mesh: &PartMesh) {
        for t in mesh.indices.chunks_exact(3) {
            let [a, b, c] = [t[0], t[1], t[2]].map(|i| corner(mesh, i));
            let face = (b - a).cross(c - a);
            for i in t {
                let normal = Vec3::from_array(mesh.normals[*i as usize]);
                assert!((normal.length() - 1.0).abs() < 1e-3, "{name}");
                assert!(normal.dot(face) >= 0.0, "{name}: normal {normal} of {face}");
            }
        }
    }

    #[test]
    fn a_round_loft_has_the_volume_of_its_prism() {
        let ring = |z: f32| Ring { z, half_x: 2.0, half_y: 2.0, offset: Vec3::ZERO };
        let mesh = Profile::Round.loft(&[ring(0.0), ring(3.0)]);
        let polygon = 0.5 * SIDES as f32 * 4.0 * (std::f32::consts::TAU / SIDES as f32).sin();
        assert!((signed_volume(&mesh) / 6.0 - 3.0 * polygon).abs() < 1e-3);
        assert_closed("prism", &mesh);
    }
}
