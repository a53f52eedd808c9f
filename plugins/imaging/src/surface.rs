//! Triangles of a field's zero, for anatomy that is only drawn: surface nets, then Taubin's smoothing.

use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::FxHashMap;

/// Taubin's factors (G. Taubin, "A Signal Processing Approach to Fair Surface Design", SIGGRAPH 1995): a shrinking and a growing step.
const TAUBIN: [f64; 2] = [0.5, -0.53];

/// A triangle surface, normals outward.
#[derive(Clone, Debug, Default)]
pub struct Surface {
    /// Nodes.
    pub nodes: Vec<DVec3>,
    /// Triangles.
    pub triangles: Vec<[u32; 3]>,
}

impl Surface {
    /// The surface of the region where `field` is negative, on a grid of cells of size `step` over a box, by naive surface nets
    /// (S. Gibson, "Constrained Elastic Surface Nets", MERL TR99-24): one node a cell that the surface passes, in the middle of its edges'
    /// cut points.
    #[must_use]
    pub fn nets(field: &(dyn Fn(DVec3) -> f64 + Sync), min: DVec3, max: DVec3, step: f64) -> Self {
        let n = ((max - min) / step).ceil().to_array().map(|v| v as usize + 2);
        let at = |i: [usize; 3]| min + DVec3::new(i[0] as f64, i[1] as f64, i[2] as f64) * step;
        let of = |i: usize| [i % n[0], i / n[0] % n[1], i / (n[0] * n[1])];
        let values: Vec<f64> = (0..n.iter().product::<usize>()).into_par_iter().map(|i| field(at(of(i)))).collect();
        let stride = [1, n[0], n[0] * n[1]];
        let mut surface = Self::default();
        let mut node_of_cell: FxHashMap<usize, u32> = FxHashMap::default();
        for i in 0..values.len() {
            let cell = of(i);
            if (0..3).any(|a| cell[a] + 1 >= n[a]) {
                continue;
            }
            let corner = |k: usize| i + (k & 1) * stride[0] + (k >> 1 & 1) * stride[1] + (k >> 2) * stride[2];
            let inside = (0..8).filter(|k| values[corner(*k)] < 0.0).count();
            if inside == 0 || inside == 8 {
                continue;
            }
            let (mut sum, mut cuts) = (DVec3::ZERO, 0.0);
            for a in 0..8_usize {
                for axis in 0..3 {
                    let b = a | 1 << axis;
                    let (va, vb) = (values[corner(a)], values[corner(b)]);
                    if b == a || (va < 0.0) == (vb < 0.0) {
                        continue;
                    }
                    sum += at(of(corner(a))).lerp(at(of(corner(b))), va / (va - vb));
                    cuts += 1.0;
                }
            }
            node_of_cell.insert(i, surface.nodes.len() as u32);
            surface.nodes.push(sum / cuts);
        }
        for (i, &v) in values.iter().enumerate() {
            let point = of(i);
            for axis in 0..3 {
                let (u, w) = ((axis + 1) % 3, (axis + 2) % 3);
                if point[axis] + 1 >= n[axis] || point[u] == 0 || point[w] == 0 {
                    continue;
                }
                let other = values[i + stride[axis]];
                if (v < 0.0) == (other < 0.0) {
                    continue;
                }
                // The four cells around the edge, counterclockwise seen from its far end.
                let around = [i - stride[u] - stride[w], i - stride[w], i, i - stride[u]].map(|c| node_of_cell.get(&c).copied());
                let [Some(a), Some(b), Some(c), Some(d)] = around else { continue };
                let quad = if v < 0.0 { [a, b, c, d] } else { [d, c, b, a] };
                surface.quad(quad);
            }
        }
        surface
    }

    /// Two triangles along the shorter diagonal.
    fn quad(&mut self, [a, b, c, d]: [u32; 4]) {
        let p = |n: u32| self.nodes[n as usize];
        if p(a).distance_squared(p(c)) <= p(b).distance_squared(p(d)) {
            self.triangles.extend([[a, b, c], [a, c, d]]);
        } else {
            self.triangles.extend([[a, b, d], [b, c, d]]);
        }
    }

    /// Taubin's smoothing: `rounds` of a shrinking and a growing step with uniform weights.
    pub fn smooth(&mut self, rounds: usize) {
        let mut neighbours: Vec<Vec<u32>> = vec![Vec::new(); self.nodes.len()];
        for [a, b, c] in &self.triangles {
            for (p, q) in [(a, b), (b, c), (c, a)] {
                neighbours[*p as usize].push(*q);
                neighbours[*q as usize].push(*p);
            }
        }
        for list in &mut neighbours {
            list.sort_unstable();
            list.dedup();
        }
        for factor in (0..rounds).flat_map(|_| TAUBIN) {
            let old = std::mem::take(&mut self.nodes);
            self.nodes = old
                .par_iter()
                .zip(&neighbours)
                .map(|(p, list)| {
                    if list.is_empty() {
                        return *p;
                    }
                    let mean = list.iter().map(|n| old[*n as usize]).sum::<DVec3>() / list.len() as f64;
                    *p + (mean - *p) * factor
                })
                .collect();
        }
    }

    /// Normals at the nodes, weighted by the triangles' angles there; unit length.
    #[must_use]
    pub fn normals(&self) -> Vec<DVec3> {
        let mut normals = vec![DVec3::ZERO; self.nodes.len()];
        for t in &self.triangles {
            let p = t.map(|n| self.nodes[n as usize]);
            let normal = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or_zero();
            for k in 0..3 {
                normals[t[k] as usize] += normal * (p[(k + 1) % 3] - p[k]).angle_between(p[(k + 2) % 3] - p[k]);
            }
        }
        normals.iter().map(|n| n.try_normalize().unwrap_or(DVec3::Y)).collect()
    }

    /// Enclosed volume, in the cube of the nodes' unit: positive with normals outward.
    #[must_use]
    pub fn volume(&self) -> f64 {
        self.triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|n| self.nodes[n as usize]);
                a.dot(b.cross(c)) / 6.0
            })
            .sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn a_torus_is_closed_and_has_its_volume() {
        let field = |p: DVec3| ((p.x.hypot(p.y) - 10.0).powi(2) + p.z * p.z).sqrt() - 4.0;
        let mut s = Surface::nets(&field, DVec3::splat(-16.0), DVec3::splat(16.0), 0.7);
        s.smooth(10);
        let want = 2.0 * PI * PI * 10.0 * 16.0;
        assert!((s.volume() / want - 1.0).abs() < 0.02, "{} but {want}", s.volume());
        let mut edges: FxHashMap<(u32, u32), i32> = FxHashMap::default();
        for [a, b, c] in &s.triangles {
            for (p, q) in [(a, b), (b, c), (c, a)] {
                *edges.entry((*p.min(q), *p.max(q))).or_insert(0) += if p < q { 1 } else { -1 };
            }
        }
        assert!(edges.values().all(|n| *n == 0), "every edge is used once in each direction");
        assert_eq!(s.nodes.len() as i64 - edges.len() as i64 + s.triangles.len() as i64, 0, "one handle");
        let outward = s.nodes.iter().zip(s.normals()).all(|(p, n)| {
            let ring = DVec3::new(p.x, p.y, 0.0).normalize() * 10.0;
            n.dot((*p - ring).normalize()) > 0.9
        });
        assert!(outward);
    }
}
