//! The sampler measures known power curves on changing sysfs trees to 0.1 %, with the same code as on a machine. Time is
//! tokio's paused clock, so nothing waits.

use albireo_power::{self as power, PowerConfig, PowerHandle, PowerSource};
use albireo_wire::{ClipEnergy, EnergyQuality};
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

const RANGE_UJ: u64 = 262_143_328_850;

/// A tree that shows `watts(seconds)` in an INA3221 and, integrated, in a RAPL counter near its wrap.
struct Tree {
    folder: tempfile::TempDir,
    start: Instant,
    joules: f64,
}

impl Tree {
    fn new() -> Self {
        let tree = Self {
            folder: tempfile::tempdir().unwrap(),
            start: Instant::now(),
            joules: 0.0,
        };
        for (file, text) in [
            ("class/hwmon/hwmon1/name", "ina3221"),
            ("class/hwmon/hwmon1/in1_label", "VDD_IN"),
            ("class/hwmon/hwmon1/in1_input", "5000"),
            ("class/powercap/intel-rapl:0/name", "package-0"),
        ] {
            tree.write(file, text);
        }
        let range = "class/powercap/intel-rapl:0/max_energy_range_uj";
        tree.write(range, &RANGE_UJ.to_string());
        tree.show(0.0);
        tree
    }

    fn path(&self) -> &Path {
        self.folder.path()
    }

    fn write(&self, file: &str, text: &str) {
        let path: PathBuf = self.path().join(file);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }

    fn show(&self, watts: f64) {
        let milliamperes = (watts / 5.0 * 1e3).round();
        self.write("class/hwmon/hwmon1/curr1_input", &milliamperes.to_string());
        // The counter starts 40 J before it wraps.
        let microjoules = RANGE_UJ - 40_000_000 + (self.joules * 1e6).round() as u64;
        let counter = "class/powercap/intel-rapl:0/energy_uj";
        self.write(counter, &(microjoules % RANGE_UJ).to_string());
    }

    /// Advances time by `seconds`, with writes half-way between the sampler's ticks.
    async fn play(&mut self, seconds: f64, watts: impl Fn(f64) -> f64) {
        let step = Duration::from_millis(10);
        let until = Instant::now() + Duration::from_secs_f64(seconds);
        while Instant::now() < until {
            let now = Instant::now();
            let at = now.duration_since(self.start).as_secs_f64();
            self.show(watts(at));
            tokio::time::sleep_until(now + step).await;
            self.joules += watts(at + 0.005) * 0.01;
        }
    }
}

async fn open(tree: &Tree, source: PowerSource) -> (PowerHandle, CancellationToken) {
    let stop = CancellationToken::new();
    let config = PowerConfig {
        source,
        sysfs: tree.path().to_owned(),
        ..PowerConfig::default()
    };
    let (power, _task) = power::start(&config, stop.clone()).await.unwrap();
    (power, stop)
}

/// The node's energy between two times.
pub(crate) async fn energy(power: &PowerHandle, start: Instant, end: Instant) -> ClipEnergy {
    let measured = power.camera().measure(start);
    measured.finish(end, Duration::MAX).await.unwrap().energy
}

/// Plays `watts` to both meters for 10 s, and returns the energy of each over 8 s of it.
async fn both(watts: impl Fn(f64) -> f64 + Copy) -> [ClipEnergy; 2] {
    let mut found = Vec::new();
    for source in [PowerSource::Ina, PowerSource::Rapl] {
        let mut tree = Tree::new();
        tree.show(watts(0.0));
        // The sampler's ticks fall between two writes.
        tokio::time::sleep(Duration::from_millis(5)).await;
        let (power, stop) = open(&tree, source).await;
        tokio::time::sleep(Duration::from_millis(5)).await;
        tree.start = Instant::now();
        let start = tree.start + Duration::from_secs(1);
        tree.play(10.0, watts).await;
        let end = start + Duration::from_secs(8);
        found.push(energy(&power, start, end).await);
        stop.cancel();
    }
    found.try_into().unwrap()
}

fn check(found: &ClipEnergy, joules: f64) {
    let total = found.node_joules.unwrap();
    assert!(
        (total / joules - 1.0).abs() < 1e-3,
        "{total} J, not {joules}: {found:?}"
    );
    assert_eq!(found.quality, EnergyQuality::Measured);
    assert!((found.coverage - 1.0).abs() < 1e-9);
    assert_eq!(found.samples, 80);
}

#[tokio::test(start_paused = true)]
async fn constant_power_integrates_to_watts_times_time_across_a_counter_wrap() {
    for found in &both(|_| 15.0).await {
        check(found, 120.0);
    }
}

#[tokio::test(start_paused = true)]
async fn a_ramp_is_integrated_exactly() {
    for found in &both(|t| 10.0 + 2.0 * t).await {
        check(found, 10.0 * 8.0 + 81.0 - 1.0);
    }
}

#[tokio::test(start_paused = true)]
async fn a_square_wave_keeps_its_energy_and_peak() {
    for found in &both(|t| if t.rem_euclid(1.0) < 0.5 { 10.0 } else { 30.0 }).await {
        check(found, 160.0);
        let peak = found.domains[0].peak_watts.unwrap();
        assert!((peak - 30.0).abs() < 0.01, "{peak}");
    }
}
