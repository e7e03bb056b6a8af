use super::exposition::{Samples, read};
use super::served::{Frames, Served, clip, frame};
use albireo_core::policy::FrameState;
use albireo_node::state::board::PowerSnapshot;
use albireo_power::MeterCost;
use albireo_wire::{DomainWatts, DroppedFrames, EnergyQuality};
use reqwest::Method;
use std::io::Write;
use std::process::{Command, Stdio};
use std::time::Duration;

async fn filled() -> Served {
    let node = Served::start().await;
    node.ready();
    let front = node.board.camera("front").unwrap();
    for seq in 0..10 {
        front.answered(frame(
            seq,
            if seq % 2 == 0 {
                FrameState::I
            } else {
                FrameState::P
            },
        ));
    }
    front.answered(frame(10, FrameState::EI));
    front.record_dropped(&DroppedFrames {
        undecodable: 4,
        ..DroppedFrames::default()
    });
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
        cost: MeterCost {
            cpu: Duration::from_millis(250),
            ..MeterCost::default()
        },
        failed_reads: 3,
        hottest: Some(("gpu-thermal".to_owned(), 61.5)),
        ..PowerSnapshot::default()
    });
    node
}

async fn scrape(node: &Served, accept: &str) -> (String, String) {
    let request = node
        .request(Method::GET, "/metrics")
        .header("accept", accept);
    let response = request.send().await.unwrap();
    let media_type = response.headers()["content-type"]
        .to_str()
        .unwrap()
        .to_owned();
    (media_type, response.text().await.unwrap())
}

fn check(samples: &Samples) {
    for (series, value) in [
        (r#"albireo_frames_total{camera="front",state="I"}"#, 5.0),
        (r#"albireo_frames_total{camera="front",state="P"}"#, 5.0),
        (r#"albireo_frames_total{camera="front",state="E+I"}"#, 1.0),
        (r#"albireo_frames_total{camera="rear",state="I"}"#, 0.0),
        (
            r#"albireo_frames_dropped_total{camera="front",kind="undecodable"}"#,
            4.0,
        ),
        (r#"albireo_frames_degraded_total{camera="front"}"#, 0.0),
        (r#"albireo_frames_skipped_total{camera="front"}"#, 5.0),
        (
            r#"albireo_power_info{source="estimate",quality="estimated"}"#,
            1.0,
        ),
        (r#"albireo_clips_total{camera="front"}"#, 1.0),
        (r#"albireo_messages_unpublished_total{camera="front"}"#, 0.0),
        (r#"albireo_threshold{camera="front",knob="u"}"#, 3e-4),
        (r#"albireo_tau_max{camera="front"}"#, 1.5e-4),
        ("albireo_ready{}", 1.0),
        ("albireo_detector_ready{}", 1.0),
        (
            r#"albireo_detector_info{model="detector.onnx",provider="cpu",policy="albireo"}"#,
            1.0,
        ),
        (r#"albireo_detector_runs_total{outcome="completed"}"#, 0.0),
        ("albireo_detector_batches_total{}", 0.0),
        (r#"albireo_detector_rebuilds_total{outcome="failed"}"#, 0.0),
        (
            r#"albireo_detector_boxes_dropped_total{reason="unknown_class"}"#,
            0.0,
        ),
        (
            r#"albireo_power_watts{domain="total",source="estimate"}"#,
            12.5,
        ),
        (
            r#"albireo_energy_joules_total{domain="total",source="estimate"}"#,
            99.5,
        ),
        (
            r#"albireo_energy_covered_seconds_total{domain="total",source="estimate"}"#,
            8.0,
        ),
        (
            r#"albireo_power_meter_cpu_seconds_total{source="estimate"}"#,
            0.25,
        ),
        (
            r#"albireo_frame_latency_seconds_count{camera="front",state="P"}"#,
            5.0,
        ),
        (
            r#"albireo_frame_latency_seconds_bucket{le="0.001",camera="front",state="P"}"#,
            5.0,
        ),
        (
            r#"albireo_frame_latency_seconds_bucket{le="0.001",camera="front",state="I"}"#,
            0.0,
        ),
        (
            r#"albireo_detector_latency_seconds_count{camera="front"}"#,
            6.0,
        ),
    ] {
        assert_eq!(
            samples.get(series),
            Some(&value),
            "{series} in {samples:#?}"
        );
    }
    assert!(!samples.contains_key(r#"albireo_last_frame_age_seconds{camera="rear"}"#));
}

#[tokio::test]
async fn metrics_are_right_in_both_formats() {
    let node = filled().await;
    let prometheus =
        "application/openmetrics-text;version=1.0.0;q=0.5,text/plain;version=0.0.4;q=0.3";
    let (media_type, text) = scrape(&node, prometheus).await;
    assert!(
        media_type.starts_with("application/openmetrics-text"),
        "{media_type}"
    );
    check(&read(&text, true));
    let (media_type, text) = scrape(&node, "*/*").await;
    assert!(media_type.starts_with("text/plain"), "{media_type}");
    check(&read(&text, false));
}

/// Needs `promtool` of Debian's package `prometheus`; the strict reader above is there without it.
#[tokio::test]
#[ignore = "needs promtool"]
async fn promtool_finds_nothing_wrong() {
    let mut promtool = match Command::new("promtool")
        .args(["check", "metrics"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
    {
        Ok(promtool) => promtool,
        Err(error) => panic!("promtool cannot be run ({error}): install the package `prometheus`"),
    };
    let (_, text) = scrape(&filled().await, "*/*").await;
    let mut input = promtool.stdin.take().unwrap();
    input.write_all(text.as_bytes()).unwrap();
    drop(input);
    let output = promtool.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr) + String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && said.is_empty(), "{said}");
}
