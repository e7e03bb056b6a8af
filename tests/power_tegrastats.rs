//! Known curves of power, printed in real time by a stand-in for `tegrastats`, come out of the sampler to
//! 0.1 %, through the same code as on a board.

#![allow(clippy::unwrap_used)]

use albireo_power::{
    self as power, Domain, Energy, Meter, MeterError, PowerConfig, PowerHandle, PowerSource,
    Tegrastats,
};
use albireo_wire::EnergyQuality;
use serde_json::{Value, json};
use std::path::Path;
use std::time::Duration;
use tokio::task::JoinHandle;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// A stand-in that does `task`, and the configuration that finds it.
fn stand_in(task: &Value) -> (tempfile::TempDir, PowerConfig) {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("tegrastats");
    let fake = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/fake_tegrastats");
    std::os::unix::fs::symlink(fake, &program).unwrap();
    std::fs::write(folder.path().join("tegrastats.json"), task.to_string()).unwrap();
    let config = PowerConfig {
        source: PowerSource::Tegrastats,
        tegrastats: program,
        sysfs: folder.path().join("sys"),
        ..PowerConfig::default()
    };
    (folder, config)
}

struct Running {
    power: PowerHandle,
    task: JoinHandle<()>,
    stop: CancellationToken,
    _folder: tempfile::TempDir,
}

async fn run(task: &Value) -> Running {
    let (folder, config) = stand_in(task);
    let stop = CancellationToken::new();
    let (power, task) = power::start(&config, stop.clone()).await.unwrap();
    Running {
        power,
        task,
        stop,
        _folder: folder,
    }
}

impl Running {
    /// Watches for `length` and gives back the mean watts over what was covered, with the whole answer.
    async fn watch(&self, length: Duration) -> (f64, Energy) {
        // Begin where a sample is: the meter has just been opened.
        let start = Instant::now() + Duration::from_millis(250);
        let end = start + length;
        tokio::time::sleep_until(end).await;
        let found = self.energy(start, end).await;
        let covered = found.coverage * length.as_secs_f64();
        (found.joules(Domain::Total).unwrap() / covered, found)
    }

    async fn energy(&self, start: Instant, end: Instant) -> Energy {
        let measured = self.power.camera("front").measure(start);
        measured.finish(end, Duration::MAX).await.unwrap().node
    }

    async fn end(self) {
        self.stop.cancel();
        self.task.await.unwrap();
    }
}

fn close(found: f64, expected: f64) -> bool {
    (found / expected - 1.0).abs() < 1e-3
}

#[tokio::test]
async fn a_constant_power_is_its_watts_times_the_time() {
    let running = run(&json!({"curve": [[0, 21.5], [1, 21.5]]})).await;
    let (mean, found) = running.watch(Duration::from_secs(3)).await;
    assert!(close(mean, 21.5), "{found:?}");
    assert_eq!(found.total_from, "input_rail");
    assert_eq!(found.source, "tegrastats");
    let cpu = found.joules(Domain::Cpu).unwrap() / found.joules(Domain::Total).unwrap();
    assert!(close(cpu, 0.3), "the domains follow their rails: {found:?}");
    let (sensor, _) = running.power.snapshot().hottest.unwrap();
    assert_eq!(sensor, "tj");
    running.end().await;
}

#[tokio::test]
async fn a_ramp_is_integrated_between_its_samples() {
    // Up and down, and watched for whole periods: the mean is the middle wherever the watch begins.
    let running = run(&json!({"curve": [[0, 20], [1, 30], [2, 20]]})).await;
    let (mean, found) = running.watch(Duration::from_secs(4)).await;
    assert!(close(mean, 25.0), "{mean} {found:?}");
    running.end().await;
}

#[tokio::test]
async fn a_square_wave_keeps_its_mean_and_its_peak() {
    let wave = json!([
        [0, 39.5],
        [0.5, 39.5],
        [0.500001, 40.5],
        [1, 40.5],
        [1.000001, 39.5]
    ]);
    let running = run(&json!({"curve": wave})).await;
    let (mean, found) = running.watch(Duration::from_secs(5)).await;
    assert!(close(mean, 40.0), "{mean} {found:?}");
    assert_eq!(found.domains[0].peak_watts, Some(40.5));
    running.end().await;
}

