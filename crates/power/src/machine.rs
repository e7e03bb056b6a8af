//! Reads the machine's condition: thermal zones, throttling, clocks, power mode. Missing files are skipped.

use crate::condition::Condition;
use crate::config::PowerConfig;
use crate::sysfs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Arc, mpsc};
use std::time::Duration;
use tokio::sync::watch;

const SOURCE: &str = "condition";

/// The most CPU cores whose clocks are read: each read of a clock interrupts the core.
const MOST_CORES: usize = 16;

/// The file in which the Raspberry Pi's firmware reports throttling.
const PI_THROTTLED: &str = "devices/platform/soc/soc:firmware/get_throttled";

/// Bits of the Raspberry Pi firmware's word for the present: frequency capped, throttled, soft limit.
const PI_NOW: u64 = 0b1110;

/// The board's power mode, if it is known.
type Mode = Option<Arc<str>>;

/// The files that report the machine's condition.
#[derive(Debug)]
pub(crate) struct Machine {
    /// Thermal zones: type and temperature file (millidegrees).
    zones: Vec<(Arc<str>, PathBuf)>,
    /// Cooling devices that limit clocks; 0 if they do not.
    cooling: Vec<PathBuf>,
    /// Counters of throttling events.
    events: Vec<PathBuf>,
    last_events: Option<u64>,
    pi: Option<PathBuf>,
    cpu_clocks: Vec<PathBuf>,
    gpu_clock: Option<PathBuf>,
    /// The mode from `nvpmodel`, and the ACPI platform profile as the fallback.
    mode: watch::Receiver<Mode>,
    profile: PathBuf,
}

impl Machine {
    /// Finds the files.
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
                .filter(|device| has_one(&label(device), &CLOCKS))
                .map(|device| device.join("cur_state"))
                .collect(),
            events: x86.filter_map(there).chain(jetson).collect(),
            last_events: None,
            pi: there(config.sysfs.join(PI_THROTTLED)),
            cpu_clocks: cpus
                .iter()
                .map(|cpu| cpu.join("cpufreq/scaling_cur_freq"))
                .filter_map(there)
                .take(MOST_CORES)
                .collect(),
            gpu_clock: class("devfreq")
                .into_iter()
                .find(|device| has_one(sysfs::name(device), &GPUS))
                .map(|device| device.join("cur_freq")),
            mode: follow_mode(config.nvpmodel.clone(), MODE_EVERY),
            profile: config.sysfs.join("firmware/acpi/platform_profile"),
        }
    }

    /// Reads the files.
    pub(crate) fn read(&mut self) -> Condition {
        let number = |path: &PathBuf| sysfs::number::<f64>(SOURCE, path).ok();
        let hottest = self
            .zones
            .iter()
            .filter_map(|(name, file)| Some((Arc::clone(name), number(file)? * 1e-3)))
            // Disabled sensors read far below zero or impossibly hot.
            .filter(|(_, celsius)| (-100.0..200.0).contains(celsius))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let clocks: Vec<f64> = self.cpu_clocks.iter().filter_map(number).collect();
        let cpu_mhz =
            (!clocks.is_empty()).then(|| clocks.iter().sum::<f64>() / clocks.len() as f64 * 1e-3);
        let mode = self.mode.borrow().clone();
        let profile = || {
            let profile = sysfs::text(SOURCE, &self.profile).ok();
            profile.filter(|mode| !mode.is_empty()).map(Into::into)
        };
        let mode = mode.or_else(profile);
        Condition {
            hottest,
            throttled: self.throttled(),
            cpu_mhz,
            gpu_mhz: self.gpu_clock.as_ref().and_then(number).map(|hz| hz * 1e-6),
            mode,
        }
    }

    /// Returns true if clocks are limited now or were since the last read; `None` if nothing reports it.
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

/// True for `cpu0` and `cpu11`, false for `cpufreq`.
fn is_cpu(name: &str) -> bool {
    name.strip_prefix("cpu")
        .is_some_and(|n| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()))
}

/// False for the `PMIC` zone of Jetson boards, which reads a constant 50 °C or 100 °C.
fn is_a_sensor(name: &str) -> bool {
    !name.to_ascii_lowercase().starts_with("pmic")
}

/// Substrings of the names that Jetson boards and others give a GPU's devfreq device.
const GPUS: [&str; 5] = ["gpu", "gp10b", "gv11b", "ga10b", "gb10b"];

/// Substrings of the types of cooling devices that lower clocks instead of running a fan.
const CLOCKS: [&str; 5] = [
    "cpufreq",
    "devfreq",
    "Processor",
    "cpu-balanced",
    "gpu-balanced",
];

fn has_one(name: &str, parts: &[&str]) -> bool {
    parts.iter().any(|part| name.contains(part))
}

/// The time between two queries of the power mode.
const MODE_EVERY: Duration = Duration::from_secs(60);

/// The time limit for the first answer: nothing is measured yet.
const FIRST_MODE: Duration = Duration::from_secs(2);

/// Queries `nvpmodel` for the power mode, now and every `period`, until the receiver is dropped. A thread does it
/// because the program is slow. If the first query has no answer, it stops.
fn follow_mode(nvpmodel: PathBuf, period: Duration) -> watch::Receiver<Mode> {
    let (newest, mode) = watch::channel(None);
    let (answered, first) = mpsc::channel();
    std::thread::spawn(move || {
        while !newest.is_closed() {
            if let Some(mode) = ask(&nvpmodel) {
                newest.send_replace(Some(mode));
            }
            let _ = answered.send(());
            if newest.borrow().is_none() {
                return;
            }
            std::thread::sleep(period);
        }
    });
    let _ = first.recv_timeout(FIRST_MODE);
    mode
}

fn ask(nvpmodel: &Path) -> Mode {
    let mut command = Command::new(nvpmodel);
    let output = command.arg("-q").stdin(Stdio::null()).output().ok()?;
    mode_in(&String::from_utf8_lossy(&output.stdout)).map(Into::into)
}

/// The mode in the output of `nvpmodel -q`: `NV Power Mode: MODE_30W`, followed by its number.
fn mode_in(output: &str) -> Option<&str> {
    let mut lines = output.lines();
    let mode = lines.find_map(|line| line.trim().strip_prefix("NV Power Mode:"))?;
    Some(mode.trim())
}

#[cfg(test)]
mod tests;
