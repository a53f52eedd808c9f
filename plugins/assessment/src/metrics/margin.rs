//! The margin of a resection: how far the surface that was cut is from the tumour, in the rest shape.
//!
//! The surface that was cut is the boundary of what has come free less the organ's own skin. The distance of each of its vertices is that to the nearest
//! point of the tumour in the piece, through healthy tissue or not; it is zero where the cut goes through tumour.

use bevy_math::DVec3;
use keyhole_tetmesh::{FACES, MaterialId, NodeId, OuterPlanes, TetMesh};
use parry3d::math::Vector;
use parry3d::query::PointQuery;
use parry3d::shape::TriMesh;
use rustc_hash::FxHashMap;

/// A vertex of a surface that was cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarginVertex {
    /// The node.
    pub node: NodeId,
    /// Where it is in the rest shape, m.
    pub place: DVec3,
    /// Distance to the tumour, m.
    pub margin_m: f64,
    /// A third of the area of the triangles around it, m2.
    pub area_m2: f64,
}

/// The surface that a resection cut, and its distance to the tumour.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Margin {
    /// Vertices, in ascending order of node.
    pub vertices: Vec<MarginVertex>,
    /// Triangles by index into the vertices, outward.
    pub triangles: Vec<[u32; 3]>,
}

impl Margin {
    /// The margin of a piece that has come free. `skin` is that of the organ before it was cut; `is_tumour` tells the materials. `None` when the piece has
    /// no tumour, or nothing of it was cut.
    #[must_use]
    pub fn of(piece: &TetMesh, skin: &OuterPlanes, is_tumour: impl Fn(MaterialId) -> bool) -> Option<Self> {
        let tumour = tumour_surface(piece, &is_tumour)?;
        let mut margin = Self::default();
        let mut index = FxHashMap::default();
        for (tet, corners) in piece.iter() {
            for (face, local) in FACES.iter().enumerate() {
                if piece.topology().neighbour(tet, face).is_some() || skin.is_outer(piece, tet, face) {
                    continue;
                }
                let nodes = local.map(|i| corners[i]);
                let [a, b, c] = nodes.map(|n| piece.rest(n));
                let third = (b - a).cross(c - a).length() / 6.0;
                let within = is_tumour(piece.tet(tet).material);
                margin.triangles.push(nodes.map(|node| {
                    let at = *index.entry(node).or_insert_with(|| {
                        margin.vertices.push(MarginVertex { node, place: piece.rest(node), margin_m: f64::INFINITY, area_m2: 0.0 });
                        margin.vertices.len() - 1
                    });
                    let vertex = &mut margin.vertices[at];
                    vertex.area_m2 += third;
                    if within {
                        vertex.margin_m = 0.0;
                    }
                    at as u32
                }));
            }
        }
        for vertex in margin.vertices.iter_mut().filter(|v| v.margin_m > 0.0) {
            let place = Vector::from_array(vertex.place.as_vec3().to_array());
            vertex.margin_m = f64::from(tumour.distance_to_local_point(place, false));
        }
        margin.in_order_of_nodes();
        (!margin.vertices.is_empty()).then_some(margin)
    }

    fn in_order_of_nodes(&mut self) {
        let mut order: Vec<usize> = (0..self.vertices.len()).collect();
        order.sort_unstable_by_key(|i| self.vertices[*i].node);
        let mut place = vec![0_u32; order.len()];
        order.iter().enumerate().for_each(|(new, old)| place[*old] = new as u32);
        self.vertices = order.iter().map(|i| self.vertices[*i]).collect();
        self.triangles.iter_mut().flatten().for_each(|i| *i = place[*i as usize]);
    }

