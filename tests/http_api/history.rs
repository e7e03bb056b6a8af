//! The history of a node, for pages opened later and for diagnosis.

use super::access::{TOKEN, with_token};
use super::served::{Served, answered, answered_all, clip, frame};
use crate::support::{Ended, albireo, assert_contains, assert_has, run_command};
use albireo_core::policy::FrameState;
use albireo_node::state::board::PowerSnapshot;
use albireo_wire::{CallCause, EnergyQuality};
use serde_json::{Value, json};
use std::collections::BTreeMap;

use std::path::Path;
use std::process::Command;
use std::time::Duration;

#[tokio::test]
async fn the_last_frames_are_listed_oldest_first_with_state_and_cause() {
    let node = Served::start().await;
    let front = node.front();
    let states = [FrameState::EI, FrameState::I, FrameState::P, FrameState::E];
    answered_all(front, &states);
    let mut blind = frame(4, FrameState::P);
    blind.degraded = true;
    blind.cause = Some(CallCause::NewObject);
    blind.tau_max = None;
    answered(front, blind);
    let past = node.json("/api/v1/cameras/front/history").await;
    let frames = json!({
        "seq": [0, 1, 2, 3, 4], "state": ["E+I", "I", "P", "E", "P"], "boxes": [1, 1, 1, 1, 1],
        "cause": ["uncertain", "uncertain", null, null, "new_object"],
        "degraded": [false, false, false, false, true], "tau_max": [1.5e-4, 1.5e-4, 1.5e-4, 1.5e-4, null],
        "detector_ms": [20.0, 20.0, null, null, null],
    });
    let slot =
        json!({"frames": 5, "skipped": 2, "degraded": 1, "calls": 3, "detector_p50_ms": 20.0});
    assert_has(&past, &json!({"frames": frames, "slots": [slot]}));
    let ago = past["now_ms"].as_i64().unwrap() - past["slots"][0]["at_ms"].as_i64().unwrap();
    assert!((0..60_000).contains(&ago), "{ago}");
    let some = node.json("/api/v1/cameras/front/history?frames=2").await;
    assert_eq!(some["frames"]["seq"], json!([3, 4]));
    for bad in ["cameras/front/history?frames=9000", "log?limit=0"] {
        node.refused(&format!("/api/v1/{bad}"), 400).await;
    }
}

#[tokio::test]
async fn the_skip_rate_of_another_threshold_is_marked_as_estimated() {
    let node = Served::start().await;
    let path = "/api/v1/cameras/front/skip-estimate";
    let nothing = node.refused(path, 409).await;
    assert_contains(nothing["detail"].as_str().unwrap(), &["no frame"]);
    let front = node.front();
    // A call on every third frame, and uncertainty that grows with the time since the last call.
    for seq in 0..300 {
        let age = seq % 3;
        let state = if age == 2 {
            FrameState::I
        } else {
            FrameState::P
        };
        let mut message = frame(seq, state);
        message.tau_max = Some(1.1e-4 * (age + 1) as f64);
        answered(front, message);
    }
    let answer = node.json(&format!("{path}?values=1e-4, 3e-4,1")).await;
    let expected = json!({"estimated": true, "threshold": {"value": 3e-4}});
    assert_has(&answer, &expected);
    let really = answer["skip_rate"].as_f64().unwrap();
    assert!((really - 2.0 / 3.0).abs() < 0.01, "{answer}");
    let rate = |value: usize| answer["values"][value]["skip_rate"].as_f64().unwrap();
    assert!(rate(0) == 0.0 && rate(2) > 0.9, "{answer}");
    assert!((rate(1) - really).abs() < 0.01, "{answer}");
    let curve = node.json(path).await;
    let curve = curve["values"].as_array().unwrap();
    assert_eq!(curve.len(), 41);
    let is_rising = curve.is_sorted_by_key(|value| value["skipped"].as_u64());
    assert!(is_rising, "{curve:?}");
    let too_many = "1,".repeat(70);
    let bad = "x 0 -1 NaN inf 1e999 1,,2".split(' ');
    for bad in bad.chain(["", &too_many]) {
        node.refused(&format!("{path}?values={bad}"), 400).await;
    }
}

