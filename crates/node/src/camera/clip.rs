//! What is counted of a clip: when it begins and ends, its counters, energy and energy-delay product.
//!
//! [`ClipTracker`] takes a camera's frames and gives back every [`ClosedClip`]; with the energy of its span and
//! what is known of the node ([`ClipMeta`]) that becomes the report on the wire.

mod config;
mod latencies;
mod report;
#[cfg(test)]
mod tests;
mod tracker;

pub use config::ClipConfig;
pub(crate) use report::{ClipMeta, ClosedClip, MeasuredClip};
pub use report::{energy_delay_product, energy_of};
pub(crate) use tracker::{ClipTracker, FrameArrival};
