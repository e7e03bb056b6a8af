//! The books of a clip: when it begins and ends, its counters, energy and energy-delay product.
//!
//! [`ClipBooks`] takes a camera's frames and gives back every [`ClosedClip`]; with the energy of its span
//! ([`clip_energy`]) and what is known of the node ([`ClipMeta`]) that becomes the report on the wire.

mod books;
mod config;
mod latencies;
mod report;
mod share;
#[cfg(test)]
mod tests;

pub use books::{ClipBooks, FrameArrival, FrameResult};
pub use config::ClipConfig;
pub use latencies::Latencies;
pub use report::{ClipMeta, ClosedClip, clip_energy, energy_delay_product, energy_of};
pub use share::{CameraShare, ShareLedger, Slice};
