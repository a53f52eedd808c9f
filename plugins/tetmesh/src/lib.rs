//! glam.
