//! The task that reads the meter at every interval, and the handle that answers for it.

use super::choose;
use super::condition::Condition;
use super::config::PowerConfig;
use super::cost::{MeterCost, thread_cpu};
use super::error::MeterError;
use super::ledger::{Ledger, Meta, SpanEnergy};
use super::machine::Machine;
use super::meter::Meter;
use super::none;
use super::reading::{Domain, Reading};
use super::series::longest_gap;
use super::user::EnergyUser;
use albireo_service::panics::{contain, message};
use albireo_wire::{BoardState, DomainWatts, EnergyQuality};
use parking_lot::{Mutex, MutexGuard};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::{Notify, watch};
use tokio::task::JoinHandle;
use tokio::time::{Instant, MissedTickBehavior};
use tokio_util::sync::CancellationToken;

/// Time between two looks at the board's condition.
const CONDITION_EVERY: Duration = Duration::from_secs(1);

/// How long a clip waits for a meter that seems to hang.
const A_MOMENT: Duration = Duration::from_millis(50);

/// Least time between a sample and one that is taken because a clip has ended.
const BETWEEN_EXTRA_SAMPLES: Duration = Duration::from_millis(10);

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

/// Energy since sampling began.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnergySoFar {
    /// Which domain.
    pub domain: Domain,
    /// Joules, over the time that samples cover.
    pub joules: f64,
    /// That time, seconds.
    pub covered_s: f64,
}

/// How far the meter has been read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Progress {
    /// The newest sample.
    newest: Option<Instant>,
    /// The last attempt that failed.
    failed: Option<Instant>,
}

/// What the sampler and its handles share. The lock is held for microseconds and never over a read.
#[derive(Debug)]
struct SamplerState {
    source: String,
    quality: EnergyQuality,
    interval: Duration,
    ledger: Mutex<Ledger>,
    /// Asks for a sample before the next interval.
    wanted: Notify,
    cost: Mutex<MeterCost>,
    failures: AtomicU64,
}

/// Answers for the energy of clips, and of any span of the last minute. Cheap to clone.
#[derive(Clone, Debug)]
pub struct PowerHandle {
    shared: Arc<SamplerState>,
    progress: watch::Receiver<Progress>,
}

impl PowerHandle {
    /// Energy of the node over `[start, end]` within the last minute, from the samples there are now.
    pub fn energy(&self, start: Instant, end: Instant) -> SpanEnergy {
        self.ledger().energy(start, end, self.meta())
    }

    /// As [`energy`](Self::energy), but waits until the meter was read after `end`, so that the end of the span
    /// is interpolated and not held: see [`settled`](Self::settled).
    pub async fn settled_energy(&self, start: Instant, end: Instant) -> SpanEnergy {
        self.settled(end, Duration::MAX).await;
        self.energy(start, end)
    }

    /// Waits until the meter was read after `end`: asks for that now, whatever the interval. Does not wait
    /// without a meter, when it cannot be read or sampling has stopped; nor for longer than `patience`, than
    /// until two intervals after `end` (a meter may deliver by its own clock), or, where the meter has not
    /// answered for longer than is bridged, than a moment.
    pub async fn settled(&self, end: Instant, patience: Duration) {
        if self.shared.source == none::SOURCE {
            return;
        }
        let mut progress = self.progress.clone();
        let is_read = |seen: &Progress| seen.newest.max(seen.failed).is_some_and(|at| at >= end);
        if is_read(&progress.borrow_and_update()) {
            return;
        }
        self.shared.wanted.notify_one();
        let newest = progress.borrow().newest;
        let hangs = newest
            .is_some_and(|newest| newest + longest_gap(self.shared.interval) < Instant::now());
        let patience = if hangs {
            A_MOMENT.min(patience)
        } else {
            patience
        };
        let limit = end + 2 * self.shared.interval + Duration::from_millis(50);
        let limit = Instant::now()
            .checked_add(patience)
            .map_or(limit, |at| at.min(limit));
        let _ = tokio::time::timeout_at(limit, progress.wait_for(is_read)).await;
    }

    /// The end by which a user of the node's energy tells what it did; asked for twice, it is the same user.
    pub fn user(&self, name: &str) -> EnergyUser {
        let number = self.ledger().user(name);
        EnergyUser::new(number, self.clone())
    }

    /// As [`user`](Self::user), for one that stands aside: of a second's energy it takes what the detector worked for it
    /// of that second, and the others divide the rest. Its name must be no other user's.
    pub fn user_aside(&self, name: &str) -> EnergyUser {
        let number = self.ledger().user_aside(name);
        EnergyUser::new(number, self.clone())
    }

    /// Energy by domain since sampling began, up to the newest sample.
    pub fn so_far(&self) -> Vec<EnergySoFar> {
        let told = self.ledger().since_start();
        let so_far = |(domain, joules, covered_s)| EnergySoFar {
            domain,
            joules,
            covered_s,
        };
        told.into_iter().map(so_far).collect()
    }

