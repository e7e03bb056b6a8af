//! A node's history: for a page that is opened later, and for diagnosis.

use super::served::{Frames, KNOB, Served, board, clip, frame, problem};
use albireo_core::policy::FrameState;
use albireo_node::api::http::{NodeView, router};
use albireo_node::config::NodeConfig;
use albireo_node::state::board::PowerSnapshot;
use albireo_service::config::{HttpConfig, Token, without_secrets};
use albireo_vision::picture::FrameLimits;
use albireo_wire::{CallCause, EnergyQuality};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

#[tokio::test]
async fn the_last_frames_are_listed_with_state_and_cause_the_newest_last() {
    let node = Served::start().await;
    let front = node.board.camera("front").unwrap();
    let states = [FrameState::EI, FrameState::I, FrameState::P, FrameState::E];
    for (seq, state) in states.into_iter().enumerate() {
        front.answered(frame(seq as u64, state));
    }
    let mut blind = (*frame(4, FrameState::P)).clone();
    blind.degraded = true;
    blind.cause = Some(CallCause::NewObject);
    blind.tau_max = None;
    front.answered(blind.into());
    let past = node.json("/api/v1/cameras/front/history").await;
    let frames = &past["frames"];
    assert_eq!(frames["seq"], json!([0, 1, 2, 3, 4]));
    assert_eq!(frames["state"], json!(["E+I", "I", "P", "E", "P"]));
    assert_eq!(
        frames["cause"],
        json!(["uncertain", "uncertain", null, null, "new_object"])
    );
    assert_eq!(
        frames["degraded"],
        json!([false, false, false, false, true])
    );
    assert_eq!(frames["tau_max"][4], Value::Null);
    assert_eq!(frames["detector_ms"], json!([20.0, 20.0, null, null, null]));
    assert_eq!(frames["boxes"][0], 1);
    let slot = &past["slots"][0];
    assert_eq!(
        (
            &slot["frames"],
            &slot["skipped"],
            &slot["degraded"],
            &slot["calls"]
        ),
        (&json!(5), &json!(2), &json!(1), &json!(3))
    );
    assert_eq!(slot["detector_p50_ms"], 20.0);
    let (now, at) = (
        past["now_ms"].as_i64().unwrap(),
        slot["at_ms"].as_i64().unwrap(),
    );
    assert!((0..60_000).contains(&(now - at)), "{now} and {at}");
    let some = node.json("/api/v1/cameras/front/history?frames=2").await;
    assert_eq!(some["frames"]["seq"], json!([3, 4]));
    problem(
        node.get("/api/v1/cameras/front/history?frames=9000").await,
        400,
    )
    .await;
    problem(node.get("/api/v1/cameras/roof/history").await, 404).await;
}

#[tokio::test]
async fn calls_are_counted_by_cause_in_every_place_that_counts_frames() {
    let node = Served::start().await;
    let front = node.board.camera("front").unwrap();
    for (seq, state) in FrameState::ALL.into_iter().enumerate() {
        front.answered(frame(seq as u64, state));
    }
    let mut periodic = (*frame(9, FrameState::I)).clone();
    periodic.cause = Some(CallCause::PeriodicCap);
    front.answered(periodic.into());
    let calls = json!({"uncertain": 3, "periodic_cap": 1});
    assert_eq!(node.json("/api/v1/frame-states").await["calls"], calls);
    let one = node.json("/api/v1/cameras/front/frame-states").await;
    assert_eq!(one["calls"], calls);
    assert_eq!(
        serde_json::to_value(node.board.counters(front, 0)).unwrap()["calls"],
        calls
    );
    let metrics = node.get("/metrics").await.text().await.unwrap();
    let line = r#"albireo_detector_calls_total{camera="front",cause="periodic_cap"} 1"#;
    assert!(metrics.contains(line), "no {line} in {metrics}");
}

