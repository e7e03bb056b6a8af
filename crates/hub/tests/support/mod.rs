//! A hub with a real database, and the messages of nodes over real Zenoh sessions.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    unreachable_pub
)]

#[path = "../../../../tests/support/assertions.rs"]
mod assertions;
#[path = "../../../../tests/support/ports.rs"]
mod ports;
pub mod postgres;

pub(crate) use assertions::assert_has;
pub(crate) use ports::free_port;

use albireo_hub::config::HubConfig;
use albireo_wire::{
    AuditReport, AuditSums, ClipReport, Desired, HealthState, OutboxStatus, PullRequest,
    ReportAnswer, ReportBatch, ReportRefusal, StatusMessage, VERSION,
};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use uuid::{Builder, Uuid};

/// The limit of any single wait on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A running hub.
pub struct Hub {
    pub http: String,
    pub zenoh: String,
    pub config: HubConfig,
    shutdown: CancellationToken,
    task: tokio::task::JoinHandle<Result<(), albireo_hub::HubError>>,
}

/// A configuration with a free Zenoh address.
pub fn config(database: &str) -> HubConfig {
    let mut config = HubConfig::default();
    config.zenoh.listen = vec![format!("tcp/127.0.0.1:{}", free_port())];
    config.database.url = database.to_owned();
    config.database.timeout_ms = 10_000;
    config.ingest.commit_ms = 20;
    config
}

/// The URL of the database file in `folder`.
pub fn sqlite(folder: &Path) -> String {
    format!("sqlite:{}", folder.join("hub.db").display())
}

impl Hub {
    /// Starts a hub and waits until it is ready.
    pub async fn start(config: HubConfig) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let http = format!("http://{}", listener.local_addr().unwrap());
        let shutdown = CancellationToken::new();
        let (given, stop) = (config.clone(), shutdown.clone());
        let task = tokio::spawn(async move { albireo_hub::run(&given, listener, stop).await });
        let hub = Self {
            zenoh: [&config.zenoh.listen[..], &config.zenoh.connect].concat()[0].clone(),
            http,
            config,
            shutdown,
            task,
        };
        hub.until("/readyz", |answer| answer["ready"] == true).await;
        hub
    }

    /// Stops the hub as a signal does.
    pub async fn stop(self) {
        self.shutdown.cancel();
        self.task.await.unwrap().unwrap();
    }

    /// The JSON answer at `path`.
    pub async fn get(&self, path: &str) -> Value {
        let response = reqwest::get(format!("{}{path}", self.http)).await.unwrap();
        response.json().await.unwrap()
    }

    pub async fn metrics(&self) -> String {
        let response = reqwest::get(format!("{}/metrics", self.http)).await;
        response.unwrap().text().await.unwrap()
    }

    /// The number of clips in the energy by node.
    pub async fn clips_with_energy(&self) -> i64 {
        let energy = self.get("/api/v1/energy?by=node").await;
        let groups = energy["groups"].as_array().unwrap().iter();
        groups.map(|group| group["clips"].as_i64().unwrap()).sum()
    }

    /// Asks until the answer satisfies `wanted`.
    pub async fn until(&self, path: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        let until = Instant::now() + PATIENCE;
        loop {
            let answer = match reqwest::get(format!("{}{path}", self.http)).await {
                Ok(response) => response.json().await.unwrap_or(Value::Null),
                Err(_) => Value::Null,
            };
            if wanted(&answer) {
                return answer;
            }
            assert!(Instant::now() < until, "{path} stays at {answer}");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }
}

/// A hub and a node's session.
pub struct Fixture {
    pub hub: Hub,
    pub session: zenoh::Session,
    folder: Option<tempfile::TempDir>,
}

impl Fixture {
    /// A hub with a SQLite file.
    pub async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let fixture = Self::on(config(&sqlite(folder.path()))).await;
        Self {
            folder: Some(folder),
            ..fixture
        }
    }

    pub async fn on(config: HubConfig) -> Self {
        let hub = Hub::start(config).await;
        Self {
            session: uplink(&hub.zenoh).await,
            hub,
            folder: None,
        }
    }

    pub async fn end(self) {
        self.session.close().await.unwrap();
        self.hub.stop().await;
        drop(self.folder);
    }
}

