//! Chooses the power meter: the configured one, or the best one on this machine.

use crate::config::{PowerConfig, PowerSource};
use crate::error::MeterError;
use crate::source::Command;
use crate::source::estimate::Estimate;
use crate::source::ina::Ina;
use crate::source::nvml::Nvml;
use crate::source::parts::Parts;
use crate::source::rapl::Rapl;
use crate::source::tegrastats::Tegrastats;
use crate::source::{Meter, NoMeter};
use albireo_wire::EnergyQuality;

/// The meters that `auto` tries, best first: the user's program, the whole board, the parts of a PC added up, one part,
/// then the estimate.
pub(crate) const BEST_FIRST: [PowerSource; 7] = [
    PowerSource::Command,
    PowerSource::Ina,
    PowerSource::Tegrastats,
    PowerSource::Parts,
    PowerSource::Rapl,
    PowerSource::Nvml,
    PowerSource::Estimate,
];

/// Opens the configured meter; also returns which one it is. May block for a fraction of a second, with `tegrastats` for
/// some seconds.
///
/// # Errors
/// [`MeterError`] if the configuration is invalid or a meter requested by name cannot be used here. `auto` falls back to
/// the estimate, which works wherever `/proc/stat` exists, then to none, and logs the fallback.
pub fn open(config: &PowerConfig) -> Result<(PowerSource, Box<dyn Meter>), MeterError> {
    if let Some((key, reason)) = config.problems().into_iter().next() {
        return Err(MeterError::Failed(format!("power.{key}: {reason}")));
    }
    open_source(config.source, config).map_err(|error| error.of(config.source.as_str()))
}

/// Opens the meter `source`; for `auto`, the best available one.
pub(crate) fn open_source(
    source: PowerSource,
    config: &PowerConfig,
) -> Result<(PowerSource, Box<dyn Meter>), MeterError> {
    let meter: Box<dyn Meter> = match source {
        PowerSource::Auto => return Ok(automatic(config)),
        PowerSource::Command => Box::new(Command::open(config)?),
        PowerSource::Ina => Box::new(Ina::open(config)?),
        PowerSource::Tegrastats => Box::new(Tegrastats::open(config)?),
        PowerSource::Rapl => Box::new(Rapl::open(config)?),
        PowerSource::Nvml => Box::new(Nvml::open(config)?),
        PowerSource::Parts => Box::new(Parts::open(config)?),
        PowerSource::Estimate => Box::new(Estimate::open(config)?),
        PowerSource::None => Box::new(NoMeter),
    };
    Ok((source, meter))
}

/// The first source that can be used, and what the log should know of it and of those before it.
fn automatic(config: &PowerConfig) -> (PowerSource, Box<dyn Meter>) {
    for source in BEST_FIRST {
        match open_source(source, config) {
            Ok((source, meter)) => {
                log_chosen(source, meter.quality());
                return (source, meter);
            }
            Err(error) => log_skipped(&error.of(source.as_str())),
        }
    }
    tracing::warn!("no power meter and no estimate: no energy figures");
    (PowerSource::None, Box::new(NoMeter))
}

fn log_chosen(source: PowerSource, quality: EnergyQuality) {
    if quality == EnergyQuality::Partial {
        tracing::warn!(
            source = source.as_str(),
            "the power meter does not read all that consumes much here (see `albireo power`)"
        );
    }
    if source == PowerSource::Estimate {
        tracing::info!(
            "no power meter: energy is estimated from utilisation (see `albireo power`)"
        );
    }
}

/// Warns only about a meter that exists but cannot be read.
fn log_skipped(why: &MeterError) {
    match why {
        MeterError::Missing(_) => tracing::debug!(%why, "power source skipped"),
        MeterError::Failed(_) => tracing::warn!(%why, "power source skipped"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::Tree;

    #[test]
    fn auto_prefers_the_board_monitor_then_counters_then_the_estimate() {
        let tree = Tree::default();
        let chosen = || open(&tree.config()).unwrap().0.as_str();
        assert_eq!(chosen(), "none");
        tree.write("proc/stat", "cpu 1 2 3 4 5 6 7 8");
        assert_eq!(chosen(), "estimate");
        tree.rapl("intel-rapl:0", "package-0", 1);
        assert_eq!(chosen(), "rapl");
        tree.ina3221("hwmon1", &[("VDD_IN", 5000, 1000)]);
        assert_eq!(chosen(), "ina");
    }

    #[rstest::rstest]
    fn a_missing_meter_selected_by_name_is_an_error(
        #[values("ina", "tegrastats", "rapl", "nvml", "rapl+nvml", "estimate")] source: &str,
    ) {
        let mut config = Tree::default().config();
        config.source = toml::Value::from(source).try_into().unwrap();
        let error = open(&config).err().unwrap();
        assert!(matches!(error, MeterError::Missing(_)), "{error}");
        assert!(
            error.to_string().starts_with(&format!("{source}: ")),
            "{error}"
        );
    }
}
