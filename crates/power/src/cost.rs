//! What the meter itself costs.

use std::time::Duration;

/// CPU time spent on reading the meter, and how long it has been read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MeterCost {
    /// Readings asked for.
    pub polls: u64,
    /// CPU time of all of them, child processes included where the system tells it.
    pub cpu: Duration,
    /// Time since sampling began.
    pub elapsed: Duration,
}

impl MeterCost {
    /// CPU time as a share of one core, 0 to 1 (and more, for more than a core).
    pub fn share_of_core(&self) -> f64 {
        if self.elapsed.is_zero() {
            0.0
        } else {
            self.cpu.as_secs_f64() / self.elapsed.as_secs_f64()
        }
    }
}

/// CPU time of the calling thread since it was started.
pub(super) fn thread_cpu() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    let seconds = u64::try_from(time.tv_sec).unwrap_or(0);
    Duration::new(seconds, u32::try_from(time.tv_nsec).unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::super::machine::Machine;
    use super::super::{PowerConfig, PowerSource, choose};
    use super::*;
    use std::path::Path;
    use tokio::time::Instant;

    /// What a board's, a PC's and a laptop's trees hold, with more files than most have.
    fn tree(root: &Path) {
        let write = |file: String, text: &str| {
            let path = root.join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        };
        for chip in 1..=2 {
            let file = |name: String| format!("class/hwmon/hwmon{chip}/{name}");
            write(file("name".to_owned()), "ina3221\n");
            for channel in 1..=3 {
                write(
                    file(format!("in{channel}_label")),
                    &format!("RAIL{chip}{channel}\n"),
                );
                write(file(format!("in{channel}_input")), "5000\n");
                write(file(format!("curr{channel}_input")), "1200\n");
            }
        }
        for package in 0..2 {
            let zones = [
                ("", "package"),
                (":0", "core"),
                (":1", "uncore"),
                (":2", "dram"),
            ];
            for (sub, name) in zones {
                let top = format!("class/powercap/intel-rapl:{package}");
                let zone = match sub {
                    "" => top,
                    sub => format!("{top}/intel-rapl:{package}{sub}"),
                };
                let label = if sub.is_empty() {
                    format!("{name}-{package}")
                } else {
                    name.to_owned()
                };
                write(format!("{zone}/name"), &label);
                write(format!("{zone}/energy_uj"), "123456789012\n");
                write(format!("{zone}/max_energy_range_uj"), "262143328850\n");
            }
        }
        let battery = "class/power_supply/BAT0";
        for (file, text) in [
            ("type", "Battery"),
            ("status", "Discharging"),
            ("current_now", "1500000"),
            ("voltage_now", "12000000"),
        ] {
            write(format!("{battery}/{file}"), text);
        }
        for zone in 0..10 {
            write(
                format!("class/thermal/thermal_zone{zone}/type"),
                "cpu-thermal\n",
            );
            write(format!("class/thermal/thermal_zone{zone}/temp"), "45000\n");
        }
        for cpu in 0..8 {
            let file = format!("devices/system/cpu/cpu{cpu}/cpufreq/scaling_cur_freq");
            write(file, "1500000\n");
        }
        write("proc/stat".to_owned(), "cpu 100 0 100 800 0 0 0 0 0 0\n");
    }

    #[test]
    fn each_source_of_files_takes_less_than_half_a_percent_of_a_core_at_ten_samples_a_second() {
        let folder = tempfile::tempdir().unwrap();
        tree(folder.path());
        for source in [
            PowerSource::Ina,
            PowerSource::Rapl,
            PowerSource::Battery,
            PowerSource::Estimate,
        ] {
            let config = PowerConfig {
                source,
                sysfs: folder.path().to_owned(),
                procfs: folder.path().join("proc"),
                nvpmodel: folder.path().join("nvpmodel"),
                ..PowerConfig::default()
            };
            let mut meter = choose::open(&config).unwrap();
            let mut machine = Machine::new(&config);
            let seconds = 30;
            let before = thread_cpu();
            for _ in 0..seconds {
                // Once a second the machine's condition, ten times the meter, as the sampler does.
                machine.read(Instant::now());
                for _ in 0..10 {
                    meter.poll(Instant::now()).unwrap();
                }
            }
            let cpu = thread_cpu().saturating_sub(before) + meter.other_cpu();
            let share = cpu.as_secs_f64() / f64::from(seconds);
            println!("{}: {:.3} % of one core", source.as_str(), share * 100.0);
            assert!(share < 0.005, "{}: {share}", source.as_str());
        }
    }
}
