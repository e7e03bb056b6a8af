//! Which meter: the one asked for, or the best this machine has.

use super::config::{PowerConfig, PowerSource};
use super::meter::{Meter, MeterError};
use super::{Estimate, NoMeter, Rapl};

/// Opens the configured meter. May block for a fraction of a second.
///
/// # Errors
/// [`MeterError`] when a meter asked for by name cannot be used here. `auto` falls back to the estimate,
/// which works wherever `/proc/stat` is, and then to none; it says so in the log.
pub fn open(config: &PowerConfig) -> Result<Box<dyn Meter>, MeterError> {
    Ok(match config.source {
        PowerSource::Auto => automatic(config),
        PowerSource::Rapl => Box::new(Rapl::open(config)?),
        PowerSource::Estimate => Box::new(Estimate::open(config)?),
        PowerSource::None => Box::new(NoMeter),
    })
}

fn automatic(config: &PowerConfig) -> Box<dyn Meter> {
    match Rapl::open(config) {
        Ok(meter) => return Box::new(meter),
        Err(why) => {
            tracing::info!(%why, "no power meter; energy will be estimated from utilisation")
        }
    }
    match Estimate::open(config) {
        Ok(meter) => Box::new(meter),
        Err(why) => {
            tracing::warn!(%why, "no energy figures");
            Box::new(NoMeter)
        }
    }
}
