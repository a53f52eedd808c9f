//! What one stroke has done so far: crossings, piercings, the base tetrahedra it touched and their children.

use crate::kernel::{Child, Vertex};
use crate::sheet::Strip;
use keyhole_tetmesh::{DVec3, EdgeKey, FaceKey, NodeId, Tet, TetId};
use rustc_hash::{FxHashMap, FxHashSet};

/// How far a crossing has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CrossingState {
    /// The sheet crosses the edge; the mesh does not show it yet.
    Recorded,
    /// The edge is split.
    Released,
    /// A node of the edge was moved onto the sheet instead.
    Dropped,
}

/// A crossing of an edge by the sheet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Crossing {
    /// Parameter from the node with the smaller id, in the rest shape as the crossing was found, kept clear of the ends.
    pub t: f64,
    /// The same as found.
    pub exact: f64,
    /// Side of the sheet that the node with the smaller id is on, +1 or -1.
    pub side: i8,
    pub state: CrossingState,
    /// Whether the blade has left for good: the release policies that wait may release it.
    pub settled: bool,
}

/// A point on a face, as weights of the face's nodes in ascending order of id.
pub(crate) type FaceWeights = [f64; 3];

/// A child as it stands in the mesh.
#[derive(Clone, Debug)]
pub(crate) struct Placed {
    pub key: Child,
    pub nodes: [NodeId; 4],
    /// Its slot; `None` until it has been added, or when its nodes have changed.
    pub id: Option<TetId>,
}

/// A base tetrahedron that the stroke has touched.
#[derive(Clone, Debug)]
pub(crate) struct Touched {
    pub corners: [NodeId; 4],
    pub tet: Tet,
    pub faces: Vec<FaceKey>,
    pub edges: Vec<EdgeKey>,
    pub children: Vec<Placed>,
}

/// A node of the mesh at a vertex of the sheet, with the corners that tell its side from the others.
#[derive(Clone, Debug)]
pub(crate) struct SideNode {
    pub node: NodeId,
    pub tags: Vec<NodeId>,
}

/// Place of an edge in the global order of splitting: longer first, then by midpoint, then by id.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SplitRank {
    pub length_squared: f64,
    pub midpoint: DVec3,
}

/// The stroke in progress.
#[derive(Clone, Debug, Default)]
pub(crate) struct Stroke {
    /// The blade's line at the last step, as points of the rest shape; empty before the first.
    pub line: Vec<DVec3>,
    pub crossings: FxHashMap<EdgeKey, Crossing>,
    pub ranks: FxHashMap<EdgeKey, SplitRank>,
    /// Edges whose crossing has not settled.
    pub unsettled: Vec<EdgeKey>,
    /// Where the start line and the paths of tip and heel pierced a face last.
    pub border: FxHashMap<FaceKey, FaceWeights>,
    /// Where the present line pierces faces.
    pub front: FxHashMap<FaceKey, FaceWeights>,
    /// Base tetrahedra that the present line is in.
    pub occupied: FxHashSet<TetId>,
    /// Released face points.
    pub face_points: FxHashMap<FaceKey, FaceWeights>,
    /// Nodes on the sheet, with the side they were on before they were moved there (0 when they were made there).
    pub on_sheet: FxHashMap<NodeId, i8>,
    /// Nodes whose crossings have been weighed for snapping.
    pub weighed: FxHashSet<NodeId>,
    pub touched: FxHashMap<TetId, Touched>,
    /// The base tetrahedron of each child.
    pub parent: FxHashMap<TetId, TetId>,
    pub sides: FxHashMap<Vertex, Vec<SideNode>>,
}

impl Stroke {
    /// Whether nothing of the tissue is in the stroke's hands.
    pub fn is_empty(&self) -> bool {
        self.crossings.is_empty() && self.touched.is_empty()
    }

    /// The crossing of an edge that is split.
    pub fn released(&self, edge: EdgeKey) -> Option<&Crossing> {
        self.crossings.get(&edge).filter(|c| c.state == CrossingState::Released)
    }

    /// Whether the crossing of an edge is known but not effective.
    pub fn is_waiting(&self, edge: EdgeKey) -> bool {
        self.crossings.get(&edge).is_some_and(|c| c.state == CrossingState::Recorded)
    }

