//! Reads the machine's condition: thermal zones, throttling, clocks, power mode. Missing files are skipped.

pub(crate) mod condition;

use self::condition::Mean;
use crate::config::PowerConfig;
use crate::source::sysfs;
use albireo_wire::BoardState;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

/// The most CPU cores whose clocks are read: each read of a clock interrupts the core.
const MOST_CORES: usize = 16;

/// The file in which the Raspberry Pi's firmware reports throttling.
const PI_THROTTLED: &str = "devices/platform/soc/soc:firmware/get_throttled";

/// Bits of the Raspberry Pi firmware's word for the present: frequency capped, throttled, soft limit.
const PI_NOW: u64 = 0b1110;

/// The files that report the machine's condition.
#[derive(Debug)]
pub(crate) struct Machine {
    /// Thermal zones: type and temperature file (millidegrees).
    zones: Vec<(String, PathBuf)>,
    /// Cooling devices that limit clocks; 0 if they do not.
    cooling: Vec<PathBuf>,
    /// Counters of throttling events.
    events: Vec<EventCounter>,
    pi: PathBuf,
    cpu_clocks: Vec<PathBuf>,
    gpu_clock: Option<PathBuf>,
    /// The busy share of a Jetson's GPU, in thousandths.
    gpu_load: Option<PathBuf>,
    /// The mode that `nvpmodel` told last.
    mode: Option<String>,
    /// Its later answers.
    modes: Receiver<String>,
    /// The ACPI platform profile, for machines without `nvpmodel`.
    profile: PathBuf,
}

#[derive(Debug)]
struct EventCounter {
    file: PathBuf,
    /// Its count when it could last be read: a core that is off for a while keeps it.
    last: Option<u64>,
}

/// Reads the condition of this machine now, such as its power mode; what it does not report is absent.
pub fn board_state(config: &PowerConfig) -> BoardState {
    Machine::new(config).read()
}

impl Machine {
    /// Finds the files.
    pub(crate) fn new(config: &PowerConfig) -> Self {
        let sys = &config.sysfs;
        let thermal = sysfs::entries(&sys.join("class/thermal"));
        let cores = cores(sys);
        let gpu = gpu(sys);
        let (mode, modes) = follow_mode(config.nvpmodel.clone(), MODE_EVERY);
        Self {
            zones: zones(&thermal),
            cooling: cooling(&thermal),
            events: throttling_counters(sys, &cores),
            pi: sys.join(PI_THROTTLED),
            cpu_clocks: clocks(&cores),
            gpu_load: gpu_load(sys, gpu.as_deref()),
            gpu_clock: gpu.map(|device| device.join("cur_freq")),
            mode,
            modes,
            profile: sys.join("firmware/acpi/platform_profile"),
        }
    }

    /// Reads the files.
    pub(crate) fn read(&mut self) -> BoardState {
        let number = |path: &PathBuf| sysfs::number::<f64>(path).ok();
        let hottest = self
            .zones
            .iter()
            .filter_map(|(name, file)| Some((name, number(file)? * 1e-3)))
            // Disabled sensors read far below zero or impossibly hot.
            .filter(|(_, celsius)| (-100.0..200.0).contains(celsius))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let mut cpu_khz = Mean::default();
        for file in &self.cpu_clocks {
            cpu_khz.add(number(file));
        }
        if let Some(newest) = self.modes.try_iter().last() {
            self.mode = Some(newest);
        }
        BoardState {
            power_mode: self.mode.clone().or_else(|| self.platform_profile()),
            hottest_celsius: hottest.map(|(_, celsius)| celsius),
            hottest_sensor: hottest.map(|(sensor, _)| sensor.clone()),
            cpu_mhz: cpu_khz.value().map(|khz| khz * 1e-3),
            gpu_mhz: self.gpu_clock.as_ref().and_then(number).map(|hz| hz * 1e-6),
            gpu_utilisation: self.gpu_utilisation(),
            throttled: self.throttled(),
        }
    }

    fn platform_profile(&self) -> Option<String> {
        let profile = sysfs::text(&self.profile).ok()?;
        if profile.is_empty() {
            None
        } else {
            Some(profile)
        }
    }

    /// The busy share of the GPU, 0 to 1. What is no number of thousandths is no figure.
    fn gpu_utilisation(&self) -> Option<f64> {
        let load: f64 = sysfs::number(self.gpu_load.as_ref()?).ok()?;
        if !(0.0..=1000.0).contains(&load) {
            return None;
        }
        Some(load * 1e-3)
    }

    /// Returns true if clocks are limited now or were since the last read; `None` if nothing reports it.
    fn throttled(&mut self) -> Option<bool> {
        // Each is silent on machines that lack it: one that reports a limit is enough, and one that reports none is an
        // answer.
        let by_cooling = self
            .cooling
            .iter()
            .filter_map(|file| sysfs::number::<u64>(file).ok())
            .map(|state| state > 0)
            .reduce(|a, b| a || b);
        let by_pi = self.pi_word().map(|word| word & PI_NOW != 0);
        let by_events = self.has_new_events();
        [by_cooling, by_pi, by_events].into_iter().flatten().reduce(|a, b| a || b)
    }

    /// True if a counter of throttling events has risen since it was last read; `None` if none can be read.
    fn has_new_events(&mut self) -> Option<bool> {
        let mut has_new = None;
        for counter in &mut self.events {
            let Ok(count) = sysfs::number::<u64>(&counter.file) else {
                continue;
            };
            let has_risen = counter.last.is_some_and(|last| count > last);
            counter.last = Some(count);
            has_new = Some(has_risen || has_new == Some(true));
        }
        has_new
    }

