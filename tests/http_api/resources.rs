use super::served::{Served, answered, answered_all, clip, frame, problem, received};
use crate::support::{assert_contains, assert_has};
use albireo_core::policy::FrameState;
use albireo_service::config::HttpConfig;
use albireo_vision::detector::{ExecutionProvider, ModelStatus};
use albireo_vision::picture::{
    FrameLimits, Picture, PictureFormat, PixelLayout, decode, picture_of_file,
};
use albireo_wire::{CallCause, DropKind};
use reqwest::{Method, Response};
use rstest::rstest;
use serde_json::json;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

#[tokio::test]
async fn frames_and_calls_are_counted_alike_everywhere_and_degraded_frames_never_as_skipped() {
    let node = Served::start().await;
    let front = node.front();
    answered_all(front, &FrameState::ALL);
    let mut periodic = frame(5, FrameState::I);
    periodic.cause = Some(CallCause::PeriodicCap);
    answered(front, periodic);
    for seq in [6, 7] {
        let mut degraded = frame(seq, FrameState::P);
        degraded.degraded = true;
        answered(front, degraded);
    }
    front.input.count(DropKind::Lost, 3, &"numbers are missing");
    let rear = node.board.camera("rear").unwrap();
    answered_all(rear, &[FrameState::P; 4]);
    let calls = json!({"uncertain": 3, "periodic_cap": 1});
    let counts = json!({
        "frames": 8, "states": {"E": 1, "P": 3, "E+I": 1, "I": 2, "AI": 1}, "skip_rate": 0.25, "degraded_frames": 2,
        "calls": calls, "dropped": {"lost": 3},
    });
    let path = "/api/v1/cameras/front/frame-states";
    assert_has(&node.json(path).await, &counts);
    let counters = serde_json::to_value(node.board.counters(front, 0)).unwrap();
    assert_has(&counters, &counts);
    let rear = json!({"states": {"P": 4}, "skip_rate": 1.0, "tau_max": 1.5e-4});
    let all = json!({
        "frames": 12, "states": {"E": 1, "P": 7, "E+I": 1, "I": 2, "AI": 1}, "skip_rate": 0.5, "degraded_frames": 2,
        "calls": calls, "cameras": [counts, rear],
    });
    assert_has(&node.json("/api/v1/frame-states").await, &all);
    let series = [
        r#"albireo_frames_skipped_total{camera="front"} 2"#,
        r#"albireo_frames_degraded_total{camera="front"} 2"#,
        r#"albireo_detector_calls_total{camera="front",cause="periodic_cap"} 1"#,
    ];
    assert_contains(&node.metrics().await, &series);
}