#[tokio::test]
async fn what_another_value_would_have_skipped_is_an_estimate_and_says_so() {
    let node = Served::start().await;
    let path = "/api/v1/cameras/front/skip-estimate";
    let nothing = problem(node.get(path).await, 409).await;
    assert!(nothing["detail"].as_str().unwrap().contains("no frame"));
    let front = node.board.camera("front").unwrap();
    // A call on every third frame, and uncertainty that grows with the time since.
    for seq in 0..300 {
        let age = seq % 3;
        let mut message = (*frame(seq, FrameState::P)).clone();
        message.tau_max = Some(1.1e-4 * (age + 1) as f64);
        if age == 2 {
            message.state = FrameState::I;
            message.cause = Some(CallCause::Uncertain);
        }
        front.answered(message.into());
    }
    let told = node.json(&format!("{path}?values=1e-4,3e-4,1")).await;
    assert_eq!(
        (&told["estimated"], &told["threshold"]["value"]),
        (&json!(true), &json!(3e-4))
    );
    let really = told["skip_rate"].as_f64().unwrap();
    assert!((really - 2.0 / 3.0).abs() < 0.01, "{told}");
    let rates: Vec<f64> = (told["values"].as_array().unwrap().iter())
        .map(|value| value["skip_rate"].as_f64().unwrap())
        .collect();
    assert_eq!(rates[0], 0.0);
    assert!(
        (rates[1] - really).abs() < 0.01 && rates[2] > 0.99,
        "{told}"
    );
    let curve = node.json(path).await;
    let curve = curve["values"].as_array().unwrap();
    assert_eq!(curve.len(), 41);
    assert!(
        curve
            .windows(2)
            .all(|pair| pair[0]["skipped"].as_u64() <= pair[1]["skipped"].as_u64())
    );
    for bad in ["x", "0", "-1", "nan", &"1,".repeat(70)] {
        problem(node.get(&format!("{path}?values={bad}")).await, 400).await;
    }
}

#[tokio::test]
async fn the_hour_of_power_is_reported_by_domain() {
    let node = Served::start().await;
    assert_eq!(node.json("/api/v1/power").await["slots"], json!([]));
    node.board.set_power(PowerSnapshot {
        source: "rapl".to_owned(),
        quality: EnergyQuality::Measured,
        joules: BTreeMap::from([("total".to_owned(), 30.0), ("cpu".to_owned(), 6.0)]),
        covered_s: BTreeMap::from([("total".to_owned(), 3.0), ("cpu".to_owned(), 3.0)]),
        ..PowerSnapshot::default()
    });
    // A piece is reported when it is over.
    assert_eq!(node.json("/api/v1/power").await["slots"], json!([]));
    tokio::time::pause();
    tokio::time::advance(Duration::from_secs(11)).await;
    tokio::time::resume();
    node.board.set_power(node.board.power());
    let told = node.json("/api/v1/power").await;
    assert_eq!(told["slots"].as_array().unwrap().len(), 1, "{told}");
    assert_eq!(
        told["slots"][0]["watts"],
        json!({"total": 10.0, "cpu": 2.0})
    );
    assert_eq!(told["slots"][0]["quality"], "measured");
}

#[tokio::test]
async fn savings_are_reported_since_the_start_and_today() {
    let node = Served::start().await;
    let front = node.board.camera("front").unwrap();
    for (seq, state) in FrameState::ALL.into_iter().enumerate() {
        front.answered(frame(seq as u64, state));
    }
    let overview = node.json("/api/v1/node").await;
    assert_eq!(overview["since_start"]["energy"], Value::Null);
    let mut power = PowerSnapshot {
        meter_quality: EnergyQuality::Measured,
        joules: BTreeMap::from([("total".to_owned(), 7200.0)]),
        covered_s: BTreeMap::from([("total".to_owned(), 120.0)]),
        sampled_s: 120.0,
        saved_detector_s: 30.0,
        ..PowerSnapshot::default()
    };
    // What a call costs is not known: calls avoided and nothing else.
    node.board.set_power(power.clone());
    let energy = node.json("/api/v1/node").await["since_start"]["energy"].clone();
    assert_eq!(energy["saved_joules_estimated"], Value::Null, "{energy}");
    power.detector_watts = Some(10.0);
    for (sampled_s, quality) in [(120.0, "measured"), (130.0, "partial")] {
        power.sampled_s = sampled_s;
        node.board.set_power(power.clone());
        let overview = node.json("/api/v1/node").await;
        for period in ["since_start", "today"] {
            let told = &overview[period];
            assert_eq!(
                (&told["frames"], &told["avoided_calls"]),
                (&json!(5), &json!(2))
            );
            let expected = json!({
                "quality": quality, "joules": 7200.0, "covered_s": 120.0, "saved_joules_estimated": 300.0,
            });
            assert_eq!(told["energy"], expected);
        }
        assert_eq!(
            overview["today"]["since_ms"],
            overview["since_start"]["since_ms"]
        );
    }
}

