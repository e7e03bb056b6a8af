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

const SOURCE: &str = "rapl";

/// The time for which `psys` is checked before it is used.
const WATCH_PLATFORM: Duration = Duration::from_millis(200);

/// The share of its parts' energy that `psys` must show: counters are not updated at the same moment.
const PLATFORM_AT_LEAST: f64 = 0.8;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Platform,
    Package,
    Core,
    Uncore,
    Dram,
    Other,
}

impl Kind {
    fn of(name: &str) -> Self {
        match name {
            "psys" => Self::Platform,
            "core" => Self::Core,
            "uncore" => Self::Uncore,
            "dram" => Self::Dram,
            _ if name.starts_with("package") => Self::Package,
            _ => Self::Other,
        }
    }

    const fn domain(self) -> Option<Domain> {
        match self {
            Self::Package => Some(Domain::Cpu),
            Self::Uncore => Some(Domain::Gpu),
            Self::Dram => Some(Domain::IoMem),
            Self::Platform | Self::Core | Self::Other => None,
        }
    }
}

/// One counter, extended to rise without end.
#[derive(Debug)]
struct Zone {
    kind: Kind,
    name: Arc<str>,
    energy: PathBuf,
    counter: Counter,
}

impl Zone {
    fn open(directory: &Path, label: Option<&str>) -> Result<Self, MeterError> {
        let name = sysfs::text(SOURCE, &directory.join("name"))?;
        let energy = directory.join("energy_uj");
        sysfs::number::<u64>(SOURCE, &energy)?;
        let range = sysfs::number(SOURCE, &directory.join("max_energy_range_uj"))?;
        Ok(Self {
            kind: Kind::of(&name),
            name: match label {
                Some(parent) => format!("{parent}/{name}").into(),
                None => name.into(),
            },
            energy,
            counter: Counter::new(1e-6, Some(range)),
        })
    }

    fn read(&mut self, now: Instant) -> Result<(), MeterError> {
        let raw = sysfs::number(SOURCE, &self.energy)?;
        if !self.counter.update(now, raw) {
            tracing::warn!(zone = %self.name, raw, "an energy counter was reset; counting continues from its new value");
        }
        Ok(())
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
        let mut platform = zones.iter().any(|z| z.kind == Kind::Platform);
        if !platform && !zones.iter().any(|z| z.kind == Kind::Package) {
            let reason = format!(
                "no package or psys counter under {} (it needs an Intel or AMD processor, Linux, and \
                 the kernel module intel_rapl_msr; virtual machines and containers often hide it)",
                root.display()
            );
            return Err(MeterError::missing(SOURCE, reason));
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

    /// True if the zone is part of the total.
    fn in_total(&self, kind: Kind) -> bool {
        match kind {
            Kind::Platform => true,
            Kind::Package | Kind::Dram => !self.platform,
            Kind::Core | Kind::Uncore | Kind::Other => false,
        }
    }
}

fn read(zones: &mut [Zone], now: Instant) -> Result<(), MeterError> {
    zones.iter_mut().try_for_each(|zone| zone.read(now))
}

/// True if the platform's counter covers the packages and their memory. On some machines it has a wrong unit or
/// does not move.
fn includes_its_parts(zones: &[Zone]) -> bool {
    let sum = |kinds: &[Kind]| -> f64 {
        let counted = zones.iter().filter(|z| kinds.contains(&z.kind));
        counted.map(|z| z.counter.joules()).sum()
    };
    sum(&[Kind::Platform]) >= PLATFORM_AT_LEAST * sum(&[Kind::Package, Kind::Dram])
}

fn find(root: &Path) -> Result<Vec<Zone>, MeterError> {
    let numbered = |path: &PathBuf| {
        let number = sysfs::name(path).rsplit_once(':').map(|(_, number)| number);
        number.is_some_and(|number| number.parse::<u32>().is_ok())
    };
    let tops = |kind: &'static str| {
        let entries = sysfs::entries(root).into_iter().filter(numbered);
        entries.filter(move |path| sysfs::name(path).split(':').next() == Some(kind))
    };
    let mut zones: Vec<Zone> = Vec::new();
    for top in tops("intel-rapl").chain(tops("intel-rapl-mmio")) {
        let zone = Zone::open(&top, None)?;
        if zones.iter().any(|known| known.name == zone.name) {
            continue;
        }
        let label = Arc::clone(&zone.name);
        zones.push(zone);
        let prefix = format!("{}:", sysfs::name(&top));
        for sub in sysfs::entries(&top) {
            if sysfs::name(&sub).starts_with(&prefix) {
                zones.push(Zone::open(&sub, Some(&label))?);
            }
        }
    }
    Ok(zones)
}

impl Meter for Rapl {
    fn source(&self) -> &str {
        SOURCE
    }

    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError> {
        read(&mut self.zones, now)?;
        let mut sums = [None; Domain::ALL.len()];
        let mut add = |domain: Domain, joules: f64| {
            *sums[domain as usize].get_or_insert(0.0) += joules;
        };
        let mut rails = Vec::with_capacity(self.zones.len());
        for zone in &self.zones {
            let joules = zone.counter.joules();
            let in_total = self.in_total(zone.kind);
            if in_total {
                add(Domain::Total, joules);
            }
            let domain = zone.kind.domain();
            if let Some(domain) = domain {
                add(domain, joules);
            }
            if zone.kind == Kind::Uncore {
                add(Domain::Cpu, -joules);
            }
            rails.push(Rail {
                name: Arc::clone(&zone.name),
                domain,
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
