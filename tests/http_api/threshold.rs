use super::served::{Served, THRESHOLD, answered, frame, prepared, problem};
use crate::support::{PATIENCE, assert_contains, assert_has};
use albireo_core::policy::FrameState;
use albireo_service::config::HttpConfig;
use reqwest::Method;
use serde_json::{Value, json};

const PATHS: [&str; 2] = ["/api/v1/threshold", "/api/v1/cameras/front/threshold"];

/// Valid JSON without a valid threshold.
const BAD: &str = r#"
{"u": -1}
{"u": 0}
{"u": -0.0}
{"u": 1e-300}
{"u": 1.0000001}
{"u": 1e300}
{"u": "NaN"}
{"u": "3e-4"}
{"u": null}
{"u": true}
{"u": [3e-4]}
{"u": 3e-4, "U": 3e-4}
{"u": 3e-4, "camera": "front"}
{"u": 3e-4, "u": 5e-4}
{"u": 3e-4, "v": 2}
{"v": 1}
{}
[1, 3e-4]
3e-4
null
"3e-4"
"#;

/// Invalid JSON.
const BROKEN: [&[u8]; 9] = [
    br#"{"u": 1e999}"#,
    br#"{"u": NaN}"#,
    br#"{"u": Infinity}"#,
    b"",
    b"u=3e-4",
    br#"{"u": 3e-4"#,
    br#"{"u": 3e-4} {"u": 4e-4}"#,
    b"\0",
    b"\xff\xfe",
];

#[tokio::test]
async fn an_invalid_threshold_is_rejected_with_the_allowed_range_and_changes_nothing() {
    let node = Served::start().await;
    let bad = BAD.trim().lines().map(|body| (body.as_bytes(), 422));
    let all: Vec<_> = bad.chain(BROKEN.map(|body| (body, 400))).collect();
    for path in PATHS {
        for &(body, status) in &all {
            let refused = problem(node.put(path, body).await, status).await;
            assert_contains(&refused["detail"], &["number from 1e-9 to 1"]);
            let allowed = json!({"minimum": 1e-9, "maximum": 1.0});
            assert_has(&refused["threshold_spec"], &allowed);
        }
    }
    for camera in &node.board.cameras {
        assert_eq!(camera.threshold(), Some(THRESHOLD.default));
    }
}

