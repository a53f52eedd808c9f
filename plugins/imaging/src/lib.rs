//! keyhole-tetmesh.
