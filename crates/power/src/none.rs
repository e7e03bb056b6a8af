//! No meter: clips carry no energy.

use super::error::MeterError;
use super::meter::Meter;
use super::reading::Reading;
use albireo_wire::EnergyQuality;
use tokio::time::Instant;

/// Its name.
pub(super) const SOURCE: &str = "none";

/// Reads nothing, ever.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoMeter;

impl Meter for NoMeter {
    fn source(&self) -> &str {
        SOURCE
    }

    fn quality(&self) -> EnergyQuality {
        EnergyQuality::Unavailable
    }

    fn poll(&mut self, _now: Instant) -> Result<Vec<Reading>, MeterError> {
        Ok(Vec::new())
    }
}
