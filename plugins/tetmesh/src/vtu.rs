//! VTU.
