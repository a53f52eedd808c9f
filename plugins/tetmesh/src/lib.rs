//! The tetrahedral mesh that every room of Keyhole looks at: nodes in the rest shape, tetrahedra with material and source, adjacency,
//! boundary, hull marks, quality, and VTU files.
//!
//! No engine, no physics. Lengths are metres; a tetrahedron is *positive* when `(b - a) . ((c - a) x (d - a)) > 0`.

pub mod boundary;
pub mod check;
pub mod components;
pub mod delta;
pub mod ids;
pub mod mesh;
pub mod outer;
pub mod quality;
pub mod topology;
pub mod vtu;
mod vtu_xml;

pub use boundary::Boundary;
pub use check::MeshError;
pub use delta::{AddedTet, NodeEdit, NodeWeights, TopologyDelta};
pub use glam::DVec3;
pub use ids::{EdgeKey, FaceKey, MaterialId, NodeId, TetId};
pub use mesh::{Tet, TetMesh};
pub use outer::OuterPlanes;
pub use topology::{EDGES, FACES, Topology};