#[tokio::test]
async fn readiness_names_the_provider_in_use_and_why_the_node_is_not_ready() {
    let node = Served::start().await;
    let starting = node.refused("/readyz", 503).await;
    let requested = json!(["cuda", "cpu"]);
    let expected = json!({"ready": false, "provider": null, "requested_providers": requested});
    assert_has(&starting, &expected);
    node.ready();
    let ready = node.json("/readyz").await;
    assert_has(&ready, &json!({"provider": "cpu", "reasons": []}));
    node.board.set_detector_status(ModelStatus::Degraded {
        reason: "the run took longer than 2000 ms".to_owned(),
        provider: ExecutionProvider::Cpu,
    });
    let degraded = node.refused("/readyz", 503).await;
    assert_contains(&degraded["detail"], &["2000 ms"]);
    node.ready();
    let power = node.board.readiness.part("power");
    power.degraded("the meter cannot be read");
    let reasons = json!([{"part": "power", "effect": "degraded"}]);
    let expected = json!({"ready": true, "state": "degraded", "reasons": reasons});
    assert_has(&node.json("/readyz").await, &expected);
    // The process is still healthy.
    assert_eq!(node.json("/healthz").await["status"], "ok");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_latest_picture_is_jpeg_whatever_the_camera_sends_and_decoded_once_for_all_requests() {
    let node = Served::start().await;
    let path = "/api/v1/cameras/front/frame.jpg";
    let none = node.refused(path, 404).await;
    assert_contains(&none["detail"], &["no picture"]);
    for (number, seq) in [(1, 7), (2, 8)] {
        let bytes = vec![number; 640 * 480 * 3];
        received(node.front(), seq, PictureFormat::Rgb8, bytes, [640, 480]);
        let asking = (0..24).map(|_| node.get(path));
        for response in futures_util::future::join_all(asking).await {
            assert_eq!(response.headers()["albireo-frame"], seq.to_string());
            assert!(response.bytes().await.unwrap().starts_with(b"\xff\xd8\xff"));
        }
        let decoded = format!("albireo_shown_pictures_decoded_total {number}\n");
        assert_contains(&node.metrics().await, &[&decoded]);
    }
    let show = |seq, format, bytes| received(node.front(), seq, format, bytes, [4, 2]);
    show(9, PictureFormat::Jpeg, b"\xff\xd8 as it came".to_vec());
    let response = node.get(path).await;
    assert_eq!(response.headers()["content-type"], "image/jpeg");
    assert_eq!(response.headers()["albireo-frame"], "9");
    assert_eq!(response.bytes().await.unwrap(), &b"\xff\xd8 as it came"[..]);
    show(10, PictureFormat::Png, b"broken".to_vec());
    node.refused(path, 500).await;
}

/// The next part of a stream of pictures: the sequence number of its frame, and the file.
async fn next_part(stream: &mut Response, read: &mut Vec<u8>) -> Option<(u64, Vec<u8>)> {
    loop {
        let ends = read.windows(4).position(|bytes| bytes == b"\r\n\r\n");
        if let Some(end) = ends {
            let head = String::from_utf8(read[..end].to_vec()).unwrap();
            let field = |name: &str| {
                head.lines()
                    .find_map(|line| line.strip_prefix(name))
                    .unwrap()
                    .parse::<u64>()
                    .unwrap()
            };
            let length = field("Content-Length: ") as usize;
            let behind = b"\r\n--frame\r\n";
            if read.len() >= end + 4 + length + behind.len() {
                let file = read[end + 4..end + 4 + length].to_vec();
                assert_eq!(read[end + 4 + length..][..behind.len()], behind[..]);
                read.drain(..end + 4 + length + behind.len());
                return Some((field("albireo-frame: "), file));
            }
        }
        read.extend_from_slice(&stream.chunk().await.ok()??);
    }
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stream_of_pictures_has_the_boxes_of_its_frames_and_ends_at_the_shutdown() {
    let node = Served::start().await;
    let path = "/api/v1/cameras/front/stream.mjpg";
    let none = node.refused("/api/v1/cameras/front/frame.jpg?boxes=true", 404).await;
    assert_contains(&none["detail"], &["no picture"]);
    answered(node.front(), frame(7, FrameState::I));
    let mut stream = node.get(&format!("{path}?rate=30")).await;
    let kind = &stream.headers()["content-type"];
    assert_eq!(kind, "multipart/x-mixed-replace; boundary=frame");
    let mut read = Vec::new();
    // The picture that is there already, then each new one.
    for seq in [7, 8, 9] {
        if seq > 7 {
            answered(node.front(), frame(seq, FrameState::P));
        }
        let (shown, file) = next_part(&mut stream, &mut read).await.unwrap();
        assert_eq!(shown, seq);
        if seq == 7 {
            assert_eq!(read, b"", "the boundary follows at once");
        }
        let mut picture = Picture::default();
        let encoded = picture_of_file(file.into(), &FrameLimits::default()).unwrap();
        let limits = FrameLimits::default();
        decode(&encoded, &limits, PixelLayout::Rgb8, None, &mut picture).unwrap();
        let blue = |x: usize, y: usize| picture.pixels[3 * (320 * y + x) + 2];
        // The box of `frame` is from 10, 20 to 110, 90.
        assert!(blue(60, 20) > 150 && blue(10, 60) > 150, "no box");
        assert!(blue(60, 55) < 50 && blue(200, 200) < 50, "more than a box");
    }
    let drawn = node.get("/api/v1/cameras/front/frame.jpg?boxes=true").await;
    assert_eq!(drawn.headers()["albireo-frame"], "9");
    node.refused(&format!("{path}?rate=31"), 400).await;
    node.refused("/api/v1/cameras/roof/stream.mjpg", 404).await;
    node.shutdown.cancel();
    assert_eq!(next_part(&mut stream, &mut read).await, None);
}

#[rstest]
#[tokio::test]
async fn a_node_has_at_most_sixteen_streams_of_pictures() {
    let node = Served::start().await;
    let path = "/api/v1/cameras/front/stream.mjpg";
    let mut open = Vec::new();
    for _ in 0..16 {
        open.push(node.get(path).await);
    }
    let refused = node.refused(path, 503).await;
    assert_contains(&refused["detail"], &["16", "boxes=true"]);
    open.pop();
    while node.get(path).await.status() != 200 {
        tokio::task::yield_now().await;
    }
}

#[tokio::test]
async fn clips_come_newest_first_by_camera_in_pages_and_from_a_known_one_on() {
    let node = Served::start().await;
    for number in 1..=300 {
        node.board.record_clip(clip("front", number));
    }
    node.board.record_clip(clip("rear", 301));
    let newest = node.json("/api/v1/clips?limit=1").await;
    assert_eq!(newest["clips"][0]["camera"], "rear");
    let id = |number: u64| clip("front", number).id;
    let of_front = "camera=front&limit=256".to_owned();
    // 256 clips are kept, one of them of the other camera.
    for (query, numbers, next) in [
        ("limit=2".to_owned(), vec![301_u64, 300], Some(300)),
        (String::new(), (252..=301).rev().collect(), Some(252)),
        (format!("limit=3&before={}", id(49)), vec![48, 47, 46], None),
        (format!("after={}", id(299)), vec![301, 300], None),
        (format!("after={}", id(301)), vec![], None),
        (of_front, (46..=300).rev().collect(), None),
    ] {
        let answer = node.json(&format!("/api/v1/clips?{query}")).await;
        let found: Vec<_> = answer["clips"]
            .as_array()
            .unwrap()
            .iter()
            .map(|clip| clip["count"].as_u64().unwrap())
            .collect();
        assert_eq!(found, numbers, "{query}");
        assert_eq!(answer["next"], json!(next.map(id)), "{query}");
    }
    for query in "limit=0 limit=257 limit=-1 limit=many camera=front&colour=red".split(' ') {
        node.refused(&format!("/api/v1/clips?{query}"), 400).await;
    }
    node.refused("/api/v1/clips?camera=roof", 404).await;
}

#[tokio::test]
async fn framework_errors_are_problem_documents_too_with_the_allowed_methods() {
    let node = Served::start().await;
    let unknown = "/nothing /api/v2 /api/v2/threshold /api/v1/cameras/front/nothing";
    for path in unknown.split(' ') {
        node.refused(path, 404).await;
    }
    // A path that is not UTF-8.
    node.refused("/api/v1/cameras/%ff/threshold", 400).await;
    let of_camera = "/api/v1/cameras/front/threshold";
    for (method, path, allowed) in [
        (Method::POST, "/api/v1/threshold", &["GET", "PUT"][..]),
        (Method::DELETE, of_camera, &["GET", "PUT"]),
        (Method::PUT, "/healthz", &["GET"]),
        (Method::OPTIONS, "/api/v1/clips", &["GET"]),
        (Method::POST, "/", &["GET"]),
    ] {
        let response = node
            .request(method, path)
            .header("content-type", "application/json")
            .send()
            .await
            .unwrap();
        assert_contains(response.headers()["allow"].to_str().unwrap(), allowed);
        assert_contains(&problem(response, 405).await["allowed"], allowed);
    }
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
    let page = Served::start().await.get("/").await.text().await.unwrap();
    assert!(page.contains("<html lang=\"en\">"));
    for outside in ["http://", "https://", "src=\"//", "href=\"//"] {
        assert!(!page.contains(outside), "{outside}");
    }
}

#[tokio::test]
async fn a_camera_whose_last_frames_were_all_unusable_says_so_and_why_until_one_is_answered() {
    let node = Served::start().await;
    let rear = node.board.camera("rear").unwrap();
    let state = async || node.json("/api/v1/cameras/rear").await;
    for _ in 0..5 {
        assert_has(&state().await, &json!({"unusable": false, "fault": null}));
        rear.input.count(DropKind::Undecodable, 1, &"undecodable picture: no pixels");
    }
    let said = state().await;
    assert_has(&said, &json!({"unusable": true}));
    assert_contains(&said["fault"], &["its last 5 frames", "no pixels"]);
    answered_all(rear, &[FrameState::I]);
    assert_has(&state().await, &json!({"unusable": false, "fault": null}));
}

#[tokio::test]
async fn cameras_show_in_configuration_order_policy_threshold_detections_and_advice() {
    let node = Served::start().await;
    let rear = node.board.camera("rear").unwrap();
    for seq in 0..300 {
        assert_eq!(rear.advice(), None);
        let mut message = frame(seq, FrameState::I);
        message.tau_max = Some(3.77e-4);
        answered(rear, message);
    }
    let front = json!({"camera": "front", "width": null, "advice": null});
    let advice = json!({"try": 4e-4, "threshold": "u"});
    let rear = json!({"key": "albireo/car-7/rear/frame", "width": 320, "advice": advice});
    let cameras = json!({"cameras": [front, rear]});
    assert_has(&node.json("/api/v1/cameras").await, &cameras);
    let missing = node.refused("/api/v1/cameras/front/detections", 404).await;
    assert_contains(&missing["detail"], &["albireo/car-7/front/frame"]);
    answered_all(node.front(), &[FrameState::P, FrameState::I]);
    let answer = node.json("/api/v1/cameras/front").await;
    let expected = json!({
        "policy": "albireo", "threshold": {"value": 3e-4}, "frames": 2, "skip_rate": 0.5, "set_by": "configuration", "policy_set_by": "configuration",
    });
    assert_has(&answer, &expected);
    // The published code measures noise in pixels, here of 320x240 pictures.
    let published = answer["u_as_published"].as_f64().unwrap();
    assert!(published > 8e-4, "{published}");
    let detections = node.json("/api/v1/cameras/front/detections").await;
    assert_has(&detections, &json!({"seq": 1, "state": "I"}));
}

#[tokio::test]
async fn a_json_answer_ends_its_line_also_when_it_refuses() {
    let node = Served::start().await;
    for path in ["/api/v1/node", "/openapi.json", "/healthz", "/nothing"] {
        let answer = node.get(path).await;
        let length = answer.content_length();
        let text = answer.text().await.unwrap();
        assert!(
            text.ends_with("}\n") && !text.ends_with("\n\n"),
            "{path}: {text}"
        );
        assert_eq!(length, Some(text.len() as u64), "{path}");
    }
    let refused = node.put("/api/v1/threshold", "{}").await.text().await.unwrap();
    assert!(refused.ends_with("}\n"), "{refused}");
    // Only JSON: a page, or metrics, are as they are.
    let metrics = node.get("/metrics").await.text().await.unwrap();
    assert!(metrics.ends_with('\n') && !metrics.ends_with("\n\n"));
}
