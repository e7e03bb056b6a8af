//! Power meters, one file each; sampling; energy summed up as it is used, exact for a clip of any length.
//!
//! ```text
//! a Meter (ina, tegrastats, rapl, nvml, …) ─ every interval_ms ─▶ Series ─▶ Ledger ─▶ SpanEnergy of a clip
//! Machine (thermal zones, clocks, …) ─ every second ─▶ Conditions ─┘  └▶ BoardState
//! frames and runs of the detector, by camera ─▶ Shares ─┘
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
mod ina;
mod ledger;
mod machine;
mod meter;
mod none;
mod nvml;
mod rails;
mod rapl;
mod reading;
pub mod sampler;
mod series;
mod shares;
mod sum;
mod survey;
mod sysfs;
mod tegrastats;
mod user;

pub use battery::Battery;
pub use choose::open;
pub use condition::Condition;
pub use config::{PowerConfig, PowerSource};
pub use cost::MeterCost;
pub use error::MeterError;
pub use estimate::Estimate;
pub use ina::Ina;
pub use ledger::SpanEnergy;
pub use meter::Meter;
pub use none::NoMeter;
pub use nvml::Nvml;
pub use rails::RailMap;
pub use rails::{RailTable, RailWatts};
pub use rapl::Rapl;
pub use reading::{Domain, Rail, Reading, Value, Values};
pub use sampler::{EnergySoFar, PowerHandle, PowerNow, start};
pub use sum::SumMeter;
pub use survey::{RailNow, SourceSurvey, survey};
pub use tegrastats::{Tegrastats, TegrastatsLine};
pub use user::{EnergyUser, OpenSpan};
