//! The task that reads the meter at every interval, and the handle that returns its figures.

use crate::choose;
use crate::config::{PowerConfig, PowerSource};
use crate::energy::account::Account;
use crate::error::MeterError;
use crate::machine::Machine;
use crate::machine::condition::combined;
use crate::reading::Domain;
use crate::source::{Meter, NoMeter};
use albireo_wire::{BoardState, DomainWatts, EnergyQuality};
use parking_lot::{Mutex, MutexGuard};
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{Instant, MissedTickBehavior};
use tokio_util::sync::CancellationToken;

/// The time between two readings of the board's condition.
const CONDITION_EVERY: Duration = Duration::from_secs(1);

/// The shortest time between two log lines about a meter that cannot be read.
const WARN_EVERY: Duration = Duration::from_secs(60);

/// The present power, and the energy since sampling began.
#[derive(Clone, Debug, PartialEq)]
pub struct PowerSnapshot {
    /// The source of the figures: `rapl`, `estimate`, …; `none` without a source.
    pub source: String,
    /// The quality of the power: [`EnergyQuality::Unavailable`] if there is no recent sample.
    pub quality: EnergyQuality,
    /// The quality of the meter.
    pub meter_quality: EnergyQuality,
    /// Power by domain, watts; empty if there is no recent sample.
    pub watts: Vec<DomainWatts>,
    /// Energy by domain since sampling began, joules, over the time that samples cover; never decreases.
    pub joules: BTreeMap<String, f64>,
    /// The time that samples cover, by domain, seconds.
    pub covered_s: BTreeMap<String, f64>,
    /// The time from the first sample to the newest, seconds: longer than the covered time if there were gaps.
    pub sampled_s: f64,
    /// Detector seconds that the avoided calls of all cameras would have taken since sampling began.
    pub saved_detector_s: f64,
    /// The watts that a running detector adds on this machine, learnt from how power follows the detector's use; `None`
    /// until known. Has the same quality as the power.
    pub detector_watts: Option<f64>,
    /// CPU time of reading the source, including child processes if the system reports it.
    pub meter_cpu: Duration,
    /// The number of failed reads.
    pub failed_reads: u64,
    /// The machine's hottest sensor and its temperature, °C.
    pub hottest: Option<(String, f64)>,
}

impl Default for PowerSnapshot {
    fn default() -> Self {
        PowerHandle::none().snapshot()
    }
}

impl PowerSnapshot {
    /// Returns the same snapshot, but with energy, covered time and savings counted since `before`.
    #[must_use]
    pub fn since(mut self, before: &Self) -> Self {
        for (now, before) in [
            (&mut self.joules, &before.joules),
            (&mut self.covered_s, &before.covered_s),
        ] {
            for (domain, sum) in now {
                *sum -= before.get(domain).copied().unwrap_or_default();
            }
        }
        self.sampled_s -= before.sampled_s;
        self.meter_cpu = self.meter_cpu.saturating_sub(before.meter_cpu);
        self.saved_detector_s -= before.saved_detector_s;
        self
    }

    /// Returns the joules of a domain and the seconds that samples cover; `None` if they cover none.
    pub fn energy(&self, domain: &str) -> Option<(f64, f64)> {
        let seconds = *self.covered_s.get(domain)?;
        let joules = *self.joules.get(domain)?;
        if seconds <= 0.0 {
            return None;
        }
        Some((joules, seconds))
    }

    /// CPU time of reading the source as a share of one core; 0 before the second sample.
    pub fn meter_share_of_core(&self) -> f64 {
        if self.sampled_s > 0.0 {
            self.meter_cpu.as_secs_f64() / self.sampled_s
        } else {
            0.0
        }
    }
}

/// Returns power and energy. Cheap to clone.
#[derive(Clone, Debug)]
pub struct PowerHandle {
    /// The lock is held for microseconds, never during a reading.
    account: Arc<Mutex<Account>>,
    /// The time of the newest sample.
    pub(crate) newest: watch::Receiver<Option<Instant>>,
}

impl PowerHandle {
    /// Returns a handle without a meter or a sampler, which never has figures.
    pub fn none() -> Self {
        let source = PowerSource::None.as_str();
        Self::new(source, &NoMeter, Duration::from_millis(100)).0
    }

    fn new(
        source: &str,
        meter: &dyn Meter,
        interval: Duration,
    ) -> (Self, watch::Sender<Option<Instant>>) {
        let interval = interval.max(Duration::from_millis(1));
        let (announce, newest) = watch::channel(None);
        let account = Arc::new(Mutex::new(Account::new(source, meter.quality(), interval)));
        (Self { account, newest }, announce)
    }

    pub(crate) fn account(&self) -> MutexGuard<'_, Account> {
        self.account.lock()
    }

    /// Returns the present power, and the energy up to the newest sample.
    pub fn snapshot(&self) -> PowerSnapshot {
        let account = self.account();
        let history = &account.history;
        let present = history.present(Instant::now());
        let mut watts = Vec::new();
        let mut joules = BTreeMap::new();
        let mut covered_s = BTreeMap::new();
        for domain in Domain::ALL {
            let name = domain.as_str();
            let sum = history.totals.sums[domain];
            if history.has(domain) {
                joules.insert(name.to_owned(), sum.joules);
                covered_s.insert(name.to_owned(), sum.seconds);
            }
            if let Some(now) = present.and_then(|sample| sample.watts[domain]) {
                let domain = name.to_owned();
                watts.push(DomainWatts { domain, watts: now });
            }
        }
        let cameras = history.totals.cameras.iter();
        let sensor = account.condition.hottest_sensor.clone();
        PowerSnapshot {
            source: account.source.clone(),
            quality: if watts.is_empty() {
                EnergyQuality::Unavailable
            } else {
                account.quality
            },
            meter_quality: account.quality,
            watts,
            joules,
            covered_s,
            sampled_s: history.sampled_s,
            saved_detector_s: cameras.map(|(_, camera)| camera.seconds).sum(),
            detector_watts: account.detector.watts(),
            meter_cpu: account.meter_cpu,
            failed_reads: account.failed_reads,
            hottest: sensor.zip(account.condition.hottest_celsius),
        }
    }
}

