//! Energy counters of Intel and AMD processors, through Linux powercap (`/sys/class/powercap`, kernel
//! documentation `power/powercap`).
//!
//! A package counter includes its subzones `core` and `uncore`, but not `dram`. `psys`, on some client
//! machines, counts the whole platform including the packages. `intel-rapl-mmio` zones count the same energy
//! as the `intel-rapl` zones of the same name and are skipped. On client processors `uncore` (PP1) is the
//! integrated GPU (Intel SDM volume 3, "RAPL domains"), so the GPU domain is `uncore` and the CPU domain is
//! the packages without it: no joule is in two domains.

use crate::config::PowerConfig;
use crate::counter::Counter;
use crate::error::MeterError;
use crate::meter::Meter;
use crate::reading::{Domain, INPUT_RAIL, Rail, Reading, SUM_OF_RAILS, Value};
use crate::sysfs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// The name of the platform's counter.
const PLATFORM: &str = "psys";

/// The time for which `psys` is checked before it is used.
const WATCH_PLATFORM: Duration = Duration::from_millis(200);

/// The share of its parts' energy that `psys` must show: counters are not updated at the same moment.
const PLATFORM_AT_LEAST: f64 = 0.8;

/// One counter of the machine.
#[derive(Debug)]
struct Zone {
    /// The domain that includes it besides the total, if any.
    domain: Option<Domain>,
    energy: PathBuf,
    counter: Counter,
}

impl Zone {
    fn open(directory: &Path, prefix: &str) -> Result<Self, MeterError> {
        let name = sysfs::text(&directory.join("name"))?;
        let energy = directory.join("energy_uj");
        sysfs::number::<u64>(&energy)?;
        let range = sysfs::number(&directory.join("max_energy_range_uj"))?;
        let domain = match &*name {
            "uncore" => Some(Domain::Gpu),
            "dram" => Some(Domain::IoMem),
            package if package.starts_with("package") => Some(Domain::Cpu),
            _ => None,
        };
        let name = format!("{prefix}{name}");
        Ok(Self {
            domain,
            energy,
            counter: Counter::new(name.into(), 1e-6, range),
        })
    }

    /// True if it is part of the total: the platform's counter, or without one the packages and their memory.
    fn in_total(&self, platform: bool) -> bool {
        match platform {
            true => &*self.counter.name == PLATFORM,
            false => matches!(self.domain, Some(Domain::Cpu | Domain::IoMem)),
        }
    }
}

/// The RAPL counters of this machine.
#[derive(Debug)]
pub(crate) struct Rapl {
    zones: Vec<Zone>,
    platform: bool,
}

impl Rapl {
    /// Finds the counters under `{sysfs}/class/powercap`.
    ///
    /// # Errors
    /// [`MeterError::Missing`] if there is none, [`MeterError::Failed`] if they cannot be read: since CVE-2020-8694
    /// only root may read them.
    pub(crate) fn open(config: &PowerConfig) -> Result<Self, MeterError> {
        let root = config.sysfs.join("class/powercap");
        let mut zones = find(&root)?;
        let mut platform = zones.iter().any(|zone| zone.in_total(true));
        if !platform && !zones.iter().any(|zone| zone.in_total(false)) {
            let reason = format!(
                "no package or psys counter under {} (it needs an Intel or AMD processor, Linux, and \
                 the kernel module intel_rapl_msr; virtual machines and containers often hide it)",
                root.display()
            );
            return Err(MeterError::missing(reason));
        }
        if platform {
            read(&mut zones, Instant::now())?;
            std::thread::sleep(WATCH_PLATFORM);
            read(&mut zones, Instant::now())?;
            platform = includes_its_parts(&zones);
            if !platform {
                tracing::warn!(
                    "the psys counter shows less energy than its packages; it is ignored"
                );
            }
        }
        Ok(Self { zones, platform })
    }
}

fn read(zones: &mut [Zone], now: Instant) -> Result<(), MeterError> {
    for zone in zones {
        let raw = sysfs::number(&zone.energy)?;
        zone.counter.update(now, raw);
    }
    Ok(())
}

/// True if the platform's counter covers the packages and their memory. On some machines it has a wrong unit or
/// does not move.
fn includes_its_parts(zones: &[Zone]) -> bool {
    let sum = |platform: bool| -> f64 {
        let counted = zones.iter().filter(|zone| zone.in_total(platform));
        counted.map(|zone| zone.counter.joules()).sum()
    };
    sum(true) >= PLATFORM_AT_LEAST * sum(false)
}

fn find(root: &Path) -> Result<Vec<Zone>, MeterError> {
    let mut tops = sysfs::entries(root);
    tops.retain(|path| {
        let kind = sysfs::name(path).rsplit_once(':').map(|(kind, _)| kind);
        matches!(kind, Some("intel-rapl" | "intel-rapl-mmio"))
    });
    tops.sort_by_key(|path| sysfs::name(path).starts_with("intel-rapl-mmio"));
    let mut zones: Vec<Zone> = Vec::new();
    for top in tops {
        let zone = Zone::open(&top, "")?;
        let name = Arc::clone(&zone.counter.name);
        if zones.iter().any(|known| known.counter.name == name) {
            continue;
        }
        zones.push(zone);
        let subs = format!("{}:", sysfs::name(&top));
        for sub in sysfs::entries(&top) {
            if sysfs::name(&sub).starts_with(&subs) {
                zones.push(Zone::open(&sub, &format!("{name}/"))?);
            }
        }
    }
    Ok(zones)
}

impl Meter for Rapl {
    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError> {
        read(&mut self.zones, now)?;
        let mut sums = [None; Domain::ALL.len()];
        let mut add = |domain: Domain, joules: f64| {
            *sums[domain as usize].get_or_insert(0.0) += joules;
        };
        let mut rails = Vec::with_capacity(self.zones.len());
        for zone in &self.zones {
            let joules = zone.counter.joules();
            let in_total = zone.in_total(self.platform);
            if in_total {
                add(Domain::Total, joules);
            }
            if let Some(domain) = zone.domain {
                add(domain, joules);
            }
            if zone.domain == Some(Domain::Gpu) {
                add(Domain::Cpu, -joules);
            }
            rails.push(Rail {
                name: Arc::clone(&zone.counter.name),
                domain: zone.domain,
                in_total,
                value: Value::Counter(joules),
            });
        }
        let total_from = match self.platform {
            true => INPUT_RAIL,
            false => SUM_OF_RAILS,
        };
        Ok(vec![Reading {
            at: None,
            values: sums.map(|sum| sum.map(Value::Counter)),
            total_from: total_from.into(),
            rails,
        }])
    }
}

#[cfg(test)]
mod tests;
