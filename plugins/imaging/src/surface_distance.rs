//! How far the surface of a mesh is from the surface of the mask, both ways.

use crate::volume::Body;
use glam::DVec3;
use rayon::prelude::*;

/// Distances from samples of one surface to the other, mm.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Distances {
    /// Mean.
    pub mean_mm: f64,
    /// 95th percentile.
    pub p95_mm: f64,
    /// Largest.
    pub max_mm: f64,
}

impl Distances {
    /// Of distances in ascending order, mm; zero when there are none.
    pub(crate) fn of(sorted: &[f64]) -> Self {
        let n = sorted.len();
        if n == 0 {
            return Self::default();
        }
        Self { mean_mm: sorted.iter().sum::<f64>() / n as f64, p95_mm: sorted[(n - 1) * 95 / 100], max_mm: sorted[n - 1] }
    }
}

/// The distances both ways. A cleft of the mask that is too narrow for the mesh shows in `mask_to_mesh` alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct SurfaceDistance {
    /// Mean of the two means, the larger of the 95th percentiles, the larger of the maxima (the Hausdorff distance of the samples).
    pub both: Distances,
    /// From the mesh's surface to the mask's.
    pub mesh_to_mask: Distances,
    /// From the mask's surface to the mesh's.
    pub mask_to_mesh: Distances,
}

/// Distance between a triangle surface, given in the body's grid coordinates (mm), and the voxel faces of the body's mask. Samples are
/// the nodes and centroids of the triangles and the centres of the voxel faces; the distances are exact.
#[must_use]
pub fn between(body: &Body, nodes: &[DVec3], triangles: &[[u32; 3]]) -> SurfaceDistance {
    let corners: Vec<[DVec3; 3]> = triangles.iter().map(|t| t.map(|n| nodes[n as usize])).collect();
    let faces = mask_faces(body);
    if corners.is_empty() || faces.is_empty() {
        return SurfaceDistance::default();
    }
    let edge = corners.iter().map(|[a, b, _]| a.distance(*b)).sum::<f64>() / corners.len() as f64;
    let cell = edge.max(body.spacing.max_element());
    let mut samples: Vec<u32> = triangles.iter().flatten().copied().collect();
    samples.sort_unstable();
    samples.dedup();
    let mut samples: Vec<DVec3> = samples.into_iter().map(|n| nodes[n as usize]).collect();
    samples.extend(corners.iter().map(|[a, b, c]| (*a + *b + *c) / 3.0));

    let of_triangle = |i: usize, p: DVec3| p.distance_squared(nearest_on_triangle(p, corners[i]));
    let of_face = |i: usize, p: DVec3| (p - p.clamp(faces[i].0, faces[i].1)).length_squared();
    let triangle_boxes: Vec<_> = corners.iter().map(|[a, b, c]| (a.min(*b).min(*c), a.max(*b).max(*c))).collect();
    let to_mesh = Buckets::new(&triangle_boxes, cell);
    let to_mask = Buckets::new(&faces, cell);
    let forth: Vec<f64> = samples.par_iter().map(|p| to_mask.nearest(*p, |i| of_face(i, *p))).collect();
    let back: Vec<f64> = faces.par_iter().map(|f| (f.0 + f.1) / 2.0).map(|p| to_mesh.nearest(p, |i| of_triangle(i, p))).collect();
    let [mesh_to_mask, mask_to_mesh] = [forth, back].map(|mut d| {
        d.sort_unstable_by(f64::total_cmp);
        Distances::of(&d)
    });
    let both = Distances {
        mean_mm: (mesh_to_mask.mean_mm + mask_to_mesh.mean_mm) / 2.0,
        p95_mm: mesh_to_mask.p95_mm.max(mask_to_mesh.p95_mm),
        max_mm: mesh_to_mask.max_mm.max(mask_to_mesh.max_mm),
    };
    SurfaceDistance { both, mesh_to_mask, mask_to_mesh }
}

/// The faces between a voxel with a part and one without, as flat boxes in grid coordinates, mm.
fn mask_faces(body: &Body) -> Vec<(DVec3, DVec3)> {
    let [nx, ny, nz] = body.dims;
    let step = [1, nx, nx * ny];
    let mut faces = Vec::new();
    for (i, _) in body.parts.iter().enumerate().filter(|(_, v)| **v != 0) {
        let index = [i % nx, i / nx % ny, i / (nx * ny)];
        let centre = body.centre(i);
        for axis in 0..3 {
            for (side, inner) in [(-0.5, index[axis] > 0), (0.5, index[axis] + 1 < [nx, ny, nz][axis])] {
                let other = if side < 0.0 { i.wrapping_sub(step[axis]) } else { i + step[axis] };
                if !inner || body.parts[other] == 0 {
                    let mut low = centre - body.spacing / 2.0;
                    let mut high = centre + body.spacing / 2.0;
                    low[axis] = centre[axis] + side * body.spacing[axis];
                    high[axis] = low[axis];
                    faces.push((low, high));
                }
            }
        }
    }
    faces
}

