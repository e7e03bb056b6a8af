//! Power from utilisation: `idle_watts + (busy_watts - idle_watts) × utilisation`, counted up as energy,
//! and the same for the GPU where its load can be read. It is a model and not a measurement, and is
//! marked estimated wherever it appears.
//!
//! CPU utilisation is the share of busy time in the first line of `/proc/stat` (proc_pid_stat(5), all cores
//! together): user, nice, system, irq and softirq against those and idle, iowait and steal.

use super::config::PowerConfig;
use super::error::MeterError;
use super::gpu_load::GpuLoad;
use super::meter::Meter;
use super::reading::{Domain, Rail, Reading, Value, Values};
use super::sysfs;
use albireo_wire::EnergyQuality;
use std::path::PathBuf;
use std::sync::Arc;
use tokio::time::Instant;

const SOURCE: &str = "estimate";

/// The estimate from utilisation.
#[derive(Debug)]
pub struct Estimate {
    stat: PathBuf,
    cpu: Model,
    gpu: Option<(GpuLoad, Model)>,
    formula: Arc<str>,
    last: Option<(Instant, Ticks)>,
}

/// Power as a straight line over utilisation, and the energy so far.
#[derive(Debug)]
struct Model {
    name: Arc<str>,
    idle_watts: f64,
    busy_watts: f64,
    watts: f64,
    joules: f64,
}

impl Model {
    fn new(name: &str, idle_watts: f64, busy_watts: f64) -> Self {
        Self {
            name: name.into(),
            idle_watts,
            busy_watts,
            watts: idle_watts,
            joules: 0.0,
        }
    }

    fn set(&mut self, utilisation: f64) {
        self.watts = self.idle_watts + (self.busy_watts - self.idle_watts) * utilisation;
    }

    fn rail(&self, domain: Option<Domain>) -> Rail {
        Rail {
            name: Arc::clone(&self.name),
            domain,
            in_total: true,
            value: Value::counter(self.joules),
        }
    }
}

/// Clock ticks since boot, all cores together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Ticks {
    busy: u64,
    all: u64,
}

impl Estimate {
    /// Opens `/proc/stat`.
    ///
    /// # Errors
    /// [`MeterError`] when there is no such file, or the configured watts make no sense.
    pub fn open(config: &PowerConfig) -> Result<Self, MeterError> {
        config.check()?;
        let gpu = GpuLoad::find(config);
        let range = |idle, busy| format!("{idle} W idle to {busy} W busy");
        let mut formula = format!(
            "estimated: {} by CPU utilisation",
            range(config.idle_watts, config.busy_watts)
        );
        if gpu.is_some() {
            let more = range(config.gpu_idle_watts, config.gpu_busy_watts);
            formula.push_str(&format!(", and {more} by GPU load"));
        }
        let meter = Self {
            stat: config.procfs.join("stat"),
            cpu: Model::new("CPU utilisation", config.idle_watts, config.busy_watts),
            gpu: gpu.map(|load| {
                let (idle, busy) = (config.gpu_idle_watts, config.gpu_busy_watts);
                (load, Model::new("GPU load", idle, busy))
            }),
            formula: formula.into(),
            last: None,
        };
        meter.ticks()?;
        Ok(meter)
    }

    fn ticks(&self) -> Result<Ticks, MeterError> {
        let text = sysfs::text(SOURCE, &self.stat)?;
        parse(&text).ok_or_else(|| MeterError::Unreadable {
            source_name: SOURCE,
            path: self.stat.clone(),
            reason: "its first line is not `cpu` with at least four numbers".to_owned(),
        })
    }
}

fn parse(stat: &str) -> Option<Ticks> {
    let mut words = stat.lines().next()?.split_ascii_whitespace();
    if words.next() != Some("cpu") {
        return None;
    }
    // user nice system idle iowait irq softirq steal; guest times are inside user and nice.
    let mut ticks = [0_u64; 8];
    let mut found = 0;
    for (slot, word) in ticks.iter_mut().zip(words) {
        *slot = word.parse().ok()?;
        found += 1;
    }
    let [user, nice, system, idle, iowait, irq, softirq, steal] = ticks;
    let busy = user + nice + system + irq + softirq;
    (found >= 4).then_some(Ticks {
        busy,
        all: busy + idle + iowait + steal,
    })
}

