use super::served::{Served, THRESHOLD, board, problem};
use crate::support::{assert_contains, assert_has};
use albireo_service::config::HttpConfig;
use reqwest::Method;
use serde_json::{Value, json};

const PATHS: [&str; 2] = ["/api/v1/threshold", "/api/v1/cameras/front/threshold"];

/// Valid JSON without a valid threshold.
const BAD: &str = r#"
{"u": -1}
{"u": 0}
{"u": 1e-300}
{"u": 1.0000001}
{"u": "3e-4"}
{"u": null}
{"u": [3e-4]}
{"u": 3e-4, "U": 3e-4}
{"u": 3e-4, "camera": "front"}
{"u": 3e-4, "u": 5e-4}
{"u": 3e-4, "v": 2}
{}
[1, 3e-4]
null
"#;

/// Invalid JSON.
const BROKEN: [&[u8]; 7] = [
    br#"{"u": 1e999}"#,
    br#"{"u": NaN}"#,
    b"",
    b"u=3e-4",
    br#"{"u": 3e-4"#,
    br#"{"u": 3e-4} {"u": 4e-4}"#,
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
            assert_has(
                &refused["threshold_spec"],
                &json!({"minimum": 1e-9, "maximum": 1.0}),
            );
        }
    }
    for camera in &node.board.cameras {
        assert_eq!(camera.threshold(), Some(THRESHOLD.default));
    }
}

#[tokio::test]
async fn only_json_and_what_plain_curl_sends_is_accepted() {
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
                assert_contains(refused["detail"].as_str().unwrap(), &[remedy]);
                assert_eq!(
                    node.front().threshold(),
                    Some(THRESHOLD.default),
                    "{media:?}"
                );
            }
        }
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
    let expected = json!({"u": 5e-4, "threshold_spec": {"name": "u"}, "survives_restart": false});
    assert_has(&changed, &expected);
    let all = json!({"u": null, "cameras": [{"u": 5e-4}, {"u": 3e-4}]});
    assert_has(&node.json(PATHS[0]).await, &all);
    assert_eq!(node.json(PATHS[1]).await, changed);
}

#[tokio::test]
async fn a_change_for_all_is_stored_and_reaches_every_camera_and_its_loop() {
    let directory = tempfile::tempdir().unwrap();
    let node = Served::kept_in(directory.path()).await;
    let cameras = node.board.cameras.iter();
    let loops: Vec<_> = cameras.map(|camera| camera.watch_threshold()).collect();
    let response = node.put(PATHS[0], r#" {"v": 1, "u": 7e-4} "#).await;
    let all: Value = response.json().await.unwrap();
    assert_has(&all, &json!({"u": 7e-4, "survives_restart": true}));
    assert!(directory.path().join("node.db").exists());
    let mut thresholds = loops.iter().map(|camera_loop| *camera_loop.borrow());
    assert!(thresholds.all(|threshold| threshold == Some(7e-4)));
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
