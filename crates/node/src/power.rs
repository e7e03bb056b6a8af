//! Power meters, one file each; sampling every 100 ms; exact integration over a span of time.
//!
//! ```text
//! a Meter (ina, tegrastats, rapl, nvml, …) ─ every interval_ms ─▶ History ─▶ integrate [start, end] ─▶ SpanEnergy
//! Machine (thermal zones, clocks, …) ─ every second ─▶ Conditions ─▶ BoardState
//! ```

mod battery;
mod child;
mod choose;
mod condition;
mod config;
mod cost;
mod counter;
mod error;
mod estimate;
mod gpu_load;
mod history;
mod ina;
pub mod integrate;
mod machine;
mod meter;
mod none;
mod nvml;
mod rails;
mod rapl;
mod reading;
pub(crate) mod sampler;
mod sum;
mod survey;
mod sysfs;
mod tegrastats;

pub use battery::Battery;
pub use choose::open;
pub use condition::Condition;
pub use config::{PowerConfig, PowerSource};
pub use cost::MeterCost;
pub use error::MeterError;
pub use estimate::Estimate;
pub use history::SpanEnergy;
pub use ina::Ina;
pub use meter::Meter;
pub(crate) use none::NoMeter;
pub use nvml::Nvml;
pub use rails::RailMap;
pub use rails::{RailTable, RailWatts};
pub use rapl::Rapl;
pub use reading::{Domain, Rail, Reading, Value, Values};
pub use sampler::{PowerHandle, PowerNow, start};
pub use sum::SumMeter;
pub use survey::{RailNow, SourceSurvey, survey};
pub use tegrastats::{Tegrastats, TegrastatsLine};
