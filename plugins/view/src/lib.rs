//! What is seen: the organs' surfaces on the GPU, wet materials, the instruments, two cameras (from outside and through the endoscope with
//! its optics), and pictures of both.
//!
//! Skin and opened inside are told apart face by face ([`outer`]), kept as triangle lists that follow topology deltas ([`sheet`]), and
//! written in place into vertex buffers ([`buffers`]), the inside a little smoother than it is ([`fairing`]).

pub mod adapter;
pub mod anatomy;
pub mod blood;
pub mod bruises;
pub mod buffers;
pub mod clips;
pub mod depth;
pub mod eyes;
pub mod fairing;
pub mod framing;
pub mod layers;
pub mod materials;
pub mod optics;
pub mod orbit;
pub mod organs;
pub mod paint;
pub mod pictures;
pub mod plugin;
pub mod shading;
pub mod sheet;
pub mod smoke;
pub mod smoothing;
#[cfg(test)]
mod testing;
pub mod theatre;
pub mod thread;
pub mod tools;

pub use adapter::{AdapterError, adapter_available, display_available};
pub use eyes::{ScopeFog, SpecimenView, ViewLayout, Viewpoint};
pub use fairing::FairingSettings;
pub use keyhole_tetmesh::outer;
pub use orbit::OrbitState;
pub use paint::{Paint, PaintedCut};
pub use pictures::{PictureError, PictureErrors, PictureOf, PictureRequest, PictureRequests, PicturesPending, take_pictures};
pub use plugin::ViewPlugin;
pub use smoke::SmokeSettings;
pub use smoothing::MotionSettings;
