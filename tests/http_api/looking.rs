use super::served::{Frames, Served, clip, frame, problem};
use albireo_core::geometry::PictureSize;
use albireo_core::policy::FrameState;
use albireo_node::state::board::{LatestFrame, PowerSnapshot};
use albireo_service::config::HttpConfig;
use albireo_vision::detector::{DetectorStatus, ExecutionProvider};
use albireo_vision::picture::{EncodedPicture, PictureFormat};
use albireo_wire::{DroppedFrames, EnergyQuality};
use reqwest::{Method, StatusCode};
use serde_json::json;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

#[tokio::test]
async fn the_frame_states_add_up_for_each_camera_and_for_all() {
    let node = Served::start().await;
    let front = node.board.camera("front").unwrap();
    for (seq, state) in FrameState::ALL.into_iter().enumerate() {
        front.answered(frame(seq as u64, state));
    }
    front.record_dropped(&DroppedFrames {
        lost: 3,
        ..DroppedFrames::default()
    });
    let rear = node.board.camera("rear").unwrap();
    rear.answered(frame(0, FrameState::P));
    let all = node.json("/api/v1/frame-states").await;
    assert_eq!(all["frames"], 6);
    assert_eq!(
        all["states"],
        json!({"E": 1, "P": 2, "E+I": 1, "I": 1, "AI": 1})
    );
    assert_eq!(all["skip_rate"], 0.5);
    assert_eq!(all["cameras"][0]["dropped"]["lost"], 3);
    let one = node.json("/api/v1/cameras/rear/frame-states").await;
    assert_eq!(one["states"]["P"], 1);
    assert_eq!(one["skip_rate"], 1.0);
    assert_eq!(one["tau_max"], 1.5e-4);
    problem(node.get("/api/v1/cameras/roof/frame-states").await, 404).await;
}

#[tokio::test]
async fn a_degraded_frame_is_told_apart_and_never_counted_as_skipped() {
    let node = Served::start().await;
    let front = node.board.camera("front").unwrap();
    for (seq, state) in [FrameState::I, FrameState::P, FrameState::P, FrameState::P]
        .into_iter()
        .enumerate()
    {
        let mut message = (*frame(seq as u64, state)).clone();
        message.degraded = seq > 1;
        front.answered(message.into());
    }
    let all = node.json("/api/v1/frame-states").await;
    assert_eq!(
        (&all["skip_rate"], &all["degraded_frames"]),
        (&json!(0.25), &json!(2))
    );
    let one = node.json("/api/v1/cameras/front/frame-states").await;
    assert_eq!(
        (&one["skip_rate"], &one["degraded_frames"]),
        (&json!(0.25), &json!(2))
    );
    assert_eq!(node.board.counters(front, 0).skip_rate, 0.25);
    let metrics = node.get("/metrics").await.text().await.unwrap();
    for line in [
        r#"albireo_frames_skipped_total{camera="front"} 1"#,
        r#"albireo_frames_degraded_total{camera="front"} 2"#,
    ] {
        assert!(metrics.contains(line), "no {line} in {metrics}");
    }
}

