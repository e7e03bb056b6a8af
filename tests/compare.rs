//! `albireo compare`, as a user runs it: the node's own code with YOLOX-Nano, a clip of a few
//! seconds, and its report.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support::{PATIENCE, albireo, fake_nvpmodel};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Output;
use tokio::time::timeout;

/// Two rounds of two seconds.
const SHORT: [&str; 10] = [
    "compare",
    "--seconds",
    "2",
    "--repeat",
    "2",
    "--warm-up",
    "0.5",
    "--cool-down",
    "0",
    "--u=1e-3",
];

async fn compare(arguments: &[&str]) -> Output {
    compare_with("", arguments).await
}

/// As [`compare`], with constants changed.
async fn compare_with(development: &str, arguments: &[&str]) -> Output {
    let output = albireo()
        .args(SHORT)
        .args(arguments)
        .env("ALBIREO_DEVELOPMENT", development)
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .output();
    timeout(PATIENCE, output).await.unwrap().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// A configuration whose `[power]` section is `power`.
fn configuration(folder: &Path, power: &str) -> PathBuf {
    let file = folder.join("node.toml");
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
    let models = models.display();
    let settings = format!("[detector]\nmodel = \"{models}/yolox_nano.onnx\"\n[power]\n{power}\n");
    std::fs::write(&file, settings).unwrap();
    file
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

/// What was written to `folder`, after a comparison that went well.
fn written(folder: &Path, output: &Output) -> Value {
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said = text(&output.stdout);
    assert_eq!(
        said,
        std::fs::read_to_string(folder.join("compare.txt")).unwrap()
    );
    for line in said.lines() {
        assert!(line.chars().count() <= 100, "{line}");
    }
    let rows = std::fs::read_to_string(folder.join("runs.csv")).unwrap();
    assert_eq!(rows.lines().count(), 5, "{rows}");
    serde_json::from_slice(&std::fs::read(folder.join("compare.json")).unwrap()).unwrap()
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn without_a_meter_cpu_time_and_detector_calls_are_compared_and_energy_is_marked_estimated() {
    let folder = tempfile::tempdir().unwrap();
    let config = configuration(folder.path(), "source = \"estimate\"");
    let out = folder.path().join("out");
    let output = compare(&[
        "--policy",
        "vanilla",
        "--policy",
        "albireo",
        "--config",
        config.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ])
    .await;
    let found = written(&out, &output);
    let said = text(&output.stdout);
    assert!(said.contains("There is no power meter here"), "{said}");
    let words = said.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(
        words.contains("% fewer detector calls than vanilla, AP@50")
            || words.contains(
                "no difference in detector calls to vanilla that 2 rounds can tell, AP@50"
            ),
        "{said}"
    );
    let verdict = &found["verdicts"][0];
    assert!(
        number(&verdict["detector_calls_percent"]) < 0.0,
        "{verdict}"
    );
    assert_eq!(verdict["energy"], "estimated", "{verdict}");
    // Where there is no terminal for a bar, a line a run says how far it is.
    let progress = text(&output.stderr);
    assert!(progress.contains("run 4 of 4, vanilla …"), "{progress}");
    assert!(said.contains("ESTIMATED"), "{said}");

    let runs = found["comparison"]["runs"].as_array().unwrap();
    let order: Vec<_> = runs
        .iter()
        .map(|run| run["variant"].as_u64().unwrap())
        .collect();
    assert_eq!(order, [0, 1, 1, 0], "every second round goes backwards");
    for run in runs {
        let report = &run["report"];
        let dropped: u64 = report["dropped"]
            .as_object()
            .unwrap()
            .values()
            .map(|kind| kind.as_u64().unwrap())
            .sum();
        let frames = report["frames"].as_u64().unwrap();
        assert_eq!(frames + dropped, 20, "the warm-up is not counted: {report}");
        assert_eq!(report["clip"], "measured");
        assert_eq!(report["energy"]["quality"], "estimated");
        // The clip's last frame has its time too.
        let seconds = number(&report["duration_s"]);
        assert!(seconds > 1.95, "{seconds}");
        assert!(number(&run["cpu_s"]) > 0.0);
        let calls = report["detector_latency_ms"]["count"].as_u64().unwrap();
        let agreement = &run["agreement"];
        if run["variant"] == 0 {
            assert_eq!(calls, frames, "vanilla runs the detector on every frame");
            assert_eq!(
                number(&agreement["ap50"]),
                1.0,
                "vanilla agrees with itself"
            );
        } else {
            assert!(calls < frames, "albireo skips: {report}");
            let recall = number(&agreement["recall"]);
            assert!(recall > 0.3 && recall <= 1.0, "{agreement}");
        }
    }
    let albireo = &found["summary"]["policies"][1];
    assert_eq!(albireo["policy"], "albireo u=1e-3");
    let calls = albireo["changes"]
        .as_array()
        .unwrap()
        .iter()
        .find(|change| change[0] == "detector_calls")
        .unwrap();
    assert!(number(&calls[1]["percent"]) < 0.0, "{calls}");
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn the_boards_own_meter_is_read_in_every_run() {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("tegrastats");
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures");
    std::os::unix::fs::symlink(fixtures.join("fake_tegrastats"), &program).unwrap();
    let task = json!({"curve": [[0, 21.5], [1, 21.5]]});
    std::fs::write(folder.path().join("tegrastats.json"), task.to_string()).unwrap();
    let power = format!(
        "source = \"tegrastats\"\ntegrastats = \"{}\"",
        program.display(),
    );
    let config = configuration(folder.path(), &power);
    let out = folder.path().join("out");
    let constants = format!(
        "sysfs={} nvpmodel={}",
        folder.path().join("sys").display(),
        fake_nvpmodel(folder.path()).display()
    );
    let (config, files) = (config.to_str().unwrap(), out.to_str().unwrap());
    let arguments = [
        "--policy",
        "vanilla",
        "--policy",
        "albireo",
        "--config",
        config,
        "--unpaced",
        "--out",
        files,
    ];
    let output = compare_with(&constants, &arguments).await;
    let found = written(&out, &output);
    let said = text(&output.stdout);
    assert!(
        said.contains("Energy is measured by `tegrastats`"),
        "{said}"
    );
    assert!(!said.contains("ESTIMATED"), "{said}");
    // The words may be broken over two lines.
    let words: Vec<_> = said.split_whitespace().collect();
    assert!(words.join(" ").contains("Power mode: MODE_30W."), "{said}");
    for run in found["comparison"]["runs"].as_array().unwrap() {
        let report = &run["report"];
        assert_eq!(report["frames"], 20, "unpaced drops nothing: {report}");
        let energy = &report["energy"];
        assert_eq!(energy["quality"], "measured", "{energy}");
        let (joules, seconds) = (number(&energy["joules"]), number(&report["duration_s"]));
        assert!((joules / (21.5 * seconds) - 1.0).abs() < 1e-3, "{report}");
        let product = joules * seconds * 1e3 / 20.0;
        // Each of the three has six decimals.
        assert!((number(&energy["edp"]) / product - 1.0).abs() < 1e-5);
        assert_eq!(report["board"]["hottest_sensor"], "tj");
        assert_eq!(report["board"]["power_mode"], "MODE_30W", "{report}");
    }
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_policy_that_skips_nothing_is_told_what_to_try() {
    let folder = tempfile::tempdir().unwrap();
    let config = configuration(folder.path(), "source = \"estimate\"");
    let arguments = ["--config", config.to_str().unwrap(), "--unpaced"];
    let output = compare(
        &[
            &arguments[..],
            &[
                "--policy",
                "vanilla",
                "--policy",
                "albireo:1e-5",
                "--policy",
                "albireo",
            ],
        ]
        .concat(),
    )
    .await;
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said = text(&output.stdout);
    let words = said.split_whitespace().collect::<Vec<_>>().join(" ");
    let told = "albireo u=1e-5: no frame was skipped, so nothing was saved; try u = ";
    let rest = words.split_once(told).unwrap_or_else(|| panic!("{said}")).1;
    let attempt: f64 = rest
        .split_whitespace()
        .next()
        .unwrap()
        .trim_end_matches('.')
        .parse()
        .unwrap();
    assert!((1e-4..2e-3).contains(&attempt), "{attempt}");
}

#[tokio::test]
async fn what_cannot_be_compared_is_refused_with_what_to_do() {
    for (arguments, expected) in [
        (&["--policy", "vanila"][..], "did you mean `vanilla`?"),
        (&["--policy", "nobody"], "the policies are `albireo`"),
        (
            &["--policy", "albireo:1e-3"],
            "no policy of this run has a setting `u` left",
        ),
        (
            &["--clip", "no/such/drive.mp4"],
            "no/such/drive.mp4: no such file",
        ),
        (&["--repeat", "0"], "--repeat"),
        (
            &["--model", "no/such.onnx"],
            "--detector no/such.onnx: no such file",
        ),
        (&["--speed", "0"], "must be a number from 0.001"),
        (&["--config", "no/node.toml"], "no/node.toml"),
    ] {
        let output = compare(arguments).await;
        assert!(!output.status.success(), "{arguments:?}");
        let said = text(&output.stderr);
        assert!(said.contains(expected), "{arguments:?}: {said}");
    }
}
