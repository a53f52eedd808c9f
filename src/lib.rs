//! Keyhole.