/// Boxes sorted into the cells of a grid that they touch.
struct Buckets {
    origin: DVec3,
    cell: f64,
    dims: [i64; 3],
    first: Vec<u32>,
    items: Vec<u32>,
}

impl Buckets {
    fn new(boxes: &[(DVec3, DVec3)], cell: f64) -> Self {
        let min = boxes.iter().map(|b| b.0).fold(DVec3::INFINITY, DVec3::min);
        let max = boxes.iter().map(|b| b.1).fold(DVec3::NEG_INFINITY, DVec3::max);
        let dims = ((max - min) / cell).floor().to_array().map(|n| n as i64 + 1);
        let mut grid = Self { origin: min, cell, dims, first: vec![0; dims.iter().product::<i64>() as usize + 1], items: Vec::new() };
        for b in boxes {
            grid.visit(b, |grid, c| grid.first[c + 1] += 1);
        }
        for i in 1..grid.first.len() {
            grid.first[i] += grid.first[i - 1];
        }
        grid.items = vec![0; grid.first[grid.first.len() - 1] as usize];
        let mut at = grid.first.clone();
        for (i, b) in boxes.iter().enumerate() {
            grid.visit(b, |grid, c| {
                grid.items[at[c] as usize] = i as u32;
                at[c] += 1;
            });
        }
        grid
    }

    fn cell_of(&self, p: DVec3) -> [i64; 3] {
        let q = ((p - self.origin) / self.cell).floor();
        std::array::from_fn(|a| (q[a] as i64).clamp(0, self.dims[a] - 1))
    }

    fn visit(&mut self, b: &(DVec3, DVec3), mut f: impl FnMut(&mut Self, usize)) {
        let (low, high) = (self.cell_of(b.0), self.cell_of(b.1));
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    let c = (x + self.dims[0] * (y + self.dims[1] * z)) as usize;
                    f(self, c);
                }
            }
        }
    }

    /// The smallest distance of any item, given squared distances: shells of cells around `p` until no nearer one is possible.
    fn nearest(&self, p: DVec3, squared: impl Fn(usize) -> f64) -> f64 {
        let centre = self.cell_of(p);
        // Outside the grid the nearest cell is further away than the shells say.
        let local = (p - self.origin).clamp(DVec3::ZERO, DVec3::from_array(self.dims.map(|d| d as f64)) * self.cell);
        let away = (p - self.origin - local).length();
        let mut best = f64::INFINITY;
        let last = self.dims.iter().max().copied().unwrap_or(1);
        for ring in 0..=last {
            if away.max((ring - 1) as f64 * self.cell).powi(2) > best {
                break;
            }
            for z in (centre[2] - ring).max(0)..=(centre[2] + ring).min(self.dims[2] - 1) {
                for y in (centre[1] - ring).max(0)..=(centre[1] + ring).min(self.dims[1] - 1) {
                    let whole = (z - centre[2]).abs() == ring || (y - centre[1]).abs() == ring;
                    let stride = if whole || ring == 0 { 1 } else { 2 * ring };
                    let mut x = centre[0] - ring;
                    while x <= centre[0] + ring {
                        if (0..self.dims[0]).contains(&x) {
                            let c = (x + self.dims[0] * (y + self.dims[1] * z)) as usize;
                            for i in &self.items[self.first[c] as usize..self.first[c + 1] as usize] {
                                best = best.min(squared(*i as usize));
                            }
                        }
                        x += stride;
                    }
                }
            }
        }
        best.sqrt()
    }
}

/// The point of a triangle nearest to `p` (C. Ericson, "Real-Time Collision Detection", 5.1.5).
#[must_use]
pub fn nearest_on_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    a + ab * (vb / sum) + ac * (vc / sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DAffine3;

    #[test]
    fn the_faces_of_a_cube_are_where_they_are() {
        // A cube of 4 x 4 x 4 voxels of 1 x 1 x 2 mm, its own box as triangles is at distance zero, the same
        // box a millimetre wider in x is one millimetre away there and nowhere further.
        let dims = [8, 8, 8];
        let parts = (0..512).map(|i| u8::from([i % 8, i / 8 % 8, i / 64].iter().all(|c| (2..6).contains(c)))).collect();
        let body = Body { dims, spacing: DVec3::new(1.0, 1.0, 2.0), parts, grid_to_lps: DAffine3::IDENTITY };
        let surface = |wider: f64| {
            let nodes: Vec<DVec3> = (0..8)
                .map(|i| {
                    DVec3::new(
                        1.5 - wider + f64::from(i & 1) * (4.0 + 2.0 * wider),
                        1.5 + f64::from(i >> 1 & 1) * 4.0,
                        3.0 + f64::from(i >> 2) * 8.0,
                    )
                })
                .collect();
            let quads = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
            let triangles: Vec<[u32; 3]> = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
            between(&body, &nodes, &triangles).both
        };
        assert!(surface(0.0).max_mm < 1e-12);
        let off = surface(1.0);
        assert!((off.max_mm - 1.0).abs() < 1e-12 && off.mean_mm < 0.8 && off.p95_mm > 0.9, "{off:?}");
    }
}
