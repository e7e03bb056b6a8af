use super::served::{Served, answered, clip, frame, received};
use crate::support::{run_command, value_of};
use albireo_core::policy::FrameState;
use albireo_node::state::board::PowerSnapshot;
use albireo_power::MeterCost;
use albireo_vision::picture::PictureFormat;
use albireo_wire::{DomainWatts, DroppedFrames, EnergyQuality};
use reqwest::Method;
use std::process::Command;
use std::time::Duration;

/// A node that has something to show on every route.
pub(super) async fn filled() -> Served {
    let node = Served::start().await;
    node.ready();
    let front = node.front();
    for seq in 0..5 {
        answered(front, frame(2 * seq, FrameState::I));
        answered(front, frame(2 * seq + 1, FrameState::P));
    }
    answered(front, frame(10, FrameState::EI));
    front.record_dropped(&DroppedFrames {
        undecodable: 4,
        ..DroppedFrames::default()
    });
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

const EXPECTED: &str = r#"
albireo_frames_total{camera="front",state="I"} 5
albireo_frames_total{camera="front",state="P"} 5
albireo_frames_total{camera="front",state="E+I"} 1
albireo_frames_total{camera="rear",state="I"} 0
albireo_frames_dropped_total{camera="front",kind="undecodable"} 4
albireo_frames_degraded_total{camera="front"} 0
albireo_frames_skipped_total{camera="front"} 5
albireo_power_info{source="estimate",quality="estimated"} 1
albireo_clips_total{camera="front"} 1
albireo_messages_unpublished_total{camera="front"} 0
albireo_threshold{camera="front",name="u"} 0.0003
albireo_tau_max{camera="front"} 0.00015
albireo_ready 1
albireo_detector_ready 1
albireo_detector_info{model="yolox_nano.onnx",provider="cpu",policy="albireo"} 1
albireo_detector_runs_total{outcome="completed"} 0
albireo_detector_batches_total 0
albireo_detector_rebuilds_total{outcome="failed"} 0
albireo_detector_boxes_dropped_total{reason="unknown_class"} 0
albireo_power_watts{domain="total",source="estimate"} 12.5
albireo_energy_joules_total{domain="total",source="estimate"} 99.5
albireo_energy_covered_seconds_total{domain="total",source="estimate"} 8
albireo_power_meter_cpu_seconds_total{source="estimate"} 0.25
albireo_frame_latency_seconds_count{camera="front",state="P"} 5
albireo_frame_latency_seconds_bucket{le="0.001",camera="front",state="P"} 5
albireo_frame_latency_seconds_bucket{le="0.001",camera="front",state="I"} 0
albireo_detector_latency_seconds_count{camera="front"} 6
"#;

#[tokio::test]
async fn metrics_match_the_recorded_frames() {
    let node = filled().await;
    let response = node.request(Method::GET, "/metrics").send().await.unwrap();
    let media_type = response.headers()["content-type"].to_str().unwrap();
    let expected = "text/plain; version=0.0.4";
    assert!(media_type.starts_with(expected), "{media_type}");
    let text = response.text().await.unwrap();
    for line in EXPECTED.trim().lines() {
        let (series, value) = line.rsplit_once(' ').unwrap();
        let expected: f64 = value.parse().unwrap();
        assert_eq!(value_of(&text, series), expected, "{series}");
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
