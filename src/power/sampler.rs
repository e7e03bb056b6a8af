//! The task that reads the meter at every interval, and the handle that answers for it.

use super::choose;
use super::config::PowerConfig;
use super::history::{History, SpanEnergy};
use super::meter::{Meter, MeterError, Reading};
use crate::wire::{DomainWatts, EnergyQuality};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{Instant, MissedTickBehavior};
use tokio_util::sync::CancellationToken;

/// Power now.
#[derive(Clone, Debug, PartialEq)]
pub struct PowerNow {
    /// The source's name.
    pub source: String,
    /// How far to trust it: [`EnergyQuality::Unavailable`] when there is no fresh sample.
    pub quality: EnergyQuality,
    /// Watts by domain; empty when there is no fresh sample.
    pub watts: Vec<DomainWatts>,
}

/// What the sampler and its handles share. The lock is held for microseconds and never over a read.
#[derive(Debug)]
struct Shared {
    source: String,
    quality: EnergyQuality,
    interval: Duration,
    history: Mutex<History>,
    failures: std::sync::atomic::AtomicU64,
}

impl Shared {
    fn history(&self) -> MutexGuard<'_, History> {
        self.history.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Answers for the energy of any span of the kept history. Cheap to clone; never waits for the meter.
#[derive(Clone, Debug)]
pub struct PowerHandle {
    shared: Arc<Shared>,
    sampled: watch::Receiver<Option<Instant>>,
}

impl PowerHandle {
    /// Energy of the node over `[start, end]`, from the samples there are now.
    pub fn energy(&self, start: Instant, end: Instant) -> SpanEnergy {
        let shared = &self.shared;
        shared
            .history()
            .energy(start, end, &shared.source, shared.quality)
    }

    /// As [`energy`](Self::energy), but waits until a sample later than `end` is in, so that the end of
    /// the span is interpolated and not held. Gives up waiting after three intervals or when the sampler
    /// has stopped, and answers with what there is.
    pub async fn settled_energy(&self, start: Instant, end: Instant) -> SpanEnergy {
        let mut sampled = self.sampled.clone();
        let later = sampled.wait_for(|newest| newest.is_some_and(|at| at >= end));
        let patience = 3 * self.shared.interval + Duration::from_millis(50);
        let _ = tokio::time::timeout(patience, later).await;
        self.energy(start, end)
    }

    /// Power now.
    pub fn now(&self) -> PowerNow {
        let watts = self.shared.history().watts(Instant::now());
        PowerNow {
            source: self.shared.source.clone(),
            quality: if watts.is_empty() {
                EnergyQuality::Unavailable
            } else {
                self.shared.quality
            },
            watts,
        }
    }

    /// The source's name: `rapl`, `estimate`, `none`, …
    pub fn source(&self) -> &str {
        &self.shared.source
    }