/// Opens the configured meter and samples it until `shutdown`.
///
/// # Errors
/// [`MeterError`] if the meter requested by name cannot be used here; `auto` never fails for that reason.
pub async fn start(
    config: &PowerConfig,
    shutdown: CancellationToken,
) -> Result<(PowerHandle, JoinHandle<()>), MeterError> {
    let meter_config = config.clone();
    let opening = tokio::task::spawn_blocking(move || {
        let (source, meter) = choose::open(&meter_config)?;
        Ok((source, meter, Machine::new(&meter_config)))
    });
    let opened = opening
        .await
        .map_err(|error| MeterError::Failed(format!("the meter cannot be opened: {error}")))?;
    let (source, meter, machine) = opened?;
    let interval = Duration::from_millis(config.interval_ms);
    let source = source.as_str();
    Ok(launch(source, meter, Some(machine), interval, shutdown))
}

/// Like [`start`], with a meter that is already open and called `source`, and without the machine's condition.
pub fn start_with(
    source: &str,
    meter: Box<dyn Meter>,
    interval: Duration,
    shutdown: CancellationToken,
) -> (PowerHandle, JoinHandle<()>) {
    launch(source, meter, None, interval, shutdown)
}

fn launch(
    source: &str,
    meter: Box<dyn Meter>,
    machine: Option<Machine>,
    interval: Duration,
    shutdown: CancellationToken,
) -> (PowerHandle, JoinHandle<()>) {
    let (handle, announce) = PowerHandle::new(source, &*meter, interval);
    let sensors = Sensors {
        meter,
        machine,
        condition_at: None,
        cpu: Duration::ZERO,
    };
    let task = tokio::spawn(sample(sensors, handle.clone(), announce, shutdown));
    (handle, task)
}

/// The sources read at every interval, on a thread that may block on files.
struct Sensors {
    meter: Box<dyn Meter>,
    machine: Option<Machine>,
    condition_at: Option<Instant>,
    /// CPU time spent in [`read`](Self::read) so far.
    cpu: Duration,
}

impl Sensors {
    /// Reads the sensors into the account.
    fn read(&mut self, account: &Mutex<Account>) -> Result<(), MeterError> {
        let cpu = thread_cpu();
        let before = Instant::now();
        let readings = match catch_unwind(AssertUnwindSafe(|| self.meter.poll(before))) {
            Ok(polled) => polled,
            // A panic is a bug in a meter; its next poll may still succeed.
            Err(_) => Err(MeterError::Failed("the meter panicked".to_owned())),
        };
        // A reading takes a while: what it shows is of the middle of it.
        let middle = before + before.elapsed() / 2;
        let condition = self.condition(before);
        self.cpu += thread_cpu().saturating_sub(cpu);
        let mut account = account.lock();
        account.meter_cpu = self.cpu + self.meter.other_cpu();
        if let Some(condition) = condition {
            account.set_condition(condition);
        }
        if readings.is_err() {
            account.failed_reads += 1;
        }
        for reading in readings? {
            account.sampled(reading.at.unwrap_or(middle), &reading);
        }
        Ok(())
    }

    /// The board's condition, if it is time to read it again.
    fn condition(&mut self, now: Instant) -> Option<BoardState> {
        if let Some(last) = self.condition_at
            && now.saturating_duration_since(last) < CONDITION_EVERY
        {
            return None;
        }
        self.condition_at = Some(now);
        let machine = self.machine.as_mut().map(Machine::read).unwrap_or_default();
        Some(combined(self.meter.condition(), machine))
    }
}

async fn sample(
    mut sensors: Sensors,
    handle: PowerHandle,
    announce: watch::Sender<Option<Instant>>,
    shutdown: CancellationToken,
) {
    let mut ticks = tokio::time::interval(handle.account().interval);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut warned: Option<Instant> = None;
    loop {
        tokio::select! {
            biased;
            () = shutdown.cancelled() => break,
            _ = ticks.tick() => {}
        }
        let account = Arc::clone(&handle.account);
        let reading = tokio::task::spawn_blocking(move || {
            let read = sensors.read(&account);
            (sensors, read)
        });
        let Ok((returned, read)) = reading.await else {
            tracing::error!("the power sampler ended: no more power figures");
            return;
        };
        sensors = returned;
        announce.send_replace(handle.account().history.newest());
        if let Err(error) = read
            && warned.is_none_or(|warned| warned.elapsed() > WARN_EVERY)
        {
            let source = handle.account().source.clone();
            tracing::warn!(%source, %error, "the power meter cannot be read now");
            warned = Some(Instant::now());
        }
    }
    // Closing a meter may wait for its child process.
    let _ = tokio::task::spawn_blocking(move || drop(sensors)).await;
}

/// CPU time of the calling thread since it started.
pub(crate) fn thread_cpu() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::try_from(time).unwrap_or_default()
}

#[cfg(test)]
mod tests;
