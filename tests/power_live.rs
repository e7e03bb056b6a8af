//! A node with a board's power monitor (a copy of sysfs) reports watts and joules, and does not wait for one that hangs.

use crate::http_api::events::Events;
use crate::support::{
    Client, Node, albireo, assert_has, fake_nvpmodel, fake_tegrastats, metric, replay, script,
    value_of,
};
use rstest::rstest;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// A sysfs tree with 24 W on three rails and a temperature sensor.
pub(crate) fn board(root: &Path) -> PathBuf {
    let sysfs = root.join("sys");
    let write = |file: String, text: &str| {
        let path = sysfs.join("class").join(file);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, format!("{text}\n")).unwrap();
    };
    let chip = "hwmon/hwmon1";
    write(format!("{chip}/name"), "ina3221");
    let rails = [
        ("VDD_GPU_SOC", "800"),
        ("VDD_CPU_CV", "400"),
        ("VIN_SYS_5V0", "1200"),
    ];
    for (i, (label, milliamperes)) in (1..).zip(rails) {
        write(format!("{chip}/in{i}_label"), label);
        write(format!("{chip}/in{i}_input"), "10000");
        write(format!("{chip}/curr{i}_input"), milliamperes);
    }
    write("thermal/thermal_zone0/type".to_owned(), "tj-thermal");
    write("thermal/thermal_zone0/temp".to_owned(), "61500");
    sysfs
}

fn settings(sysfs: &Path) -> String {
    format!(
        r#"
[node]
name = "bench"
[policy]
name = "fixed-skip"
[policy.fixed_skip]
n = 3
[clip]
silence_s = 3.0
[power]
source = "ina"
# development: sysfs={} nvpmodel={}
[[camera]]
name = "front"
delivery = "every"
"#,
        sysfs.display(),
        fake_nvpmodel(sysfs).display()
    )
}

/// Replays that many frames of the demo as one clip.
async fn drive(node: &Node, frames: &str) {
    let clip = "--node bench --clip drive --clip-seconds 1000 --frames";
    let clip: Vec<_> = clip.split(' ').chain([frames]).collect();
    replay(node, "demo", &clip).await;
}

/// The next message of that kind that satisfies `wanted`.
async fn next(client: &mut Client, kind: &str, wanted: impl Fn(&Value) -> bool) -> Value {
    loop {
        let (key, message) = client.next().await.unwrap();
        if key.ends_with(kind) && wanted(&message) {
            return message;
        }
    }
}

fn near(value: &Value, expected: f64) -> bool {
    (value.as_f64().unwrap() / expected - 1.0).abs() < 1e-3
}