    /// The word of the Raspberry Pi's firmware, which is hexadecimal.
    fn pi_word(&self) -> Option<u64> {
        let text = sysfs::text(&self.pi).ok()?;
        u64::from_str_radix(text.trim_start_matches("0x"), 16).ok()
    }
}

/// The folders of the processor's cores: `cpu0` and `cpu11`, but not `cpufreq`.
fn cores(sys: &Path) -> Vec<PathBuf> {
    let mut found = sysfs::entries(&sys.join("devices/system/cpu"));
    found.retain(|path| {
        let number = sysfs::name(path).strip_prefix("cpu");
        number.is_some_and(|number| number.parse::<u32>().is_ok())
    });
    found
}

fn clocks(cores: &[PathBuf]) -> Vec<PathBuf> {
    cores
        .iter()
        .map(|core| core.join("cpufreq/scaling_cur_freq"))
        .filter(|file| file.exists())
        .take(MOST_CORES)
        .collect()
}

/// The type of a thermal zone or a cooling device.
fn kind(device: &Path) -> String {
    sysfs::text(&device.join("type")).unwrap_or_default()
}

fn zones(thermal: &[PathBuf]) -> Vec<(String, PathBuf)> {
    let mut found = Vec::new();
    for zone in thermal {
        let kind = kind(zone);
        // This zone of Jetson boards reads a constant 50 °C or 100 °C.
        let is_constant = kind.to_ascii_lowercase().starts_with("pmic");
        if sysfs::name(zone).starts_with("thermal_zone") && !is_constant {
            found.push((kind, zone.join("temp")));
        }
    }
    found
}

fn cooling(thermal: &[PathBuf]) -> Vec<PathBuf> {
    let limits_clocks = |device: &&PathBuf| {
        sysfs::name(device).starts_with("cooling_device") && has_one(&kind(device), &CLOCKS)
    };
    thermal
        .iter()
        .filter(limits_clocks)
        .map(|device| device.join("cur_state"))
        .collect()
}

/// The counters of throttling events: of the cores on a PC, of the power monitors on a Jetson board.
fn throttling_counters(sys: &Path, cores: &[PathBuf]) -> Vec<EventCounter> {
    let mut found = Vec::new();
    for core in cores {
        for file in ["core_throttle_count", "package_throttle_count"] {
            let counter = core.join("thermal_throttle").join(file);
            if counter.exists() {
                found.push(counter);
            }
        }
    }
    for chip in sysfs::entries(&sys.join("class/hwmon")) {
        for file in sysfs::entries(&chip) {
            let name = sysfs::name(&file);
            if name.starts_with("oc") && name.ends_with("_event_cnt") {
                found.push(file);
            }
        }
    }
    let unread = |file| EventCounter { file, last: None };
    found.into_iter().map(unread).collect()
}

/// The GPU among the devices whose clock changes.
fn gpu(sys: &Path) -> Option<PathBuf> {
    let devices = sysfs::entries(&sys.join("class/devfreq"));
    devices.into_iter().find(|device| has_one(sysfs::name(device), &GPUS))
}

fn gpu_load(sys: &Path, gpu: Option<&Path>) -> Option<PathBuf> {
    let of_device = gpu.map(|device| device.join("device/load"));
    let elsewhere = GPU_LOADS.map(|file| sys.join(file));
    of_device.into_iter().chain(elsewhere).find(|file| file.exists())
}

/// Substrings of the names that Jetson boards and others give a GPU's devfreq device.
const GPUS: [&str; 5] = ["gpu", "gp10b", "gv11b", "ga10b", "gb10b"];

/// Where Jetson boards have the GPU's load without a devfreq device, by release (JetPack 4 and 5, 6).
const GPU_LOADS: [&str; 2] = ["devices/gpu.0/load", "devices/platform/gpu.0/load"];

/// Substrings of the types of cooling devices that lower clocks instead of running a fan.
const CLOCKS: [&str; 4] = ["cpufreq", "devfreq", "Processor", "-balanced"];

fn has_one(name: &str, parts: &[&str]) -> bool {
    parts.iter().any(|part| name.contains(part))
}

/// The time between two queries of the power mode.
const MODE_EVERY: Duration = Duration::from_secs(60);

/// The time limit for the first answer: nothing is measured yet.
const FIRST_MODE: Duration = Duration::from_secs(2);

/// Queries `nvpmodel` for the power mode, now and every `period`, until the receiver is dropped. A thread does it
/// because the program is slow. Returns the first answer, if it comes in time. If there is none, the thread stops.
fn follow_mode(nvpmodel: PathBuf, period: Duration) -> (Option<String>, Receiver<String>) {
    let (newest, modes) = channel();
    std::thread::spawn(move || {
        let Some(mut mode) = ask(&nvpmodel) else {
            return;
        };
        while newest.send(mode.clone()).is_ok() {
            std::thread::sleep(period);
            if let Some(now) = ask(&nvpmodel) {
                mode = now;
            }
        }
    });
    (modes.recv_timeout(FIRST_MODE).ok(), modes)
}

/// The mode in the output of `nvpmodel -q`: `NV Power Mode: MODE_30W`, followed by its number.
fn ask(nvpmodel: &Path) -> Option<String> {
    let output = Command::new(nvpmodel).arg("-q").stdin(Stdio::null()).output().ok()?;
    let text = String::from_utf8_lossy(&output.stdout);
    let mode = text.lines().find_map(|line| line.trim().strip_prefix("NV Power Mode:"))?;
    Some(mode.trim().to_owned())
}

#[cfg(test)]
mod tests;
