//! Fewer triangles for a surface that is only drawn: edges collapse in the order of the quadric error.
//!
//! M. Garland, P. Heckbert, "Surface Simplification Using Quadric Error Metrics", SIGGRAPH 1997, with the middle of the edge, the best
//! point straight above or below it, or one of its ends as the new place, the link condition and a check against turned triangles.

use crate::surface::Surface;
use glam::{DMat3, DVec3};
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Cosine of the largest turn of a triangle's normal in one collapse.
const MAX_TURN: f64 = 0.3;

/// Sum of squared distances to planes: `x.A x + 2 b.x + c`, and the area they stand for.
#[derive(Clone, Copy, Debug)]
struct Quadric {
    a: DMat3,
    b: DVec3,
    c: f64,
    area: f64,
}

impl Quadric {
    const ZERO: Self = Self { a: DMat3::ZERO, b: DVec3::ZERO, c: 0.0, area: 0.0 };

    fn of_triangle([p, q, r]: [DVec3; 3]) -> Self {
        let cross = (q - p).cross(r - p);
        let area = cross.length() / 2.0;
        let n = cross.normalize_or_zero();
        let d = -n.dot(p);
        Self { a: DMat3::from_cols(n * n.x, n * n.y, n * n.z) * area, b: n * d * area, c: d * d * area, area }
    }

    fn add(&mut self, o: &Self) {
        self.a += o.a;
        self.b += o.b;
        self.c += o.c;
        self.area += o.area;
    }

    /// Mean squared distance.
    fn error(&self, x: DVec3) -> f64 {
        ((x.dot(self.a * x) + 2.0 * self.b.dot(x) + self.c) / self.area.max(f64::MIN_POSITIVE)).max(0.0)
    }
}

/// A collapse that is possible as long as both ends still have these versions.
struct Candidate {
    error: f64,
    ends: [u32; 2],
    versions: [u32; 2],
    to: DVec3,
}

impl PartialEq for Candidate {
    fn eq(&self, o: &Self) -> bool {
        self.cmp(o) == Ordering::Equal
    }
}
impl Eq for Candidate {}
impl PartialOrd for Candidate {
    fn partial_cmp(&self, o: &Self) -> Option<Ordering> {
        Some(self.cmp(o))
    }
}
impl Ord for Candidate {
    /// The smallest error is the greatest: the heap gives it first. Ends break ties.
    fn cmp(&self, o: &Self) -> Ordering {
        o.error.total_cmp(&self.error).then_with(|| o.ends.cmp(&self.ends)).then_with(|| o.versions.cmp(&self.versions))
    }
}

struct Work {
    nodes: Vec<DVec3>,
    triangles: Vec<Option<[u32; 3]>>,
    around: Vec<Vec<u32>>,
    quadrics: Vec<Quadric>,
    versions: Vec<u32>,
    heap: BinaryHeap<Candidate>,
}

/// Collapses edges while the root of the mean squared distance to the original planes stays below `tolerance`, in the nodes' unit.
#[must_use]
pub fn decimate(surface: Surface, tolerance: f64) -> Surface {
    let count = surface.nodes.len();
    let mut work = Work {
        around: vec![Vec::new(); count],
        quadrics: vec![Quadric::ZERO; count],
        versions: vec![0; count],
        heap: BinaryHeap::new(),
        triangles: surface.triangles.iter().copied().map(Some).collect(),
        nodes: surface.nodes,
    };
    for (i, t) in surface.triangles.iter().enumerate() {
        let q = Quadric::of_triangle(t.map(|n| work.nodes[n as usize]));
        for n in t {
            work.around[*n as usize].push(i as u32);
            work.quadrics[*n as usize].add(&q);
        }
    }
    for t in &surface.triangles {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            if a < b {
                work.offer(a, b);
            }
        }
    }
    while let Some(best) = work.heap.pop() {
        if best.error.sqrt() > tolerance {
            break;
        }
        let [a, b] = best.ends;
        if best.versions == [work.versions[a as usize], work.versions[b as usize]] && work.allowed(a, b, best.to) {
            work.collapse(a, b, best.to);
        }
    }
    work.finish()
}

