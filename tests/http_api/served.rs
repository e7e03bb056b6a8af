//! The HTTP interface of a node on a free port, over a board that the test fills.

use albireo_core::geometry::PictureSize;
use albireo_core::policy::{Albireo, FrameState, ThresholdSpec};
use albireo_node::config::{CameraConfig, NodeConfig};
use albireo_node::frame::LatestFrame;
use albireo_node::state::board::{Board, CameraBoard};
use albireo_node::{FrameRecord, PreparedNode};
use albireo_service::ServiceError;
use albireo_service::config::HttpConfig;
use albireo_service::http;
use albireo_vision::detector::{ExecutionProvider, ModelStatus};
use albireo_vision::picture::{EncodedPicture, PictureFormat};
use albireo_wire::{CallCause, ClipReport, DetectionsMessage};
use reqwest::{Client, Method, RequestBuilder, Response, StatusCode};
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

pub(crate) const THRESHOLD: ThresholdSpec = Albireo::THRESHOLD;

pub(crate) struct Served {
    pub board: Arc<Board>,
    pub address: SocketAddr,
    pub client: Client,
    pub shutdown: CancellationToken,
    pub task: JoinHandle<Result<(), ServiceError>>,
}

pub(crate) fn prepared(policy: &str, state_dir: Option<&Path>) -> PreparedNode {
    let mut config = NodeConfig::default();
    config.policy.select(policy).unwrap();
    config.cameras = ["front", "rear"].map(CameraConfig::named).to_vec();
    config.node.name = "car-7".to_owned();
    config.node.state_dir = state_dir.map(Path::to_owned);
    // Nothing is written there: only a node that starts has a writer.
    config.record.folder = Some("recordings".into());
    config.detector.providers = vec![ExecutionProvider::Cuda, ExecutionProvider::Cpu];
    PreparedNode::new(&config).unwrap()
}

impl Served {
    pub(crate) async fn start() -> Self {
        Self::with(HttpConfig::default()).await
    }

    pub(crate) async fn with(config: HttpConfig) -> Self {
        Self::over(config, prepared("albireo", None)).await
    }

    pub(crate) async fn kept_in(state_dir: &Path) -> Self {
        Self::over(HttpConfig::default(), prepared("albireo", Some(state_dir))).await
    }

    pub(crate) async fn over(http: HttpConfig, node: PreparedNode) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let shutdown = CancellationToken::new();
        let config = NodeConfig {
            http,
            ..NodeConfig::default()
        };
        let board = Arc::clone(node.board());
        let stop = shutdown.clone();
        let task = tokio::spawn(async move {
            let router = node.router(&config, stop.clone());
            let methods = [Method::GET, Method::PUT];
            http::run(&config.http, &[], &methods, router, listener, stop).await
        });
        Self {
            board,
            address,
            client: Client::new(),
            shutdown,
            task,
        }
    }

    pub(crate) fn front(&self) -> &Arc<CameraBoard> {
        self.board.camera("front").unwrap()
    }

    pub(crate) fn request(&self, method: Method, path: &str) -> RequestBuilder {
        let url = format!("http://{}{path}", self.address);
        self.client.request(method, url)
    }

    pub(crate) async fn get(&self, path: &str) -> Response {
        self.request(Method::GET, path).send().await.unwrap()
    }

    pub(crate) async fn json(&self, path: &str) -> Value {
        let response = self.get(path).await;
        assert_eq!(response.status(), StatusCode::OK, "{path}");
        response.json().await.unwrap()
    }

    pub(crate) async fn metrics(&self) -> String {
        self.get("/metrics").await.text().await.unwrap()
    }

    pub(crate) async fn refused(&self, path: &str, status: u16) -> Value {
        problem(self.get(path).await, status).await
    }

    pub(crate) async fn put(&self, path: &str, body: impl Into<reqwest::Body>) -> Response {
        self.request(Method::PUT, path)
            .body(body)
            .header("content-type", "application/json")
            .send()
            .await
            .unwrap()
    }

    pub(crate) fn ready(&self) {
        self.board.set_detector_status(ModelStatus::Ready {
            provider: ExecutionProvider::Cpu,
        });
    }
}

/// The problem document of an error answer, after checks of its form.
pub(crate) async fn problem(response: Response, status: u16) -> Value {
    let url = response.url().clone();
    assert_eq!(response.status().as_u16(), status, "{url}");
    let media_type = &response.headers()["content-type"];
    assert_eq!(media_type, "application/problem+json", "{url}");
    let problem: Value = response.json().await.unwrap();
    assert_eq!(problem["status"], status, "{url}");
    assert_eq!(problem["type"], "about:blank", "{url}");
    for member in ["title", "detail"] {
        let text = problem[member].as_str().unwrap_or_default();
        assert!(!text.is_empty(), "{url}: no {member} in {problem}");
    }
    problem
}

pub(crate) fn answered(camera: &CameraBoard, detections: DetectionsMessage) {
    let detections = Arc::new(detections);
    let total = Duration::from_secs_f64(detections.latency_ms.total / 1e3);
    // A black picture.
    let (width, height) = (detections.width, detections.height);
    let picture = EncodedPicture {
        format: PictureFormat::Rgb8,
        bytes: vec![0; 3 * (width * height) as usize].into(),
        size: PictureSize::new(width, height),
        mount: None,
    };
    camera.show(Arc::clone(&detections), picture);
    camera.record_frame(&FrameRecord::new(detections, total));
}

/// Answers a frame of each of these states, numbered from 0.
pub(crate) fn answered_all(camera: &CameraBoard, states: &[FrameState]) {
    for (seq, state) in (0..).zip(states) {
        answered(camera, frame(seq, *state));
    }
}

pub(crate) fn received(
    camera: &CameraBoard,
    seq: u64,
    format: PictureFormat,
    bytes: Vec<u8>,
    [width, height]: [u32; 2],
) {
    let picture = EncodedPicture {
        format,
        bytes: bytes.into(),
        size: PictureSize::new(width, height),
        mount: None,
    };
    camera.input.set_latest_frame(LatestFrame::new(seq, picture));
}

pub(crate) fn frame(seq: u64, state: FrameState) -> DetectionsMessage {
    let message = json!({
        "v": 1, "seq": seq, "t_ns": 1_800_000_000_000_000_000_u64, "clip": "window-0", "state": state.as_str(),
        "tau_max": 1.5e-4, "threshold": {"name": "u", "value": 3e-4}, "width": 320, "height": 240,
        "boxes": [{
            "box": [10.0, 20.0, 110.0, 90.0], "class": "car", "confidence": 0.9, "source": "detected", "object": 0,
            "confirmed": true,
        }],
        "latency_ms": {"total": 0.4, "waiting": 0.0, "policy": 0.0},
    });
    let mut message: DetectionsMessage = serde_json::from_value(message).unwrap();
    if !state.is_skipped() {
        message.cause = Some(CallCause::Uncertain);
        message.latency_ms.total = 22.0;
        message.latency_ms.detector = Some(20.0);
    }
    message
}

pub(crate) fn clip(camera: &str, number: u64) -> ClipReport {
    let id = uuid::Uuid::from_u128(number.into());
    crate::support::clip_report("car-7", camera, number, id)
}
