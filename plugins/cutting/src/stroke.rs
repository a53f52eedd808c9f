//! What one stroke has done so far: crossings, piercings, the base tetrahedra it touched and their children.

use crate::course::Visits;
use crate::kernel::{Child, Vertex};
use crate::release::FaceState;
use crate::sheet::{Strip, in_steps};
use keyhole_tetmesh::{DVec3, EdgeKey, FaceKey, NodeId, Tet, TetId};
use rustc_hash::{FxHashMap, FxHashSet};
use smallvec::SmallVec;

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
    /// A hash of each vertex of the key: where they differ, so do the vertices.
    pub hashes: [u32; 4],
    pub nodes: [NodeId; 4],
    /// Its slot; `None` until it has been added.
    pub id: Option<TetId>,
    /// The side that it lies on, 0 when it is not known or on both.
    pub label: i8,
}

/// A base tetrahedron that the stroke has touched.
#[derive(Clone, Debug)]
pub(crate) struct Touched {
    pub tet: Tet,
    pub faces: SmallVec<[FaceKey; 4]>,
    pub edges: SmallVec<[EdgeKey; 6]>,
    pub children: Vec<Placed>,
}

/// A node of the mesh at a vertex of the sheet, with the corners that tell its side from the others.
#[derive(Clone, Debug)]
pub(crate) struct SideNode {
    pub node: NodeId,
    pub tags: SmallVec<[NodeId; 4]>,
}

/// Place of an edge in the global order of splitting: longer first, then by midpoint, then by id.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SplitRank {
    pub length_squared: f64,
    pub midpoint: DVec3,
}

/// The stroke in progress: what all blades in the organ have done since it began.
#[derive(Clone, Debug, Default)]
pub(crate) struct Stroke {
    pub crossings: FxHashMap<EdgeKey, Crossing>,
    pub ranks: FxHashMap<EdgeKey, SplitRank>,
    /// Edges whose crossing has not settled.
    pub unsettled: Vec<EdgeKey>,
    /// Where the start line and the paths of tip and heel pierced a face last.
    pub border: FxHashMap<FaceKey, FaceWeights>,
    /// How far lines have come in a face that the sheet crosses on one edge only: a blade that draws back does not heal it.
    pub reach: FxHashMap<FaceKey, FaceWeights>,
    /// Where the blades have been.
    pub visits: Visits,
    /// Released face points.
    pub face_points: FxHashMap<FaceKey, (FaceWeights, FaceState)>,
    /// Nodes that were moved onto the sheet, with the side they were on before.
    pub on_sheet: FxHashMap<NodeId, i8>,
    /// Nodes whose crossings have been weighed for snapping.
    pub weighed: FxHashSet<NodeId>,
    /// Touched base tetrahedra, by their place.
    pub touched: Vec<Touched>,
    /// Base tetrahedra whose corners' sides may have become known.
    pub stale_labels: Vec<TetId>,
    pub sides: FxHashMap<Vertex, SmallVec<[SideNode; 2]>>,
    /// The side of the sheet that each node near it is on, +1 or -1: the first crossing that tells decides.
    pub node_sides: FxHashMap<NodeId, i8>,
    /// Those of which the side is a guess that the next crossing may overrule.
    pub guessed: FxHashSet<NodeId>,
    /// Edges that the sheet has crossed, whether that was recorded or not.
    pub hits: FxHashSet<EdgeKey>,
    /// Nodes that turned out to lie on the other side: the sheet is led past them, see [`crate::sides`].
    pub led_past: Vec<NodeId>,
}

impl Stroke {
    /// Whether nothing of the tissue is in the stroke's hands.
    pub fn is_empty(&self) -> bool {
        self.crossings.is_empty() && self.touched.is_empty()
    }

    /// Forgets all; keeps the room.
    pub fn clear(&mut self) {
        self.crossings.clear();
        self.ranks.clear();
        self.unsettled.clear();
        self.border.clear();
        self.reach.clear();
        self.visits.clear();
        self.face_points.clear();
        self.on_sheet.clear();
        self.weighed.clear();
        self.touched.clear();
        self.stale_labels.clear();
        self.sides.clear();
        self.node_sides.clear();
        self.guessed.clear();
        self.hits.clear();
        self.led_past.clear();
    }

    /// The crossing of an edge that is split.
    pub fn released(&self, edge: EdgeKey) -> Option<&Crossing> {
        self.crossings.get(&edge).filter(|c| c.state == CrossingState::Released)
    }

    /// Side labels of the corners of a base tetrahedron: +1, -1, or 0 for those on the sheet and those not known.
    pub fn labels(&self, corners: [NodeId; 4]) -> [i8; 4] {
        std::array::from_fn(|i| {
            if self.on_sheet.contains_key(&corners[i]) {
                return 0;
            }
            // An edge that no sheet crosses ends on one side of it: the side its other node came from.
            let beside = || {
                (0..4)
                    .filter(|&j| !self.crossings.contains_key(&EdgeKey::new(corners[i], corners[j])))
                    .find_map(|j| self.on_sheet.get(&corners[j]).copied())
            };
            self.node_sides.get(&corners[i]).copied().or_else(beside).unwrap_or(0)
        })
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
        let free = key.iter().filter_map(|v| match v {
            Vertex::Corner(n) if !self.on_sheet.contains_key(n) => corners.iter().position(|c| c == n),
            _ => None,
        });
        let (mut label, mut is_free) = (0, false);
        for i in free {
            is_free = true;
            if labels[i] != 0 && label == -labels[i] {
                return 0;
            }
            if labels[i] != 0 {
                label = labels[i];
            }
        }
        // A child all of whose vertices lie on the sheet goes to one side, always the same.
        if is_free { label } else { 1 }
    }

    /// Whether the face between two children is a face of the cut: all of it on the sheet, and they on opposite sides.
    pub fn is_marked(&self, face: &[Vertex; 3], labels: [i8; 2]) -> bool {
        labels[0] * labels[1] == -1 && face.iter().all(|v| self.is_on_sheet(*v))
    }
}

impl Crossing {
    /// A crossing at parameter `t` from the node with the smaller id, which is on side `side`; kept `clearance` from the ends.
    pub fn new(t: f64, side: i8, clearance: f64) -> Self {
        let clearance = in_steps(clearance);
        Self { t: t.clamp(clearance, 1.0 - clearance), exact: t, side, state: CrossingState::Recorded, settled: false }
    }
}

/// The strip that starts a stroke: the line alone.
pub(crate) fn starting_strip(line: &[DVec3]) -> Strip {
    Strip::between(line, line)
}
