//! Reads the machine's condition: thermal zones, throttling, clocks, power mode. What is not there is left out.

use crate::condition::{Condition, is_a_sensor};
use crate::config::PowerConfig;
use crate::sysfs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::time::Instant;

const SOURCE: &str = "condition";

/// CPU cores whose clocks are read: each read of a clock interrupts the core.
const MOST_CORES: usize = 16;

/// Bits of the Raspberry Pi firmware's word that say "now": frequency capped, throttled, soft limit.
const PI_NOW: u64 = 0b1110;

/// The files with the machine's condition.
#[derive(Debug)]
pub(crate) struct Machine {
    /// Thermal zones: type and temperature file (millidegrees).
    zones: Vec<(Arc<str>, PathBuf)>,
    /// Cooling devices that hold clocks back, 0 when they do not.
    cooling: Vec<PathBuf>,
    /// Counters of throttling events.
    events: Vec<PathBuf>,
    last_events: Option<u64>,
    pi: Option<PathBuf>,
    cpu_clocks: Vec<PathBuf>,
    gpu_clock: Option<PathBuf>,
    mode: PowerMode,
}

impl Machine {
    /// Looks for the files.
    pub(crate) fn new(config: &PowerConfig) -> Self {
        let class = |name: &str| sysfs::entries(&config.sysfs.join("class").join(name));
        let label = |path: &Path| sysfs::text(SOURCE, &path.join("type")).unwrap_or_default();
        let cpus: Vec<PathBuf> = sysfs::entries(&config.sysfs.join("devices/system/cpu"))
            .into_iter()
            .filter(|p| is_cpu(sysfs::name(p)))
            .collect();
        let there = |path: PathBuf| path.exists().then_some(path);
        let x86 = cpus.iter().flat_map(|cpu| {
            ["core_throttle_count", "package_throttle_count"]
                .map(|file| cpu.join("thermal_throttle").join(file))
        });
        let jetson = class("hwmon")
            .into_iter()
            .flat_map(|chip| sysfs::entries(&chip))
            .filter(|file| {
                let name = sysfs::name(file);
                name.starts_with("oc") && name.ends_with("_event_cnt")
            });
        Self {
            zones: class("thermal")
                .into_iter()
                .filter(|zone| sysfs::name(zone).starts_with("thermal_zone"))
                .map(|zone| (label(&zone), zone.join("temp")))
                .filter(|(name, _)| is_a_sensor(name))
                .map(|(name, file)| (name.into(), file))
                .collect(),
            cooling: class("thermal")
                .into_iter()
                .filter(|device| sysfs::name(device).starts_with("cooling_device"))
                .filter(|device| holds_clocks_back(&label(device)))
                .map(|device| device.join("cur_state"))
                .collect(),
            events: x86.filter_map(there).chain(jetson).collect(),
            last_events: None,
            pi: there(
                config
                    .sysfs
                    .join("devices/platform/soc/soc:firmware/get_throttled"),
            ),
            cpu_clocks: cpus
                .iter()
                .map(|cpu| cpu.join("cpufreq/scaling_cur_freq"))
                .filter_map(there)
                .take(MOST_CORES)
                .collect(),
            gpu_clock: class("devfreq")
                .into_iter()
                .find(|device| is_gpu(sysfs::name(device)))
                .map(|device| device.join("cur_freq")),
            mode: PowerMode::new(
                &config.nvpmodel,
                config.sysfs.join("firmware/acpi/platform_profile"),
            ),
        }
    }

    /// Reads them.
    pub(crate) fn read(&mut self, now: Instant) -> Condition {
        let number = |path: &PathBuf| sysfs::number::<f64>(SOURCE, path).ok();
        let hottest = self
            .zones
            .iter()
            .filter_map(|(name, file)| Some((Arc::clone(name), number(file)? * 1e-3)))
            // Sensors that are off read far below zero, or an impossible heat.
            .filter(|(_, celsius)| (-100.0..200.0).contains(celsius))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let clocks: Vec<f64> = self.cpu_clocks.iter().filter_map(number).collect();
        let cpu_mhz =
            (!clocks.is_empty()).then(|| clocks.iter().sum::<f64>() / clocks.len() as f64 * 1e-3);
        Condition {
            hottest,
            throttled: self.throttled(),
            cpu_mhz,
            gpu_mhz: self.gpu_clock.as_ref().and_then(number).map(|hz| hz * 1e-6),
            mode: self.mode.read(now),
        }
    }

