use super::served::{Served, answered, frame, problem};
use crate::support::{PATIENCE, assert_contains, assert_has};
use albireo_core::policy::FrameState;
use reqwest::Method;
use serde_json::{Value, json};

const PATH: &str = "/api/v1/target";

#[tokio::test]
async fn an_invalid_target_is_rejected_with_a_reason_and_changes_nothing() {
    let node = Served::start().await;
    let bad = r#"
{"target": {"skip_rate": 1.0}}
{"target": {"recall": 1.5}}
{"target": {"watts": 0}}
{"target": {"speed": 3}}
{"target": {"skip_rate": 0.5}, "v": 2}
[]
"#;
    let bad = bad.trim().lines().map(|body| (body, 422));
    for (body, status) in bad.chain([("", 400), (r#"{"target": {"skip_rate": 0.5}"#, 400)]) {
        let refused = problem(node.put(PATH, body).await, status).await;
        assert!(refused["detail"].is_string(), "{body}");
        assert_eq!(node.json(PATH).await["target"], Value::Null, "{body}");
    }
}

#[tokio::test]
async fn a_target_is_set_read_and_switched_off_by_null_or_a_manual_threshold() {
    let node = Served::start().await;
    let set = node.put(PATH, r#"{"target": {"skip_rate": 0.5}}"#).await;
    assert_eq!(set.status(), 200);
    let set: Value = set.json().await.unwrap();
    let expected = json!({
        "target": {"skip_rate": 0.5}, "source": "local", "range": {"least": 1.5e-4, "most": 2e-3},
        "threshold": {"name": "u", "value": 3e-4},
    });
    assert_has(&set, &expected);
    assert_eq!(node.json(PATH).await, set);
    let series = "albireo_target{target=\"skip_rate\"} 0.5";
    assert_contains(&node.metrics().await, &[series]);

    let path = "/api/v1/cameras/front/threshold";
    assert_eq!(node.put(path, r#"{"u": 7e-4}"#).await.status(), 200);
    let off = json!({"target": null, "off": "the threshold was set by hand"});
    assert_has(&node.json(PATH).await, &off);
    assert!(!node.metrics().await.contains("albireo_target{"));

    node.put(PATH, r#"{"target": {"watts": 6.0}}"#).await;
    assert_eq!(node.json(PATH).await["target"], json!({"watts": 6.0}));
    let off = node.put(PATH, r#"{"target": null}"#).await;
    let off: Value = off.json().await.unwrap();
    assert_has(&off, &json!({"target": null, "off": "it was switched off"}));
}

/// A pipe in place of the file stalls the writer until it is read.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn frames_and_requests_continue_while_a_change_waits_for_a_stalled_disk() {
    let directory = tempfile::tempdir().unwrap();
    let pipe = directory.path().join("settings.json.new");
    crate::support::pipe(&pipe);
    let node = Served::kept_in(directory.path()).await;
    let body = r#"{"target": {"skip_rate": 0.5}}"#;
    let change = tokio::spawn(node.request(Method::PUT, PATH).body(body).send());
    let served = tokio::time::timeout(PATIENCE, async {
        while node.json(PATH).await["target"] != json!({"skip_rate": 0.5}) {}
        for path in "/api/v1/threshold /api/v1/cameras /metrics /readyz".split(' ') {
            node.get(path).await.text().await.unwrap();
        }
        for (seq, camera) in node.board.cameras.iter().enumerate() {
            answered(camera, frame(seq as u64, FrameState::P));
        }
        node.board.publish_counters(0);
    });
    let served = served.await;
    let acknowledged = change.is_finished();
    // Read before any assertion: a failing test would wait for the writer.
    let reading = tokio::task::spawn_blocking(move || std::fs::read_to_string(pipe));
    let written = reading.await.unwrap().unwrap();
    served.expect("requests wait for the disk");
    assert!(!acknowledged, "acknowledged, not written");
    assert!(written.contains("skip_rate"), "{written}");
    assert_eq!(change.await.unwrap().unwrap().status(), 200);
}
