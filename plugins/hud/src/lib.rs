//! keyhole-whiteboard.
