//! Which meter: the one asked for, or the best this machine has.

use super::config::{PowerConfig, PowerSource};
use super::error::MeterError;
use super::meter::Meter;
use super::{Battery, Estimate, Ina, NoMeter, Nvml, Rapl, SumMeter, Tegrastats};

/// The meters `auto` tries, best first: those of the whole board, those of a PC's parts, and then the
/// battery, whose figures are of the whole machine but seldom renewed.
const BEST_FIRST: [PowerSource; 6] = [
    PowerSource::Ina,
    PowerSource::Tegrastats,
    PowerSource::Sum,
    PowerSource::Rapl,
    PowerSource::Battery,
    PowerSource::Nvml,
];

/// Opens the configured meter. May block for a fraction of a second, `tegrastats` for some seconds.
///
/// # Errors
/// [`MeterError`] when the configuration makes no sense, or a meter asked for by name cannot be used here.
/// `auto` falls back to the estimate, which works wherever `/proc/stat` is, and then to none; it says so in
/// the log.
pub fn open(config: &PowerConfig) -> Result<Box<dyn Meter>, MeterError> {
    config.check()?;
    match config.source {
        PowerSource::Auto => Ok(automatic(config)),
        source => open_source(source, config),
    }
}

/// Opens the meter of that name; for `auto`, the one it would choose.
pub(super) fn open_source(
    source: PowerSource,
    config: &PowerConfig,
) -> Result<Box<dyn Meter>, MeterError> {
    Ok(match source {
        PowerSource::Auto => automatic(config),
        PowerSource::Ina => Box::new(Ina::open(config)?),
        PowerSource::Tegrastats => Box::new(Tegrastats::open(config)?),
        PowerSource::Rapl => Box::new(Rapl::open(config)?),
        PowerSource::Nvml => Box::new(Nvml::open(config)?),
        PowerSource::Battery => Box::new(Battery::open(config)?),
        PowerSource::Sum => {
            let members: Result<Vec<_>, _> =
                config.sum.iter().map(|s| open_source(*s, config)).collect();
            Box::new(SumMeter::new(members?)?)
        }
        PowerSource::Estimate => Box::new(Estimate::open(config)?),
        PowerSource::None => Box::new(NoMeter),
    })
}

fn automatic(config: &PowerConfig) -> Box<dyn Meter> {
    for source in BEST_FIRST {
        match open_source(source, config) {
            Ok(meter) => return meter,
            // A meter that is there and may not be read is worth a word; one that is not there is not.
            Err(why @ MeterError::Missing { .. }) => tracing::debug!(%why, "passed over"),
            Err(why) => tracing::warn!(%why, "passed over"),
        }
    }
    match Estimate::open(config) {
        Ok(meter) => {
            tracing::info!(
                "no power meter; energy is estimated from utilisation (see `albireo power`)"
            );
            Box::new(meter)
        }
        Err(why) => {
            tracing::warn!(%why, "no energy figures");
            Box::new(NoMeter)
        }
    }
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
    fn auto_takes_the_boards_monitor_before_counters_before_the_battery_before_the_estimate() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        // What the machine itself may have of NVIDIA's is not in this tree: take no card of it.
        let mut config = config(root);
        config.sum = vec![PowerSource::Rapl, PowerSource::Battery];
        let mut chosen = Vec::new();
        let mut ask = || chosen.push(open(&config).unwrap().source().to_owned());
        ask();
        write(root, "proc/stat", "cpu 1 2 3 4\n");
        ask();
        write(root, "sys/class/power_supply/BAT0/type", "Battery");
        write(root, "sys/class/power_supply/BAT0/status", "Discharging");
        write(root, "sys/class/power_supply/BAT0/power_now", "1000000");
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
        // Without a battery and a card in the way, `nvml` could still stand before these on a machine
        // that has one.
        assert_eq!(chosen[2..], ["battery", "sum(rapl+battery)", "ina"]);
        assert!(["none", "nvml"].contains(&&*chosen[0]), "{chosen:?}");
        assert!(["estimate", "nvml"].contains(&&*chosen[1]), "{chosen:?}");
    }

    #[test]
    fn a_meter_asked_for_by_name_that_is_not_there_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        for source in [
            PowerSource::Ina,
            PowerSource::Tegrastats,
            PowerSource::Rapl,
            PowerSource::Battery,
            PowerSource::Sum,
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
