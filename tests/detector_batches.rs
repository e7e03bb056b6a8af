//! Several cameras in one run of the model.

#![allow(clippy::unwrap_used)]

use super::support::detectors;
use albireo_vision::detector::{CameraSlot, Detected, DetectorConfig, DetectorHandle};

/// A model with an open batch; the score of a car is how red the picture is, that of a traffic light how green.
fn config(model: &str) -> DetectorConfig {
    DetectorConfig {
        report_classes: Some(Vec::new()),
        confidence: 0.3,
        timeout_ms: 60_000,
        batch_size: 3,
        // Far longer than three tasks need to ask: the run begins when the third has.
        batch_wait_ms: 1000,
        ..detectors::config(model)
    }
}

async fn detect(detector: &DetectorHandle, camera: usize, color: [u8; 3]) -> Detected {
    let picture = detectors::one_colour(color);
    detector.detect(CameraSlot(camera), picture).await.unwrap()
}

fn confidences(detected: &Detected) -> Vec<(u16, i64)> {
    let list = detected.detections.iter();
    list.map(|found| (found.class.0, (found.confidence * 100.0).round() as i64))
        .collect()
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn cameras_share_a_run_and_each_gets_its_own_boxes() {
    let detector = detectors::started(&config("yolo_open.onnx")).await;
    let colors = [[204, 0, 0], [0, 153, 0], [102, 0, 0]];
    let expected = [vec![(0, 80)], vec![(1, 60)], vec![(0, 40)]];
    let [one, two, three] = colors;
    let mut before = detector.counters().worker;
    // The first round makes the cameras known: a batch waits for known cameras only.
    for round in 0..2 {
        let together = tokio::join!(
            detect(&detector, 0, one),
            detect(&detector, 1, two),
            detect(&detector, 2, three)
        );
        let found = [&together.0, &together.1, &together.2].map(confidences);
        assert_eq!(found, expected);
        let after = detector.counters().worker;
        assert_eq!(after.completed - before.completed, 3);
        if round == 1 {
            assert_eq!(after.batches - before.batches, 1);
            // Of one run's time each picture used an even part.
            let all = [&together.0, &together.1, &together.2];
            assert!(all.iter().all(|found| found.pictures == 3));
            assert!(all.iter().all(|found| found.took == together.0.took));
        }
        before = after;
    }
}
