//! The whole way over real processes: `albireo node`, `albireo replay`, and a client that shares no code
//! with them.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::support::{Client, Node, PATIENCE, albireo, python, shared};
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
silence_s = 2.0
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
        .args([
            "--connect",
            &node.zenoh,
            "--node",
            "bench",
            "--camera",
            "front",
        ])
        .args(["--every", "--wait-for-subscriber"])
        .args(more)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .output();
    let output = timeout(PATIENCE, output)
        .await
        .expect("the replay ends in time")
        .expect("the replay runs");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
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
    report["dropped"]
        .as_object()
        .expect("drops by kind")
        .values()
        .map(|number| number.as_u64().expect("a number"))
        .sum()
}

/// The metric families Prometheus' own strict parser finds.
fn parsed_by_prometheus(metrics: &str) -> BTreeMap<String, u64> {
    let mut parser = std::process::Command::new(python())
        .arg(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/tests/clients/parse_metrics.py"
        ))
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

    let mut states = BTreeMap::<&str, u64>::new();
    for message in &detections {
        *states
            .entry(message["state"].as_str().expect("a state"))
            .or_default() += 1;
    }
    for state in ["P", "I", "AI"] {
        assert!(states.contains_key(state), "no {state} in {states:?}");
    }
    for (state, count) in report["states"].as_object().expect("five counters") {
        assert_eq!(
            states.get(state.as_str()).copied().unwrap_or(0),
            *count,
            "{state}"
        );
    }
    let energy = &report["energy"];
    assert!(energy["joules"].as_f64().expect("energy") > 0.0);
    let edp = energy["edp"].as_f64().expect("energy-delay product");
    let expected = energy["joules"].as_f64().expect("energy")
        * report["duration_s"].as_f64().expect("seconds")
        * 1e3
        / detections.len() as f64;
    // Both were sent with six significant digits.
    assert!((edp - expected).abs() < 2e-5 * expected, "{edp} {expected}");

    // A client that comes late gets the report from the publisher's cache.
    let mut late = Client::listen(&node.zenoh, "albireo/bench/front/clip", true).await;
    let (_, kept) = late.next().await.expect("the cache answers");
    assert_eq!(kept, report);
    late.finish().await;

    let metrics = reqwest::Client::new()
        .get(format!("{}/metrics", node.http))
        .header("accept", "application/openmetrics-text")
        .send()
        .await
        .expect("the node answers")
        .text()
        .await
        .expect("metrics are text");
    let families = parsed_by_prometheus(&metrics);
    for family in [
        "albireo_frames",
        "albireo_frames_dropped",
        "albireo_threshold",
        "albireo_detector_boxes_dropped",
    ] {
        assert!(families.contains_key(family), "no {family} in {families:?}");
    }
    let asked = detections
        .iter()
        .filter(|message| ["I", "E+I", "AI"].contains(&message["state"].as_str().unwrap()))
        .count();
    let counted = format!("albireo_detector_runs_total{{outcome=\"completed\"}} {asked}");
    assert!(
        metrics
            .lines()
            .any(|line| line.trim_end_matches(".0") == counted),
        "{counted} is not in {metrics}"
    );

    let (status, took, log, _) = node.stop().await;
    assert!(status.success(), "{log}");
    assert!(took.as_secs_f64() < 5.0, "ended after {took:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ../shared and ONNX Runtime and Python and ffmpeg"]
async fn shared_the_check_values_of_yolox_nano_come_out_at_the_far_end() {
    let node = Node::start(&yolox_settings("vanilla")).await;
    let mut client = Client::listen(&node.zenoh, "albireo/bench/front/*", false).await;
    let folder = tempfile::tempdir().expect("a temporary folder");
    let extracted = std::process::Command::new("ffmpeg")
        .args(["-v", "error", "-i"])
        .arg(shared("media/highway_two_cars.mp4"))
        .args(["-vf", "select=eq(n\\,60)", "-frames:v", "1"])
        .arg(folder.path().join("frame.png"))
        .status()
        .expect("ffmpeg is installed (Debian package `ffmpeg`)");
    assert!(extracted.success());
    replay(&node, folder.path(), &["--clip", "frame-60"]).await;
    let (detections, _) = until_clip(&mut client, "frame-60").await;

    let boxes = detections[0]["boxes"].as_array().expect("boxes");
    for (corners, confidence) in [
        ([554.0, 324.0, 659.0, 396.0], 0.88),
        ([455.0, 325.0, 528.0, 396.0], 0.82),
    ] {
        let near = |found: &&Value| {
            let edges = found["box"].as_array().expect("four edges");
            edges
                .iter()
                .zip(corners)
                .all(|(edge, expected)| (edge.as_f64().expect("a number") - expected).abs() <= 2.0)
        };
        let found = boxes
            .iter()
            .find(near)
            .unwrap_or_else(|| panic!("no {corners:?} in {boxes:?}"));
        assert_eq!(found["class"], "car");
        let score = found["confidence"].as_f64().expect("a confidence");
        assert!(
            (score - confidence).abs() <= 0.01,
            "{score} for {confidence}"
        );
    }
}
