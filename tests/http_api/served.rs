//! A node's interface on a free port, over a board that the test writes.

use albireo_core::detection::ObjectId;
use albireo_core::policy::{BoxSource, FrameState, Knob};
use albireo_node::FrameRecord;
use albireo_node::api::http::{NodeView, router};
use albireo_node::state::board::{Board, BoardSetup, CameraBoard, CameraSetup, DetectorFacts};
use albireo_node::state::target::TargetSetup;
use albireo_service::config::HttpConfig;
use albireo_service::http::{self, HttpError};
use albireo_vision::detector::{DetectorStatus, ExecutionProvider};
use albireo_vision::picture::FrameLimits;
use albireo_wire::{
    BoxMessage, CallCause, ClipEnd, ClipEnergy, ClipReport, DetectionsMessage, DomainEnergy,
    DroppedFrames, EnergyQuality, FrameStates, Latency, Percentiles, Threshold, ThresholdChange,
};
use reqwest::{Client, Method, RequestBuilder, Response, StatusCode};
use serde_json::Value;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

pub(crate) const KNOB: Knob = Knob {
    name: "u",
    meaning: "The detector is skipped while every uncertainty is below it.",
    minimum: 1e-9,
    maximum: 1.0,
    default: 3e-4,
    useful_minimum: 1.5e-4,
    useful_maximum: 1e-1,
};

/// A served node.
pub(crate) struct Served {
    pub board: Arc<Board>,
    pub detector: watch::Sender<DetectorStatus>,
    pub address: SocketAddr,
    pub client: Client,
    pub shutdown: CancellationToken,
    pub task: JoinHandle<Result<(), HttpError>>,
}

/// A board with the cameras `front` and `rear`.
pub(crate) fn board(
    knob: Option<Knob>,
    state_dir: Option<PathBuf>,
) -> (Arc<Board>, watch::Sender<DetectorStatus>) {
    let (detector, detector_status) = watch::channel(DetectorStatus::Starting);
    let camera = |name: &str| CameraSetup {
        name: name.to_owned(),
        key: format!("albireo/car-7/{name}/frame"),
        source: None,
        knob,
        threshold: None,
        sizeless: true,
        longest_pause: None,
        audited: true,
    };
    let board = Board::new(BoardSetup {
        node: "car-7".to_owned(),
        cameras: vec![camera("front"), camera("rear")],
        outbox: albireo_node::delivery::outbox::Outbox::open(
            &albireo_node::delivery::outbox::OutboxConfig::default(),
            state_dir.as_deref(),
        )
        .unwrap(),
        policy: "albireo",
        target: TargetSetup {
            policy: "albireo",
            knob: Some(KNOB),
            ..TargetSetup::default()
        },
        detector: DetectorFacts {
            model: "detector.onnx".to_owned(),
            requested: vec![ExecutionProvider::Cuda, ExecutionProvider::Cpu],
        },
        detector_status,
    });
    (board, detector)
}

impl Served {
    /// With the default settings.
    pub(crate) async fn start() -> Self {
        Self::with(HttpConfig::default(), Some(KNOB)).await
    }

    pub(crate) async fn with(config: HttpConfig, knob: Option<Knob>) -> Self {
        Self::over(config, board(knob, None)).await
    }

    /// Over a board with that state directory.
    pub(crate) async fn kept_in(state_dir: &Path) -> Self {
        let board = board(Some(KNOB), Some(state_dir.into()));
        Self::over(HttpConfig::default(), board).await
    }

    async fn over(
        config: HttpConfig,
        (board, detector): (Arc<Board>, watch::Sender<DetectorStatus>),
    ) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let shutdown = CancellationToken::new();
        let view = NodeView {
            board: Arc::clone(&board),
            limits: FrameLimits::default(),
            config: Arc::new(Value::Null),
        };
        let stop = shutdown.clone();
        let task = tokio::spawn(async move {
            http::run(&config, router(view, stop.clone()), listener, stop).await
        });
        Self {
            board,
            detector,
            address,
            client: Client::new(),
            shutdown,
            task,
        }
    }

    pub(crate) fn request(&self, method: Method, path: &str) -> RequestBuilder {
        self.client
            .request(method, format!("http://{}{path}", self.address))
    }

    pub(crate) async fn get(&self, path: &str) -> Response {
        self.request(Method::GET, path).send().await.unwrap()
    }

    /// The JSON of a successful answer.
    pub(crate) async fn json(&self, path: &str) -> Value {
        let response = self.get(path).await;
        assert_eq!(response.status(), StatusCode::OK, "{path}");
        response.json().await.unwrap()
    }

    pub(crate) async fn put(&self, path: &str, body: impl Into<reqwest::Body>) -> Response {
        self.request(Method::PUT, path)
            .header("content-type", "application/json")
            .body(body)
            .send()
            .await
            .unwrap()
    }

    pub(crate) fn ready(&self) {
        self.detector.send_replace(DetectorStatus::Ready {
            provider: ExecutionProvider::Cpu,
        });
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.shutdown.cancel();
    }
}

