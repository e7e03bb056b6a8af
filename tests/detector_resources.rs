//! A model that takes forever to load.

use super::support::detectors::model;
use super::support::{Node, assert_contains, until};
use std::time::Duration;

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