/// The files of a tar archive.
fn untar(archive: &[u8]) -> BTreeMap<String, String> {
    let mut files = BTreeMap::new();
    let mut rest = archive;
    while let Some((header, after)) = rest.split_at_checked(512) {
        let name = header.split(|byte| *byte == 0).next().unwrap();
        if name.is_empty() {
            break;
        }
        let size = std::str::from_utf8(&header[124..135]).unwrap();
        let size = usize::from_str_radix(size, 8).unwrap();
        let text = String::from_utf8(after[..size].to_vec()).unwrap();
        files.insert(String::from_utf8(name.to_vec()).unwrap(), text);
        rest = &after[size.next_multiple_of(512)..];
    }
    files
}

#[tokio::test]
async fn one_archive_has_what_helps_to_find_a_fault_and_no_secret() {
    let secret = "the-token-of-this-very-node";
    let mut config = NodeConfig::default();
    config.http.token = Some(Token::new(secret));
    let (board, _detector) = board(Some(KNOB), None);
    board
        .camera("front")
        .unwrap()
        .answered(frame(0, FrameState::I));
    board.record_clip(clip("front", 0));
    let view = NodeView {
        board,
        limits: FrameLimits::default(),
        config: Arc::new(without_secrets(&config)),
    };
    let mut node = Served::start().await;
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    node.address = listener.local_addr().unwrap();
    let stop = node.shutdown.clone();
    tokio::spawn(async move {
        let router = router(view, stop.clone());
        albireo_service::http::run(&config.http, router, listener, stop).await
    });
    problem(node.get("/api/v1/diag").await, 401).await;
    problem(node.get("/api/v1/log").await, 401).await;
    let request = node.request(reqwest::Method::GET, "/api/v1/diag");
    let answer = request.bearer_auth(secret).send().await.unwrap();
    assert_eq!(answer.headers()["content-type"], "application/x-tar");
    let files = untar(&answer.bytes().await.unwrap());
    let names: Vec<_> = files.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        [
            "about.json",
            "cameras.json",
            "clips.json",
            "configuration.json",
            "frame-states.json",
            "log.txt",
            "metrics.txt",
            "node.json"
        ]
    );
    for (name, text) in &files {
        assert!(!text.contains(secret), "{name}");
        if name.ends_with(".json") {
            serde_json::from_str::<Value>(text).unwrap();
        }
    }
    assert!(files["configuration.json"].contains("(secret)"));
    assert!(files["metrics.txt"].contains("albireo_frames_total"));
    assert!(files["clips.json"].contains("window-0"));
    #[cfg(feature = "hub")]
    the_command_fetches_it(&format!("http://{}", node.address), secret).await;
}

/// `albireo diag` writes the same archive, and says why it cannot.
#[cfg(feature = "hub")]
async fn the_command_fetches_it(node: &str, secret: &str) {
    let folder = tempfile::tempdir().unwrap();
    let fetch = |token: &str| {
        let mut command = crate::support::albireo();
        command
            .args(["diag", node, "--output", "node.tar"])
            .env("ALBIREO_HTTP__TOKEN", token)
            .current_dir(folder.path());
        command
    };
    let refused = fetch("not-the-token-of-it").output().await.unwrap();
    assert_eq!(refused.status.code(), Some(1));
    assert!(
        String::from_utf8_lossy(&refused.stderr).contains("token"),
        "{refused:?}"
    );
    let fetched = fetch(secret).output().await.unwrap();
    assert!(fetched.status.success(), "{fetched:?}");
    let files = untar(&std::fs::read(folder.path().join("node.tar")).unwrap());
    assert!(files.contains_key("log.txt") && files.len() == 8);
    // What is there is left alone.
    let again = fetch(secret).output().await.unwrap();
    assert_eq!(again.status.code(), Some(1));
}

#[tokio::test]
async fn the_last_lines_of_the_log_can_be_had_from_a_number_on() {
    let node = Served::with(HttpConfig::default(), Some(KNOB)).await;
    let log = node.json("/api/v1/log?limit=5").await;
    assert!(log["lines"].as_array().unwrap().len() <= 5, "{log}");
    assert_eq!(
        node.json("/api/v1/log?after=18446744073709551615").await["lines"],
        json!([])
    );
    problem(node.get("/api/v1/log?limit=0").await, 400).await;
}
