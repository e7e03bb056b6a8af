//! Reads the card through NVML: its description, and the energy that it uses during a measurement, by its energy
//! counter and by integrating its power.

use anyhow::{Context, anyhow};
use nvml_wrapper::Nvml;
use std::ffi::OsStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// The time between two readings of the power.
const EVERY: Duration = Duration::from_millis(20);

#[derive(Clone)]
pub(crate) struct Card {
    nvml: Arc<Nvml>,
    device: u32,
}

/// The energy used during a measurement.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Energy {
    /// The energy by the card's counter, in joules.
    pub counter: Option<f64>,
    /// The integral of its power, read every 20 ms, in joules.
    pub integrated: Option<f64>,
    /// The duration of the measurement.
    pub seconds: f64,
}

impl Energy {
    /// The joules of the counter, or else of the power.
    pub(crate) fn joules(self) -> Option<f64> {
        self.counter.or(self.integrated)
    }

    /// The mean power in watts.
    pub(crate) fn watts(self) -> Option<f64> {
        self.joules().map(|joules| joules / self.seconds)
    }
}

impl Card {
    /// # Errors
    /// If there is no NVIDIA driver, or no card of this number.
    pub(crate) fn open(device: u32) -> anyhow::Result<Self> {
        let library = OsStr::new("libnvidia-ml.so.1");
        let nvml = Nvml::builder()
            .lib_path(library)
            .init()
            .map_err(|_| anyhow!("no NVIDIA driver: libnvidia-ml.so.1 cannot be loaded"))?;
        nvml.device_by_index(device)
            .with_context(|| format!("NVML shows no card {device}"))?;
        Ok(Self {
            nvml: Arc::new(nvml),
            device,
        })
    }

    /// The card's name, memory and driver.
    pub(crate) fn description(&self) -> anyhow::Result<String> {
        let card = self.nvml.device_by_index(self.device)?;
        let memory = card.memory_info()?;
        Ok(format!(
            "{}, {:.0} GiB, driver {}",
            card.name()?,
            memory.total as f64 / f64::from(1 << 30),
            self.nvml.sys_driver_version()?,
        ))
    }

    fn counter(&self) -> Option<f64> {
        let card = self.nvml.device_by_index(self.device).ok()?;
        Some(card.total_energy_consumption().ok()? as f64 * 1e-3)
    }

    fn watts(&self) -> Option<f64> {
        let card = self.nvml.device_by_index(self.device).ok()?;
        Some(f64::from(card.power_usage().ok()?) * 1e-3)
    }

    /// Starts a measurement.
    pub(crate) fn measure(&self) -> Measuring {
        let card = self.clone();
        let over = Arc::new(AtomicBool::new(false));
        let begun = Instant::now();
        let before = self.counter();
        let stop = over.clone();
        let thread = std::thread::spawn(move || {
            let mut last = card.watts()?;
            let mut at = Instant::now();
            let mut joules = 0.0;
            while !stop.load(Ordering::Relaxed) {
                std::thread::sleep(EVERY);
                let watts = card.watts()?;
                joules += (last + watts) / 2.0 * at.elapsed().as_secs_f64();
                last = watts;
                at = Instant::now();
            }
            Some(joules)
        });
        Measuring {
            card: self.clone(),
            begun,
            before,
            over,
            thread,
        }
    }
}

/// A running measurement, which [`end`](Self::end) stops.
pub(crate) struct Measuring {
    card: Card,
    begun: Instant,
    before: Option<f64>,
    over: Arc<AtomicBool>,
    thread: JoinHandle<Option<f64>>,
}

impl Measuring {
    pub(crate) fn end(self) -> Energy {
        let after = self.card.counter();
        let seconds = self.begun.elapsed().as_secs_f64();
        self.over.store(true, Ordering::Relaxed);
        Energy {
            counter: after.zip(self.before).map(|(after, before)| after - before),
            integrated: self.thread.join().ok().flatten(),
            seconds,
        }
    }
}
