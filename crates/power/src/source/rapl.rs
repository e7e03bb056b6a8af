//! Reads the energy counters of Intel and AMD processors, through Linux powercap (`/sys/class/powercap`, kernel
//! documentation `power/powercap`).
//!
//! A package counter includes its subzones `core` and `uncore`, but not `dram`. `psys`, on some client
//! machines, counts the whole platform including the packages; beside a graphics card it is not used, because no
//! documentation says whether it includes the card. `intel-rapl-mmio` zones count the same energy
//! as the `intel-rapl` zones of the same name and are skipped. On client processors `uncore` (PP1) is the
//! integrated GPU (Intel SDM volume 3, "RAPL domains"), so the GPU domain is `uncore` and the CPU domain is
//! the packages without it: no joule is in two domains.

use crate::config::PowerConfig;
use crate::error::MeterError;
use crate::reading::{Domain, PerDomain, Rail, Reading, Value};
use crate::source::Meter;
use crate::source::counter::Counter;
use crate::source::parts;
use crate::source::sysfs;
use albireo_wire::EnergyQuality;
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
        // Fails here if the counter may not be read, as on most systems without root.
        sysfs::number::<u64>(&energy)?;
        // Without a range, a wrap looks like a reset, which loses one interval and not the zone.
        let range = sysfs::number(&directory.join("max_energy_range_uj")).unwrap_or(u64::MAX);
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

    /// True if it is part of this total.
    fn counts_for(&self, whole: Whole) -> bool {
        match whole {
            Whole::Platform => &*self.counter.name == PLATFORM,
            Whole::Packages => matches!(self.domain, Some(Domain::Cpu | Domain::IoMem)),
        }
    }
}

/// What the total counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Whole {
    /// The platform, by its own counter.
    Platform,
    /// The packages and their memory.
    Packages,
}

/// The RAPL counters of this machine.
#[derive(Debug)]
pub(crate) struct Rapl {
    zones: Vec<Zone>,
    whole: Whole,
    /// Graphics cards of this machine, which these counters do not include.
    cards: usize,
}

impl Rapl {
    /// Finds the counters under `{sysfs}/class/powercap`.
    ///
    /// # Errors
    /// [`MeterError::Missing`] if there is none, [`MeterError::Failed`] if they cannot be read: since CVE-2020-8694
    /// only root may read them.
    pub(crate) fn open(config: &PowerConfig) -> Result<Self, MeterError> {
        Self::beside(config, parts::cards(&config.sysfs))
    }

    /// Like [`open`](Self::open), on a machine with this number of graphics cards.
    pub(super) fn beside(config: &PowerConfig, cards: usize) -> Result<Self, MeterError> {
        let root = config.sysfs.join("class/powercap");
        let mut zones = find(&root)?;
        let has = |whole: Whole| zones.iter().any(|zone| zone.counts_for(whole));
        let mut whole = if cards == 0 && has(Whole::Platform) {
            Whole::Platform
        } else {
            Whole::Packages
        };
        if !has(whole) {
            let reason = format!(
                "no package or psys counter under {} (it needs an Intel or AMD processor, Linux, and \
                 the kernel module intel_rapl_msr; virtual machines and containers often hide it)",
                root.display()
            );
            return Err(MeterError::missing(reason));
        }
        if whole == Whole::Platform {
            read(&mut zones, Instant::now())?;
            std::thread::sleep(WATCH_PLATFORM);
            read(&mut zones, Instant::now())?;
            if !includes_its_parts(&zones) {
                whole = Whole::Packages;
                tracing::warn!(
                    "the psys counter shows less energy than its packages; it is ignored"
                );
            }
        }
        Ok(Self {
            zones,
            whole,
            cards,
        })
    }

    /// The parts of the machine that the total includes, in words.
    pub(super) fn parts(&self) -> &'static str {
        let has_memory = self.zones.iter().any(|zone| zone.domain == Some(Domain::IoMem));
        if self.whole == Whole::Platform {
            "platform (psys)"
        } else if has_memory {
            "processor + memory"
        } else {
            "processor"
        }
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
    let joules = |whole: Whole| -> f64 {
        zones
            .iter()
            .filter(|zone| zone.counts_for(whole))
            .map(|zone| zone.counter.joules())
            .sum()
    };
    joules(Whole::Platform) >= PLATFORM_AT_LEAST * joules(Whole::Packages)
}

/// The zones under `root`, each package before its parts.
fn find(root: &Path) -> Result<Vec<Zone>, MeterError> {
    let mut tops = sysfs::entries(root);
    tops.retain(|path| {
        let kind = sysfs::name(path).rsplit_once(':').map(|(kind, _)| kind);
        matches!(kind, Some("intel-rapl" | "intel-rapl-mmio"))
    });
    // The duplicates come last, so that they are known as such.
    tops.sort_by_key(|path| sysfs::name(path).starts_with("intel-rapl-mmio"));
    let mut zones: Vec<Zone> = Vec::new();
    for top in tops {
        let zone = match Zone::open(&top, "") {
            Ok(zone) => zone,
            // Without a package the total would be too small; every other zone can be left out.
            Err(error) if is_package(&top) => return Err(error),
            Err(error) => {
                tracing::warn!(zone = %top.display(), %error, "an energy counter is left out");
                continue;
            }
        };
        let name = Arc::clone(&zone.counter.name);
        if zones.iter().any(|known| known.counter.name == name) {
            continue;
        }
        zones.push(zone);
        let sub_prefix = format!("{}:", sysfs::name(&top));
        for sub in sysfs::entries(&top) {
            if !sysfs::name(&sub).starts_with(&sub_prefix) {
                continue;
            }
            match Zone::open(&sub, &format!("{name}/")) {
                Ok(zone) => zones.push(zone),
                // The package's counter is worth more than its parts.
                Err(error) => {
                    tracing::warn!(zone = %sub.display(), %error, "an energy counter is left out");
                }
            }
        }
    }
    Ok(zones)
}

/// True for a zone that counts a processor package and is no duplicate of another.
fn is_package(zone: &Path) -> bool {
    let name = sysfs::text(&zone.join("name")).unwrap_or_default();
    name.starts_with("package") && !sysfs::name(zone).starts_with("intel-rapl-mmio")
}

impl Meter for Rapl {
    fn quality(&self) -> EnergyQuality {
        parts::quality(self.cards == 0)
    }

    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError> {
        read(&mut self.zones, now)?;
        let mut sums = PerDomain::<Option<f64>>::default();
        let mut add = |domain: Domain, joules: f64| {
            *sums[domain].get_or_insert(0.0) += joules;
        };
        let mut rails = Vec::with_capacity(self.zones.len());
        for zone in &self.zones {
            let joules = zone.counter.joules();
            let in_total = zone.counts_for(self.whole);
            if in_total {
                add(Domain::Total, joules);
            }
            if let Some(domain) = zone.domain {
                add(domain, joules);
            }
            // The package's counter includes it.
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
        let left_out = parts::without_cards(self.cards);
        Ok(vec![Reading {
            at: None,
            values: PerDomain::each(|domain| sums[domain].map(Value::Counter)),
            total_from: parts::total_from(self.parts(), left_out.as_slice()).into(),
            rails,
        }])
    }
}

#[cfg(test)]
mod tests;
