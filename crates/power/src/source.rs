//! The power meters, and the trait that all of them have.

mod child;
mod command;
mod counter;
pub(crate) mod estimate;
pub(crate) mod ina;
pub(crate) mod nvml;
pub(crate) mod parts;
pub(crate) mod rapl;
pub(crate) mod sysfs;
pub(crate) mod tegrastats;

pub(crate) use command::Command;

use crate::error::MeterError;
use crate::reading::Reading;
use albireo_wire::{BoardState, EnergyQuality};
use std::time::Duration;
use tokio::time::Instant;

/// A power meter. Reading may block for some milliseconds, so the sampler calls it outside the async threads.
pub trait Meter: Send {
    /// [`EnergyQuality::Measured`]; [`EnergyQuality::Partial`] if a part of the machine whose consumption matters is not
    /// read; [`EnergyQuality::Estimated`]; [`EnergyQuality::Unavailable`] without a meter.
    fn quality(&self) -> EnergyQuality {
        EnergyQuality::Measured
    }

    /// Returns the readings since the last call: one from a meter that is polled, any number from one that delivers by
    /// itself. `now` is the time of the call.
    ///
    /// # Errors
    /// [`MeterError`] if nothing can be read now; the sampler counts it and tries again at the next interval.
    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError>;

    /// The board's condition as far as the source reads it, at the last poll. Called once per second.
    fn condition(&mut self) -> BoardState {
        BoardState::default()
    }

    /// CPU time the meter has used outside [`poll`](Self::poll), in child processes.
    fn other_cpu(&self) -> Duration {
        Duration::ZERO
    }
}

/// No meter: it reads nothing, and clips carry no energy.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct NoMeter;

impl Meter for NoMeter {
    fn quality(&self) -> EnergyQuality {
        EnergyQuality::Unavailable
    }

    fn poll(&mut self, _now: Instant) -> Result<Vec<Reading>, MeterError> {
        Ok(Vec::new())
    }
}
