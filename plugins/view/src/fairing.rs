//! The opened surface as the eye should see it. A mesh is coarse against what an eye resolves, so a cut surface shows the tetrahedra that it
//! was cut from. Its nodes are shown a little off their places, as low-pass filtered as a blade's path is smooth; physics knows nothing of it.
//!
//! The filter is Taubin's (A signal processing approach to fair surface design, SIGGRAPH 1995): passes of the umbrella operator with a
//! positive and a slightly larger negative factor in turn smooth without shrinking. Neighbours count by the inverse of their distance, as a
//! cut makes edges of all lengths (Desbrun et al., Implicit fairing of irregular meshes, SIGGRAPH 1999): with equal shares the angles from
//! face to face of a kidney cut by a shaking hand fall from 17.5 to 12.0 degrees, with these to 8.4. Only the part along the surface's
//! normal is used, so a flat cut stays as it is and nothing drifts within the surface. What does not move: the rim that the opened surface
//! shares with the skin, and folds, such as the bottom of a wound, where the two sides of a cut meet. No node moves farther than a
//! fraction of the edges around it.

use crate::sheet::Sheet;
use bevy::prelude::*;
use keyhole_tetmesh::NodeId;
use smallvec::SmallVec;

/// Whether and how the opened surface is faired.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct FairingSettings {
    /// Default true.
    pub enabled: bool,
    /// Pairs of passes. Default 6.
    pub passes: u32,
    /// How far a node may be shown off its place, as a part of the mean length of the opened surface's edges there. Default 0.4.
    pub reach: f32,
}

impl Default for FairingSettings {
    fn default() -> Self {
        Self { enabled: true, passes: 6, reach: 0.4 }
    }
}

/// Factors of the two passes of a pair. They pass frequencies below `1 / 0.5 - 1 / 0.53 = 0.11` of the umbrella operator's spectrum (0 to 2).
const FACTORS: [f32; 2] = [0.5, -0.53];

/// Where area vectors around a node cancel to less than the first of these parts the node is on a fold and stays; above the second it moves
/// freely. Two planes that meet at an angle leave the sine of its half: the bottom of a wound rounds off once it is open by 35 degrees. A
/// corner of stairs leaves 0.58.
const FOLD: [f32; 2] = [0.1, 0.3];

/// Passes over the normals. The shape keeps some of its dents, at the rim above all; the light need not show them.
const NORMAL_PASSES: u32 = 2;

/// The nodes of an opened surface and how they hang together. Its size, and the cost of all of it, is that of the opened surface.
#[derive(Clone, Debug, Default)]
pub struct Fairing {
    /// Ascending; everything below is by index into this.
    nodes: Vec<NodeId>,
    /// Whether the node is on the rim.
    rim: Vec<bool>,
    faces: Vec<[u32; 3]>,
    /// The neighbours of node `i` are `neighbours[first[i]..first[i + 1]]`.
    first: Vec<u32>,
    neighbours: Vec<u32>,
    /// How much each of the neighbours counts: the nearer the more, 1 in all.
    shares: Vec<f32>,
    at: Vec<Vec3>,
    next: Vec<Vec3>,
    normals: Vec<Vec3>,
    weights: Vec<f32>,
}

