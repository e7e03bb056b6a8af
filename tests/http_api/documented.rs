//! A node that has something to show on every route: its metrics, and what the documentation promises.

use super::served::{Served, answered, clip, frame, problem, received};
use crate::support::{Ended, run_command, value_of};
use albireo_core::policy::FrameState;
use albireo_node::state::board::PowerSnapshot;
use albireo_vision::picture::PictureFormat;
use albireo_wire::{DomainWatts, DropKind, EnergyQuality};
use reqwest::Method;
use serde_json::{Value, json};
use std::process::Command;
use std::time::Duration;

async fn filled() -> Served {
    let node = Served::start().await;
    node.ready();
    let front = node.front();
    for seq in 0..5 {
        answered(front, frame(2 * seq, FrameState::I));
        answered(front, frame(2 * seq + 1, FrameState::P));
    }
    answered(front, frame(10, FrameState::EI));
    front.input.count(DropKind::Undecodable, 4, &"half a picture");
    received(front, 0, PictureFormat::Gray8, vec![7; 16], [4, 4]);
    node.board.record_clip(clip("front", 0));
    node.board.set_power(PowerSnapshot {
        source: "estimate".to_owned(),
        quality: EnergyQuality::Estimated,
        watts: vec![DomainWatts {
            domain: "total".to_owned(),
            watts: 12.5,
        }],
        joules: [("total".to_owned(), 99.5)].into(),
        covered_s: [("total".to_owned(), 8.0)].into(),
        meter_cpu: Duration::from_millis(250),
        failed_reads: 3,
        hottest: Some(("gpu-thermal".to_owned(), 61.5)),
        ..PowerSnapshot::default()
    });
    node
}

/// The metrics that do not change with the time or the process.
const SHOWN: &str = "ready detector_info detector_batches_total detector_boxes_dropped_total \
    detector_runs_total detector_rebuilds_total frames_total frames_dropped_total frames_skipped_total \
    frames_degraded_total clips_total messages_unpublished_total frame_latency_seconds_count \
    detector_latency_seconds_count threshold tau_max power_info power_watts energy_joules_total \
    energy_covered_seconds_total temperature_celsius power_failed_reads_total power_meter_cpu_seconds_total";

#[tokio::test]
async fn metrics_match_the_recorded_frames() {
    let node = filled().await;
    let response = node.request(Method::GET, "/metrics").send().await.unwrap();
    let media_type = response.headers()["content-type"].to_str().unwrap();
    let expected = "text/plain; version=0.0.4";
    assert!(media_type.starts_with(expected), "{media_type}");
    let text = response.text().await.unwrap();
    let is_shown = |line: &&str| {
        let name = line.split(['{', ' ']).next().unwrap();
        let name = name.strip_prefix("albireo_").unwrap_or_default();
        SHOWN.split(' ').any(|shown| shown == name)
    };
    let shown: Vec<_> = text.lines().filter(is_shown).collect();
    insta::assert_snapshot!("metrics_of_the_recorded_frames", shown.join("\n"));
    for (state, count) in [("P", 5.0), ("I", 0.0)] {
        let labels = format!(r#"{{le="0.001",camera="front",state="{state}"}}"#);
        let bucket = format!("albireo_frame_latency_seconds_bucket{labels}");
        assert_eq!(value_of(&text, &bucket), count, "{state}");
    }
    assert!(!text.contains(r#"albireo_last_frame_age_seconds{camera="rear"}"#));
}

#[tokio::test]
#[ignore = "needs promtool"]
async fn promtool_accepts_the_metrics() {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(&file, filled().await.metrics().await).unwrap();
    let check = format!("promtool check metrics < {}", file.path().display());
    let ended = run_command(Command::new("sh").args(["-c", &check]));
    let said = format!("{}{}", ended.err, ended.out);
    assert!(ended.code == Some(0) && said.is_empty(), "{said}");
}

fn operations(document: &Value) -> Vec<(String, &Value)> {
    let mut found = Vec::new();
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            found.push((format!("{method} {path}"), operation));
        }
    }
    found
}

#[tokio::test]
async fn every_documented_route_is_shown_on_a_page_listed_in_the_index_and_answers() {
    let node = filled().await;
    let document = node.json("/openapi.json").await;
    let described = albireo_node::api::http::openapi();
    assert_eq!(document, serde_json::to_value(described).unwrap());
    let page = node.get("/docs/").await.text().await.unwrap();
    assert!(page.contains("swagger-ui"), "{page}");
    let script = node.get("/docs/swagger-initializer.js").await;
    let script = script.text().await.unwrap();
    assert!(script.contains("/openapi.json"), "{script}");
    let index = node.json("/api/v1").await;
    assert_eq!(index["cameras"], json!(["front", "rear"]));
    let listed = index["routes"].as_array().unwrap();
    assert!(
        listed.iter().all(|route| route["summary"] != ""),
        "{listed:?}"
    );
    for (route, _) in operations(&document) {
        let (method, path) = route.split_once(' ').unwrap();
        assert!(listed.iter().any(|one| one["path"] == *path), "{path}");
        let ask = async |camera: &str| {
            let path = path.replace("{camera}", camera);
            match method {
                "get" => node.get(&path).await,
                _ => node.put(&path, r#"{"u": 5e-4}"#).await,
            }
        };
        if method == "get" {
            assert_eq!(ask("front").await.status(), 200, "{route}");
        }
        if path.contains("{camera}") {
            let missing = problem(ask("roof").await, 404).await;
            assert_eq!(missing["allowed"], json!(["front", "rear"]), "{route}");
        }
    }
}

#[tokio::test]
#[ignore = "needs curl"]
async fn every_documented_command_works() {
    let node = filled().await;
    let document = node.json("/openapi.json").await;
    let directory = tempfile::tempdir().unwrap();
    for (name, operation) in operations(&document) {
        let command = operation["description"]
            .as_str()
            .unwrap()
            .split('`')
            .find(|part| part.starts_with("curl "))
            .unwrap_or_else(|| panic!("{name} shows no command"));
        let here = command.replace("127.0.0.1:8080", &node.address.to_string());
        assert_ne!(here, command, "{name}");
        // The streams never end by themselves.
        let (limit, code, begin) = if name.ends_with("/events") {
            (3, 28, "event: ")
        } else if name.ends_with("/stream.mjpg") {
            (3, 28, "")
        } else {
            (60, 0, "")
        };
        let curl = format!("exec curl -sSf --max-time {limit} ");
        let mut shell = tokio::process::Command::new("sh");
        shell.args(["-c", &here.replace("curl ", &curl)]);
        let ended = Ended::from(shell.current_dir(directory.path()).output().await.unwrap());
        assert_eq!(ended.code, Some(code), "{command}: {}", ended.err);
        assert!(ended.out.starts_with(begin), "{command}: {}", ended.out);
        // The other commands are for the default policy.
        if name.ends_with("/policy") {
            node.put("/api/v1/policy", r#"{"name": "albireo"}"#).await;
        }
    }
    assert!(directory.path().join("frame.jpg").is_file());
    assert_eq!(node.front().threshold(), Some(5e-4));
}