/// A test on SQLite and on PostgreSQL.
macro_rules! on_both {
    ($test:path, $sqlite:ident, $postgres:ident) => {
        #[tokio::test(flavor = "multi_thread")]
        async fn $sqlite() {
            let folder = tempfile::tempdir().unwrap();
            $test(&crate::support::sqlite(folder.path())).await;
        }

        #[tokio::test(flavor = "multi_thread")]
        #[ignore = "needs PostgreSQL"]
        async fn $postgres() {
            let server = crate::support::postgres::Postgres::start();
            $test(&server.url()).await;
        }
    };
}
pub(crate) use on_both;

/// The Zenoh session of a node's uplink.
pub async fn uplink(endpoint: &str) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"client\"".to_owned()),
        ("connect/endpoints", format!("[\"{endpoint}\"]")),
        ("connect/timeout_ms", "-1".to_owned()),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    zenoh::open(config).await.unwrap()
}

/// The reply to a batch.
#[derive(Debug, PartialEq)]
pub enum Reply {
    Answer(ReportAnswer),
    Refused(ReportRefusal),
    Nothing,
}

impl Reply {
    pub fn answer(self) -> ReportAnswer {
        match self {
            Self::Answer(answer) => answer,
            reply => panic!("{reply:?}"),
        }
    }

    /// Asserts that every report was stored.
    pub fn assert_stored(self) {
        let answer = self.answer();
        assert!(answer.refused.is_empty(), "{answer:?}");
    }
}

/// Sends a payload on the key of `node`.
pub async fn send(session: &zenoh::Session, node: &str, payload: Vec<u8>) -> Reply {
    let key = format!("albireo/@report/{node}");
    let replies = session
        .get(key)
        .payload(payload)
        .timeout(Duration::from_secs(20))
        .await
        .unwrap();
    while let Ok(reply) = replies.recv_async().await {
        match reply.result() {
            Ok(sample) => {
                return Reply::Answer(albireo_wire::read(&sample.payload().to_bytes()).unwrap());
            }
            Err(error) => {
                if let Ok(refusal) = albireo_wire::read(&error.payload().to_bytes()) {
                    return Reply::Refused(refusal);
                }
            }
        }
    }
    Reply::Nothing
}