    /// Whether clocks are held back now, or were since the last read; `None` when nothing reports it.
    fn throttled(&mut self) -> Option<bool> {
        let count = |path: &PathBuf| sysfs::number::<u64>(SOURCE, path).ok();
        let cooling: Vec<u64> = self.cooling.iter().filter_map(count).collect();
        let events: Vec<u64> = self.events.iter().filter_map(count).collect();
        let pi = self.pi.as_ref().and_then(|file| {
            let word = sysfs::text(SOURCE, file).ok()?;
            u64::from_str_radix(word.trim_start_matches("0x"), 16).ok()
        });
        let sum: u64 = events.iter().sum();
        let more = self.last_events.is_some_and(|last| sum > last);
        if !events.is_empty() {
            self.last_events = Some(sum);
        }
        let reported = !cooling.is_empty() || !events.is_empty() || pi.is_some();
        let now = cooling.iter().any(|state| *state > 0) || pi.is_some_and(|w| w & PI_NOW != 0);
        reported.then_some(more || now)
    }
}

/// `cpu0`, `cpu11`; not `cpufreq`.
fn is_cpu(name: &str) -> bool {
    name.strip_prefix("cpu")
        .is_some_and(|n| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()))
}

/// A devfreq device of a GPU, by the names Jetson boards and others give it.
fn is_gpu(name: &str) -> bool {
    ["gpu", "gp10b", "gv11b", "ga10b", "gb10b"]
        .iter()
        .any(|part| name.contains(part))
}

/// A cooling device that cools by lower clocks, and not by a fan.
fn holds_clocks_back(kind: &str) -> bool {
    [
        "cpufreq",
        "devfreq",
        "Processor",
        "cpu-balanced",
        "gpu-balanced",
    ]
    .iter()
    .any(|part| kind.contains(part))
}

/// Time between two questions for the power mode.
const QUERY_INTERVAL: Duration = Duration::from_secs(60);

/// How long the first answer is waited for: nothing is measured yet.
const FIRST_ANSWER: Duration = Duration::from_secs(2);

/// The board's power mode: `nvpmodel`'s, else the platform profile of ACPI. The program takes its time, so a thread asks it,
/// and its answer is taken at a later reading.
#[derive(Debug)]
struct PowerMode {
    nvpmodel: PathBuf,
    profile: PathBuf,
    asked_at: Instant,
    question: Option<JoinHandle<Option<Arc<str>>>>,
    /// None where the program had no answer at first: it is not started every minute for nothing.
    known: Option<Arc<str>>,
}

impl PowerMode {
    fn new(nvpmodel: &Path, profile: PathBuf) -> Self {
        let mut mode = Self {
            nvpmodel: nvpmodel.to_owned(),
            profile,
            asked_at: Instant::now(),
            question: None,
            known: None,
        };
        mode.ask();
        let until = std::time::Instant::now() + FIRST_ANSWER;
        while mode.question.is_some() && std::time::Instant::now() < until {
            std::thread::sleep(Duration::from_millis(5));
            mode.take_answer();
        }
        mode
    }

    /// The mode as far as it is known; never waits.
    fn read(&mut self, now: Instant) -> Option<Arc<str>> {
        self.take_answer();
        if self.known.is_none() {
            let profile = sysfs::text(SOURCE, &self.profile).ok();
            return profile.filter(|mode| !mode.is_empty()).map(Into::into);
        }
        if self.question.is_none() && now.saturating_duration_since(self.asked_at) >= QUERY_INTERVAL
        {
            self.asked_at = now;
            self.ask();
        }
        self.known.clone()
    }

    fn ask(&mut self) {
        let program = self.nvpmodel.clone();
        self.question = Some(std::thread::spawn(move || {
            let mut command = Command::new(program);
            let output = command.arg("-q").stdin(Stdio::null()).output().ok()?;
            mode_in(&String::from_utf8_lossy(&output.stdout)).map(Into::into)
        }));
    }

    fn take_answer(&mut self) {
        if let Some(question) = self.question.take_if(|question| question.is_finished())
            && let Ok(Some(mode)) = question.join()
        {
            self.known = Some(mode);
        }
    }
}

/// The mode in the output of `nvpmodel -q`: `NV Power Mode: MODE_30W`, then its number.
fn mode_in(output: &str) -> Option<&str> {
    let mut lines = output.lines();
    let mode = lines.find_map(|line| line.trim().strip_prefix("NV Power Mode:"))?;
    Some(mode.trim())
}

#[cfg(test)]
mod tests;
