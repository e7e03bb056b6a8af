//! The task that reads the meter at every interval, and the handle that answers for it.

use super::choose;
use super::condition::{Condition, Conditions};
use super::config::PowerConfig;
use super::cost::{MeterCost, thread_cpu};
use super::error::MeterError;
use super::history::{History, SpanEnergy};
use super::machine::Machine;
use super::meter::Meter;
use super::reading::Reading;
use albireo_wire::{BoardState, DomainWatts, EnergyQuality};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{Instant, MissedTickBehavior};
use tokio_util::sync::CancellationToken;

/// Time between two looks at the board's condition.
const CONDITION_EVERY: Duration = Duration::from_secs(1);

/// History kept at least.
const KEEP_AT_LEAST: Duration = Duration::from_secs(600);

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
struct SamplerState {
    source: String,
    quality: EnergyQuality,
    interval: Duration,
    history: Mutex<History>,
    conditions: Mutex<Conditions>,
    cost: Mutex<MeterCost>,
    failures: AtomicU64,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Answers for the energy of any span of the kept history. Cheap to clone; never waits for the meter.
#[derive(Clone, Debug)]
pub struct PowerHandle {
    shared: Arc<SamplerState>,
    sampled: watch::Receiver<Option<Instant>>,
}

impl PowerHandle {
    /// Energy of the node over `[start, end]`, from the samples there are now.
    pub fn energy(&self, start: Instant, end: Instant) -> SpanEnergy {
        let shared = &self.shared;
        lock(&shared.history).energy(start, end, &shared.source, shared.quality)
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
        let watts = lock(&self.shared.history).watts(Instant::now());
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
        self.shared.failures.load(Ordering::Relaxed)
    }

    /// The board's state over `[start, end]`: temperature, throttling, clocks, power mode. `None` where the
    /// board tells nothing of it.
    pub fn board(&self, start: Instant, end: Instant) -> Option<BoardState> {
        lock(&self.shared.conditions).state(start, end)
    }

    /// What reading the meter has cost so far.
    pub fn cost(&self) -> MeterCost {
        *lock(&self.shared.cost)
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
    let opened = tokio::task::spawn_blocking(move || {
        choose::open(&wanted).map(|meter| (meter, Machine::new(&wanted)))
    });
    let (meter, machine) = opened.await.map_err(|error| {
        MeterError::Failed(format!("the power meter could not be opened: {error}"))
    })??;
    let interval = Duration::from_millis(config.interval_ms);
    Ok(launch(meter, Some(machine), interval, keep, shutdown))
}

/// As [`start`], with a meter already open, and without a look at the machine's condition.
#[cfg(test)]
pub(crate) fn start_with(
    meter: Box<dyn Meter>,
    interval: Duration,
    keep: Duration,
    shutdown: CancellationToken,
) -> (PowerHandle, JoinHandle<()>) {
    launch(meter, None, interval, keep, shutdown)
}

fn launch(
    meter: Box<dyn Meter>,
    machine: Option<Machine>,
    interval: Duration,
    keep: Duration,
    shutdown: CancellationToken,
) -> (PowerHandle, JoinHandle<()>) {
    let interval = interval.max(Duration::from_millis(1));
    let keep = keep.max(KEEP_AT_LEAST);
    let shared = Arc::new(SamplerState {
        source: meter.source().to_owned(),
        quality: meter.quality(),
        interval,
        history: Mutex::new(History::new(keep)),
        conditions: Mutex::new(Conditions::new(keep)),
        cost: Mutex::default(),
        failures: AtomicU64::new(0),
    });
    let (announce, sampled) = watch::channel(None);
    let senses = Sensors {
        meter,
        machine,
        last_condition: None,
        cpu: Duration::ZERO,
    };
    let task = tokio::spawn(sample(senses, Arc::clone(&shared), announce, shutdown));
    (PowerHandle { shared, sampled }, task)
}

/// What is read at every interval, on a thread where waiting for files does no harm.
struct Sensors {
    meter: Box<dyn Meter>,
    machine: Option<Machine>,
    last_condition: Option<Instant>,
    /// CPU time spent in [`look`](Self::look) so far.
    cpu: Duration,
}

/// What one look has seen.
struct Seen {
    readings: Result<Vec<Reading>, MeterError>,
    condition: Option<Condition>,
    /// The middle of the reading.
    at: Instant,
    /// CPU time of all looks so far, other threads and processes of the meter included.
    cpu: Duration,
}

impl Sensors {
    fn look(&mut self) -> Seen {
        let cpu = thread_cpu();
        let before = Instant::now();
        let readings = self.meter.poll(before);
        let at = before + before.elapsed() / 2;
        let due = self
            .last_condition
            .is_none_or(|last| before.saturating_duration_since(last) >= CONDITION_EVERY);
        let condition = due.then(|| {
            self.last_condition = Some(before);
            let machine = self.machine.as_mut().map(|m| m.read(before));
            self.meter.condition().and(machine.unwrap_or_default())
        });
        self.cpu += thread_cpu().saturating_sub(cpu);
        Seen {
            readings,
            condition,
            at,
            cpu: self.cpu + self.meter.other_cpu(),
        }
    }
}

async fn sample(
    mut senses: Sensors,
    shared: Arc<SamplerState>,
    announce: watch::Sender<Option<Instant>>,
    shutdown: CancellationToken,
) {
    let began = Instant::now();
    let mut ticks = tokio::time::interval(shared.interval);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut warned: Option<Instant> = None;
    loop {
        tokio::select! {
            () = shutdown.cancelled() => break,
            _ = ticks.tick() => {}
        }
        let look = tokio::task::spawn_blocking(move || {
            let seen = senses.look();
            (senses, seen)
        });
        let Ok((returned, seen)) = look.await else {
            tracing::error!(
                source = shared.source,
                "the power meter panicked; no more power figures"
            );
            return;
        };
        senses = returned;
        if let Some(condition) = seen.condition {
            lock(&shared.conditions).push(seen.at, condition);
        }
        {
            let mut cost = lock(&shared.cost);
            cost.polls += 1;
            cost.cpu = seen.cpu;
            cost.elapsed = began.elapsed();
        }
        match seen.readings {
            Ok(readings) => record(&shared, &announce, seen.at, &readings),
            Err(error) => {
                let failures = shared.failures.fetch_add(1, Ordering::Relaxed) + 1;
                if warned.is_none_or(|w| w.elapsed() > Duration::from_secs(60)) {
                    tracing::warn!(%error, failures, "the power meter cannot be read now");
                    warned = Some(Instant::now());
                }
            }
        }
    }
    // Closing a meter may wait for its child process.
    let _ = tokio::task::spawn_blocking(move || drop(senses)).await;
}

fn record(
    shared: &SamplerState,
    announce: &watch::Sender<Option<Instant>>,
    at: Instant,
    readings: &[Reading],
) {
    let newest = {
        let mut history = lock(&shared.history);
        for reading in readings {
            history.push(reading.at.unwrap_or(at), reading);
        }
        history.newest()
    };
    announce.send_if_modified(|last| std::mem::replace(last, newest) != newest);
}

#[cfg(test)]
mod tests;