impl Meter for Estimate {
    fn source(&self) -> &str {
        SOURCE
    }

    fn quality(&self) -> EnergyQuality {
        EnergyQuality::Estimated
    }

    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError> {
        let ticks = self.ticks()?;
        let loaded = self.gpu.as_ref().and_then(|(load, _)| load.read());
        if let Some((then, before)) = self.last {
            let seconds = now.saturating_duration_since(then).as_secs_f64();
            let all = ticks.all.saturating_sub(before.all);
            // The kernel counts in ticks of 10 ms: within one tick the last figure still holds.
            if all > 0 {
                let busy = ticks.busy.saturating_sub(before.busy).min(all);
                self.cpu.set(busy as f64 / all as f64);
            }
            self.cpu.joules += self.cpu.watts * seconds;
            if let Some((_, gpu)) = &mut self.gpu {
                if let Some(load) = loaded {
                    gpu.set(load);
                }
                gpu.joules += gpu.watts * seconds;
            }
        }
        self.last = Some((now, ticks));
        let mut values = Values::default();
        let mut rails = vec![self.cpu.rail(None)];
        values.set(Domain::Total, Value::counter(self.cpu.joules));
        if let Some((_, gpu)) = &self.gpu {
            values.add(Domain::Total, Value::counter(gpu.joules));
            values.set(Domain::Gpu, Value::counter(gpu.joules));
            rails.push(gpu.rail(Some(Domain::Gpu)));
        }
        Ok(vec![Reading {
            at: Some(now),
            values,
            total_from: Arc::clone(&self.formula),
            rails,
        }])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn config(stat: &str) -> (tempfile::TempDir, PowerConfig) {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("stat"), stat).unwrap();
        let config = PowerConfig {
            procfs: folder.path().to_owned(),
            sysfs: folder.path().to_owned(),
            idle_watts: 4.0,
            busy_watts: 24.0,
            ..PowerConfig::default()
        };
        (folder, config)
    }

    #[test]
    fn half_busy_cores_cost_half_way_between_idle_and_busy() {
        let (folder, config) = config("cpu  100 0 100 800 0 0 0 0 0 0\ncpu0 1 2 3 4\n");
        let mut meter = Estimate::open(&config).unwrap();
        let start = Instant::now();
        meter.poll(start).unwrap();
        std::fs::write(
            folder.path().join("stat"),
            "cpu  140 0 110 850 0 0 0 0 0 0\n",
        )
        .unwrap();
        let readings = meter.poll(start + Duration::from_secs(2)).unwrap();
        let value = readings[0].values.get(Domain::Total);
        assert_eq!(value.joules, Some(28.0));
        assert_eq!(meter.quality(), EnergyQuality::Estimated);
    }

    #[test]
    fn a_gpu_whose_load_can_be_read_is_added_and_told_apart() {
        let (folder, config) = config("cpu 100 0 100 800\n");
        let gpu = folder.path().join("devices/platform/gpu.0");
        std::fs::create_dir_all(&gpu).unwrap();
        std::fs::write(gpu.join("load"), "500\n").unwrap();
        let mut meter = Estimate::open(&config).unwrap();
        let start = Instant::now();
        meter.poll(start).unwrap();
        std::fs::write(folder.path().join("stat"), "cpu 100 0 100 900\n").unwrap();
        let reading = meter
            .poll(start + Duration::from_secs(1))
            .unwrap()
            .remove(0);
        // Idle cores at 4 W, and a GPU half way between 1 W and 15 W.
        assert_eq!(reading.values.get(Domain::Total).joules, Some(12.0));
        assert_eq!(reading.values.get(Domain::Gpu).joules, Some(8.0));
        assert!(reading.total_from.contains("by GPU load"));
    }

    #[test]
    fn a_stat_file_of_another_kind_is_refused() {
        for text in ["", "intr 1 2 3", "cpu 1 2", "cpu 1 x 3 4"] {
            let (_folder, config) = config(text);
            assert!(Estimate::open(&config).is_err(), "{text:?}");
        }
    }

    #[test]
    fn busy_watts_below_idle_watts_are_refused() {
        let (_folder, mut config) = config("cpu 1 2 3 4");
        config.busy_watts = 1.0;
        let text = Estimate::open(&config).unwrap_err().to_string();
        assert!(text.contains("busy_watts"), "{text}");
    }
}