fn watts(message: &Value, domain: &str) -> f64 {
    message["watts"]
        .as_array()
        .unwrap()
        .iter()
        .find(|entry| entry["domain"] == domain)
        .map_or(0.0, |entry| entry["watts"].as_f64().unwrap())
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime and Python"]
async fn measured_watts_are_reported_everywhere_and_nothing_waits_for_a_meter_that_then_hangs() {
    let folder = tempfile::tempdir().unwrap();
    let sysfs = board(folder.path());
    let node = Node::start(&settings(&sysfs)).await;
    let mut client = Client::listen(&node.zenoh, "albireo/bench/front/*").await;

    let counters = next(&mut client, "/counters", |m| !m["watts"][0].is_null()).await;
    assert_eq!(counters["power_quality"], "measured");
    let shown = ["total", "gpu", "cpu", "io_mem"].map(|domain| watts(&counters, domain));
    for (shown, expected) in shown.into_iter().zip([24.0, 8.0, 4.0, 12.0]) {
        assert!((shown - expected).abs() < 1e-6, "{counters}");
    }

    let events = format!("{}/api/v1/events?types=counters", node.http);
    let mut events = Events::new(reqwest::get(events).await.unwrap());
    let event = events.expect("counters").await;
    assert!((watts(&event, "total") - 24.0).abs() < 1e-6, "{event}");

    let gpu = r#"albireo_power_watts{domain="gpu",source="ina"}"#;
    assert!((metric(&node.http, gpu).await - 8.0).abs() < 1e-6);
    let cost = r#"albireo_power_meter_cpu_seconds_total{source="ina"}"#;
    assert!(metric(&node.http, cost).await > 0.0);

    drive(&node, "25").await;
    let is_drive = |message: &Value| {
        let clip = message["clip"].as_str();
        clip.is_some_and(|clip| clip.starts_with("drive"))
    };
    let report = next(&mut client, "/clip", is_drive).await;
    let energy = &report["energy"];
    let seconds = report["duration_s"].as_f64().unwrap();
    let expected = json!({"quality": "measured", "source": "ina", "total_from": "sum_of_rails"});
    assert_has(energy, &expected);
    assert!(near(&energy["coverage"], 1.0), "{report}");
    for joules in ["joules", "node_joules"] {
        assert!(near(&energy[joules], 24.0 * seconds), "{report}");
    }
    let edp = 24.0 * seconds * seconds * 1e3 / 25.0;
    assert!(near(&energy["edp"], edp), "{report}");
    let samples = energy["samples"].as_f64().unwrap();
    let most = seconds * 10.0 + 1.0;
    assert!(samples > 5.0 && samples <= most, "{samples}");
    let domains = energy["domains"].as_array().unwrap();
    assert_eq!(domains.len(), 4, "{energy}");
    assert!(near(&domains[1]["mean_watts"], 8.0) && near(&domains[1]["peak_watts"], 8.0));
    assert!(near(&report["board"]["hottest_celsius"], 61.5), "{report}");
    assert_eq!(report["board"]["power_mode"], "MODE_30W", "{report}");
    let metrics = node.text("/metrics").await;
    let series = |name| format!(r#"albireo_energy_{name}_total{{domain="total",source="ina"}}"#);
    let joules = value_of(&metrics, &series("joules"));
    let seconds = value_of(&metrics, &series("covered_seconds"));
    assert!(seconds >= 2.0, "{metrics}");
    assert!((joules / seconds / 24.0 - 1.0).abs() < 1e-6, "{metrics}");

    // Reading a pipe without a writer never ends.
    let pipe = folder.path().join("pipe");
    crate::support::pipe(&pipe);
    std::fs::rename(&pipe, sysfs.join("class/hwmon/hwmon1/curr1_input")).unwrap();
    let hangs = next(&mut client, "/counters", |m| m["watts"][0].is_null()).await;
    assert_eq!(hangs["power_quality"], "unavailable");

    drive(&node, "12").await;
    let mut states = Vec::new();
    let report = loop {
        let (key, message) = client.next().await.unwrap();
        if key.ends_with("/detections") {
            states.push(message["state"].as_str().unwrap().to_owned());
        } else if key.ends_with("/clip") {
            break message;
        }
    };
    let skipped = states.iter().filter(|state| *state == "P").count();
    assert_eq!(states.len(), 12, "{states:?}");
    assert_eq!(skipped, 8, "{states:?}");
    assert_eq!(report["energy"]["quality"], "unavailable", "{report}");
    assert!(report["energy"]["joules"].is_null());

    let took = node.stop_well().await.took;
    assert!(took.as_secs_f64() < 10.0, "ended after {took:?}");
}

#[rstest]
#[tokio::test]
async fn the_survey_lists_every_source_and_runs_tegrastats_through_a_configured_script() {
    let folder = tempfile::tempdir().unwrap();
    let program = fake_tegrastats(folder.path(), &json!({"curve": [[0, 20], [1, 20]]}));
    // A fake sudo that logs its arguments and runs them.
    let sudo = "printf '%s\\n' \"$*\" >> \"$0.log\"\nshift\nexec \"$@\"";
    script(folder.path(), "sudo", sudo);
    let by_sudo = format!("exec sudo -n {} \"$@\"", program.display());
    let script = script(folder.path(), "by-sudo", &by_sudo);
    let path = std::env::var("PATH").unwrap_or_default();
    let path = format!("{}:{path}", folder.path().display());
    let sysfs = folder.path().join("sys");
    for (is_asked, started) in [(false, &program), (true, &script)] {
        let output = albireo()
            .args(["power", "--json"])
            .env("PATH", &path)
            .env("ALBIREO_POWER__TEGRASTATS", started)
            .env("ALBIREO_DEVELOPMENT", format!("sysfs={}", sysfs.display()))
            .output();
        let found: Value = serde_json::from_slice(&output.await.unwrap().stdout).unwrap();
        let sources = found.as_array().unwrap();
        let names: Vec<_> = sources.iter().map(|one| one["source"].as_str().unwrap()).collect();
        assert_eq!(
            names.join(" "),
            "command ina tegrastats rapl+nvml rapl nvml estimate"
        );
        assert_has(&sources[2], &json!({"why_not": null, "automatic": true}));
        assert_eq!(sources[2]["watts"][0][1], 20.0, "{found}");
        let reason = &sources[1]["why_not"];
        assert!(reason.is_string(), "a reason why not: {found}");
        let log = std::fs::read_to_string(folder.path().join("sudo.log")).unwrap_or_default();
        let expected = format!("-n {} --interval 100", program.display());
        assert_eq!(log.lines().next(), is_asked.then_some(&*expected), "{log}");
    }
}
