use super::served::{KNOB, Served, problem};
use albireo_service::config::HttpConfig;
use reqwest::{Method, StatusCode};
use serde_json::json;

const PATHS: [&str; 2] = ["/api/v1/threshold", "/api/v1/cameras/front/threshold"];

#[tokio::test]
async fn a_bad_threshold_is_refused_says_what_is_allowed_and_changes_nothing() {
    let node = Served::start().await;
    for path in PATHS {
        for (body, status) in [
            (r#"{"u": -1}"#, 422),
            (r#"{"u": 0}"#, 422),
            (r#"{"u": -0.0}"#, 422),
            (r#"{"u": 1e-300}"#, 422),
            (r#"{"u": 1.0000001}"#, 422),
            (r#"{"u": 1e300}"#, 422),
            (r#"{"u": 1e999}"#, 400),
            (r#"{"u": NaN}"#, 400),
            (r#"{"u": Infinity}"#, 400),
            (r#"{"u": "NaN"}"#, 422),
            (r#"{"u": "3e-4"}"#, 422),
            (r#"{"u": null}"#, 422),
            (r#"{"u": true}"#, 422),
            (r#"{"u": [3e-4]}"#, 422),
            (r#"{"u": 3e-4, "U": 3e-4}"#, 422),
            (r#"{"u": 3e-4, "camera": "front"}"#, 422),
            (r#"{"u": 3e-4, "u": 5e-4}"#, 422),
            (r#"{"u": 3e-4, "v": 2}"#, 422),
            (r#"{"v": 1}"#, 422),
            ("{}", 422),
            ("[1, 3e-4]", 422),
            ("3e-4", 422),
            ("null", 422),
            ("\"3e-4\"", 422),
            ("", 400),
            ("u=3e-4", 400),
            (r#"{"u": 3e-4"#, 400),
            (r#"{"u": 3e-4} {"u": 4e-4}"#, 400),
            ("\u{0}", 400),
        ] {
            let refused = problem(node.put(path, body).await, status).await;
            let detail = refused["detail"].as_str().unwrap();
            assert!(detail.contains("number from 1e-9 to 1"), "{body}: {detail}");
            assert_eq!(refused["knob"]["minimum"], 1e-9, "{body}");
            assert_eq!(refused["knob"]["maximum"], 1.0, "{body}");
        }
        let refused = problem(node.put(path, vec![0xff, 0xfe]).await, 400).await;
        assert!(refused["detail"].as_str().unwrap().contains("number from"));
    }
    for camera in node.board.cameras() {
        assert_eq!(camera.threshold(), Some(KNOB.default));
    }
}

#[tokio::test]
async fn a_threshold_of_another_content_type_is_refused() {
    let node = Served::start().await;
    for path in PATHS {
        for content_type in [
            "text/plain",
            "application/jsonp",
            "application/json5; charset=utf-8",
        ] {
            let request = node.request(Method::PUT, path).body(r#"{"u": 5e-4}"#);
            let request = request.header("content-type", content_type);
            let refused = problem(request.send().await.unwrap(), 415).await;
            assert_eq!(refused["allowed"], json!(["application/json"]));
            let detail = refused["detail"].as_str().unwrap();
            assert!(
                detail.contains("-H 'content-type: application/json'"),
                "{detail}"
            );
        }
    }
    assert_eq!(node.board.cameras()[0].threshold(), Some(KNOB.default));
}

#[tokio::test]
async fn a_threshold_sent_by_curl_without_further_ado_is_taken() {
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
        let front = node.board.camera("front").unwrap();
        assert_eq!(front.threshold(), Some(5e-4));
        assert_eq!(node.put(path, r#"{"u": 3e-4}"#).await.status(), 200);
    }
}

#[tokio::test]
async fn a_huge_body_is_refused_without_reading_it_all() {
    let node = Served::start().await;
    for path in PATHS {
        let body = format!("{{\"u\": 5e-4{}}}", " ".repeat(16 << 10));
        let refused = problem(node.put(path, body).await, 413).await;
        assert!(
            refused["detail"]
                .as_str()
                .unwrap()
                .contains("at most 16384 bytes")
        );
        let just_fits = format!("{{\"u\": 5e-4{}}}", " ".repeat((16 << 10) - 11));
        assert_eq!(just_fits.len(), 16 << 10);
        assert_eq!(node.put(path, just_fits).await.status(), StatusCode::OK);
    }
}

#[tokio::test]
async fn a_change_for_one_camera_leaves_the_others() {
    let node = Served::start().await;
    let response = node
        .put("/api/v1/cameras/front/threshold", r#"{"u": 5e-4}"#)
        .await;
    assert_eq!(response.status(), StatusCode::OK);
    let changed: serde_json::Value = response.json().await.unwrap();
    assert_eq!(changed["u"], 5e-4);
    assert_eq!(changed["knob"]["name"], "u");
    assert_eq!(changed["survives_restart"], false);
    let all = node.json("/api/v1/threshold").await;
    assert_eq!(all["u"], serde_json::Value::Null);
    assert_eq!(all["cameras"][0]["u"], 5e-4);
    assert_eq!(all["cameras"][1]["u"], 3e-4);
    let front = node.json("/api/v1/cameras/front/threshold").await;
    assert_eq!(front, changed);
}

#[tokio::test]
async fn a_change_for_all_reaches_every_camera_and_its_loop() {
    let node = Served::start().await;
    let loops: Vec<_> = node
        .board
        .cameras()
        .iter()
        .map(|camera| camera.watch_threshold())
        .collect();
    let response = node
        .put("/api/v1/threshold", r#" {"v": 1, "u": 7e-4} "#)
        .await;
    let all: serde_json::Value = response.json().await.unwrap();
    assert_eq!(all["u"], 7e-4);
    for camera_loop in loops {
        assert_eq!(*camera_loop.borrow(), Some(7e-4));
    }
}

#[tokio::test]
async fn an_unknown_camera_is_refused_with_the_names_of_the_known_ones() {
    let node = Served::start().await;
    let path = "/api/v1/cameras/roof/threshold";
    for response in [node.get(path).await, node.put(path, r#"{"u": 5e-4}"#).await] {
        let missing = problem(response, 404).await;
        assert_eq!(missing["allowed"], json!(["front", "rear"]));
    }
}

#[tokio::test]
async fn a_policy_without_a_threshold_says_so() {
    let node = Served::with(HttpConfig::default(), None).await;
    for path in PATHS {
        let refused = problem(node.put(path, r#"{"u": 5e-4}"#).await, 409).await;
        let detail = refused["detail"].as_str().unwrap();
        assert_eq!(detail, "policy `albireo` has no threshold to change");
    }
    let front = node.json("/api/v1/cameras/front/threshold").await;
    assert_eq!(front, json!({"camera": "front", "survives_restart": false}));
}

#[tokio::test]
async fn a_stored_change_is_reported_as_durable() {
    let directory = tempfile::tempdir().unwrap();
    let node = Served::kept_in(directory.path()).await;
    let response = node.put("/api/v1/threshold", r#"{"u": 7e-4}"#).await;
    let all: serde_json::Value = response.json().await.unwrap();
    assert_eq!(all["survives_restart"], true);
    assert!(directory.path().join("node.db").exists());
}