#[tokio::test]
async fn power_of_the_last_hour_is_reported_by_domain_and_savings_since_the_start_and_today() {
    let node = Served::start().await;
    answered_all(node.front(), &FrameState::ALL);
    let overview = node.json("/api/v1/node").await;
    assert_eq!(overview["since_start"]["energy"], Value::Null);
    assert_eq!(node.json("/api/v1/power").await["slots"], json!([]));
    node.board.set_power(PowerSnapshot {
        source: "rapl".to_owned(),
        quality: EnergyQuality::Measured,
        joules: BTreeMap::from([("total".to_owned(), 30.0), ("cpu".to_owned(), 6.0)]),
        covered_s: BTreeMap::from([("total".to_owned(), 3.0), ("cpu".to_owned(), 3.0)]),
        ..PowerSnapshot::default()
    });
    // A slot is reported once it is over.
    assert_eq!(node.json("/api/v1/power").await["slots"], json!([]));
    tokio::time::pause();
    tokio::time::advance(Duration::from_secs(11)).await;
    tokio::time::resume();
    node.board.set_power(node.board.power());
    let slot = json!({"watts": {"total": 10.0, "cpu": 2.0}, "quality": "measured"});
    assert_has(&node.json("/api/v1/power").await, &json!({"slots": [slot]}));
    let mut power = PowerSnapshot {
        meter_quality: EnergyQuality::Measured,
        joules: BTreeMap::from([("total".to_owned(), 7200.0)]),
        covered_s: BTreeMap::from([("total".to_owned(), 120.0)]),
        sampled_s: 120.0,
        saved_detector_s: 30.0,
        detector_watts: Some(10.0),
        ..PowerSnapshot::default()
    };
    for (sampled_s, quality) in [(120.0, "measured"), (130.0, "partial")] {
        power.sampled_s = sampled_s;
        node.board.set_power(power.clone());
        let overview = node.json("/api/v1/node").await;
        let energy = json!({
            "quality": quality, "joules": 7200.0, "covered_s": 120.0, "saved_joules_estimated": 300.0,
        });
        for period in ["since_start", "today"] {
            let answer = &overview[period];
            let expected = json!({"frames": 5, "avoided_calls": 2, "energy": energy});
            assert_has(answer, &expected);
            assert_eq!(answer["since_ms"], overview["today"]["since_ms"]);
        }
    }
}

fn untar(archive: &Path) -> BTreeMap<String, String> {
    let folder = tempfile::tempdir().unwrap();
    let mut tar = Command::new("tar");
    run_command(tar.arg("-xf").arg(archive).arg("-C").arg(folder.path())).succeeds();
    let mut texts = BTreeMap::new();
    for file in std::fs::read_dir(folder.path()).unwrap() {
        let file = file.unwrap();
        let name = file.file_name().into_string().unwrap();
        texts.insert(name, std::fs::read_to_string(file.path()).unwrap());
    }
    texts
}

#[tokio::test]
async fn the_diagnostic_archive_is_complete_and_contains_no_secret() {
    let node = Served::with(with_token()).await;
    answered(node.front(), frame(0, FrameState::I));
    node.board.record_clip(clip("front", 0));
    node.refused("/api/v1/diag", 401).await;
    node.refused("/api/v1/log", 401).await;
    let answer = node
        .request(reqwest::Method::GET, "/api/v1/diag")
        .bearer_auth(TOKEN)
        .send()
        .await
        .unwrap();
    assert_eq!(answer.headers()["content-type"], "application/x-tar");
    let folder = tempfile::tempdir().unwrap();
    let archive = folder.path().join("diag.tar");
    std::fs::write(&archive, answer.bytes().await.unwrap()).unwrap();
    let files = untar(&archive);
    let names: Vec<_> = files.keys().map(String::as_str).collect();
    let expected = "about.json cameras.json clips.json configuration.json frame-states.json log.txt metrics.txt node.json";
    assert_eq!(names.join(" "), expected);
    for (name, text) in &files {
        assert!(!text.contains(TOKEN), "{name}");
        let is_json = serde_json::from_str::<Value>(text).is_ok();
        assert!(is_json || !name.ends_with(".json"), "{name}");
    }
    assert_contains(&files["configuration.json"], &["(secret)"]);
    assert_contains(&files["metrics.txt"], &["albireo_frames_total"]);
    assert_contains(&files["clips.json"], &["window-0"]);

    // `albireo diag` writes the same archive, or reports why it cannot.
    let address = format!("http://{}", node.address);
    let archive = folder.path().join("node.tar");
    let fetch = async |token: &str| -> Ended {
        let mut command = albireo();
        command.args(["diag", &address, "--output"]).arg(&archive);
        command.env("ALBIREO_HTTP__TOKEN", token);
        command.output().await.unwrap().into()
    };
    assert_contains(&fetch("not-the-token-of-it").await.fails(), &["token"]);
    fetch(TOKEN).await.succeeds();
    let files = untar(&archive);
    assert!(files.contains_key("log.txt") && files.len() == 8);
    // An existing file is not overwritten.
    fetch(TOKEN).await.fails();
}
