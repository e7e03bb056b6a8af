//! The books of a clip: when it begins and ends, its counters, energy and energy-delay product.

mod config;

pub use config::ClipConfig;
