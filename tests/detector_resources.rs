//! Models that need more memory or time than there is.

#![allow(clippy::panic, clippy::unwrap_used)]

use super::support::detectors::{config, model, one_colour};
use super::support::{PATIENCE, albireo};
use albireo_vision::detector::{
    CameraSlot, DetectorConfig, DetectorHandle, DetectorStatus, InferenceError,
};
use std::process::Stdio;
use std::time::{Duration, Instant};
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::time::timeout;

const CAMERA: CameraSlot = CameraSlot(0);

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_run_without_enough_memory_is_counted_and_the_next_picture_is_answered() {
    let detector = DetectorHandle::start(&DetectorConfig {
        confidence: 0.3,
        ..config("hungry.onnx")
    })
    .await
    .unwrap();
    let dark = one_colour([102, 0, 0]);
    let answer = detector.detect(CAMERA, dark.clone()).await.unwrap();
    assert_eq!(answer.detections.len(), 1);
    let error = detector
        .detect(CAMERA, one_colour([255, 0, 0]))
        .await
        .unwrap_err();
    assert!(matches!(error, InferenceError::Failed(_)), "{error}");
    let error = error.to_string();
    // In plain words, and how much it was.
    for part in [
        "there is not enough memory",
        "a smaller model or input size",
        "562949953421568",
    ] {
        assert!(error.contains(part), "{part} is not in: {error}");
    }
    detector
        .status()
        .wait_for(|status| matches!(status, DetectorStatus::Ready { .. }))
        .await
        .unwrap();
    let answer = detector.detect(CAMERA, dark).await.unwrap();
    assert_eq!(answer.detections.len(), 1);
    let counters = detector.counters().worker;
    assert_eq!(
        (counters.completed, counters.failed, counters.rebuilds),
        (2, 1, 1)
    );
    assert_eq!(counters.panicked, 0);
    detector.stop().await;
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_model_that_needs_more_memory_than_there_is_is_refused_with_its_name_and_why() {
    let error = match DetectorHandle::start(&config("starving.onnx")).await {
        Ok(_) => panic!("it was accepted"),
        Err(error) => error.to_string(),
    };
    for part in [
        "the first run of the model",
        "starving.onnx",
        "there is not enough memory",
        "562949953421568",
    ] {
        assert!(error.contains(part), "{part} is not in: {error}");
    }
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn an_input_of_signed_bytes_is_refused_with_what_is_taken() {
    let error = match DetectorHandle::start(&config("yolo_signed.onnx")).await {
        Ok(_) => panic!("it was accepted"),
        Err(error) => error.to_string(),
    };
    for part in [
        "yolo_signed.onnx",
        "the elements of its input are int8 instead of float32, float16 or uint8",
        "`images` int8 [1, 32, 64, 3]",
    ] {
        assert!(error.contains(part), "{part} is not in: {error}");
    }
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_node_whose_model_never_finishes_loading_stops_when_told() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("node.toml");
    let settings = format!(
        "http.listen = \"127.0.0.1:0\"\nzenoh.listen = [\"tcp/127.0.0.1:0\"]\nlog.format = \"json\"\n\
         [detector]\nmodel = {:?}\n[[camera]]\nname = \"front\"\n",
        model("endless.onnx")
    );
    std::fs::write(&file, settings).unwrap();
    let mut node = albireo()
        .args(["node", "--config"])
        .arg(&file)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(node.stderr.take().unwrap()).lines();
    let mut log = String::new();
    let said = |log: &str, what: &str| log.contains(what);
    let until_it_is_said = async {
        while !said(&log, "ONNX Runtime loaded") {
            let line = lines.next_line().await.unwrap();
            log.push_str(&line.unwrap_or_else(|| panic!("the node ended:\n{log}")));
            log.push('\n');
        }
    };
    timeout(PATIENCE, until_it_is_said).await.unwrap();
    assert!(said(&log, "loading the detector") && said(&log, "endless.onnx"));
    let address = log
        .lines()
        .find_map(|line| {
            serde_json::from_str::<serde_json::Value>(line).ok()?["http"]
                .as_str()
                .map(str::to_owned)
        })
        .unwrap();
    let ready = reqwest::get(format!("{address}/readyz")).await.unwrap();
    assert_eq!(ready.status(), 503);
    let id = node.id().unwrap().to_string();
    let start = Instant::now();
    let kill = std::process::Command::new("kill")
        .args(["-TERM", &id])
        .status();
    assert!(kill.unwrap().success());
    let status = timeout(PATIENCE, node.wait()).await.unwrap().unwrap();
    let took = start.elapsed();
    while let Some(line) = lines.next_line().await.unwrap() {
        log.push_str(&line);
        log.push('\n');
    }
    assert!(status.success(), "{status}:\n{log}");
    assert!(took < Duration::from_secs(10), "it took {took:?}:\n{log}");
    assert!(said(&log, "stopped before the node was ready"), "{log}");
    // What the end of ONNX Runtime did to a run that went on.
    assert!(!said(&log, "GetElementType"), "{log}");
}
