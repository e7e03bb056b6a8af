//! `albireo compare` end to end: the code of the node with YOLOX-Nano on a clip of a few seconds, and the report.

use crate::power_live::board;
use crate::support::{Ended, assert_contains, fake_nvpmodel, fake_tegrastats, project, run};
use albireo_wire::{ClipReport, EnergyQuality};
use serde_json::{Value, json};
use std::path::Path;

/// Runs a comparison of two rounds of 20 frames, with changed constants.
fn compare(development: &str, arguments: &[&str]) -> Ended {
    let short = "compare --seconds 0.8 --repeat 2 --warm-up 0.6 --cool-down 0 --u=1e-3";
    let arguments: Vec<_> = short.split(' ').chain(arguments.iter().copied()).collect();
    run(&arguments, &[("ALBIREO_DEVELOPMENT", development)])
}

struct Compared {
    /// What was printed.
    words: String,
    progress: String,
    report: Value,
}

/// Compares vanilla and albireo with that `[power]` section.
fn compared(folder: &Path, power: &str, development: &str, more: &[&str]) -> Compared {
    let config = folder.join("node.toml");
    let out = folder.join("out");
    let model = project("models/yolox_nano.onnx");
    let settings = format!("detector.model = {model:?}\n[power]\n{power}\n");
    std::fs::write(&config, settings).unwrap();
    let policies = ["--policy", "vanilla", "--policy", "albireo"];
    let config = config.to_str().unwrap();
    let files = out.to_str().unwrap();
    let files = ["--config", config, "--out", files];
    let ended = compare(development, &[&policies, &files, more].concat());
    let progress = ended.err.clone();
    let said = ended.succeeds();
    let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    assert_eq!(said, read("compare.txt"));
    assert_eq!(read("runs.csv").lines().count(), 5);
    let report = serde_json::from_str(&read("compare.json")).unwrap();
    // Lines may wrap anywhere.
    let words: Vec<_> = said.split_whitespace().collect();
    Compared {
        words: words.join(" "),
        progress,
        report,
    }
}

fn report(run: &Value) -> ClipReport {
    serde_json::from_value(run["report"].clone()).unwrap()
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn without_a_meter_cpu_time_and_detector_calls_are_compared_and_energy_is_marked_estimated() {
    let folder = tempfile::tempdir().unwrap();
    let power = "source = \"estimate\"";
    // Ten frames per second, which the detector keeps up with on a busy machine.
    let slowly = ["--speed", "0.4"];
    let Compared {
        words,
        progress,
        report: found,
    } = compared(folder.path(), power, "", &slowly);
    assert_contains(&words, &["There is no power meter here", "ESTIMATED"]);
    // Without a terminal for a progress bar, one line per run reports the progress.
    assert_contains(&progress, &["run 4 of 4, vanilla …"]);
    let verdict = &found["verdicts"][0];
    // The sentence, for the headings of the table name the same figures.
    let sentence = verdict["sentence"].as_str().unwrap();
    let parts = [
        " detector calls ",
        ", AP@50 ",
        " the boxes of vanilla",
        "(estimated)",
    ];
    assert_contains(sentence, &parts);
    assert_contains(&words, &[sentence]);
    let calls = verdict["detector_calls_percent"].as_f64().unwrap();
    assert!(calls < 0.0, "{verdict}");
    assert_eq!(verdict["energy"], "estimated", "{verdict}");

    for run in found["comparison"]["runs"].as_array().unwrap() {
        let report = report(run);
        let frames = report.frames + report.dropped.total();
        assert_eq!(frames, 20, "the warm-up is not counted: {report:?}");
        assert_eq!(report.clip, "measured");
        assert_eq!(report.energy.quality, EnergyQuality::Estimated);
        // The duration includes the last frame.
        assert!(report.duration_s > 1.95, "{report:?}");
        assert!(run["cpu_s"].as_f64().unwrap() > 0.0);
        let calls = report.detector_latency_ms.count;
        let agreement = &run["agreement"];
        // The demonstration's road has ground truth.
        let by_truth = &run["by_truth"];
        assert_eq!(by_truth["frames"], 20, "{by_truth}");
        // A busy machine drops frames, whose boxes are missed.
        assert!(by_truth["recall"].as_f64().unwrap() > 0.0, "{by_truth}");
        if run["variant"] == 0 {
            assert_eq!(calls, report.frames, "vanilla examines every frame");
            assert_eq!(agreement["ap50"], 1.0, "vanilla agrees with itself");
        } else {
            assert!(calls < report.frames, "albireo skips: {report:?}");
            let recall = agreement["recall"].as_f64().unwrap();
            assert!(recall > 0.3 && recall <= 1.0, "{agreement}");
        }
    }
    let albireo = &found["summary"]["policies"][1];
    assert_eq!(albireo["policy"], "albireo u=1e-3");
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn the_boards_own_meter_is_read_in_every_run() {
    let folder = tempfile::tempdir().unwrap();
    let program = fake_tegrastats(folder.path(), &json!({"curve": [[0, 21.5], [1, 21.5]]}));
    let power = format!("source = \"tegrastats\"\ntegrastats = {program:?}");
    let sysfs = board(folder.path());
    let nvpmodel = fake_nvpmodel(folder.path());
    let constants = format!("sysfs={} nvpmodel={}", sysfs.display(), nvpmodel.display());
    let compared = compared(folder.path(), &power, &constants, &["--unpaced"]);
    let Compared {
        words,
        report: found,
        ..
    } = compared;
    assert!(!words.contains("ESTIMATED"), "{words}");
    assert_contains(&words, &["Energy is measured by `tegrastats`"]);
    assert_contains(&words, &["Power mode: MODE_30W."]);
    for run in found["comparison"]["runs"].as_array().unwrap() {
        let report = report(run);
        assert_eq!(report.frames, 20, "unpaced drops nothing: {report:?}");
        assert_eq!(report.energy.quality, EnergyQuality::Measured);
        let joules = report.energy.joules.unwrap();
        let seconds = report.duration_s;
        assert!((joules / (21.5 * seconds) - 1.0).abs() < 1e-3, "{report:?}");
        let product = joules * seconds * 1e3 / 20.0;
        // Each of the three has six decimals.
        assert!((report.energy.edp.unwrap() / product - 1.0).abs() < 1e-5);
        let board = report.board.unwrap();
        let sensor = board.hottest_sensor.unwrap();
        let mode = board.power_mode.unwrap();
        assert_eq!((&*sensor, &*mode), ("tj-thermal", "MODE_30W"));
    }
}

#[rstest::rstest]
#[case(["--policy", "vanila"], "did you mean `vanilla`?")]
#[case(["--policy", "nobody"], "the policies are `albireo`")]
#[case(["--policy", "albireo:1e-3"], "no policy of this run has a setting `u` left")]
#[case(["--clip", "no/such/drive.mp4"], "no/such/drive.mp4: no such file")]
#[case(["--repeat", "0"], "--repeat")]
#[case(["--model", "no/such.onnx"], "no/such.onnx: no such file")]
#[case(["--speed", "0"], "must be a number from 0.001")]
#[case(["--config", "no/node.toml"], "no/node.toml")]
fn an_invalid_comparison_is_rejected_with_a_remedy(
    #[case] arguments: [&str; 2],
    #[case] expected: &str,
) {
    let ended = compare("", &arguments);
    assert_ne!(ended.code, Some(0));
    assert_contains(&ended.err, &[expected]);
}
