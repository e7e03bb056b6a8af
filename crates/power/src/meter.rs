//! What every power meter can do.

use super::condition::Condition;
use super::error::MeterError;
use super::reading::Reading;
use albireo_wire::EnergyQuality;
use std::time::Duration;
use tokio::time::Instant;

/// A power meter. Reading may block for some milliseconds, so the sampler calls it off the async
/// threads.
pub trait Meter: Send {
    /// The source's name in reports: `rapl`, `estimate`, …
    fn source(&self) -> &str;

    /// [`EnergyQuality::Measured`] or [`EnergyQuality::Estimated`]; [`EnergyQuality::Unavailable`] where there is no
    /// meter.
    fn quality(&self) -> EnergyQuality;

    /// What was read since the last call: one reading for a meter that is asked, none or several for one
    /// that delivers on its own. `now` is the time of the call.
    ///
    /// # Errors
    /// [`MeterError`] when nothing can be read now; the sampler counts it and asks again at the next
    /// interval.
    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError>;

    /// What the source tells of the board besides power, as of the last poll. Asked once a second.
    fn condition(&mut self) -> Condition {
        Condition::default()
    }

    /// CPU time the meter has used outside of [`poll`](Self::poll): threads and processes of its own.
    fn other_cpu(&self) -> Duration {
        Duration::ZERO
    }
}