    /// Several as one; the nodes are still those of each piece. `None` of none.
    #[must_use]
    pub fn joined<'a>(margins: impl Iterator<Item = &'a Self>) -> Option<Self> {
        let mut joined = Self::default();
        for margin in margins {
            let from = joined.vertices.len() as u32;
            joined.vertices.extend(&margin.vertices);
            joined.triangles.extend(margin.triangles.iter().map(|t| t.map(|i| i + from)));
        }
        (!joined.vertices.is_empty()).then_some(joined)
    }

    /// Area, m2.
    #[must_use]
    pub fn area_m2(&self) -> f64 {
        self.vertices.iter().map(|v| v.area_m2).sum()
    }

    /// The least distance, m.
    #[must_use]
    pub fn least_m(&self) -> f64 {
        self.vertices.iter().map(|v| v.margin_m).fold(f64::INFINITY, f64::min)
    }

    /// The mean over the area, m.
    #[must_use]
    pub fn mean_m(&self) -> f64 {
        self.vertices.iter().map(|v| v.margin_m * v.area_m2).sum::<f64>() / self.area_m2()
    }

    /// The part of the area where the margin is at most so much (m).
    #[must_use]
    pub fn part_within(&self, margin_m: f64) -> f64 {
        let within = self.vertices.iter().filter(|v| v.margin_m <= margin_m);
        within.map(|v| v.area_m2).sum::<f64>() / self.area_m2()
    }

    /// The distance that so much of the area (0 to 1) does not exceed, m.
    #[must_use]
    pub fn quantile_m(&self, part: f64) -> f64 {
        let mut by_margin: Vec<&MarginVertex> = self.vertices.iter().collect();
        by_margin.sort_unstable_by(|a, b| a.margin_m.total_cmp(&b.margin_m));
        let wanted = part * self.area_m2();
        let mut area = 0.0;
        for vertex in &by_margin {
            area += vertex.area_m2;
            if area >= wanted {
                return vertex.margin_m;
            }
        }
        by_margin.last().map_or(0.0, |v| v.margin_m)
    }
}