impl Work {
    fn offer(&mut self, a: u32, b: u32) {
        let mut q = self.quadrics[a as usize];
        q.add(&self.quadrics[b as usize]);
        let (p, r) = (self.nodes[a as usize], self.nodes[b as usize]);
        // Chords lie inside a curved surface: a step down the gradient brings the middle of the edge back out.
        let middle = (p + r) / 2.0;
        let gradient = q.a * middle + q.b;
        let curvature = gradient.dot(q.a * gradient);
        let down = if curvature > 0.0 { middle - gradient * (gradient.length_squared() / curvature) } else { middle };
        let places = [middle, p, r, if down.distance(middle) < p.distance(r) { down } else { middle }];
        let to = places.into_iter().min_by(|x, y| q.error(*x).total_cmp(&q.error(*y))).unwrap_or(p);
        let versions = [self.versions[a as usize], self.versions[b as usize]];
        self.heap.push(Candidate { error: q.error(to), ends: [a, b], versions, to });
    }

    fn neighbours(&self, n: u32) -> Vec<u32> {
        let mut list: Vec<u32> =
            self.around[n as usize].iter().filter_map(|t| self.triangles[*t as usize]).flatten().filter(|m| *m != n).collect();
        list.sort_unstable();
        list.dedup();
        list
    }

    /// The link condition (two common neighbours) and no triangle turned over.
    fn allowed(&self, a: u32, b: u32, to: DVec3) -> bool {
        let (of_a, of_b) = (self.neighbours(a), self.neighbours(b));
        if of_a.iter().filter(|n| of_b.binary_search(n).is_ok()).count() != 2 {
            return false;
        }
        [(a, b), (b, a)].into_iter().all(|(moved, other)| {
            self.around[moved as usize].iter().filter_map(|t| self.triangles[*t as usize]).filter(|t| !t.contains(&other)).all(|t| {
                let p = t.map(|n| self.nodes[n as usize]);
                let q = t.map(|n| if n == moved { to } else { self.nodes[n as usize] });
                let [old, new] = [p, q].map(|[x, y, z]| (y - x).cross(z - x));
                old.dot(new) > MAX_TURN * old.length() * new.length()
            })
        })
    }

    fn collapse(&mut self, a: u32, b: u32, to: DVec3) {
        self.nodes[a as usize] = to;
        let q = self.quadrics[b as usize];
        self.quadrics[a as usize].add(&q);
        for t in std::mem::take(&mut self.around[b as usize]) {
            let Some(corners) = self.triangles[t as usize].as_mut() else { continue };
            if corners.contains(&a) {
                self.triangles[t as usize] = None;
            } else {
                corners.iter_mut().filter(|n| **n == b).for_each(|n| *n = a);
                self.around[a as usize].push(t);
            }
        }
        let triangles = &self.triangles;
        self.around[a as usize].retain(|t| triangles[*t as usize].is_some());
        self.versions[a as usize] += 1;
        self.versions[b as usize] += 1;
        for n in self.neighbours(a) {
            let triangles = &self.triangles;
            self.around[n as usize].retain(|t| triangles[*t as usize].is_some());
            self.offer(a.min(n), a.max(n));
        }
    }

    fn finish(self) -> Surface {
        let mut new = vec![u32::MAX; self.nodes.len()];
        let mut surface = Surface::default();
        for t in self.triangles.into_iter().flatten() {
            let corners = t.map(|n| {
                if new[n as usize] == u32::MAX {
                    new[n as usize] = surface.nodes.len() as u32;
                    surface.nodes.push(self.nodes[n as usize]);
                }
                new[n as usize]
            });
            surface.triangles.push(corners);
        }
        surface
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ball_stays_a_ball_with_a_fifth_of_its_triangles() {
        let ball = Surface::nets(&|p: DVec3| p.length() - 10.0, DVec3::splat(-12.0), DVec3::splat(12.0), 0.5);
        let before = (ball.triangles.len(), ball.volume());
        let s = decimate(ball, 0.1);
        assert!(s.triangles.len() * 5 < before.0, "{} of {}", s.triangles.len(), before.0);
        assert!((s.volume() / before.1 - 1.0).abs() < 0.02);
        assert_eq!(s.nodes.len() as i64 - s.triangles.len() as i64 / 2, 2, "still a sphere");
        assert!(s.nodes.iter().all(|p| (p.length() - 10.0).abs() < 0.3));
    }
}
