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
    events: Vec<PathBuf>,
    last_events: Option<u64>,
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

/// Reads the condition of this machine now, such as its power mode; what it does not report is absent.
pub fn board_state(config: &PowerConfig) -> BoardState {
    Machine::new(config).read()
}

impl Machine {
    /// Finds the files.
    pub(crate) fn new(config: &PowerConfig) -> Self {
        let class = |name: &str| sysfs::entries(&config.sysfs.join("class").join(name));
        let label = |path: &Path| sysfs::text(&path.join("type")).unwrap_or_default();
        let there = |path: PathBuf| path.exists().then_some(path);
        let mut cpus = sysfs::entries(&config.sysfs.join("devices/system/cpu"));
        // `cpu0` and `cpu11`, but not `cpufreq`.
        cpus.retain(|path| {
            let number = sysfs::name(path).strip_prefix("cpu");
            number.is_some_and(|number| number.parse::<u32>().is_ok())
        });
        let x86 = cpus.iter().flat_map(|cpu| {
            ["core_throttle_count", "package_throttle_count"]
                .map(|file| cpu.join("thermal_throttle").join(file))
        });
        let jetson =
            class("hwmon")
                .into_iter()
                .flat_map(|chip| sysfs::entries(&chip))
                .filter(|file| {
                    let name = sysfs::name(file);
                    name.starts_with("oc") && name.ends_with("_event_cnt")
                });
        let gpu = class("devfreq").into_iter().find(|device| has_one(sysfs::name(device), &GPUS));
        let load = gpu.iter().map(|gpu| gpu.join("device/load"));
        let other_loads = GPU_LOADS.map(|file| config.sysfs.join(file));
        let (mode, modes) = follow_mode(config.nvpmodel.clone(), MODE_EVERY);
        Self {
            zones: class("thermal")
                .into_iter()
                .filter(|zone| sysfs::name(zone).starts_with("thermal_zone"))
                .map(|zone| (label(&zone), zone.join("temp")))
                // This zone of Jetson boards reads a constant 50 °C or 100 °C.
                .filter(|(name, _)| !name.to_ascii_lowercase().starts_with("pmic"))
                .collect(),
            cooling: class("thermal")
                .into_iter()
                .filter(|device| sysfs::name(device).starts_with("cooling_device"))
                .filter(|device| has_one(&label(device), &CLOCKS))
                .map(|device| device.join("cur_state"))
                .collect(),
            events: x86.filter_map(there).chain(jetson).collect(),
            last_events: None,
            pi: config.sysfs.join(PI_THROTTLED),
            cpu_clocks: cpus
                .iter()
                .map(|cpu| cpu.join("cpufreq/scaling_cur_freq"))
                .filter_map(there)
                .take(MOST_CORES)
                .collect(),
            gpu_load: load.chain(other_loads).find_map(there),
            gpu_clock: gpu.map(|device| device.join("cur_freq")),
            mode,
            modes,
            profile: config.sysfs.join("firmware/acpi/platform_profile"),
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
        self.mode = self.modes.try_iter().last().or(self.mode.take());
        let profile = || {
            let profile = sysfs::text(&self.profile).ok();
            profile.filter(|mode| !mode.is_empty())
        };
        BoardState {
            power_mode: self.mode.clone().or_else(profile),
            hottest_celsius: hottest.map(|(_, celsius)| celsius),
            hottest_sensor: hottest.map(|(sensor, _)| sensor.clone()),
            cpu_mhz: cpu_khz.value().map(|khz| khz * 1e-3),
            gpu_mhz: self.gpu_clock.as_ref().and_then(number).map(|hz| hz * 1e-6),
            gpu_utilisation: self
                .gpu_load
                .as_ref()
                .and_then(number)
                .filter(|load| (0.0..=1000.0).contains(load))
                .map(|load| load * 1e-3),
            throttled: self.throttled(),
        }
    }

    /// Returns true if clocks are limited now or were since the last read; `None` if nothing reports it.
    fn throttled(&mut self) -> Option<bool> {
        let count = |path: &PathBuf| sysfs::number::<u64>(path).ok();
        let cooling = self.cooling.iter().filter_map(count);
        let events = self.events.iter().filter_map(count).reduce(|a, b| a + b);
        let last = std::mem::replace(&mut self.last_events, events);
        let pi = sysfs::text(&self.pi)
            .ok()
            .and_then(|word| u64::from_str_radix(word.trim_start_matches("0x"), 16).ok());
        // Each is silent on machines that lack it: one that reports a limit is enough, and one that reports none is an answer.
        let by_cooling = cooling.map(|state| state > 0).reduce(|a, b| a || b);
        let by_pi = pi.map(|word| word & PI_NOW != 0);
        let by_events = events.map(|events| last.is_some_and(|last| events > last));
        [by_cooling, by_pi, by_events].into_iter().flatten().reduce(|a, b| a || b)
    }
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
        let mut mode = ask(&nvpmodel);
        while let Some(known) = mode
            && newest.send(known.clone()).is_ok()
        {
            std::thread::sleep(period);
            mode = ask(&nvpmodel).or(Some(known));
        }
    });
    (modes.recv_timeout(FIRST_MODE).ok(), modes)
}

/// The mode in the output of `nvpmodel -q`: `NV Power Mode: MODE_30W`, followed by its number.
fn ask(nvpmodel: &Path) -> Option<String> {
    let mut command = Command::new(nvpmodel);
    let output = command.arg("-q").stdin(Stdio::null()).output().ok()?;
    let text = String::from_utf8_lossy(&output.stdout);
    let mut lines = text.lines();
    let mode = lines.find_map(|line| line.trim().strip_prefix("NV Power Mode:"))?;
    Some(mode.trim().to_owned())
}

#[cfg(test)]
mod tests;