/// The problem document of an error answer, checked to be one.
pub(crate) async fn problem(response: Response, status: u16) -> Value {
    assert_eq!(response.status().as_u16(), status, "{}", response.url());
    assert_eq!(
        response.headers()["content-type"],
        "application/problem+json",
        "{}",
        response.url()
    );
    let url = response.url().clone();
    let problem: Value = response.json().await.unwrap();
    assert_eq!(problem["status"], status, "{url}");
    assert_eq!(problem["type"], "about:blank", "{url}");
    for member in ["title", "detail"] {
        assert!(
            problem[member]
                .as_str()
                .is_some_and(|text| !text.is_empty()),
            "{url}: no {member} in {problem}"
        );
    }
    problem
}

/// Frames without a loop that answers them.
pub(crate) trait Frames {
    /// A frame gets its only answer.
    fn answered(&self, detections: Arc<DetectionsMessage>);
}

impl Frames for CameraBoard {
    fn answered(&self, detections: Arc<DetectionsMessage>) {
        let total = Duration::from_secs_f64(detections.latency_ms.total / 1e3);
        self.show(Arc::clone(&detections));
        self.record_frame(&FrameRecord::new(detections, total));
    }
}

pub(crate) fn frame(seq: u64, state: FrameState) -> Arc<DetectionsMessage> {
    Arc::new(DetectionsMessage {
        v: 1,
        seq,
        t_ns: 1_800_000_000_000_000_000,
        clip: "window-0".to_owned(),
        state,
        pending: false,
        degraded: false,
        cause: (!state.is_skipped()).then_some(CallCause::Uncertain),
        tau_max: Some(1.5e-4),
        threshold: Some(Threshold::new(KNOB.name, 3e-4)),
        width: 320,
        height: 240,
        boxes: vec![BoxMessage {
            corners: [10.0, 20.0, 110.0, 90.0],
            class: "car".to_owned(),
            confidence: 0.9,
            source: BoxSource::Detected,
            object: Some(ObjectId(0)),
            confirmed: true,
        }],
        latency_ms: Latency {
            total: if state.is_skipped() { 0.4 } else { 22.0 },
            detector: (!state.is_skipped()).then_some(20.0),
            ..Latency::default()
        },
    })
}

pub(crate) fn clip(camera: &str, report: u64) -> ClipReport {
    ClipReport {
        v: 1,
        id: uuid::Uuid::from_u128(report.into()),
        node: "car-7".to_owned(),
        camera: camera.to_owned(),
        clip: format!("window-{report}"),
        part: 0,
        count: Some(report),
        ended_by: ClipEnd::Window,
        started_ns: 1_800_000_000_000_000_000,
        duration_s: 40.0,
        frames: 1200,
        states: FrameStates {
            e: 100,
            p: 500,
            ei: 50,
            i: 400,
            ai: 150,
        },
        skip_rate: 0.5,
        degraded_frames: 0,
        dropped: DroppedFrames::default(),
        policy: "albireo".to_owned(),
        threshold: Some(Threshold::new(KNOB.name, 3e-4)),
        threshold_changes: vec![ThresholdChange {
            seq: 0,
            threshold: Threshold::new(KNOB.name, 3e-4),
        }],
        model: "detector.onnx".to_owned(),
        provider: "cpu".to_owned(),
        total_latency_ms: Percentiles::default(),
        detector_latency_ms: Percentiles::default(),
        detector_used_ms: 0.0,
        board: None,
        audit: None,
        energy: ClipEnergy {
            joules: Some(412.0),
            node_joules: Some(412.0),
            saved_joules_estimated: None,
            edp: Some(13_733.3),
            quality: EnergyQuality::Estimated,
            source: "estimate".to_owned(),
            total_from: "idle + utilisation x (busy - idle)".to_owned(),
            samples: 400,
            coverage: 1.0,
            domains: vec![DomainEnergy {
                domain: "total".to_owned(),
                joules: 412.0,
                mean_watts: 10.3,
                peak_watts: None,
            }],
        },
    }
}
