//! The sampler measures known power curves, printed in real time by a fake `tegrastats`, to 0.1 %.

use crate::support::assert_contains;
use albireo_power::{self as power, PowerConfig, PowerSource};
use albireo_wire::{ClipEnergy, EnergyQuality};
use serde_json::{Value, json};
use std::time::Duration;
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

/// Measures a fake `tegrastats` that does `task` for `length`: mean watts over the covered time, all, and failed reads.
async fn watch(task: &Value, length: Duration) -> (f64, ClipEnergy, u64) {
    let (_folder, config) = stand_in(task);
    let stop = CancellationToken::new();
    let (power, task) = power::start(&config, stop.clone()).await.unwrap();
    // Starts at a sample: the meter was just opened.
    let start = Instant::now() + Duration::from_millis(250);
    let end = start + length;
    tokio::time::sleep_until(end).await;
    let measured = power.camera().measure(start);
    let found = measured.finish(end, Duration::MAX).await.unwrap().energy;
    let failed_reads = power.snapshot().failed_reads;
    stop.cancel();
    task.await.unwrap();
    let covered = found.coverage * length.as_secs_f64();
    (found.node_joules.unwrap() / covered, found, failed_reads)
}

fn close(found: f64, expected: f64) -> bool {
    (found / expected - 1.0).abs() < 1e-3
}

#[tokio::test]
async fn a_square_wave_keeps_its_mean_and_its_peak() {
    // The steps are so small that late lines on a busy machine do not matter, yet larger than the tolerance.
    let task = json!({
        "curve": [[0, 39.9], [0.5, 39.9], [0.500001, 40.1], [1, 40.1], [1.000001, 39.9]],
    });
    let (mean, found, _) = watch(&task, Duration::from_secs(5)).await;
    assert!(close(mean, 40.0), "{mean} {found:?}");
    assert_eq!(found.domains[0].peak_watts, Some(40.1));
    assert_eq!(found.total_from, "input_rail");
    assert_eq!(found.source, "tegrastats");
    let cpu = found.domains.iter().find(|domain| domain.domain == "cpu");
    let share = cpu.unwrap().joules / found.node_joules.unwrap();
    assert!(close(share, 0.3), "domains follow their rails: {found:?}");
}

#[tokio::test]
async fn a_stall_lowers_the_coverage_and_adds_no_energy() {
    let task = json!({"curve": [[0, 30], [1, 30]], "stall": [1.5, 4.0]});
    let (mean, found, failed_reads) = watch(&task, Duration::from_secs(6)).await;
    assert!(close(mean, 30.0), "{found:?}");
    assert_eq!(found.quality, EnergyQuality::Partial);
    assert!(found.coverage < 0.65 && found.coverage > 0.2, "{found:?}");
    assert!(failed_reads > 0);
}

#[test]
fn a_slow_first_line_is_not_a_stall() {
    let (_folder, config) = stand_in(&json!({"curve": [[0, 30], [1, 30]], "stall": [0, 1.5]}));
    let (_, mut meter) = power::open(&config).unwrap();
    let _no_line_yet = meter.poll(Instant::now()).unwrap();
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
        assert_contains(&power::open(&config).err().unwrap().to_string(), said);
    }
}
