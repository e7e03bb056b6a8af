//! The task that reads the meter at every interval, and the handle that answers for it.

use crate::account::Account;
use crate::choose;
use crate::condition::Condition;
use crate::config::PowerConfig;
use crate::error::MeterError;
use crate::machine::Machine;
use crate::measurement::CameraEnergy;
use crate::meter::{Meter, NONE, NoMeter};
use crate::reading::{Domain, Reading};
use albireo_wire::{DomainWatts, EnergyQuality};
use parking_lot::{Mutex, MutexGuard};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{Instant, MissedTickBehavior};
use tokio_util::sync::CancellationToken;

/// Time between two readings of the board's condition.
const CONDITION_EVERY: Duration = Duration::from_secs(1);

/// Least time between two log lines about a meter that cannot be read.
const WARN_EVERY: Duration = Duration::from_secs(60);

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

/// What reading the meter has cost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MeterCost {
    /// Readings asked for.
    pub polls: u64,
    /// CPU time of all of them, child processes included where the system reports it.
    pub cpu: Duration,
    /// Time since sampling began.
    pub elapsed: Duration,
}

impl MeterCost {
    /// CPU time as a share of one core, 0 to 1 (and more, for more than a core).
    pub fn share_of_core(&self) -> f64 {
        self.cpu.as_secs_f64() / self.elapsed.as_secs_f64().max(f64::MIN_POSITIVE)
    }
}

/// What the sampler and its handles share. A lock is held for microseconds and never over a reading.
#[derive(Debug)]
struct Shared {
    source: String,
    quality: EnergyQuality,
    interval: Duration,
    account: Mutex<Account>,
    cost: Mutex<MeterCost>,
    failures: AtomicU64,
}

/// Answers for power and energy. Cheap to clone.
#[derive(Clone, Debug)]
pub struct PowerHandle {
    shared: Arc<Shared>,
    newest: watch::Receiver<Option<Instant>>,
}

impl PowerHandle {
    /// A handle without a meter or a sampler: no figure ever.
    pub fn none() -> Self {
        Self::new(&NoMeter, Duration::from_millis(100)).0
    }

    fn new(meter: &dyn Meter, interval: Duration) -> (Self, watch::Sender<Option<Instant>>) {
        let interval = interval.max(Duration::from_millis(1));
        let (announce, newest) = watch::channel(None);
        let (source, quality) = (meter.source(), meter.quality());
        let shared = Arc::new(Shared {
            source: source.to_owned(),
            quality,
            interval,
            account: Mutex::new(Account::new(source, quality, interval)),
            cost: Mutex::default(),
            failures: AtomicU64::new(0),
        });
        (Self { shared, newest }, announce)
    }

    /// The camera of that name; asked for twice, it is the same one.
    pub fn camera(&self, name: &str) -> CameraEnergy {
        CameraEnergy::new(name, self.clone())
    }

    pub(crate) fn account(&self) -> MutexGuard<'_, Account> {
        self.shared.account.lock()
    }

    /// Waits for the first sample at or after `end`: not without a meter or once sampling has stopped, not longer than
    /// `patience`, and not longer than two intervals, for the meter may have failed.
    pub(crate) async fn sampled(&self, end: Instant, patience: Duration) {
        if self.shared.source == NONE {
            return;
        }
        let limit = end + 2 * self.shared.interval + Duration::from_millis(50);
        let patient = Instant::now().checked_add(patience).unwrap_or(limit);
        let mut newest = self.newest.clone();
        let reached = newest.wait_for(|newest| *newest >= Some(end));
        let _ = tokio::time::timeout_at(limit.min(patient), reached).await;
    }

    /// Energy by domain since sampling began, up to the newest sample.
    pub fn so_far(&self) -> Vec<EnergySoFar> {
        let account = self.account();
        let sums = account.history.totals().sums;
        let known = Domain::ALL.into_iter().zip(sums);
        known
            .filter(|(domain, _)| account.history.has(*domain))
            .map(|(domain, sum)| EnergySoFar {
                domain,
                joules: sum.joules,
                covered_s: sum.covered_s,
            })
            .collect()
    }

    /// From the first sample to the newest, seconds: longer than the covered time where there were gaps.
    pub fn sampled_s(&self) -> f64 {
        self.account().history.sampled_s()
    }

    /// Detector seconds that avoided calls of all cameras would have taken since sampling began.
    pub fn saved_detector_s(&self) -> f64 {
        let account = self.account();
        let cameras = &account.history.totals().cameras;
        cameras.iter().map(|(_, camera)| camera.saved_s).sum()
    }

    /// Watts that a running detector adds on this machine, as far as its power has followed the detector's use; `None`
    /// until that is known. Of the quality of [`now`](Self::now).
    pub fn detector_watts(&self) -> Option<f64> {
        self.account().detector.watts()
    }

    /// Power now.
    pub fn now(&self) -> PowerNow {
        let account = self.account();
        let present = account.history.present(Instant::now());
        let watts = present.map(|sample| sample.watts).unwrap_or_default();
        let watts: Vec<_> = (Domain::ALL.into_iter().zip(watts))
            .filter_map(|(domain, watts)| {
                let domain = domain.as_str().to_owned();
                Some(DomainWatts {
                    domain,
                    watts: watts?,
                })
            })
            .collect();
        PowerNow {
            source: self.shared.source.clone(),
            quality: match watts.is_empty() {
                true => EnergyQuality::Unavailable,
                false => self.shared.quality,
            },
            watts,
        }
    }

    /// The source's name: `rapl`, `estimate`, `none`, …
    pub fn source(&self) -> &str {
        &self.shared.source
    }

    /// How far to trust the source.
    pub fn quality(&self) -> EnergyQuality {
        self.shared.quality
    }

    /// How often the meter could not be read.
    pub fn failed_reads(&self) -> u64 {
        self.shared.failures.load(Ordering::Relaxed)
    }

    /// The board's condition as last read.
    pub fn condition(&self) -> Condition {
        self.account().condition.clone()
    }

    /// What reading the meter has cost so far.
    pub fn cost(&self) -> MeterCost {
        *self.shared.cost.lock()
    }
}

