//! A look at every source: whether it can be used here and why not, its rails, and watts now.

use super::choose;
use super::config::{PowerConfig, PowerSource};
use super::cost::thread_cpu;
use super::error::MeterError;
use super::meter::Meter;
use super::reading::{Domain, Reading, Value};
use albireo_wire::EnergyQuality;
use serde::Serialize;
use std::time::Duration;
use tokio::time::Instant;

/// The sources, in the order they are listed.
const SOURCES: [PowerSource; 7] = [
    PowerSource::Ina,
    PowerSource::Tegrastats,
    PowerSource::Rapl,
    PowerSource::Nvml,
    PowerSource::Battery,
    PowerSource::Sum,
    PowerSource::Estimate,
];

/// How long a source is watched.
const WATCH: Duration = Duration::from_millis(1000);

/// One rail, now.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RailNow {
    /// The name.
    pub name: String,
    /// Watts: what a power monitor reads, or the mean rise of a counter.
    pub watts: Option<f64>,
    /// The domain it is counted in, besides the total.
    pub domain: Option<&'static str>,
    /// Whether it is added up into the total.
    pub in_total: bool,
}

/// What one source is good for here.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SourceSurvey {
    /// Its name in the configuration.
    pub source: &'static str,
    /// Whether `source = "auto"` would take it.
    pub automatic: bool,
    /// Why it cannot be used here; `None` when it can.
    pub why_not: Option<String>,
    /// Measured or estimated.
    pub quality: EnergyQuality,
    /// How the total comes about.
    pub total_from: String,
    /// Watts now by domain.
    pub watts: Vec<(&'static str, f64)>,
    /// Rail by rail.
    pub rails: Vec<RailNow>,
    /// CPU time of reading it every `interval_ms`, as a share of one core.
    pub share_of_core: Option<f64>,
}

/// Opens every source in turn and watches it for a second. Blocks for some seconds.
pub fn survey(config: &PowerConfig) -> Vec<SourceSurvey> {
    let automatic = choose::open_source(PowerSource::Auto, config)
        .map(|meter| family(meter.source()).to_owned())
        .unwrap_or_default();
    SOURCES
        .into_iter()
        .map(|source| {
            let mut found = SourceSurvey {
                source: source.as_str(),
                automatic: automatic == source.as_str(),
                why_not: None,
                quality: EnergyQuality::Unavailable,
                total_from: String::new(),
                watts: Vec::new(),
                rails: Vec::new(),
                share_of_core: None,
            };
            let watched = choose::open_source(source, config)
                .and_then(|mut meter| found.watch(meter.as_mut(), config));
            found.why_not = watched.err().map(|error| error.to_string());
            found
        })
        .collect()
}

/// `sum` of `sum(rapl+nvml)`.
fn family(source: &str) -> &str {
    source.split('(').next().unwrap_or(source)
}

impl SourceSurvey {
    fn watch(&mut self, meter: &mut dyn Meter, config: &PowerConfig) -> Result<(), MeterError> {
        let interval = Duration::from_millis(config.interval_ms);
        let began = Instant::now();
        let mut first: Option<(Instant, Reading)> = None;
        let mut last: Option<(Instant, Reading)> = None;
        let (mut cpu, mut polls) = (Duration::ZERO, 0_u32);
        while began.elapsed() < WATCH {
            let now = Instant::now();
            let before = thread_cpu();
            let readings = meter.poll(now);
            cpu += thread_cpu().saturating_sub(before);
            polls += 1;
            for reading in readings? {
                let at = reading.at.unwrap_or(now);
                first.get_or_insert_with(|| (at, reading.clone()));
                last = Some((at, reading));
            }
            std::thread::sleep(interval);
        }
        let cpu = cpu + meter.other_cpu();
        self.quality = meter.quality();
        // What one interval's reading costs, whatever the length of this watch.
        self.share_of_core = Some(cpu.as_secs_f64() / f64::from(polls) / interval.as_secs_f64());
        if let (Some(first), Some(last)) = (first, last) {
            self.tell(&first, &last);
        }
        Ok(())
    }

    fn tell(&mut self, first: &(Instant, Reading), last: &(Instant, Reading)) {
        let seconds = last.0.saturating_duration_since(first.0).as_secs_f64();
        let watts = |before: Value, now: Value| -> Option<f64> {
            let rise = match (before.joules, now.joules) {
                (Some(before), Some(now)) if seconds > 0.0 => Some((now - before) / seconds),
                _ => None,
            };
            match (now.watts, rise) {
                (Some(power), rise) => Some(power + rise.unwrap_or(0.0)),
                (None, rise) => rise,
            }
        };
        self.total_from = last.1.total_from.to_string();
        self.watts = Domain::ALL
            .into_iter()
            .filter_map(|domain| {
                let (before, now) = (first.1.values.get(domain), last.1.values.get(domain));
                Some((domain.as_str(), watts(before, now)?))
            })
            .collect();
        self.rails = last
            .1
            .rails
            .iter()
            .map(|rail| {
                let before = first.1.rails.iter().find(|r| r.name == rail.name);
                RailNow {
                    name: rail.name.to_string(),
                    watts: watts(before.map(|r| r.value).unwrap_or_default(), rail.value),
                    domain: rail.domain.map(Domain::as_str),
                    in_total: rail.in_total,
                }
            })
            .collect();
    }
}
