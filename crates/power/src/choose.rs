//! Chooses the power meter: the one configured, or the best of this machine.

use crate::config::{PowerConfig, PowerSource};
use crate::error::MeterError;
use crate::estimate::Estimate;
use crate::ina::Ina;
use crate::meter::{Meter, NoMeter};
use crate::nvml::Nvml;
use crate::rapl::Rapl;
use crate::tegrastats::Tegrastats;

/// The meters `auto` tries, best first: those of the whole board, then those of a PC's parts, then the estimate.
pub(crate) const BEST_FIRST: [PowerSource; 5] = [
    PowerSource::Ina,
    PowerSource::Tegrastats,
    PowerSource::Rapl,
    PowerSource::Nvml,
    PowerSource::Estimate,
];

/// Opens the configured meter. May block for a fraction of a second, `tegrastats` for some seconds.
///
/// # Errors
/// [`MeterError`] when the configuration makes no sense, or a meter asked for by name cannot be used here.
/// `auto` falls back to the estimate, which works wherever `/proc/stat` is, and then to none; the log says so.
pub fn open(config: &PowerConfig) -> Result<Box<dyn Meter>, MeterError> {
    config.check()?;
    open_source(config.source, config)
}

/// Opens the meter of that name; for `auto`, the one it would choose.
pub(crate) fn open_source(
    source: PowerSource,
    config: &PowerConfig,
) -> Result<Box<dyn Meter>, MeterError> {
    Ok(match source {
        PowerSource::Auto => automatic(config),
        PowerSource::Ina => Box::new(Ina::open(config)?),
        PowerSource::Tegrastats => Box::new(Tegrastats::open(config)?),
        PowerSource::Rapl => Box::new(Rapl::open(config)?),
        PowerSource::Nvml => Box::new(Nvml::open(config)?),
        PowerSource::Estimate => Box::new(Estimate::open(config)?),
        PowerSource::None => Box::new(NoMeter),
    })
}

fn automatic(config: &PowerConfig) -> Box<dyn Meter> {
    for source in BEST_FIRST {
        match open_source(source, config) {
            Ok(meter) => {
                if source == PowerSource::Estimate {
                    tracing::info!(
                        "no power meter: energy is estimated from utilisation (see `albireo power`)"
                    );
                }
                return meter;
            }
            // A meter that is there and may not be read is worth a line; one that is not there is not.
            Err(why @ MeterError::Missing { .. }) => tracing::debug!(%why, "passed over"),
            Err(why) => tracing::warn!(%why, "passed over"),
        }
    }
    tracing::warn!("no power meter and no estimate: no energy figures");
    Box::new(NoMeter)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(root: &std::path::Path, file: &str, text: &str) {
        let path = root.join(file);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }

    fn config(root: &std::path::Path) -> PowerConfig {
        PowerConfig {
            sysfs: root.join("sys"),
            procfs: root.join("proc"),
            tegrastats: root.join("tegrastats"),
            ..PowerConfig::default()
        }
    }

    #[test]
    fn auto_takes_the_boards_monitor_before_counters_before_the_estimate() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let config = config(root);
        let mut chosen = Vec::new();
        let mut ask = || chosen.push(open(&config).unwrap().source().to_owned());
        ask();
        write(root, "proc/stat", "cpu 1 2 3 4\n");
        ask();
        let zone = "sys/class/powercap/intel-rapl:0";
        write(root, &format!("{zone}/name"), "package-0");
        write(root, &format!("{zone}/energy_uj"), "1");
        write(root, &format!("{zone}/max_energy_range_uj"), "100");
        ask();
        write(root, "sys/class/hwmon/hwmon1/name", "ina3221");
        write(root, "sys/class/hwmon/hwmon1/in1_label", "VDD_IN");
        write(root, "sys/class/hwmon/hwmon1/in1_input", "5000");
        write(root, "sys/class/hwmon/hwmon1/curr1_input", "1000");
        ask();
        // A card of the machine that this runs on is not in the tree: `nvml` may come first.
        assert!(["none", "nvml"].contains(&&*chosen[0]), "{chosen:?}");
        assert!(["estimate", "nvml"].contains(&&*chosen[1]), "{chosen:?}");
        assert_eq!(chosen[2..], ["rapl", "ina"]);
    }

    #[test]
    fn a_meter_asked_for_by_name_that_is_not_there_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        for source in [
            PowerSource::Ina,
            PowerSource::Tegrastats,
            PowerSource::Rapl,
            PowerSource::Estimate,
        ] {
            let config = PowerConfig {
                source,
                ..config(folder.path())
            };
            let error = open(&config).err().unwrap();
            assert!(matches!(error, MeterError::Missing { .. }), "{error}");
        }
    }
}