    /// Side labels of the corners of a base tetrahedron: +1, -1, or 0 for those on the sheet and those not known.
    pub fn labels(&self, corners: [NodeId; 4]) -> [i8; 4] {
        let mut labels = [0_i8; 4];
        for [i, j] in keyhole_tetmesh::EDGES {
            if let Some(c) = self.crossings.get(&EdgeKey::new(corners[i], corners[j])) {
                let (low, high) = if corners[i] < corners[j] { (i, j) } else { (j, i) };
                labels[low] = c.side;
                labels[high] = -c.side;
            }
        }
        for i in 0..4 {
            if labels[i] != 0 || self.on_sheet.contains_key(&corners[i]) {
                continue;
            }
            // An edge that no sheet crosses ends on one side of it: the side its other node came from.
            labels[i] = (0..4)
                .filter(|&j| !self.crossings.contains_key(&EdgeKey::new(corners[i], corners[j])))
                .filter_map(|j| self.on_sheet.get(&corners[j]).copied())
                .find(|s| *s != 0)
                .unwrap_or(0);
        }
        for i in 0..4 {
            if self.on_sheet.contains_key(&corners[i]) {
                labels[i] = 0;
            }
        }
        labels
    }

    /// Whether one sheet can make the crossings of a base tetrahedron, `extra` among them: whether no corner lies on both sides.
    pub fn is_one_sheet(&self, corners: [NodeId; 4], extra: &FxHashMap<EdgeKey, Crossing>) -> bool {
        let mut labels = [0_i8; 4];
        for [i, j] in keyhole_tetmesh::EDGES {
            let key = EdgeKey::new(corners[i], corners[j]);
            if let Some(c) = self.crossings.get(&key).or_else(|| extra.get(&key)) {
                let (low, high) = if corners[i] < corners[j] { (i, j) } else { (j, i) };
                for (corner, side) in [(low, c.side), (high, -c.side)] {
                    if labels[corner] == -side {
                        return false;
                    }
                    labels[corner] = side;
                }
            }
        }
        true
    }

    /// Whether a vertex lies on the sheet.
    pub fn is_on_sheet(&self, vertex: Vertex) -> bool {
        match vertex {
            Vertex::Corner(n) => self.on_sheet.contains_key(&n),
            Vertex::Edge(_) | Vertex::Face(_) => true,
        }
    }

    /// The side that a child lies on, 0 when it is not known or on both.
    pub fn child_label(&self, key: &Child, corners: [NodeId; 4], labels: [i8; 4]) -> i8 {
        let mut label = 0;
        let mut free = false;
        for v in key {
            if let Vertex::Corner(n) = v
                && !self.on_sheet.contains_key(n)
            {
                free = true;
                let l = corners.iter().position(|c| c == n).map_or(0, |i| labels[i]);
                if l != 0 && label == -l {
                    return 0;
                }
                if l != 0 {
                    label = l;
                }
            }
        }
        // A child all of whose vertices lie on the sheet goes to one side, always the same.
        if free { label } else { 1 }
    }

    /// Whether the face between two children is a face of the cut: all of it on the sheet, and they on opposite sides.
    pub fn is_marked(&self, face: &[Vertex; 3], labels: [i8; 2]) -> bool {
        labels[0] * labels[1] == -1 && face.iter().all(|v| self.is_on_sheet(*v))
    }
}

/// What a step of the sheet meets.
#[derive(Debug, Default)]
pub(crate) struct Meeting {
    /// Base tetrahedra that the strip or the present line meets.
    pub tets: Vec<TetId>,
    /// Those that the present line is in.
    pub occupied: FxHashSet<TetId>,
    /// Crossings found, by edge, at most one each.
    pub crossings: FxHashMap<EdgeKey, Crossing>,
    /// Edges crossed twice or more by this step alone.
    pub folded: bool,
    pub front: FxHashMap<FaceKey, FaceWeights>,
    pub border: FxHashMap<FaceKey, FaceWeights>,
    /// Area of the strip inside the tissue, m2.
    pub area: f64,
}

impl Meeting {
    /// Keeps the hits of an edge.
    pub fn record(&mut self, edge: EdgeKey, hits: &[crate::sheet::Hit]) {
        match hits {
            [] => {}
            [hit] => {
                let t = hit.t.clamp(crate::sheet::CLEARANCE, 1.0 - crate::sheet::CLEARANCE);
                let crossing = Crossing { t, exact: hit.t, side: hit.side, state: CrossingState::Recorded, settled: false };
                self.crossings.insert(edge, crossing);
            }
            _ => self.folded = true,
        }
    }
}

/// The strip that starts a stroke: the line alone.
pub(crate) fn starting_strip(line: &[DVec3]) -> Strip {
    Strip::between(line, line)
}