#[tokio::test]
async fn a_query_where_none_is_read_is_refused_if_the_request_would_change_something() {
    let node = Served::start().await;
    for (path, body) in [
        ("/api/v1/threshold?camera=front", r#"{"u": 5e-4}"#),
        ("/api/v1/cameras/front/threshold?u=1e-3", r#"{"u": 5e-4}"#),
        ("/api/v1/policy?name=vanilla", r#"{"name": "vanilla"}"#),
    ] {
        let refused = problem(node.put(path, body).await, 400).await;
        assert_contains(&refused["detail"], &["takes no query", "in the body"]);
    }
    for camera in &node.board.cameras {
        assert_eq!(camera.threshold(), Some(THRESHOLD.default));
    }
    let for_one = node.put("/api/v1/threshold?camera=front", r#"{"u": 5e-4}"#).await;
    let refused = problem(for_one, 400).await;
    let way_out = "/api/v1/cameras/{camera}/threshold";
    assert_contains(&refused["detail"], &[way_out]);
    // Health checks and pages add a query to what they read.
    for path in [
        "/api/v1?x",
        "/api/v1/node?_=1",
        "/api/v1/cameras/front?x=1",
        "/api/v1/power?minutes=x",
        "/api/v1/threshold?",
    ] {
        node.json(path).await;
    }
}

#[tokio::test]
async fn only_json_of_limited_size_and_what_plain_curl_sends_is_accepted() {
    let node = Served::start().await;
    for (media, is_accepted) in [
        (Some("text/plain"), false),
        (Some("application/jsonp"), false),
        (Some("application/json5; charset=utf-8"), false),
        (Some("application/x-www-form-urlencoded"), true),
        (None, true),
    ] {
        for path in PATHS {
            let mut request = node.request(Method::PUT, path).body(r#"{"u": 5e-4}"#);
            if let Some(media) = media {
                request = request.header("content-type", media);
            }
            let response = request.send().await.unwrap();
            if is_accepted {
                assert_eq!(response.status(), 200, "{media:?}");
                assert_eq!(node.front().threshold(), Some(5e-4), "{media:?}");
                assert_eq!(node.put(path, r#"{"u": 3e-4}"#).await.status(), 200);
            } else {
                let refused = problem(response, 415).await;
                assert_eq!(refused["allowed"], json!(["application/json"]));
                let remedy = "-H 'content-type: application/json'";
                assert_contains(&refused["detail"], &[remedy]);
                let kept = Some(THRESHOLD.default);
                assert_eq!(node.front().threshold(), kept, "{media:?}");
            }
        }
    }
    let body = |length: usize| format!("{{\"u\": 5e-4{}}}", " ".repeat(length - 11));
    for path in PATHS {
        let refused = problem(node.put(path, body(16385)).await, 413).await;
        assert_contains(&refused["detail"], &["at most 16384 bytes"]);
        assert_eq!(node.put(path, body(16384)).await.status(), 200);
    }
}

#[tokio::test]
async fn a_change_for_one_camera_leaves_the_others_alone() {
    let node = Served::start().await;
    let response = node.put(PATHS[1], r#"{"u": 5e-4}"#).await;
    assert_eq!(response.status(), 200);
    let changed: Value = response.json().await.unwrap();
    let expected = json!({"u": 5e-4, "threshold_spec": {"name": "u"}, "survives_restart": false});
    assert_has(&changed, &expected);
    let all = json!({"u": null, "cameras": [{"u": 5e-4}, {"u": 3e-4}]});
    assert_has(&node.json(PATHS[0]).await, &all);
    assert_eq!(node.json(PATHS[1]).await, changed);
}

#[tokio::test]
async fn a_change_for_all_is_stored_and_reaches_every_camera() {
    let directory = tempfile::tempdir().unwrap();
    let node = Served::kept_in(directory.path()).await;
    let response = node.put(PATHS[0], r#" {"v": 1, "u": 7e-4} "#).await;
    let all: Value = response.json().await.unwrap();
    assert_has(&all, &json!({"u": 7e-4, "survives_restart": true}));
    assert!(directory.path().join("node.db").exists());
    assert!(node.board.cameras.iter().all(|camera| camera.threshold() == Some(7e-4)));
}

#[tokio::test]
async fn a_policy_without_a_threshold_says_so() {
    let node = Served::over(HttpConfig::default(), prepared("vanilla", None)).await;
    for path in PATHS {
        let refused = problem(node.put(path, r#"{"u": 5e-4}"#).await, 409).await;
        let detail = "policy `vanilla` has no threshold to change";
        assert_eq!(refused["detail"], detail);
    }
    let front = node.json(PATHS[1]).await;
    assert_eq!(front, json!({"camera": "front", "survives_restart": false}));
}

const TARGET: &str = "/api/v1/target";

#[tokio::test]
async fn a_target_holds_until_null_or_a_manual_threshold_and_an_invalid_one_changes_nothing() {
    let node = Served::start().await;
    let set = node.put(TARGET, r#"{"target": {"skip_rate": 0.5}}"#).await;
    assert_eq!(set.status(), 200);
    let set: Value = set.json().await.unwrap();
    let expected = json!({
        "target": {"skip_rate": 0.5}, "source": "local", "range": {"least": 1.5e-4, "most": 2e-3},
        "threshold": {"name": "u", "value": 3e-4},
    });
    assert_has(&set, &expected);
    let camera = node.json("/api/v1/cameras/front").await;
    assert_eq!(camera["set_by"], "local", "who set the target moves it");
    let bad = r#"
{"target": {"skip_rate": 1.0}}
{"target": {"skip_rate": -0.6}}
{"target": {"recall": 1.5}}
{"target": {"watts": 0}}
{"target": {"watts": "6"}}
{"target": {"speed": 3}}
{"target": {"skip_rate": 0.6, "watts": 6}}
{"target": 0.6}
{"target": {"skip_rate": 0.6}, "v": 2}
{"target": {"skip_rate": 0.6}, "u": 1e-3}
{}
[]
"#;
    let bad = bad.trim().lines().map(|body| (body, 422));
    for (body, status) in bad.chain([("", 400), (r#"{"target": {"skip_rate": 0.6}"#, 400)]) {
        let refused = problem(node.put(TARGET, body).await, status).await;
        assert!(refused["detail"].is_string(), "{body}");
        assert_eq!(node.json(TARGET).await, set, "{body}");
    }
    let series = "albireo_target{target=\"skip_rate\"} 0.5";
    assert_contains(&node.metrics().await, &[series]);

    let path = "/api/v1/cameras/front/threshold";
    assert_eq!(node.put(path, r#"{"u": 7e-4}"#).await.status(), 200);
    let off = json!({"target": null, "off": "the threshold was set by hand"});
    assert_has(&node.json(TARGET).await, &off);
    assert!(!node.metrics().await.contains("albireo_target{"));

    node.put(TARGET, r#"{"target": {"watts": 6.0}}"#).await;
    assert_eq!(node.json(TARGET).await["target"], json!({"watts": 6.0}));
    let off = node.put(TARGET, r#"{"target": null}"#).await;
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
    let change = tokio::spawn(node.request(Method::PUT, TARGET).body(body).send());
    let served = tokio::time::timeout(PATIENCE / 3, async {
        while node.json(TARGET).await["target"] != json!({"skip_rate": 0.5}) {}
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