#[tokio::test]
async fn missing_lines_are_bridged() {
    let running = run(&json!({"curve": [[0, 30], [1, 30]], "skip": 3})).await;
    let (mean, found) = running.watch(Duration::from_secs(3)).await;
    assert!(close(mean, 30.0), "{found:?}");
    assert!(found.samples <= 21, "{found:?}");
    running.end().await;
}

#[tokio::test]
async fn a_stall_is_told_as_coverage_and_adds_no_energy() {
    let task = json!({"curve": [[0, 30], [1, 30]], "stall": [1.5, 4.0]});
    let running = run(&task).await;
    let (mean, found) = running.watch(Duration::from_secs(6)).await;
    assert!(close(mean, 30.0), "{found:?}");
    assert_eq!(found.quality, EnergyQuality::Partial);
    assert!(found.coverage < 0.65 && found.coverage > 0.2, "{found:?}");
    assert!(running.power.snapshot().failed_reads > 0);
    running.end().await;
}

#[tokio::test]
async fn a_child_that_dies_is_started_again_and_half_its_last_line_is_no_reading() {
    let task = json!({"curve": [[0, 30], [1, 30]], "die_at": 1.5});
    let running = run(&task).await;
    let (mean, found) = running.watch(Duration::from_secs(6)).await;
    assert!(close(mean, 30.0), "{found:?}");
    assert_eq!(found.domains[0].peak_watts, Some(30.0));
    let now = Instant::now();
    let samples_after = running.energy(now - Duration::from_millis(900), now).await;
    assert!(
        samples_after.samples > 3,
        "it prints again: {samples_after:?}"
    );
    running.end().await;
}

#[tokio::test]
async fn recorded_lines_of_every_board_are_integrated_to_their_own_total() {
    let lines = include_str!("fixtures/telemetry/tegrastats_lines.tsv");
    // What an independent reading says of them is in the file of expectations beside it.
    for (name, watts, rule) in [
        ("agx_orin_jp5:5", 22.430, "sum_of_rails"),
        ("agx_orin_jp7:1", 13.907, "sum_of_rails"),
        ("agx_thor:2", 19.780, "input_rail"),
        ("agx_thor:3", 8.291, "sum_of_rails"),
        ("orin_nano:2", 12.479, "input_rail"),
        ("orin_nx:2", 7.280, "input_rail"),
        ("xavier_and_older:1", 32.850, "sum_of_rails"),
    ] {
        let line = lines
            .lines()
            .find_map(|l| l.strip_prefix(name)?.strip_prefix('\t'));
        let running = run(&json!({"lines": [line.unwrap()]})).await;
        let (mean, found) = running.watch(Duration::from_millis(700)).await;
        assert!(close(mean, watts), "{name}: {found:?}");
        assert_eq!(found.total_from, rule, "{name}");
        assert_eq!(found.quality, EnergyQuality::Measured, "{name}");
        running.end().await;
    }
}

#[tokio::test]
async fn a_program_without_rails_says_that_root_is_needed() {
    let line = "RAM 998/15389MB (lfb 3313x4MB) CPU [4%@883] EMC_FREQ 0% GR3D_FREQ 0% cpu@56.8C";
    let (_folder, config) = stand_in(&json!({"lines": [line]}));
    let error = tokio::task::spawn_blocking(move || Tegrastats::open(&config).err())
        .await
        .unwrap()
        .unwrap();
    assert!(matches!(error, MeterError::Permission { .. }));
    assert!(error.to_string().contains("sudo -n tegrastats"), "{error}");
}

#[test]
fn a_program_that_prints_something_else_is_refused() {
    let (_folder, config) = stand_in(&json!({"lines": ["hello"]}));
    let text = Tegrastats::open(&config).err().unwrap().to_string();
    assert!(
        text.contains("does not print lines of tegrastats"),
        "{text}"
    );
}

#[test]
fn the_meter_takes_its_child_with_it() {
    let (folder, config) = stand_in(&json!({"curve": [[0, 30], [1, 30]]}));
    let children = || {
        let own = folder.path().join("tegrastats");
        std::fs::read_dir("/proc")
            .unwrap()
            .filter_map(|entry| std::fs::read(entry.ok()?.path().join("cmdline")).ok())
            .filter(|line| String::from_utf8_lossy(line).contains(&*own.to_string_lossy()))
            .count()
    };
    let mut meter = Tegrastats::open(&config).unwrap();
    // On a busy machine the child may be late with a line; whether it lives and dies is asked here.
    let _ = meter.poll(Instant::now());
    assert_eq!(children(), 1);
    drop(meter);
    assert_eq!(children(), 0);
}
