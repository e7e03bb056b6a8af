use super::served::{Frames, Served, clip, frame, problem};
use crate::support::{assert_contains, assert_has};
use albireo_core::policy::FrameState;
use albireo_service::config::HttpConfig;
use albireo_vision::detector::{DetectorStatus, ExecutionProvider};
use albireo_vision::picture::PictureFormat;
use albireo_wire::DroppedFrames;
use reqwest::{Method, StatusCode};
use rstest::rstest;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};

#[tokio::test]
async fn frame_states_add_up_per_camera_and_in_total() {
    let node = Served::start().await;
    node.front().answered_all(&FrameState::ALL);
    node.front().record_dropped(&DroppedFrames {
        lost: 3,
        ..DroppedFrames::default()
    });
    let rear = node.board.camera("rear").unwrap();
    rear.answered(frame(0, FrameState::P));
    let all = node.json("/api/v1/frame-states").await;
    let states = json!({"E": 1, "P": 2, "E+I": 1, "I": 1, "AI": 1});
    let expected = json!({"frames": 6, "states": states, "skip_rate": 0.5});
    assert_has(&all, &expected);
    assert_eq!(all["cameras"][0]["dropped"]["lost"], 3);
    let one = node.json("/api/v1/cameras/rear/frame-states").await;
    let expected = json!({"states": {"P": 1}, "skip_rate": 1.0, "tau_max": 1.5e-4});
    assert_has(&one, &expected);
    node.refused("/api/v1/cameras/roof/frame-states", 404).await;
}

#[tokio::test]
async fn a_degraded_frame_is_counted_separately_and_never_as_skipped() {
    let node = Served::start().await;
    let front = node.front();
    for seq in 0..4 {
        let state = [FrameState::I, FrameState::P][usize::from(seq > 0)];
        let mut message = frame(seq, state);
        message.degraded = seq > 1;
        front.answered(message);
    }
    let expected = json!({"skip_rate": 0.25, "degraded_frames": 2});
    for path in ["/api/v1/frame-states", "/api/v1/cameras/front/frame-states"] {
        assert_has(&node.json(path).await, &expected);
    }
    assert_eq!(node.board.counters(front, 0).skip_rate, 0.25);
    let metrics = node.metrics().await;
    let skipped = r#"albireo_frames_skipped_total{camera="front"} 1"#;
    let degraded = r#"albireo_frames_degraded_total{camera="front"} 2"#;
    assert_contains(&metrics, &[skipped, degraded]);
}

#[tokio::test]
async fn cameras_are_listed_in_configuration_order() {
    let node = Served::start().await;
    let rear = node.board.camera("rear").unwrap();
    rear.answered(frame(0, FrameState::I));
    let front = json!({"camera": "front", "width": null});
    let rear = json!({"key": "albireo/car-7/rear/frame", "width": 320});
    let cameras = json!({"cameras": [front, rear]});
    assert_has(&node.json("/api/v1/cameras").await, &cameras);
}

#[tokio::test]
async fn readiness_names_the_provider_in_use_and_why_the_node_is_not_ready() {
    let node = Served::start().await;
    let zenoh = node.board.readiness.part("zenoh");
    zenoh.not_ready("the session is not open yet");
    let starting = node.refused("/readyz", 503).await;
    let requested = json!(["cuda", "cpu"]);
    let expected = json!({"ready": false, "provider": null, "requested_providers": requested});
    assert_has(&starting, &expected);
    assert_eq!(starting["reasons"].as_array().unwrap().len(), 2);
    zenoh.works();
    node.ready();
    let ready = node.json("/readyz").await;
    assert_has(&ready, &json!({"provider": "cpu", "reasons": []}));
    node.board.set_detector_status(DetectorStatus::Degraded {
        reason: "the run took longer than 2000 ms".to_owned(),
        provider: ExecutionProvider::Cpu,
    });
    let degraded = node.refused("/readyz", 503).await;
    assert_contains(degraded["detail"].as_str().unwrap(), &["2000 ms"]);
    node.ready();
    let power = node.board.readiness.part("power");
    power.degraded("the meter cannot be read");
    let reasons = json!([{"part": "power", "effect": "degraded"}]);
    let expected = json!({"ready": true, "state": "degraded", "reasons": reasons});
    assert_has(&node.json("/readyz").await, &expected);
    // The process is still healthy.
    assert_eq!(node.json("/healthz").await["status"], "ok");
}

