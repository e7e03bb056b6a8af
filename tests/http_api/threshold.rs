use super::served::{KNOB, Served, board, problem};
use crate::support::{assert_contains, assert_has};
use albireo_service::config::HttpConfig;
use reqwest::Method;
use rstest::rstest;
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
            let detail = refused["detail"].as_str().unwrap();
            assert_contains(detail, &["number from 1e-9 to 1"]);
            assert_has(&refused["knob"], &json!({"minimum": 1e-9, "maximum": 1.0}));
        }
    }
    for camera in &node.board.cameras {
        assert_eq!(camera.threshold(), Some(KNOB.default));
    }
}

#[rstest]
#[tokio::test]
async fn a_threshold_of_another_content_type_is_rejected(
    #[values("text/plain", "application/jsonp", "application/json5; charset=utf-8")] media: &str,
) {
    let node = Served::start().await;
    for path in PATHS {
        let request = node.request(Method::PUT, path).body(r#"{"u": 5e-4}"#);
        let request = request.header("content-type", media);
        let refused = problem(request.send().await.unwrap(), 415).await;
        assert_eq!(refused["allowed"], json!(["application/json"]));
        let remedy = "-H 'content-type: application/json'";
        assert_contains(refused["detail"].as_str().unwrap(), &[remedy]);
    }
    assert_eq!(node.front().threshold(), Some(KNOB.default));
}

#[tokio::test]
async fn a_threshold_sent_by_plain_curl_is_accepted() {
    let node = Served::start().await;
    for (path, content_type) in [
        (PATHS[0], Some("application/x-www-form-urlencoded")),
        (PATHS[1], None),
    ] {
        let mut request = node.request(Method::PUT, path).body(r#"{"u": 5e-4}"#);
        if let Some(content_type) = content_type {
            request = request.header("content-type", content_type);
        }
        assert_eq!(request.send().await.unwrap().status(), 200);
        assert_eq!(node.front().threshold(), Some(5e-4));
        assert_eq!(node.put(path, r#"{"u": 3e-4}"#).await.status(), 200);
    }
}

#[tokio::test]
async fn a_huge_body_is_rejected_without_reading_it_all() {
    let node = Served::start().await;
    let body = |length: usize| format!("{{\"u\": 5e-4{}}}", " ".repeat(length - 11));
    for path in PATHS {
        let refused = problem(node.put(path, body(16385)).await, 413).await;
        let detail = refused["detail"].as_str().unwrap();
        assert_contains(detail, &["at most 16384 bytes"]);
        assert_eq!(node.put(path, body(16384)).await.status(), 200);
    }
}

#[tokio::test]
async fn a_change_for_one_camera_leaves_the_others_alone() {
    let node = Served::start().await;
    let response = node.put(PATHS[1], r#"{"u": 5e-4}"#).await;
    assert_eq!(response.status(), 200);
    let changed: Value = response.json().await.unwrap();
    let expected = json!({"u": 5e-4, "knob": {"name": "u"}, "survives_restart": false});
    assert_has(&changed, &expected);
    let all = json!({"u": null, "cameras": [{"u": 5e-4}, {"u": 3e-4}]});
    assert_has(&node.json(PATHS[0]).await, &all);
    assert_eq!(node.json(PATHS[1]).await, changed);
}

#[tokio::test]
async fn a_change_for_all_reaches_every_camera_and_its_loop() {
    let node = Served::start().await;
    let cameras = node.board.cameras.iter();
    let loops: Vec<_> = cameras.map(|camera| camera.watch_threshold()).collect();
    let response = node.put(PATHS[0], r#" {"v": 1, "u": 7e-4} "#).await;
    let all: Value = response.json().await.unwrap();
    assert_eq!(all["u"], 7e-4);
    let mut thresholds = loops.iter().map(|camera_loop| *camera_loop.borrow());
    assert!(thresholds.all(|threshold| threshold == Some(7e-4)));
}

#[tokio::test]
async fn an_unknown_camera_is_rejected_with_the_known_names() {
    let node = Served::start().await;
    let path = "/api/v1/cameras/roof/threshold";
    for response in [node.get(path).await, node.put(path, r#"{"u": 5e-4}"#).await] {
        let missing = problem(response, 404).await;
        assert_eq!(missing["allowed"], json!(["front", "rear"]));
    }
}

#[tokio::test]
async fn a_policy_without_a_threshold_says_so() {
    let node = Served::over(HttpConfig::default(), board("vanilla", None)).await;
    for path in PATHS {
        let refused = problem(node.put(path, r#"{"u": 5e-4}"#).await, 409).await;
        let detail = "policy `vanilla` has no threshold to change";
        assert_eq!(refused["detail"], detail);
    }
    let front = node.json(PATHS[1]).await;
    assert_eq!(front, json!({"camera": "front", "survives_restart": false}));
}

#[tokio::test]
async fn a_stored_change_is_reported_as_durable() {
    let directory = tempfile::tempdir().unwrap();
    let node = Served::kept_in(directory.path()).await;
    let response = node.put(PATHS[0], r#"{"u": 7e-4}"#).await;
    let all: Value = response.json().await.unwrap();
    assert_eq!(all["survives_restart"], true);
    assert!(directory.path().join("node.db").exists());
}