    /// How often the meter could not be read.
    pub fn failed_reads(&self) -> u64 {
        self.shared
            .failures
            .load(std::sync::atomic::Ordering::Relaxed)
    }
}

/// Opens the configured meter and starts sampling it until `shutdown`. Samples are kept for `keep`, and
/// at least ten minutes: give it twice the longest clip.
///
/// # Errors
/// [`MeterError`] when the meter asked for by name cannot be used here; `auto` always finds one.
pub async fn start(
    config: &PowerConfig,
    keep: Duration,
    shutdown: CancellationToken,
) -> Result<(PowerHandle, JoinHandle<()>), MeterError> {
    let wanted = config.clone();
    let meter = tokio::task::spawn_blocking(move || choose::open(&wanted))
        .await
        .map_err(|error| {
            MeterError::Configuration(format!("the meter could not be opened: {error}"))
        })??;
    let interval = Duration::from_millis(config.interval_ms);
    Ok(start_with(meter, interval, keep, shutdown))
}

/// As [`start`], with a meter already open.
pub fn start_with(
    meter: Box<dyn Meter>,
    interval: Duration,
    keep: Duration,
    shutdown: CancellationToken,
) -> (PowerHandle, JoinHandle<()>) {
    let interval = interval.max(Duration::from_millis(1));
    let shared = Arc::new(Shared {
        source: meter.source().to_owned(),
        quality: meter.quality(),
        interval,
        history: Mutex::new(History::new(keep.max(Duration::from_secs(600)))),
        failures: std::sync::atomic::AtomicU64::new(0),
    });
    let (announce, sampled) = watch::channel(None);
    let task = tokio::spawn(sample(meter, Arc::clone(&shared), announce, shutdown));
    (PowerHandle { shared, sampled }, task)
}

async fn sample(
    mut meter: Box<dyn Meter>,
    shared: Arc<Shared>,
    announce: watch::Sender<Option<Instant>>,
    shutdown: CancellationToken,
) {
    let mut ticks = tokio::time::interval(shared.interval);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut warned: Option<Instant> = None;
    loop {
        tokio::select! {
            () = shutdown.cancelled() => return,
            _ = ticks.tick() => {}
        }
        let read = tokio::task::spawn_blocking(move || {
            let before = Instant::now();
            let result = meter.poll(before);
            (meter, result, before + before.elapsed() / 2)
        });
        let Ok((returned, result, at)) = read.await else {
            tracing::error!(
                source = shared.source,
                "the power meter panicked; no more power figures"
            );
            return;
        };
        meter = returned;
        match result {
            Ok(readings) => record(&shared, &announce, at, &readings),
            Err(error) => {
                let failures = shared
                    .failures
                    .fetch_add(1, std::sync::atomic::Ordering::Relaxed)
                    + 1;
                if warned.is_none_or(|w| w.elapsed() > Duration::from_secs(60)) {
                    tracing::warn!(%error, failures, "the power meter cannot be read now");
                    warned = Some(Instant::now());
                }
            }
        }
    }
}

fn record(
    shared: &Shared,
    announce: &watch::Sender<Option<Instant>>,
    at: Instant,
    readings: &[Reading],
) {
    let newest = {
        let mut history = shared.history();
        for reading in readings {
            history.push(reading.at.unwrap_or(at), reading);
        }
        history.newest()
    };
    announce.send_if_modified(|last| std::mem::replace(last, newest) != newest);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::power::{Domain, NoMeter, Value, Values};

    /// A meter that follows a curve of power over the seconds since it was made.
    struct Curve<F>(Instant, F);

    impl<F: FnMut(f64) -> Option<f64> + Send> Meter for Curve<F> {
        fn source(&self) -> &str {
            "curve"
        }

        fn quality(&self) -> EnergyQuality {
            EnergyQuality::Measured
        }

        fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError> {
            let watts = self.1(now.duration_since(self.0).as_secs_f64());
            let watts = watts.ok_or_else(|| MeterError::Configuration("stalled".to_owned()))?;
            let mut values = Values::default();
            values.set(Domain::Total, Value::power(watts));
            Ok(vec![Reading {
                at: None,
                values,
                total_from: "input_rail".into(),
                rails: Vec::new(),
            }])
        }
    }

    fn sampled(
        curve: impl FnMut(f64) -> Option<f64> + Send + 'static,
    ) -> (PowerHandle, Instant, CancellationToken, JoinHandle<()>) {
        let start = Instant::now();
        let stop = CancellationToken::new();
        let interval = Duration::from_millis(100);
        let (handle, task) = start_with(
            Box::new(Curve(start, curve)),
            interval,
            Duration::ZERO,
            stop.clone(),
        );
        (handle, start, stop, task)
    }

    #[tokio::test(start_paused = true)]
    async fn a_span_is_answered_to_its_edges_and_the_sampler_stops_when_told() {
        let (handle, start, stop, task) = sampled(|t| Some(10.0 + t));
        let end = start + Duration::from_millis(8_250);
        tokio::time::sleep_until(end).await;
        let found = handle
            .settled_energy(start + Duration::from_millis(250), end)
            .await;
        let exact = 10.0 * 8.0 + 0.5 * (8.25_f64.powi(2) - 0.25_f64.powi(2));
        assert!((found.total_joules().unwrap() / exact - 1.0).abs() < 1e-3);
        assert_eq!(found.quality, EnergyQuality::Measured);
        assert_eq!(handle.now().quality, EnergyQuality::Measured);
        stop.cancel();
        task.await.unwrap();
        tokio::time::sleep(Duration::from_secs(5)).await;
        assert_eq!(handle.now().quality, EnergyQuality::Unavailable);
    }

    #[tokio::test(start_paused = true)]
    async fn a_stalled_meter_is_counted_and_its_time_is_not_covered() {
        let (handle, start, stop, task) = sampled(|t| (!(2.95..5.95).contains(&t)).then_some(20.0));
        tokio::time::sleep_until(start + Duration::from_secs(11)).await;
        let found = handle.energy(start, start + Duration::from_secs(10));
        assert!(handle.failed_reads() >= 29);
        assert_eq!(found.quality, EnergyQuality::Partial);
        assert!((found.coverage - 0.69).abs() < 0.02, "{}", found.coverage);
        let joules = found.total_joules().unwrap();
        assert!((joules - 200.0 * found.coverage).abs() < 1e-6);
        stop.cancel();
        task.await.unwrap();
    }

    #[tokio::test(start_paused = true)]
    async fn without_a_meter_energy_is_unavailable_and_nobody_waits_long() {
        let stop = CancellationToken::new();
        let (handle, _task) = start_with(
            Box::new(NoMeter),
            Duration::from_millis(100),
            Duration::ZERO,
            stop.clone(),
        );
        let start = Instant::now();
        tokio::time::sleep(Duration::from_secs(2)).await;
        let asked = Instant::now();
        let found = handle.settled_energy(start, asked).await;
        assert!(asked.elapsed() < Duration::from_millis(500));
        assert_eq!(found, SpanEnergy::unavailable("none"));
        stop.cancel();
    }
}