#[tokio::test]
async fn the_latest_picture_is_jpeg_whatever_the_camera_sends() {
    let node = Served::start().await;
    let path = "/api/v1/cameras/front/frame.jpg";
    let none = node.refused(path, 404).await;
    assert_contains(none["detail"].as_str().unwrap(), &["no picture"]);
    let show = |seq, format, bytes| node.front().sent(seq, format, bytes, [4, 2]);
    show(7, PictureFormat::Jpeg, b"\xff\xd8 as it came".to_vec());
    let response = node.get(path).await;
    assert_eq!(response.headers()["content-type"], "image/jpeg");
    assert_eq!(response.headers()["albireo-frame"], "7");
    assert_eq!(response.bytes().await.unwrap(), &b"\xff\xd8 as it came"[..]);
    show(8, PictureFormat::Rgb8, vec![128; 24]);
    let response = node.get(path).await;
    assert_eq!(response.status(), StatusCode::OK);
    assert!(response.bytes().await.unwrap().starts_with(b"\xff\xd8\xff"));
    show(9, PictureFormat::Png, b"broken".to_vec());
    node.refused(path, 500).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_picture_is_decoded_once_for_all_requests() {
    let node = Served::start().await;
    for (number, seq) in [(1, 7), (2, 8)] {
        let bytes = vec![number; 640 * 480 * 3];
        node.front()
            .sent(seq, PictureFormat::Rgb8, bytes, [640, 480]);
        let asking = (0..24).map(|_| node.get("/api/v1/cameras/front/frame.jpg"));
        for response in futures_util::future::join_all(asking).await {
            assert_eq!(response.headers()["albireo-frame"], seq.to_string());
            assert!(response.bytes().await.unwrap().starts_with(b"\xff\xd8\xff"));
        }
        let decoded = format!("albireo_shown_pictures_decoded_total {number}\n");
        assert_contains(&node.metrics().await, &[&decoded]);
    }
}

/// The camera and number of each clip at a path.
async fn clips(node: &Served, path: &str) -> Vec<(String, u64)> {
    let answer = node.json(path).await;
    let clips = answer["clips"].as_array().unwrap().iter();
    let name = |clip: &Value| clip["camera"].as_str().unwrap().to_owned();
    clips
        .map(|clip| (name(clip), clip["count"].as_u64().unwrap()))
        .collect()
}

#[tokio::test]
async fn clips_come_newest_first_filtered_by_camera_and_limited() {
    let node = Served::start().await;
    for report in 0..300 {
        node.board.record_clip(clip("front", report));
    }
    node.board.record_clip(clip("rear", 0));
    let two = clips(&node, "/api/v1/clips?limit=2").await;
    assert_eq!(two, [("rear".to_owned(), 0), ("front".to_owned(), 299)]);
    // 256 clips are kept, one of them of the other camera.
    let front = clips(&node, "/api/v1/clips?camera=front&limit=256").await;
    assert_eq!(front.len(), 255);
    assert_eq!(clips(&node, "/api/v1/clips").await.len(), 50);
    for query in "limit=0 limit=257 limit=-1 limit=many camera=front&colour=red".split(' ') {
        node.refused(&format!("/api/v1/clips?{query}"), 400).await;
    }
    node.refused("/api/v1/clips?camera=roof", 404).await;
}

#[tokio::test]
async fn clips_can_be_paged_and_polled_for_new_ones() {
    let node = Served::start().await;
    for report in 1..=5 {
        node.board.record_clip(clip("front", report));
    }
    let id = |report: u64| clip("front", report).id;
    for (query, numbers, next) in [
        ("limit=2".to_owned(), &[5, 4][..], Some(id(4))),
        (format!("limit=3&before={}", id(4)), &[3, 2, 1], None),
        (format!("after={}", id(3)), &[5, 4], None),
        (format!("after={}", id(5)), &[], None),
    ] {
        let path = format!("/api/v1/clips?{query}");
        let found = clips(&node, &path).await.into_iter();
        let found: Vec<_> = found.map(|(_, number)| number).collect();
        assert_eq!(found, numbers, "{query}");
        assert_eq!(node.json(&path).await["next"], json!(next), "{query}");
    }
}

#[tokio::test]
async fn framework_errors_are_problem_documents_too() {
    let node = Served::start().await;
    let unknown = "/nothing /api/v2 /api/v2/threshold /api/v1/cameras/front/nothing";
    for path in unknown.split(' ') {
        node.refused(path, 404).await;
    }
    // A path that is not UTF-8.
    node.refused("/api/v1/cameras/%ff/threshold", 400).await;
}

#[rstest]
#[case(Method::POST, "/api/v1/threshold", &["GET", "PUT"])]
#[case(Method::DELETE, "/api/v1/cameras/front/threshold", &["GET", "PUT"])]
#[case(Method::PUT, "/healthz", &["GET"])]
#[case(Method::OPTIONS, "/api/v1/clips", &["GET"])]
#[case(Method::POST, "/", &["GET"])]
#[tokio::test]
async fn a_wrong_method_is_rejected_with_the_allowed_ones(
    #[case] method: Method,
    #[case] path: &str,
    #[case] allowed: &[&str],
) {
    let node = Served::start().await;
    let request = node.request(method, path);
    let request = request.header("content-type", "application/json");
    let response = request.send().await.unwrap();
    assert_contains(response.headers()["allow"].to_str().unwrap(), allowed);
    let answer = problem(response, 405).await["allowed"].to_string();
    assert_contains(&answer, allowed);
}

#[tokio::test]
async fn an_unfinished_request_times_out_with_an_answer() {
    let config = HttpConfig {
        timeout_ms: 50,
        ..HttpConfig::default()
    };
    let node = Served::with(config).await;
    let mut connection = tokio::net::TcpStream::connect(node.address).await.unwrap();
    let head = "PUT /api/v1/threshold HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n\
                Content-Length: 12\r\nConnection: close\r\n\r\n{\"u\":";
    connection.write_all(head.as_bytes()).await.unwrap();
    let mut answer = String::new();
    connection.read_to_string(&mut answer).await.unwrap();
    let said = ["HTTP/1.1 408 ", "application/problem+json", "within 50ms"];
    assert_contains(&answer, &said);
}

#[tokio::test]
async fn the_page_loads_nothing_from_other_hosts() {
    let node = Served::start().await;
    let response = node.get("/").await;
    let policy = response.headers()["content-security-policy"].to_str();
    assert_contains(policy.unwrap(), &["default-src 'none'"]);
    let page = response.text().await.unwrap();
    assert!(page.contains("<html lang=\"en\">"));
    for outside in ["http://", "https://", "src=\"//", "href=\"//"] {
        assert!(!page.contains(outside), "{outside}");
    }
}

#[tokio::test]
async fn a_camera_shows_its_policy_threshold_and_latest_detections() {
    let node = Served::start().await;
    let missing = node.refused("/api/v1/cameras/front/detections", 404).await;
    let detail = missing["detail"].as_str().unwrap();
    assert_contains(detail, &["albireo/car-7/front/frame"]);
    node.front().answered_all(&[FrameState::P, FrameState::I]);
    let answer = node.json("/api/v1/cameras/front").await;
    let expected = json!({
        "policy": "albireo", "version": env!("CARGO_PKG_VERSION"), "threshold": {"value": 3e-4}, "frames": 2,
        "skip_rate": 0.5, "set_by": "configuration",
    });
    assert_has(&answer, &expected);
    // The published code measures noise in pixels, here of 320x240 pictures.
    let published = answer["u_as_published"].as_f64().unwrap();
    assert!(published > 8e-4, "{published}");
    let detections = node.json("/api/v1/cameras/front/detections").await;
    assert_has(&detections, &json!({"seq": 1, "state": "I"}));
    node.refused("/api/v1/cameras/roof", 404).await;
}

#[tokio::test]
async fn a_camera_that_skips_nothing_gets_advice() {
    let node = Served::start().await;
    let front = node.front();
    for seq in 0..300 {
        assert_eq!(front.snapshot().advice, None);
        let mut message = frame(seq, FrameState::I);
        message.tau_max = Some(3.77e-4);
        front.answered(message);
    }
    let expected = json!({"cameras": [{"advice": {"try": 4e-4, "knob": "u"}}, {"advice": null}]});
    assert_has(&node.json("/api/v1/cameras").await, &expected);
}

#[tokio::test]
async fn the_index_lists_every_documented_route() {
    let node = Served::start().await;
    let index = node.json("/api/v1").await;
    assert_eq!(index["cameras"], json!(["front", "rear"]));
    let routes = index["routes"].as_array().unwrap();
    assert!(routes.len() >= 18, "{routes:?}");
    let mut summaries = routes.iter().map(|route| &route["summary"]);
    assert!(summaries.all(|summary| summary != ""), "{routes:?}");
    let described = node.json("/openapi.json").await;
    let paths = described["paths"].as_object().unwrap().keys();
    for path in paths {
        assert!(routes.iter().any(|route| route["path"] == **path), "{path}");
    }
}
