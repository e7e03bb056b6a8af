//! Power meters, one file each; sampling every 100 ms; exact integration over a span of time.
//!
//! ```text
//! a Meter (rapl, estimate, …) ─ every interval_ms ─▶ History ─▶ integrate over [start, end] ─▶ SpanEnergy
//! ```

mod choose;
mod config;
mod estimate;
mod history;
pub mod integrate;
mod meter;
mod none;
mod rapl;
mod sampler;
mod sysfs;

pub use choose::open;
pub use config::{PowerConfig, PowerSource};
pub use estimate::Estimate;
pub use history::SpanEnergy;
pub use meter::{Domain, Meter, MeterError, Rail, Reading, Value, Values};
pub use none::NoMeter;
pub use rapl::Rapl;
pub use sampler::{PowerHandle, PowerNow, start, start_with};
