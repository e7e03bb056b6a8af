//! The whole way over real processes: `albireo node`, `albireo replay`, and a client that shares no code
//! with them.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::support::{Client, Ended, Node, PATIENCE, albireo, project, python, shared, value_of};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Stdio;
use tokio::time::timeout;

/// A node with YOLOX-Nano.
fn yolox_settings(policy: &str) -> String {
    format!(
        r#"
[node]
name = "bench"
[detector]
model = "{}"
timeout_ms = 30000
[policy]
name = "{policy}"
u = 5e-4
[clip]
silence_s = 6.0
[[camera]]
name = "front"
delivery = "every"
# development: ring=4
"#,
        shared("models/yolox_nano_416.onnx").display()
    )
}

async fn replay(node: &Node, source: &Path, more: &[&str]) {
    let output = albireo()
        .arg("replay")
        .arg(source)
        .args(["--connect", &node.zenoh, "--node", "bench"])
        .args(["--camera", "front", "--every", "--wait-for-subscriber"])
        .args(more)
        .output();
    let output = timeout(PATIENCE, output)
        .await
        .expect("the replay ends in time");
    Ended::from(output.unwrap()).succeeds();
}

/// Detections until the report of `clip` comes, and that report.
async fn until_clip(client: &mut Client, clip: &str) -> (Vec<Value>, Value) {
    let mut detections = Vec::new();
    loop {
        let (key, message) = client.next().await.expect("the client goes on");
        match key.rsplit('/').next() {
            Some("detections") => detections.push(message),
            Some("clip") if message["clip"] == clip => return (detections, message),
            _ => {}
        }
    }
}

fn total_dropped(report: &Value) -> u64 {
    let kinds = report["dropped"].as_object().unwrap().values();
    kinds.map(|number| number.as_u64().unwrap()).sum()
}

/// The metric families Prometheus' own strict parser finds.
fn parsed_by_prometheus(metrics: &str) -> BTreeMap<String, u64> {
    let mut parser = std::process::Command::new(python())
        .arg(project("tests/clients/parse_metrics.py"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("Python starts");
    std::io::Write::write_all(&mut parser.stdin.take().expect("piped"), metrics.as_bytes())
        .expect("the parser reads");
    let output = parser.wait_with_output().expect("the parser ends");
    assert!(output.status.success(), "the parser refuses:\n{metrics}");
    serde_json::from_slice(&output.stdout).expect("JSON")
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ../shared and ONNX Runtime and Python and ffmpeg"]
async fn shared_every_frame_of_a_clip_is_answered_or_reported_as_dropped() {
    let node = Node::start(&yolox_settings("albireo")).await;
    let mut client = Client::listen(&node.zenoh, "albireo/bench/front/*", false).await;
    let video = shared("media/highway_two_cars.mp4");
    replay(&node, &video, &["--clip", "two-cars"]).await;
    let (detections, report) = until_clip(&mut client, "two-cars").await;

    let dropped = total_dropped(&report);
    assert_eq!(report["frames"], detections.len(), "{report}");
    assert_eq!(detections.len() as u64 + dropped, 251, "{report}");
    let numbers: BTreeSet<_> = detections.iter().map(|d| d["seq"].as_u64()).collect();
    assert_eq!(
        numbers.len(),
        detections.len(),
        "every frame is answered once"
    );

    for (state, count) in report["states"].as_object().expect("five counters") {
        let found = detections
            .iter()
            .filter(|message| message["state"] == **state)
            .count();
        assert_eq!(*count, found, "{state}");
        assert!(
            found > 0 || ["E", "E+I"].contains(&&**state),
            "no {state} in {report}"
        );
    }
    let number = |value: &Value| value.as_f64().unwrap();
    let (joules, edp) = (
        number(&report["energy"]["joules"]),
        number(&report["energy"]["edp"]),
    );
    assert!(joules > 0.0);
    let expected = joules * number(&report["duration_s"]) * 1e3 / detections.len() as f64;
    // Both were sent with six significant digits.
    assert!((edp - expected).abs() < 2e-5 * expected, "{edp} {expected}");

    // A client that comes late gets the report from the publisher's cache.
    let mut late = Client::listen(&node.zenoh, "albireo/bench/front/clip", true).await;
    let (_, kept) = late.next().await.expect("the cache answers");
    assert_eq!(kept, report);
    late.finish().await;

    let metrics = reqwest::Client::new().get(format!("{}/metrics", node.http));
    let metrics = metrics.send().await.unwrap().text().await.unwrap();
    let families = parsed_by_prometheus(&metrics);
    for family in [
        "frames",
        "frames_dropped",
        "threshold",
        "detector_boxes_dropped",
    ] {
        assert!(
            families.contains_key(&format!("albireo_{family}")),
            "no {family} in {families:?}"
        );
    }
    let asked = ["I", "E+I", "AI"].map(|state| report["states"][state].as_u64().unwrap());
    let runs = value_of(
        &metrics,
        "albireo_detector_runs_total{outcome=\"completed\"}",
    );
    assert_eq!(runs, asked.iter().sum::<u64>() as f64);

    let (status, took, log, _) = node.stop().await;
    assert!(status.success(), "{log}");
    assert!(took.as_secs_f64() < 5.0, "ended after {took:?}");
}