/// Opens the configured meter and samples it until `shutdown`.
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
    let (meter, machine) = opened
        .await
        .map_err(|error| MeterError::Failed(format!("the meter cannot be opened: {error}")))??;
    let interval = Duration::from_millis(config.interval_ms);
    Ok(launch(meter, Some(machine), interval, shutdown))
}

/// As [`start`], with a meter already open, and without the machine's condition.
pub fn start_with(
    meter: Box<dyn Meter>,
    interval: Duration,
    shutdown: CancellationToken,
) -> (PowerHandle, JoinHandle<()>) {
    launch(meter, None, interval, shutdown)
}

fn launch(
    meter: Box<dyn Meter>,
    machine: Option<Machine>,
    interval: Duration,
    shutdown: CancellationToken,
) -> (PowerHandle, JoinHandle<()>) {
    let (handle, announce) = PowerHandle::new(&*meter, interval);
    let sensors = Sensors {
        meter,
        machine,
        condition_at: None,
        cpu: Duration::ZERO,
    };
    let shared = Arc::clone(&handle.shared);
    let task = tokio::spawn(sample(sensors, shared, announce, shutdown));
    (handle, task)
}

/// What is read at every interval, on a thread where waiting for files does no harm.
struct Sensors {
    meter: Box<dyn Meter>,
    machine: Option<Machine>,
    condition_at: Option<Instant>,
    /// CPU time spent in [`read`](Self::read) so far.
    cpu: Duration,
}

struct Read {
    readings: Result<Vec<Reading>, MeterError>,
    condition: Option<Condition>,
    /// The middle of the reading.
    at: Instant,
    /// CPU time of all readings so far, other processes of the meter included.
    cpu: Duration,
}

impl Sensors {
    fn read(&mut self) -> Read {
        let cpu = thread_cpu();
        let before = Instant::now();
        // A panic is a bug in a meter; its next reading may be one that it can read.
        let polled = catch_unwind(AssertUnwindSafe(|| self.meter.poll(before)));
        let readings =
            polled.unwrap_or_else(|_| Err(MeterError::Failed("the meter panicked".to_owned())));
        let at = before + before.elapsed() / 2;
        let age = |last: Instant| before.saturating_duration_since(last);
        let due = self
            .condition_at
            .is_none_or(|last| age(last) >= CONDITION_EVERY);
        let condition = due.then(|| {
            self.condition_at = Some(before);
            let machine = self.machine.as_mut().map(|machine| machine.read(before));
            self.meter.condition().and(machine.unwrap_or_default())
        });
        self.cpu += thread_cpu().saturating_sub(cpu);
        Read {
            readings,
            condition,
            at,
            cpu: self.cpu + self.meter.other_cpu(),
        }
    }
}

async fn sample(
    mut sensors: Sensors,
    shared: Arc<Shared>,
    announce: watch::Sender<Option<Instant>>,
    shutdown: CancellationToken,
) {
    let began = Instant::now();
    let mut ticks = tokio::time::interval(shared.interval);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut warned: Option<Instant> = None;
    loop {
        tokio::select! {
            biased;
            () = shutdown.cancelled() => break,
            _ = ticks.tick() => {}
        }
        let reading = tokio::task::spawn_blocking(move || {
            let read = sensors.read();
            (sensors, read)
        });
        let Ok((returned, read)) = reading.await else {
            tracing::error!(
                source = shared.source,
                "the power sampler ended: no more power figures"
            );
            return;
        };
        sensors = returned;
        {
            let mut cost = shared.cost.lock();
            cost.polls += 1;
            cost.cpu = read.cpu;
            cost.elapsed = began.elapsed();
        }
        let mut account = shared.account.lock();
        if let Some(condition) = read.condition {
            account.set_condition(condition);
        }
        match read.readings {
            Ok(readings) => {
                for reading in readings {
                    account.sampled(reading.at.unwrap_or(read.at), &reading);
                }
                let newest = account.history.newest();
                drop(account);
                announce.send_if_modified(|known| std::mem::replace(known, newest) != newest);
            }
            Err(error) => {
                drop(account);
                let failures = shared.failures.fetch_add(1, Ordering::Relaxed) + 1;
                if warned.is_none_or(|warned| warned.elapsed() > WARN_EVERY) {
                    tracing::warn!(%error, failures, "the power meter cannot be read now");
                    warned = Some(Instant::now());
                }
            }
        }
    }
    // Closing a meter may wait for its child process.
    let _ = tokio::task::spawn_blocking(move || drop(sensors)).await;
}

/// CPU time of the calling thread since it was started.
pub(crate) fn thread_cpu() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    let seconds = u64::try_from(time.tv_sec).unwrap_or(0);
    Duration::new(seconds, u32::try_from(time.tv_nsec).unwrap_or(0))
}

#[cfg(test)]
mod tests;
