//! Models that need too much memory or time.

use super::support::detectors::{CAMERA, changed, detected, model, one_colour, started};
use super::support::{Node, assert_contains, until};
use albireo_vision::detector::{DetectorStatus, InferenceError};
use std::time::Duration;

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_run_without_enough_memory_is_counted_and_the_next_picture_is_answered() {
    const DARK: [u8; 3] = [102, 0, 0];
    let detector = started(&changed("hungry.onnx", |config| config.confidence = 0.3)).await;
    assert_eq!(detected(&detector, DARK).await.detections.len(), 1);
    let red = detector.detect(CAMERA, one_colour([255, 0, 0])).await;
    let error = red.unwrap_err();
    assert!(matches!(error, InferenceError::Failed(_)), "{error}");
    // The error explains itself and names the size.
    let said = [
        "there is not enough memory",
        "a smaller model or input size",
        "562949953421568",
    ];
    assert_contains(&error.to_string(), &said);
    let is_ready = |status: &DetectorStatus| matches!(status, DetectorStatus::Ready { .. });
    detector.status().wait_for(is_ready).await.unwrap();
    assert_eq!(detected(&detector, DARK).await.detections.len(), 1);
    let counts = detector.counters().worker;
    assert_eq!((counts.completed, counts.failed), (2, 1));
    assert_eq!((counts.rebuilds, counts.panicked), (1, 0));
    detector.stop().await;
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_node_whose_model_never_finishes_loading_stops_on_request() {
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
    let said = ["loading the detector", "stopped before the node was ready"];
    assert_contains(&log, &said);
    // The unloading of ONNX Runtime must not break a run in progress.
    assert!(!log.contains("GetElementType"), "{log}");
}
