//! Tries every source and reports whether it can be used here, its rails, and its present watts.

use crate::choose;
use crate::config::PowerConfig;
use crate::error::MeterError;
use crate::reading::{Domain, Reading};
use crate::sampler::thread_cpu;
use crate::source::Meter;
use albireo_wire::EnergyQuality;
use serde::Serialize;
use std::time::Duration;
use tokio::time::Instant;

/// The time for which each source is read.
const WATCH: Duration = Duration::from_millis(1000);

/// The present state of one rail.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RailNow {
    /// The name.
    pub name: String,
    /// Watts: the value of a power monitor, or the mean rise of a counter.
    pub watts: Option<f64>,
    /// The domain that includes it, besides the total.
    pub domain: Option<&'static str>,
    /// True if it is part of the total.
    pub in_total: bool,
}

/// The survey of one source on this machine.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SourceSurvey {
    /// Its name in the configuration.
    pub source: &'static str,
    /// True if `source = "auto"` would choose it.
    pub automatic: bool,
    /// The reason it cannot be used here; `None` if it can.
    pub why_not: Option<String>,
    /// Measured or estimated.
    pub quality: EnergyQuality,
    /// The origin of the total.
    pub total_from: String,
    /// Present watts by domain.
    pub watts: Vec<(&'static str, f64)>,
    /// The rails.
    pub rails: Vec<RailNow>,
    /// CPU time of one read per `interval_ms`, as a share of one core.
    pub share_of_core: Option<f64>,
}

/// Opens every source in turn and reads it for one second. Blocks for some seconds.
pub fn survey(config: &PowerConfig) -> Vec<SourceSurvey> {
    let mut found: Vec<SourceSurvey> = Vec::new();
    for source in choose::BEST_FIRST {
        let opened = choose::open_source(source, config);
        let mut one = SourceSurvey {
            source: source.as_str(),
            automatic: opened.is_ok() && !found.iter().any(|better| better.automatic),
            ..SourceSurvey::default()
        };
        let watched = match opened {
            Ok((_, mut meter)) => one.watch(meter.as_mut(), config),
            Err(error) => Err(error),
        };
        one.why_not = watched.err().map(|error| error.of(source.as_str()).to_string());
        found.push(one);
    }
    found
}

impl SourceSurvey {
    fn watch(&mut self, meter: &mut dyn Meter, config: &PowerConfig) -> Result<(), MeterError> {
        let began = Instant::now();
        let before = thread_cpu();
        let mut read: Vec<(Instant, Reading)> = Vec::new();
        while began.elapsed() < WATCH {
            let now = Instant::now();
            for reading in meter.poll(now)? {
                read.push((reading.at.unwrap_or(now), reading));
            }
            std::thread::sleep(Duration::from_millis(config.interval_ms));
        }
        let cpu = thread_cpu().saturating_sub(before) + meter.other_cpu();
        self.quality = meter.quality();
        self.share_of_core = Some(cpu.as_secs_f64() / began.elapsed().as_secs_f64());
        let (Some((from, first)), Some((to, last))) = (read.first(), read.last()) else {
            return Ok(());
        };
        let seconds = (*to - *from).as_secs_f64();
        self.total_from = last.total_from.to_string();
        for domain in Domain::ALL {
            let Some(value) = last.value(domain) else {
                continue;
            };
            if let Some(watts) = value.mean_watts(first.value(domain), seconds) {
                self.watts.push((domain.as_str(), watts));
            }
        }
        for rail in &last.rails {
            let before = first.rails.iter().find(|earlier| earlier.name == rail.name);
            self.rails.push(RailNow {
                name: rail.name.to_string(),
                watts: rail.value.mean_watts(before.map(|rail| rail.value), seconds),
                domain: rail.domain.map(Domain::as_str),
                in_total: rail.in_total,
            });
        }
        Ok(())
    }
}