    /// The account of energy, locked.
    pub(super) fn ledger(&self) -> MutexGuard<'_, Ledger> {
        self.shared.ledger.lock()
    }

    /// What the account of energy does not know of the meter.
    pub(super) fn meta(&self) -> Meta<'_> {
        Meta {
            source: &self.shared.source,
            quality: self.shared.quality,
        }
    }

    /// Power now.
    pub fn now(&self) -> PowerNow {
        let watts = self.ledger().watts(Instant::now());
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

    /// The board's state over `[start, end]` within the last minute: temperature, throttling, clocks, power
    /// mode. `None` where the board tells nothing of it.
    pub fn board(&self, start: Instant, end: Instant) -> Option<BoardState> {
        self.ledger().board(start, end)
    }

    /// What reading the meter has cost so far.
    pub fn cost(&self) -> MeterCost {
        *self.shared.cost.lock()
    }
}

/// Opens the configured meter and starts sampling it until `shutdown`.
///
/// # Errors
/// [`MeterError`] when the meter asked for by name cannot be used here; `auto` always finds one.
pub async fn start(
    config: &PowerConfig,
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
    Ok(launch(meter, Some(machine), interval, shutdown))
}

/// As [`start`], with a meter already open, and without a look at the machine's condition.
pub fn start_with(
    meter: Box<dyn Meter>,
    interval: Duration,
    shutdown: CancellationToken,
) -> (PowerHandle, JoinHandle<()>) {
    launch(meter, None, interval, shutdown)
}

/// A handle to nothing, for tests that need no energy and no runtime.
pub fn without_a_meter() -> PowerHandle {
    let interval = Duration::from_millis(100);
    let state = SamplerState::new(&super::NoMeter, interval);
    let (_, progress) = watch::channel(Progress::default());
    let shared = Arc::new(state);
    PowerHandle { shared, progress }
}

fn launch(
    meter: Box<dyn Meter>,
    machine: Option<Machine>,
    interval: Duration,
    shutdown: CancellationToken,
) -> (PowerHandle, JoinHandle<()>) {
    let shared = Arc::new(SamplerState::new(&*meter, interval));
    let (announce, progress) = watch::channel(Progress::default());
    let senses = Sensors {
        meter,
        machine,
        last_condition: None,
        cpu: Duration::ZERO,
    };
    let task = tokio::spawn(sample(senses, Arc::clone(&shared), announce, shutdown));
    (PowerHandle { shared, progress }, task)
}

impl SamplerState {
    fn new(meter: &dyn Meter, interval: Duration) -> Self {
        let interval = interval.max(Duration::from_millis(1));
        Self {
            source: meter.source().to_owned(),
            quality: meter.quality(),
            interval,
            ledger: Mutex::new(Ledger::new(interval)),
            wanted: Notify::new(),
            cost: Mutex::default(),
            failures: AtomicU64::new(0),
        }
    }
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
        // A meter that meets a reading it has a bug for is a meter that cannot be read now: the next reading may do.
        let meter = &mut self.meter;
        let polled = contain(|| meter.poll(before));
        let readings = polled.unwrap_or_else(|panic| {
            let said = message(&*panic);
            Err(MeterError::Failed(format!("the meter panicked: {said}")))
        });
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
    announce: watch::Sender<Progress>,
    shutdown: CancellationToken,
) {
    let began = Instant::now();
    let mut ticks = tokio::time::interval(shared.interval);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut warned: Option<Instant> = None;
    let mut last = began;
    loop {
        // However many clips end, their samples cost no more than ten times the configured ones.
        let earliest = last + BETWEEN_EXTRA_SAMPLES.max(shared.interval / 10);
        let regular = tokio::select! {
            biased;
            () = shutdown.cancelled() => break,
            _ = ticks.tick() => true,
            () = async {
                tokio::time::sleep_until(earliest).await;
                shared.wanted.notified().await;
            } => false,
        };
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
        last = Instant::now();
        if let Some(condition) = seen.condition {
            shared.ledger.lock().looked(seen.at, condition);
        }
        {
            let mut cost = shared.cost.lock();
            cost.polls += 1;
            cost.cpu = seen.cpu;
            cost.elapsed = began.elapsed();
        }
        match seen.readings {
            Ok(readings) => record(&shared, &announce, seen.at, &readings, regular),
            Err(error) => {
                let failures = shared.failures.fetch_add(1, Ordering::Relaxed) + 1;
                // Nobody waits for a meter that does not answer.
                announce.send_modify(|progress| progress.failed = Some(seen.at));
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
    announce: &watch::Sender<Progress>,
    at: Instant,
    readings: &[Reading],
    regular: bool,
) {
    let newest = {
        let mut ledger = shared.ledger.lock();
        for reading in readings {
            // A meter that tells the time delivers by its own clock, whenever it is asked.
            let regular = regular || reading.at.is_some();
            ledger.sampled(reading.at.unwrap_or(at), reading, regular);
        }
        ledger.newest()
    };
    announce.send_if_modified(|progress| std::mem::replace(&mut progress.newest, newest) != newest);
}

#[cfg(test)]
mod tests;