impl Fairing {
    /// The opened surface of an organ with that skin.
    #[must_use]
    pub fn of(inside: &Sheet, skin: &Sheet) -> Self {
        let node = |slot: u32| inside.vertices()[slot as usize].node;
        let mut nodes: Vec<NodeId> = inside.indices().iter().map(|slot| node(*slot)).collect();
        nodes.sort_unstable();
        nodes.dedup();
        let place = |slot: u32| nodes.partition_point(|n| *n < node(slot)) as u32;
        let faces: Vec<[u32; 3]> = inside.indices().chunks_exact(3).map(|f| [place(f[0]), place(f[1]), place(f[2])]).collect();
        let mut pairs: Vec<[u32; 2]> = faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, a], [b, c], [c, b], [c, a], [a, c]]).collect();
        pairs.sort_unstable();
        pairs.dedup();
        let first = (0..=nodes.len() as u32).map(|i| pairs.partition_point(|p| p[0] < i) as u32).collect();
        let neighbours = pairs.into_iter().map(|p| p[1]).collect();
        let rim = nodes.iter().map(|n| skin.has_node(*n)).collect();
        Self { nodes, rim, faces, first, neighbours, ..Self::default() }
    }

    /// Where to show the nodes. `positions` and `shown` (m) have one entry a node slot; of `shown` only the entries of the opened surface's
    /// nodes are written.
    pub fn show(&mut self, positions: &[Vec3], settings: &FairingSettings, shown: &mut Vec<Vec3>) {
        shown.resize(positions.len(), Vec3::ZERO);
        self.at.clear();
        self.at.extend(self.nodes.iter().map(|n| positions[n.index()]));
        self.weigh();
        for factor in FACTORS.into_iter().cycle().take(2 * settings.passes as usize) {
            self.pass(factor);
        }
        for (i, node) in self.nodes.iter().enumerate() {
            let from = positions[node.index()];
            let around = self.around(i);
            let edges: f32 = around.iter().map(|j| positions[self.nodes[*j as usize].index()].distance(from)).sum();
            let reach = settings.reach * edges / around.len().max(1) as f32;
            shown[node.index()] = if self.weights[i] > 0.0 { from + (self.at[i] - from).clamp_length_max(reach) } else { from };
        }
    }

    /// Averages the normals at the nodes with those around them, the less the more they differ: the light follows the slope, not the faces.
    /// `normals` has one entry a node slot, of any length; those of the opened surface's nodes become unit vectors.
    pub fn soften(&mut self, normals: &mut [Vec3]) {
        self.normals.clear();
        self.normals.extend(self.nodes.iter().map(|n| normals[n.index()].normalize_or_zero()));
        for _ in 0..NORMAL_PASSES {
            let mut next = std::mem::take(&mut self.next);
            next.clear();
            next.extend((0..self.nodes.len()).map(|i| {
                let (own, around) = (self.normals[i], self.around(i));
                let others = around.iter().map(|j| self.normals[*j as usize]).map(|n| n.dot(own).max(0.0) * n).sum::<Vec3>();
                (own + 2.0 * others / around.len().max(1) as f32).normalize_or_zero()
            }));
            self.next = std::mem::replace(&mut self.normals, next);
        }
        for (node, normal) in self.nodes.iter().zip(&self.normals) {
            normals[node.index()] = *normal;
        }
    }

    /// Normals of the nodes, and how freely each may move along its own.
    fn weigh(&mut self) {
        let count = self.nodes.len();
        self.normals.clear();
        self.normals.resize(count, Vec3::ZERO);
        self.weights.clear();
        self.weights.resize(count, 0.0);
        for face in &self.faces {
            let [a, b, c] = face.map(|i| self.at[i as usize]);
            let area = (b - a).cross(c - a);
            for i in face {
                self.normals[*i as usize] += area;
                self.weights[*i as usize] += area.length();
            }
        }
        self.shares.clear();
        for i in 0..count {
            let lengths = self.around(i).iter().map(|j| self.at[*j as usize].distance(self.at[i]));
            let inverse: SmallVec<[f32; 16]> = lengths.map(|l| Some(l.recip()).filter(|x| x.is_finite()).unwrap_or(0.0)).collect();
            let sum: f32 = inverse.iter().sum();
            self.shares.extend(inverse.iter().map(|x| if sum > 0.0 { x / sum } else { 0.0 }));
            let whole = self.weights[i];
            let open = if whole > 0.0 { self.normals[i].length() / whole } else { 0.0 };
            self.weights[i] = if self.rim[i] { 0.0 } else { ((open - FOLD[0]) / (FOLD[1] - FOLD[0])).clamp(0.0, 1.0) };
            self.normals[i] = self.normals[i].normalize_or_zero();
        }
    }

    fn pass(&mut self, factor: f32) {
        let mut next = std::mem::take(&mut self.next);
        next.clear();
        next.extend((0..self.nodes.len()).map(|i| {
            let (from, around) = (self.at[i], self.around(i));
            if self.weights[i] <= 0.0 {
                return from;
            }
            let shares = &self.shares[self.first[i] as usize..self.first[i + 1] as usize];
            let umbrella = around.iter().zip(shares).map(|(j, share)| *share * (self.at[*j as usize] - from)).sum::<Vec3>();
            from + factor * self.weights[i] * umbrella.dot(self.normals[i]) * self.normals[i]
        }));
        self.next = std::mem::replace(&mut self.at, next);
    }

    /// The nodes, ascending.
    pub(crate) fn nodes(&self) -> &[NodeId] {
        &self.nodes
    }

    /// Whether the node at an index is on the rim.
    pub(crate) fn is_rim(&self, i: usize) -> bool {
        self.rim[i]
    }

    /// The indices of the neighbours of the node at an index.
    pub(crate) fn around(&self, i: usize) -> &[u32] {
        &self.neighbours[self.first[i] as usize..self.first[i + 1] as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outer::OuterPlanes;
    use crate::sheet::{Side, Surface};
    use crate::testing::{block, parted};
    use bevy::math::DVec3;
    use rustc_hash::FxHashMap;

    const EDGE: f64 = 0.005;
    const MIDDLE: DVec3 = DVec3::new(4.5, 4.0, 3.5);
    const OBLIQUE: DVec3 = DVec3::new(0.8, 0.5, 0.3);

    /// A block parted along the faces nearest to a plane through a point (in cells): its surface, its rest positions, and the pairs of nodes
    /// that were one.
    fn torn(point: DVec3, normal: DVec3) -> (Surface, Vec<Vec3>, Vec<[usize; 2]>) {
        let mut mesh = block([9, 8, 7], EDGE);
        let planes = OuterPlanes::of(&mesh);
        let mut surface = Surface::of(&mesh, &planes);
        let pairs = parted(&mut mesh, point * EDGE, normal.normalize());
        let delta = mesh.take_delta();
        surface.apply(&mesh, &planes, &delta);
        let pairs = pairs.into_iter().map(|(a, b)| [a.index(), b.index()]).collect();
        (surface, mesh.rest_positions().iter().map(|p| p.as_vec3()).collect(), pairs)
    }

    /// Root mean square of the angles between the normals of neighbouring faces of the opened surface, degrees.
    fn roughness(sheet: &Sheet, positions: &[Vec3]) -> f32 {
        let mut normals: FxHashMap<[usize; 2], Vec<Vec3>> = FxHashMap::default();
        for face in sheet.indices().chunks_exact(3) {
            let [a, b, c] = [0, 1, 2].map(|k| sheet.vertices()[face[k] as usize].node.index());
            let normal = (positions[b] - positions[a]).cross(positions[c] - positions[a]).normalize();
            for (p, q) in [(a, b), (b, c), (c, a)] {
                normals.entry([p.min(q), p.max(q)]).or_default().push(normal);
            }
        }
        let angles: Vec<f32> = normals.values().filter(|n| n.len() == 2).map(|n| n[0].angle_between(n[1]).to_degrees()).collect();
        (angles.iter().map(|a| a * a).sum::<f32>() / angles.len() as f32).sqrt()
    }

    fn shown(surface: &Surface, positions: &[Vec3], settings: &FairingSettings) -> Vec<Vec3> {
        let mut out = Vec::new();
        Fairing::of(surface.sheet(Side::Inside), surface.sheet(Side::Skin)).show(positions, settings, &mut out);
        out
    }

    #[test]
    fn stairs_become_a_slope_within_reach_and_the_rim_stays() {
        let settings = FairingSettings::default();
        for normal in [OBLIQUE, DVec3::new(1.0, 0.35, 0.1), DVec3::new(0.6, -0.6, 0.5)] {
            let (surface, positions, _) = torn(MIDDLE, normal);
            let (inside, skin) = (surface.sheet(Side::Inside), surface.sheet(Side::Skin));
            let out = shown(&surface, &positions, &settings);
            let (before, after) = (roughness(inside, &positions), roughness(inside, &out));
            let moved = |n: usize| out[n].distance(positions[n]);
            let nodes: Vec<usize> = inside.vertices().iter().map(|v| v.node.index()).collect();
            let rim: Vec<usize> = nodes.iter().copied().filter(|n| skin.has_node(NodeId(*n as u32))).collect();
            println!("along {normal}: {before:.1} degrees before, {after:.1} after; {} of {} nodes on the rim", rim.len(), nodes.len());
            assert!(rim.len() > 20 && nodes.len() > 2 * rim.len());
            assert!(after < 0.6 * before, "{before} to {after} degrees");
            assert!(rim.iter().all(|n| out[*n] == positions[*n]), "the rim moved");
            // No edge of the block is longer than a face's diagonal.
            let bound = settings.reach * std::f32::consts::SQRT_2 * EDGE as f32;
            assert!(nodes.iter().all(|n| moved(*n) <= bound * 1.001), "beyond its reach");
            assert!(nodes.iter().any(|n| moved(*n) > 0.1 * EDGE as f32));
        }
    }

    /// What was one node is still shown at one place while the cut is shut: no gap, and neither side comes through the other.
    #[test]
    fn the_two_sides_of_a_shut_cut_stay_together() {
        let (surface, positions, pairs) = torn(MIDDLE, OBLIQUE);
        let out = shown(&surface, &positions, &FairingSettings::default());
        assert!(pairs.len() > 40);
        for [a, b] in pairs {
            assert!(out[a].distance(out[b]) < 1e-4 * EDGE as f32, "{} and {}", out[a], out[b]);
        }
    }

    #[test]
    fn a_flat_cut_is_shown_as_it_is_and_a_moved_one_moved() {
        let settings = FairingSettings::default();
        let (surface, positions, pairs) = torn(DVec3::new(4.0, 4.0, 3.5), DVec3::X);
        let out = shown(&surface, &positions, &settings);
        assert_eq!(pairs.len(), 9 * 8);
        assert!(pairs.iter().flatten().all(|n| out[*n].distance(positions[*n]) < 1e-4 * EDGE as f32));
        let turn = Isometry3d::new(Vec3::new(0.1, -0.2, 0.05), Quat::from_rotation_y(0.7));
        let (surface, positions, pairs) = torn(MIDDLE, OBLIQUE);
        let out = shown(&surface, &positions, &settings);
        let turned: Vec<Vec3> = positions.iter().map(|p| turn * *p).collect();
        let out_turned = shown(&surface, &turned, &settings);
        assert!(pairs.iter().flatten().all(|n| (turn * out[*n]).distance(out_turned[*n]) < 1e-4 * EDGE as f32));
    }

    /// On a slope of stairs the light comes nearer to that of a slope, and flat stays flat.
    #[test]
    fn softened_normals_lean_towards_the_slope() {
        for (normal, least) in [(OBLIQUE, 0.5), (DVec3::X, 1.0)] {
            let (surface, positions, pairs) = torn(DVec3::new(4.0, 4.0, 3.5), normal);
            let (inside, skin) = (surface.sheet(Side::Inside), surface.sheet(Side::Skin));
            let mut normals = Vec::new();
            crate::buffers::node_normals(inside, &positions, &mut normals);
            // Of the side that is left of the plane: its outward normal is the plane's.
            let off = |normals: &[Vec3]| {
                let angles = pairs.iter().map(|p| normals[p[0]].angle_between(normal.as_vec3()).to_degrees());
                (angles.map(|a| a * a).sum::<f32>() / pairs.len() as f32).sqrt()
            };
            let before = off(&normals);
            Fairing::of(inside, skin).soften(&mut normals);
            println!("along {normal}: {before:.1} degrees off the slope before, {:.1} after", off(&normals));
            assert!(off(&normals) <= least * before + 0.1);
        }
    }

    #[test]
    fn without_passes_and_without_reach_nothing_moves() {
        let (surface, positions, pairs) = torn(MIDDLE, OBLIQUE);
        for settings in [FairingSettings { passes: 0, ..default() }, FairingSettings { reach: 0.0, ..default() }] {
            let out = shown(&surface, &positions, &settings);
            assert!(pairs.iter().flatten().all(|n| out[*n] == positions[*n]));
        }
    }
}
