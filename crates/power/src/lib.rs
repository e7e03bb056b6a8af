//! Power meters for boards and PCs, and the energy between two instants, divided between the cameras of a node.
//!
//! A [`Meter`] reads watts or counts joules: `ina` and `tegrastats` on Jetson boards, `rapl` and `nvml` added up on
//! PCs, a program of the user's, or an estimate from CPU utilisation. [`start`] opens one and samples it. Its
//! [`PowerHandle`] returns the present power, the energy since the start and, through a [`CameraEnergy`], the energy of
//! a clip: exact for any length in constant memory, complete or marked with the share of its time that samples cover. It
//! also learns the watts that a running detector adds, and estimates from them how much avoided calls saved.
//!
//! ```text
//! Meter ─ every interval_ms ─▶ running totals ─▶ two copies subtracted: a clip's energy
//! frames, detector calls ─▶ attribution to cameras ─┘
//! ```
//!
//! ```
//! # #[tokio::main(flavor = "current_thread")]
//! # async fn main() -> Result<(), albireo_power::MeterError> {
//! use albireo_power::{PowerConfig, PowerSource, start};
//! use std::time::Duration;
//! use tokio::time::Instant;
//!
//! let config = PowerConfig { source: PowerSource::Auto, ..PowerConfig::default() };
//! let stop = tokio_util::sync::CancellationToken::new();
//! let (power, sampler) = start(&config, stop.clone()).await?;
//!
//! let camera = power.camera();
//! let clip = camera.measure(Instant::now());
//! tokio::time::sleep(Duration::from_millis(500)).await;
//! camera.frame();
//! if let Some(used) = clip.finish(Instant::now(), Duration::MAX).await {
//!     let energy = used.energy;
//!     println!("{:?} J by {} ({:?})", energy.joules, energy.source, energy.quality);
//! }
//! stop.cancel();
//! let _ = sampler.await;
//! # Ok(())
//! # }
//! ```

mod choose;
mod config;
mod energy;
mod error;
mod machine;
mod measurement;
mod rails;
mod reading;
mod sampler;
mod source;
mod survey;
#[cfg(test)]
mod tests;

pub use choose::open;
pub use config::{PowerConfig, PowerSource};
pub use energy::account::Measured;
pub use error::MeterError;
pub use machine::board_state;
pub use measurement::{CameraEnergy, Measurement};
pub use rails::{RailMap, RailTable, RailWatts};
pub use reading::{Domain, PerDomain, Rail, Reading, Value, Values};
pub use sampler::{PowerHandle, PowerSnapshot, start, start_with};
pub use source::Meter;
pub use source::tegrastats::tegrastats_rails;
pub use survey::{RailNow, SourceSurvey, survey};