/// Sends a batch until a hub answers.
pub async fn deliver(session: &zenoh::Session, batch: &ReportBatch) -> Reply {
    let until = Instant::now() + PATIENCE;
    let payload = batch.to_payload(albireo_wire::BatchCompression::Best);
    let payload = payload.unwrap();
    loop {
        match send(session, &batch.node, payload.clone()).await {
            Reply::Nothing => {}
            reply => return reply,
        }
        assert!(Instant::now() < until, "no hub answers");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Delivers the batch of these reports, all of which must be stored.
pub async fn store(
    session: &zenoh::Session,
    node: &str,
    series: u8,
    numbers: std::ops::RangeInclusive<u64>,
    started_ns: u64,
) {
    let batch = batch(node, series, numbers, started_ns);
    deliver(session, &batch).await.assert_stored();
}

/// Now, nanoseconds since the Unix epoch.
pub fn now_ns() -> u64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    u64::try_from(since.unwrap().as_nanos()).unwrap()
}

/// The audit of every second report: ten boxes of the detector in four frames, of which nine or eight were shown.
fn audit(number: u64) -> AuditReport {
    let shown = if number.is_multiple_of(4) { 9 } else { 8 };
    let mut sums = AuditSums::default();
    sums.add_missed(3);
    sums.frames = 4;
    sums.detected = 10;
    sums.shown = 12;
    sums.paired = shown;
    sums.squares.detected = 30;
    sums.squares.paired = 24;
    sums.squares.detected_paired = 26;
    AuditReport {
        share: 0.02,
        calls: 4,
        detector_us: 120_000,
        joules: Some(0.5),
        sums,
    }
}

/// The id of a report of that series and number, made at that time.
pub fn id(series: u8, number: u64, made_ns: u64) -> Uuid {
    let mut random = [series; 10];
    random[2..].copy_from_slice(&number.to_be_bytes());
    Builder::from_unix_timestamp_millis(made_ns / 1_000_000, &random).into_uuid()
}

/// The report of clip `number` of a series, which began `number` × 40 s after `started_ns`.
pub fn report(node: &str, series: u8, number: u64, started_ns: u64) -> ClipReport {
    let begun_ns = started_ns + number * 40_000_000_000;
    let joules = 100.1 + number as f64 / 3.0;
    let times = |count: u64, mean: f64| {
        let (p95, p99) = (mean * 2.0, mean * 3.0);
        json!({"count": count, "mean": mean, "p50": mean, "p95": p95, "p99": p99})
    };
    let quality = ["measured", "partial", "estimated"][number as usize % 3];
    let report = json!({
        "v": VERSION, "id": id(series, number, begun_ns + 40_000_000_000), "node": node, "camera": "front",
        "clip": format!("window-{number}"), "count": number, "ended_by": "window", "started_ns": begun_ns,
        "duration_s": 40.0, "frames": 1200, "states": {"E": 100, "P": 700, "E+I": 50, "I": 300, "AI": 50},
        "skip_rate": 800.0 / 1200.0, "degraded_frames": 20, "dropped": {}, "policy": "albireo",
        "threshold": {"name": "u", "value": 3e-4}, "threshold_changes": [], "model": "detector.onnx", "provider": "cpu",
        "total_latency_ms": times(1200, 11.3), "detector_latency_ms": times(400, 30.7),
        "energy": {
            "joules": joules, "node_joules": joules * 2.0, "saved_joules_estimated": 12.5,
            "edp": joules * 40_000.0 / 1200.0, "quality": quality,
            "source": "rapl", "total_from": "input_rail", "samples": 400, "coverage": 1.0,
            "domains": [{"domain": "cpu", "joules": joules * 1.5, "mean_watts": 3.0}],
        },
    });
    ClipReport {
        audit: number.is_multiple_of(2).then(|| audit(number)),
        ..serde_json::from_value(report).unwrap()
    }
}

/// The batch of reports with those numbers.
pub fn batch(
    node: &str,
    series: u8,
    numbers: std::ops::RangeInclusive<u64>,
    started_ns: u64,
) -> ReportBatch {
    ReportBatch {
        v: VERSION,
        node: node.into(),
        t_ms: now_ns() / 1_000_000,
        reports: numbers
            .map(|number| report(node, series, number, started_ns))
            .collect(),
    }
}

/// The counts of a node's clips at the hub, sorted.
pub async fn counts(hub: &Hub, node: &str) -> Vec<u64> {
    let clips = hub
        .get(&format!("/api/v1/clips?node={node}&limit=1000"))
        .await;
    let clips = clips["clips"].as_array().unwrap();
    let mut counts: Vec<u64> = clips
        .iter()
        .map(|clip| clip["count"].as_u64().unwrap())
        .collect();
    counts.sort_unstable();
    counts
}

/// A short status, without the full part.
pub fn status(run: u32, seq: u64) -> StatusMessage {
    StatusMessage {
        v: VERSION,
        run,
        started_ns: 1,
        seq,
        t_ns: now_ns(),
        health: HealthState::Ready,
        waiting: 0,
        revision: 0,
        full: None,
    }
}

pub fn full_status(run: u32, seq: u64, reasons: &[(&str, &str)]) -> StatusMessage {
    let state = if reasons.is_empty() {
        HealthState::Ready
    } else {
        HealthState::Degraded
    };
    let reasons: BTreeMap<_, _> = reasons.iter().copied().collect();
    let full = json!({
        "version": "0.1.0", "cameras": [], "policy": "albireo", "model": "detector.onnx", "provider": "cpu",
        "power_source": "rapl", "power_quality": "measured", "health": {"state": state, "reasons": reasons},
        "outbox": OutboxStatus::default(),
    });
    StatusMessage {
        health: state,
        full: Some(serde_json::from_value(full).unwrap()),
        ..status(run, seq)
    }
}

/// Publishes the status of a node.
pub async fn put_status(session: &zenoh::Session, node: &str, status: &StatusMessage) {
    let payload = serde_json::to_vec(status).unwrap();
    session
        .put(format!("albireo/@status/{node}"), payload)
        .await
        .unwrap();
}

/// The desired setting that the hub answers to a node's query.
pub async fn pull(session: &zenoh::Session, node: &str) -> Desired {
    let request = PullRequest {
        v: VERSION,
        revision: 0,
    };
    let replies = session
        .get(format!("albireo/@pull/{node}"))
        .payload(serde_json::to_vec(&request).unwrap())
        .timeout(Duration::from_secs(20))
        .await
        .unwrap();
    let reply = replies.recv_async().await.unwrap();
    let sample = reply.into_result().unwrap();
    albireo_wire::read(&sample.payload().to_bytes()).unwrap()
}
