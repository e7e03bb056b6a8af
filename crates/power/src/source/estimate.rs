//! Estimates power from CPU utilisation: `idle_watts + (busy_watts - idle_watts) × utilisation`, integrated to energy.
//! It is a model, not a measurement, and is marked estimated everywhere.
//!
//! Utilisation is the share of busy time in the first line of `/proc/stat` (proc_pid_stat(5), all cores together):
//! user, nice, system, irq and softirq, divided by these plus idle, iowait and steal.

use crate::config::PowerConfig;
use crate::error::MeterError;
use crate::reading::{Reading, Value, Values};
use crate::source::Meter;
use crate::source::sysfs;
use albireo_wire::EnergyQuality;
use std::path::PathBuf;
use tokio::time::Instant;

/// The estimate from CPU utilisation.
#[derive(Debug)]
pub(crate) struct Estimate {
    stat: PathBuf,
    idle_watts: f64,
    busy_watts: f64,
    /// The last poll, and the clock ticks then.
    last: Option<(Instant, Ticks)>,
    watts: f64,
    joules: f64,
}

/// Clock ticks since boot, all cores together.
#[derive(Clone, Copy, Debug)]
struct Ticks {
    busy: u64,
    all: u64,
}

impl Estimate {
    /// Opens `/proc/stat`.
    ///
    /// # Errors
    /// [`MeterError`] if the file does not exist or is invalid.
    pub(crate) fn open(config: &PowerConfig) -> Result<Self, MeterError> {
        let meter = Self {
            stat: config.procfs.join("stat"),
            idle_watts: config.idle_watts,
            busy_watts: config.busy_watts,
            last: None,
            watts: config.idle_watts,
            joules: 0.0,
        };
        meter.ticks()?;
        Ok(meter)
    }

    fn ticks(&self) -> Result<Ticks, MeterError> {
        let text = sysfs::text(&self.stat)?;
        let numbers = text.strip_prefix("cpu ").unwrap_or_default();
        let ticks: Vec<u64> = numbers
            .split_ascii_whitespace()
            .map_while(|number| number.parse().ok())
            .collect();
        // Two more follow: guest times, which user and nice include.
        let [user, nice, system, idle, iowait, irq, softirq, steal, ..] = ticks[..] else {
            let reason = "its first line is not `cpu` with at least eight numbers";
            return Err(MeterError::unreadable(&self.stat, reason));
        };
        let busy = user + nice + system + irq + softirq;
        let all = busy + idle + iowait + steal;
        Ok(Ticks { busy, all })
    }
}

impl Meter for Estimate {
    fn quality(&self) -> EnergyQuality {
        EnergyQuality::Estimated
    }

    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError> {
        let ticks = self.ticks()?;
        if let Some((then, before)) = self.last.replace((now, ticks)) {
            let all = ticks.all.saturating_sub(before.all);
            // The kernel counts in ticks of 10 ms: within one tick, the last figure still holds.
            if all > 0 {
                let busy = ticks.busy.saturating_sub(before.busy).min(all);
                let utilisation = busy as f64 / all as f64;
                self.watts = self.idle_watts + (self.busy_watts - self.idle_watts) * utilisation;
            }
            self.joules += self.watts * now.saturating_duration_since(then).as_secs_f64();
        }
        let idle = self.idle_watts;
        let busy = self.busy_watts;
        let formula = format!("estimated: {idle} W idle to {busy} W busy by CPU utilisation");
        Ok(vec![Reading {
            at: Some(now),
            values: Values {
                total: Some(Value::Counter(self.joules)),
                ..Values::default()
            },
            total_from: formula.into(),
            rails: Vec::new(),
        }])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reading::Domain;
    use crate::tests::Tree;
    use std::time::Duration;

    fn open(tree: &Tree, stat: &str) -> Result<Estimate, MeterError> {
        tree.write("proc/stat", stat);
        Estimate::open(&PowerConfig {
            idle_watts: 4.0,
            busy_watts: 24.0,
            ..tree.config()
        })
    }

    #[test]
    fn half_load_draws_halfway_between_idle_and_busy_power() {
        let tree = Tree::default();
        let mut meter = open(&tree, "cpu  100 0 100 800 0 0 0 0 0 0\ncpu0 1 2 3 4").unwrap();
        let start = Instant::now();
        meter.poll(start).unwrap();
        tree.write("proc/stat", "cpu  140 0 110 850 0 0 0 0 0 0");
        let readings = meter.poll(start + Duration::from_secs(2)).unwrap();
        assert_eq!(readings[0].value(Domain::Total), Some(Value::Counter(28.0)));
        assert_eq!(meter.quality(), EnergyQuality::Estimated);
    }

    #[test]
    fn a_malformed_stat_file_is_rejected() {
        for text in ["", "intr 1 2 3", "cpu 1 2", "cpu 1 x 3 4 5 6 7 8"] {
            assert!(open(&Tree::default(), text).is_err(), "{text:?}");
        }
    }
}
