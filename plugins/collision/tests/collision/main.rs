//! Detection against brute force, and penetration depths against closed forms.

mod detection;
mod meshes;
