//! The sampler measures known power curves, printed in real time by a fake `tegrastats`, to 0.1 %, with the same code as on a
//! board.

use crate::support::{assert_contains, until};
use albireo_power::{self as power, PowerConfig, PowerHandle, PowerSource};
use albireo_wire::{ClipEnergy, EnergyQuality};
use serde_json::{Value, json};
use std::time::Duration;
use tokio::task::JoinHandle;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// A fake `tegrastats` that does `task`, and the configuration that uses it.
fn stand_in(task: &Value) -> (tempfile::TempDir, PowerConfig) {
    let folder = tempfile::tempdir().unwrap();
    let program = crate::support::fake_tegrastats(folder.path(), task);
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
    /// Measures for `length`, and returns the mean watts over the covered time and the whole result.
    async fn watch(&self, length: Duration) -> (f64, ClipEnergy) {
        // Starts at a sample: the meter was just opened.
        let start = Instant::now() + Duration::from_millis(250);
        let end = start + length;
        tokio::time::sleep_until(end).await;
        let found = self.energy(start, end).await;
        let covered = found.coverage * length.as_secs_f64();
        (found.node_joules.unwrap() / covered, found)
    }

    async fn energy(&self, start: Instant, end: Instant) -> ClipEnergy {
        crate::power_sysfs::energy(&self.power, start, end).await
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
async fn constant_power_integrates_to_watts_times_time() {
    let running = run(&json!({"curve": [[0, 21.5], [1, 21.5]]})).await;
    let (mean, found) = running.watch(Duration::from_secs(3)).await;
    assert!(close(mean, 21.5), "{found:?}");
    assert_eq!(
        (&*found.total_from, &*found.source),
        ("input_rail", "tegrastats")
    );
    let cpu = found.domains.iter().find(|domain| domain.domain == "cpu");
    let share = cpu.unwrap().joules / found.node_joules.unwrap();
    assert!(
        close(share, 0.3),
        "the domains follow their rails: {found:?}"
    );
    running.end().await;
}

#[tokio::test]
async fn a_square_wave_keeps_its_mean_and_its_peak() {
    // The steps are so small that late lines on a busy machine do not matter, yet larger than the tolerance.
    let wave = json!([
        [0, 39.9],
        [0.5, 39.9],
        [0.500001, 40.1],
        [1, 40.1],
        [1.000001, 39.9]
    ]);
    let running = run(&json!({"curve": wave})).await;
    let (mean, found) = running.watch(Duration::from_secs(5)).await;
    assert!(close(mean, 40.0), "{mean} {found:?}");
    assert_eq!(found.domains[0].peak_watts, Some(40.1));
    running.end().await;
}

#[tokio::test]
async fn a_stall_lowers_the_coverage_and_adds_no_energy() {
    let task = json!({"curve": [[0, 30], [1, 30]], "stall": [1.5, 4.0]});
    let running = run(&task).await;
    let (mean, found) = running.watch(Duration::from_secs(6)).await;
    assert!(close(mean, 30.0), "{found:?}");
    assert_eq!(found.quality, EnergyQuality::Partial);
    assert!(found.coverage < 0.65 && found.coverage > 0.2, "{found:?}");
    assert!(running.power.snapshot().failed_reads > 0);
    running.end().await;
}

#[test]
fn a_slow_first_line_is_not_a_stall() {
    let task = json!({"curve": [[0, 30], [1, 30]], "stall": [0, 1.5]});
    let (_folder, config) = stand_in(&task);
    let mut meter = power::open(&config).unwrap();
    let _no_line_yet = meter.poll(Instant::now()).unwrap();
}

#[tokio::test]
async fn a_child_that_exits_is_restarted_and_its_partial_last_line_is_ignored() {
    let task = json!({"curve": [[0, 30], [1, 30]], "die_at": 1.5});
    let running = run(&task).await;
    let (mean, found) = running.watch(Duration::from_secs(6)).await;
    assert!(close(mean, 30.0), "{found:?}");
    assert_eq!(found.domains[0].peak_watts, Some(30.0));
    until("it prints again", async || {
        let now = Instant::now();
        let after = running.energy(now - Duration::from_millis(900), now).await;
        after.samples > 3
    })
    .await;
    running.end().await;
}

#[test]
fn missing_rails_are_explained_by_missing_root_rights_and_another_program_is_rejected() {
    let line = "RAM 998/15389MB (lfb 3313x4MB) CPU [4%@883] EMC_FREQ 0% GR3D_FREQ 0% cpu@56.8C";
    let denied = "permission denied; it prints no power rails for this user";
    for (line, said) in [
        (line, &[denied, "sudo -n tegrastats"][..]),
        ("hello", &["its output is not that of tegrastats"]),
    ] {
        let (_folder, config) = stand_in(&json!({"lines": [line]}));
        let error = power::open(&config).err().unwrap();
        assert_contains(&error.to_string(), said);
    }
}