/// The surface of the tumour in a piece; `None` without one.
fn tumour_surface(piece: &TetMesh, is_tumour: impl Fn(MaterialId) -> bool) -> Option<TriMesh> {
    let within = |tet| is_tumour(piece.tet(tet).material);
    let mut index = FxHashMap::default();
    let (mut points, mut triangles) = (Vec::new(), Vec::new());
    for (tet, corners) in piece.iter().filter(|(tet, _)| within(*tet)) {
        for (face, local) in FACES.iter().enumerate() {
            if piece.topology().neighbour(tet, face).is_some_and(within) {
                continue;
            }
            triangles.push(local.map(|i| {
                *index.entry(corners[i]).or_insert_with(|| {
                    points.push(Vector::from_array(piece.rest(corners[i]).as_vec3().to_array()));
                    points.len() as u32 - 1
                })
            }));
        }
    }
    // Fails only without a triangle.
    TriMesh::new(points, triangles).ok()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;
    use crate::metrics::resection::{Piece, Resection, Volumes};
    use keyhole_tetmesh::Tet;

    /// A bar 40 x 10 x 10 mm along x of cubes of 5 mm, five tetrahedra each; the cubes in columns 2 and 3 (10 to 20 mm) are tumour.
    fn bar() -> TetMesh {
        let edge = 0.005;
        let id = |i: usize, j: usize, k: usize| (i + 9 * (j + 3 * k)) as u32;
        let nodes: Vec<DVec3> = (0..81).map(|c| DVec3::new((c % 9) as f64, (c / 9 % 3) as f64, (c / 27) as f64) * edge).collect();
        let (mut tets, mut materials) = (Vec::new(), Vec::new());
        for [i, j, k] in (0..32).map(|c| [c % 8, c / 8 % 2, c / 16]) {
            for five in [[0, 1, 2, 4], [3, 1, 7, 2], [5, 1, 4, 7], [6, 2, 7, 4], [1, 2, 4, 7]] {
                let five: [usize; 4] = if (i + j + k) % 2 == 0 { five } else { five.map(|b| b ^ 1) };
                let mut tet = five.map(|b| id(i + (b & 1), j + (b >> 1 & 1), k + (b >> 2 & 1)));
                let [a, b, c, d] = tet.map(|n| nodes[n as usize]);
                if (b - a).dot((c - a).cross(d - a)) < 0.0 {
                    tet.swap(2, 3);
                }
                tets.push(tet);
                materials.push(MaterialId(u8::from((2..4).contains(&i)).into()));
            }
        }
        TetMesh::new(nodes, &tets, &materials)
    }

    /// The tetrahedra of a mesh whose middle has an x within a range, as a mesh of their own.
    fn part(mesh: &TetMesh, from: f64, to: f64) -> TetMesh {
        let kept: Vec<_> = mesh.iter().filter(|(t, _)| (from..to).contains(&(mesh.points(*t).iter().sum::<DVec3>().x / 4.0))).collect();
        let tets: Vec<([u32; 4], Tet)> = kept.iter().map(|(t, corners)| (corners.map(|n| n.0), mesh.tet(*t))).collect();
        TetMesh::from_parts(mesh.rest_positions().to_vec(), &tets)
    }

    const TUMOUR: fn(MaterialId) -> bool = |m| m == MaterialId(1);

    /// Cut at 25 mm, the freed end (0 to 25 mm) has the whole tumour, 1 ml, and a flat cut surface of 100 mm2 that is 5 mm from it. Of 3 ml of healthy tissue
    /// 1.5 ml go with it.
    #[test]
    fn a_cut_five_millimetres_from_the_tumour() {
        let bar = bar();
        let skin = OuterPlanes::of(&bar);
        let (freed, left) = (part(&bar, 0.0, 0.025), part(&bar, 0.025, 1.0));
        let margin = Margin::of(&freed, &skin, TUMOUR).unwrap();
        assert!((margin.area_m2() - 1e-4).abs() < 1e-12, "{}", margin.area_m2());
        for v in &margin.vertices {
            assert!((v.margin_m - 0.005).abs() < 1e-8 && (v.place.x - 0.025).abs() < 1e-12, "{v:?}");
        }
        assert!((margin.mean_m() - 0.005).abs() < 1e-8 && (margin.quantile_m(0.5) - 0.005).abs() < 1e-8);
        assert_eq!((margin.part_within(0.0049), margin.part_within(0.0051)), (0.0, 1.0));
        let before = Volumes::of(&bar, TUMOUR);
        let pieces = [Piece { mesh: &freed, freed: true }, Piece { mesh: &left, freed: false }];
        let resection = Resection::of(before, &pieces, TUMOUR);
        assert_eq!(resection.tumour_left_m3(), 0.0);
        assert!((resection.healthy_removed_m3() - 1.5e-6).abs() < 1e-15);
        assert!((resection.preserved().unwrap() - 0.5).abs() < 1e-9);
        assert!((resection.freed.tumour_m3 - 1e-6).abs() < 1e-15);
    }

    /// Cut at 15 mm, through the middle of the tumour: half of it stays, and the margin is zero all over the surface.
    #[test]
    fn a_cut_through_the_tumour() {
        let bar = bar();
        let skin = OuterPlanes::of(&bar);
        let (freed, left) = (part(&bar, 0.0, 0.015), part(&bar, 0.015, 1.0));
        let margin = Margin::of(&freed, &skin, TUMOUR).unwrap();
        assert_eq!((margin.least_m(), margin.part_within(0.0)), (0.0, 1.0));
        let pieces = [Piece { mesh: &freed, freed: true }, Piece { mesh: &left, freed: false }];
        let resection = Resection::of(Volumes::of(&bar, TUMOUR), &pieces, TUMOUR);
        assert!((resection.tumour_left_m3() - 0.5e-6).abs() < 1e-15);
        // The other side of the cut, which has no tumour in a piece without one, and a piece that was not cut.
        assert_eq!(Margin::of(&part(&bar, 0.025, 1.0), &skin, TUMOUR), None);
        assert_eq!(Margin::of(&bar, &skin, TUMOUR), None);
    }
}
