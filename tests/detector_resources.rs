//! Models that need more memory or time than there is.

#![allow(clippy::panic, clippy::unwrap_used)]

use super::support::detectors::{config, model, one_colour, started};
use super::support::{Node, assert_says, until};
use albireo_vision::detector::{CameraSlot, DetectorConfig, DetectorStatus, InferenceError};
use std::time::Duration;

const CAMERA: CameraSlot = CameraSlot(0);

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_run_without_enough_memory_is_counted_and_the_next_picture_is_answered() {
    let config = DetectorConfig {
        confidence: 0.3,
        ..config("hungry.onnx")
    };
    let detector = started(&config).await;
    let (dark, red) = (one_colour([102, 0, 0]), one_colour([255, 0, 0]));
    let answer = detector.detect(CAMERA, dark.clone()).await.unwrap();
    assert_eq!(answer.detections.len(), 1);
    let error = detector.detect(CAMERA, red).await.unwrap_err();
    assert!(matches!(error, InferenceError::Failed(_)), "{error}");
    // In plain words, and how much it was.
    let remedy = [
        "there is not enough memory",
        "a smaller model or input size",
    ];
    assert_says(
        &error.to_string(),
        &[&remedy[..], &["562949953421568"]].concat(),
    );
    let is_ready = |status: &DetectorStatus| matches!(status, DetectorStatus::Ready { .. });
    detector.status().wait_for(is_ready).await.unwrap();
    let answer = detector.detect(CAMERA, dark).await.unwrap();
    assert_eq!(answer.detections.len(), 1);
    let counters = detector.counters().worker;
    let counted = [
        counters.completed,
        counters.failed,
        counters.rebuilds,
        counters.panicked,
    ];
    assert_eq!(counted, [2, 1, 1, 0]);
    detector.stop().await;
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_node_whose_model_never_finishes_loading_stops_when_told() {
    let settings = format!("detector.model = {:?}\n", model("endless.onnx"));
    let node = Node::start_unready(&settings).await;
    let ready = reqwest::get(format!("{}/readyz", node.http)).await.unwrap();
    assert_eq!(ready.status(), 503);
    until("the model is being loaded", async || {
        let lines = node.text("/api/v1/log").await;
        lines.contains("ONNX Runtime loaded") && lines.contains("endless.onnx")
    })
    .await;
    let (status, took, log, _) = node.stop().await;
    assert!(status.success(), "{status}:\n{log}");
    assert!(took < Duration::from_secs(10), "it took {took:?}:\n{log}");
    assert_says(
        &log,
        &["loading the detector", "stopped before the node was ready"],
    );
    // What the end of ONNX Runtime did to a run that went on.
    assert!(!log.contains("GetElementType"), "{log}");
}