#[tokio::test]
async fn the_quality_of_power_is_an_info_and_no_label_of_a_counter() {
    let node = Served::start().await;
    let joules = std::collections::BTreeMap::from([("total".to_owned(), 5.0)]);
    for quality in [EnergyQuality::Measured, EnergyQuality::Unavailable] {
        node.board.set_power(PowerSnapshot {
            source: "ina".to_owned(),
            quality,
            joules: joules.clone(),
            ..node.board.power()
        });
        let metrics = node.get("/metrics").await.text().await.unwrap();
        let counter = r#"albireo_energy_joules_total{domain="total",source="ina"} 5"#;
        assert!(metrics.contains(counter), "{metrics}");
        let quality = serde_json::to_value(quality).unwrap();
        let info = format!(r#"albireo_power_info{{source="ina",quality={quality}}} 1"#);
        assert!(metrics.contains(&info), "no {info} in {metrics}");
    }
}

#[tokio::test]
async fn cameras_are_listed_in_the_order_of_the_configuration() {
    let node = Served::start().await;
    node.board
        .camera("rear")
        .unwrap()
        .answered(frame(0, FrameState::I));
    let list = node.json("/api/v1/cameras").await;
    assert_eq!(list["cameras"][0]["camera"], "front");
    assert_eq!(list["cameras"][0]["width"], json!(null));
    assert_eq!(list["cameras"][1]["key"], "albireo/car-7/rear/frame");
    assert_eq!(list["cameras"][1]["width"], 320);
}

#[tokio::test]
async fn readiness_names_the_provider_that_really_runs_and_why_it_is_not_ready() {
    let node = Served::start().await;
    let zenoh = node.board.readiness().part("zenoh");
    zenoh.not_ready("the session is not open yet");
    let starting = problem(node.get("/readyz").await, 503).await;
    assert_eq!(starting["ready"], false);
    assert_eq!(starting["provider"], json!(null));
    assert_eq!(starting["requested_providers"], json!(["cuda", "cpu"]));
    assert_eq!(starting["reasons"].as_array().unwrap().len(), 2);
    zenoh.works();
    node.ready();
    let ready = node.json("/readyz").await;
    assert_eq!(ready["provider"], "cpu");
    assert_eq!(ready["reasons"], json!([]));
    node.detector.send_replace(DetectorStatus::Degraded {
        reason: "the run took longer than 2000 ms".to_owned(),
        provider: ExecutionProvider::Cpu,
    });
    let degraded = problem(node.get("/readyz").await, 503).await;
    assert!(degraded["detail"].as_str().unwrap().contains("2000 ms"));
    node.ready();
    let power = node.board.readiness().part("power");
    power.degraded("the meter cannot be read");
    let degraded = node.json("/readyz").await;
    assert_eq!(
        (&degraded["ready"], &degraded["state"]),
        (&json!(true), &json!("degraded"))
    );
    assert_eq!(degraded["reasons"][0]["part"], "power");
    assert_eq!(degraded["reasons"][0]["effect"], "degraded");
    // The process still lives.
    assert_eq!(node.json("/healthz").await["status"], "ok");
}

#[tokio::test]
async fn the_latest_picture_is_jpeg_whatever_the_camera_sends() {
    let node = Served::start().await;
    let path = "/api/v1/cameras/front/frame.jpg";
    let none = problem(node.get(path).await, 404).await;
    assert!(none["detail"].as_str().unwrap().contains("no picture"));
    let camera = node.board.camera("front").unwrap();
    let show = |seq, format, bytes: Vec<u8>| {
        camera.set_latest_frame(LatestFrame {
            seq,
            picture: EncodedPicture {
                format,
                bytes: bytes.into(),
                size: PictureSize::new(4, 2),
            },
        });
    };
    show(7, PictureFormat::Jpeg, b"\xff\xd8 as it came".to_vec());
    let response = node.get(path).await;
    assert_eq!(response.headers()["content-type"], "image/jpeg");
    assert_eq!(response.headers()["albireo-frame"], "7");
    assert_eq!(
        response.bytes().await.unwrap(),
        b"\xff\xd8 as it came".as_slice()
    );
    show(8, PictureFormat::Rgb8, vec![128; 24]);
    let response = node.get(path).await;
    assert_eq!(response.status(), StatusCode::OK);
    assert!(response.bytes().await.unwrap().starts_with(b"\xff\xd8\xff"));
    show(9, PictureFormat::Png, b"broken".to_vec());
    problem(node.get(path).await, 500).await;
}

#[tokio::test]
async fn clips_come_newest_first_by_camera_and_number() {
    let node = Served::start().await;
    for report in 0..300 {
        node.board.record_clip(clip("front", report));
    }
    node.board.record_clip(clip("rear", 0));
    let names = |list: serde_json::Value| -> Vec<(String, u64)> {
        let clips = list["clips"].as_array().unwrap();
        let name = |clip: &serde_json::Value| clip["camera"].as_str().unwrap().to_owned();
        clips
            .iter()
            .map(|clip| (name(clip), clip["count"].as_u64().unwrap()))
            .collect()
    };
    let two = names(node.json("/api/v1/clips?limit=2").await);
    assert_eq!(two, [("rear".to_owned(), 0), ("front".to_owned(), 299)]);
    let front = names(node.json("/api/v1/clips?camera=front&limit=256").await);
    assert_eq!(
        front.len(),
        255,
        "256 are kept, one of them the other camera's"
    );
    assert_eq!(names(node.json("/api/v1/clips").await).len(), 50);
    for query in [
        "limit=0",
        "limit=257",
        "limit=-1",
        "limit=many",
        "camera=front&colour=red",
    ] {
        problem(node.get(&format!("/api/v1/clips?{query}")).await, 400).await;
    }
    problem(node.get("/api/v1/clips?camera=roof").await, 404).await;
}

#[tokio::test]
async fn errors_of_the_framework_are_problem_documents_too() {
    let node = Served::start().await;
    for path in [
        "/nothing",
        "/api/v2",
        "/api/v2/threshold",
        "/api/v1/cameras/front/nothing",
    ] {
        problem(node.get(path).await, 404).await;
    }
    for (method, path, allowed) in [
        (Method::POST, "/api/v1/threshold", ["GET", "PUT"].as_slice()),
        (
            Method::DELETE,
            "/api/v1/cameras/front/threshold",
            &["GET", "PUT"],
        ),
        (Method::PUT, "/healthz", &["GET"]),
        (Method::OPTIONS, "/api/v1/clips", &["GET"]),
        (Method::POST, "/", &["GET"]),
    ] {
        let request = node.request(method, path);
        let request = request.header("content-type", "application/json");
        let response = request.send().await.unwrap();
        let header = response.headers()["allow"].to_str().unwrap().to_owned();
        let told = problem(response, 405).await;
        for method in allowed {
            assert!(header.contains(method), "{header}");
            assert!(
                told["allowed"].as_array().unwrap().contains(&json!(method)),
                "{told}"
            );
        }
    }
    // A path that is not UTF-8.
    problem(node.get("/api/v1/cameras/%ff/threshold").await, 400).await;
}

#[tokio::test]
async fn a_request_that_does_not_end_is_answered_and_dropped() {
    let config = HttpConfig {
        timeout_ms: 50,
        ..HttpConfig::default()
    };
    let node = Served::with(config, Some(super::served::KNOB)).await;
    let mut connection = tokio::net::TcpStream::connect(node.address).await.unwrap();
    let head = "PUT /api/v1/threshold HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n\
                Content-Length: 12\r\nConnection: close\r\n\r\n{\"u\":";
    connection.write_all(head.as_bytes()).await.unwrap();
    let mut answer = String::new();
    connection.read_to_string(&mut answer).await.unwrap();
    assert!(answer.starts_with("HTTP/1.1 408 "), "{answer}");
    assert!(answer.contains("application/problem+json"), "{answer}");
    assert!(answer.contains("within 50ms"), "{answer}");
}

#[tokio::test]
async fn the_page_needs_nothing_from_elsewhere() {
    let node = Served::start().await;
    let response = node.get("/").await;
    let policy = response.headers()["content-security-policy"]
        .to_str()
        .unwrap();
    assert!(policy.contains("default-src 'none'"), "{policy}");
    let page = response.text().await.unwrap();
    assert!(page.contains("<html lang=\"en\">"));
    for outside in ["http://", "https://", "src=\"//", "href=\"//"] {
        assert!(!page.contains(outside), "{outside}");
    }
}

#[tokio::test]
async fn one_camera_shows_policy_threshold_and_its_newest_detections() {
    let node = Served::start().await;
    let missing = problem(node.get("/api/v1/cameras/front/detections").await, 404).await;
    let detail = missing["detail"].as_str().unwrap();
    assert!(detail.contains("albireo/car-7/front/frame"), "{detail}");
    let front = node.board.camera("front").unwrap();
    front.answered(frame(4, FrameState::P));
    front.answered(frame(5, FrameState::I));
    let told = node.json("/api/v1/cameras/front").await;
    assert_eq!(told["policy"], "albireo");
    assert_eq!(told["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!(
        (&told["threshold"]["value"], &told["frames"]),
        (&json!(3e-4), &json!(2))
    );
    assert_eq!(told["skip_rate"], 0.5);
    assert_eq!(told["set_by"], "configuration");
    // Pictures of 320x240: the published code counts its noise in pixels.
    let published = told["u_as_published"].as_f64().unwrap();
    assert!(published > 8e-4, "{published}");
    let detections = node.json("/api/v1/cameras/front/detections").await;
    assert_eq!(
        (&detections["seq"], &detections["state"]),
        (&json!(5), &json!("I"))
    );
    problem(node.get("/api/v1/cameras/roof").await, 404).await;
}

#[tokio::test]
async fn a_camera_that_skips_nothing_is_told_what_to_try() {
    let node = Served::start().await;
    let front = node.board.camera("front").unwrap();
    for seq in 0..300 {
        assert_eq!(front.snapshot().advice, None);
        let mut message = (*frame(seq, FrameState::I)).clone();
        message.tau_max = Some(3.77e-4);
        front.answered(message.into());
    }
    let told = node.json("/api/v1/cameras").await;
    let advice = &told["cameras"][0]["advice"];
    assert_eq!(
        (&advice["try"], &advice["knob"]),
        (&json!(4e-4), &json!("u"))
    );
    assert_eq!(told["cameras"][1]["advice"], json!(null));
}

#[tokio::test]
async fn clips_are_read_page_by_page_and_only_the_new_ones() {
    let node = Served::start().await;
    for report in 1..=5 {
        node.board.record_clip(clip("front", report));
    }
    let numbers = |answer: &serde_json::Value| -> Vec<u64> {
        let clips = answer["clips"].as_array().unwrap();
        clips
            .iter()
            .map(|clip| clip["count"].as_u64().unwrap())
            .collect()
    };
    let id = |report: u64| clip("front", report).id;
    let first = node.json("/api/v1/clips?limit=2").await;
    assert_eq!(
        (numbers(&first), &first["next"]),
        (vec![5, 4], &json!(id(4)))
    );
    let second = format!("/api/v1/clips?limit=3&before={}", id(4));
    let second = node.json(&second).await;
    assert_eq!(
        (numbers(&second), &second["next"]),
        (vec![3, 2, 1], &json!(null))
    );
    for (after, newer) in [(3, &[5, 4][..]), (5, &[])] {
        let answer = node
            .json(&format!("/api/v1/clips?after={}", id(after)))
            .await;
        assert_eq!(numbers(&answer), newer);
    }
}

#[tokio::test]
async fn the_index_names_every_route_of_the_description() {
    let node = Served::start().await;
    let index = node.json("/api/v1").await;
    assert_eq!(index["cameras"], json!(["front", "rear"]));
    let routes = index["routes"].as_array().unwrap();
    assert!(routes.len() >= 18, "{routes:?}");
    for route in routes {
        let summary = route["summary"].as_str().unwrap();
        assert!(!summary.is_empty(), "{route}");
    }
    let described = node.json("/openapi.json").await;
    let paths = described["paths"].as_object().unwrap().keys();
    for path in paths {
        assert!(routes.iter().any(|route| route["path"] == **path), "{path}");
    }
}
