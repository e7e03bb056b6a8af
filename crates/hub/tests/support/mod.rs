//! A hub with a real database, and the messages of nodes over real Zenoh sessions.

#[path = "../../../../tests/support/assertions.rs"]
mod assertions;
#[path = "../../../../tests/support/ports.rs"]
mod ports;
pub(crate) mod postgres;
#[path = "../../../../tests/support/fleet/reports.rs"]
mod reports;

pub(crate) use assertions::{assert_contains, assert_has};
pub(crate) use ports::free_port;
pub(crate) use postgres::{on_both, sqlite};
pub(crate) use reports::{Reply, id, now_ns, open};

use albireo_hub::config::HubConfig;
use albireo_wire::{
    BatchCompression, ClipReport, Desired, EnergyQuality, HealthState, OutboxStatus, ReportBatch,
    StatusMessage, Threshold, VERSION,
};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::sync::LazyLock;
use std::time::{Duration, Instant};
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

/// The limit of a test, as in `.cargo/config.toml`. A wait that says what it waits for ends earlier, so that it is heard.
pub(crate) const PATIENCE: Duration = Duration::from_secs(360);

pub(crate) struct Hub {
    pub http: String,
    pub zenoh: String,
    pub uplink: zenoh::Session,
    pub config: HubConfig,
    /// The folder of a database of its own.
    folder: Option<tempfile::TempDir>,
    shutdown: CancellationToken,
    task: tokio::task::JoinHandle<Result<(), albireo_hub::HubError>>,
}

/// A configuration with a free Zenoh address.
pub(crate) fn config(database: &str) -> HubConfig {
    let mut config = HubConfig::default();
    config.zenoh.listen = vec![format!("tcp/127.0.0.1:{}", free_port())];
    config.database.url = database.to_owned();
    config.database.timeout_ms = 10_000;
    config.ingest.commit_ms = 20;
    config
}

impl Hub {
    /// A hub with a new SQLite file.
    pub(crate) async fn fresh() -> Self {
        Self::fresh_with(|_| ()).await
    }

    pub(crate) async fn fresh_with(change: impl FnOnce(&mut HubConfig)) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut config = config(&sqlite(folder.path()));
        change(&mut config);
        Self {
            folder: Some(folder),
            ..Self::start(config).await
        }
    }

    pub(crate) async fn start(config: HubConfig) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let http = format!("http://{}", listener.local_addr().unwrap());
        let shutdown = CancellationToken::new();
        let given = config.clone();
        let stop = shutdown.clone();
        let task = tokio::spawn(async move { albireo_hub::run(&given, listener, stop).await });
        let mut endpoints = config.zenoh.listen.iter().chain(&config.zenoh.connect);
        let zenoh = endpoints.next().unwrap().clone();
        let hub = Self {
            uplink: reports::uplink(&zenoh).await,
            zenoh,
            http,
            config,
            folder: None,
            shutdown,
            task,
        };
        hub.until("/readyz", |answer| answer["ready"] == true).await;
        hub
    }

    /// Stops the hub as a signal does.
    pub(crate) async fn stop(self) {
        self.uplink.close().await.unwrap();
        self.shutdown.cancel();
        self.task.await.unwrap().unwrap();
    }

    pub(crate) async fn restart(mut self) -> Self {
        let config = self.config.clone();
        let folder = self.folder.take();
        self.stop().await;
        Self {
            folder,
            ..Self::start(config).await
        }
    }

    pub(crate) async fn get(&self, path: &str) -> Value {
        let response = reqwest::get(format!("{}{path}", self.http)).await.unwrap();
        response.json().await.unwrap()
    }

    pub(crate) async fn assert_metrics(&self, lines: &[&str]) {
        let response = reqwest::get(format!("{}/metrics", self.http)).await.unwrap();
        let metrics = response.text().await.unwrap();
        assert_contains(&metrics, lines);
    }

    pub(crate) async fn clips_with_energy(&self) -> i64 {
        let energy = self.get("/api/v1/energy?by=node").await;
        energy["groups"]
            .as_array()
            .unwrap()
            .iter()
            .map(|group| group["clips"].as_i64().unwrap())
            .sum()
    }

    pub(crate) async fn until(&self, path: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        let until = Instant::now() + PATIENCE / 6;
        loop {
            let answer = self.get(path).await;
            if wanted(&answer) {
                return answer;
            }
            assert!(Instant::now() < until, "{path} stays at {answer}");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    pub(crate) async fn until_state(&self, node: &str, state: &str) -> Value {
        let path = format!("/api/v1/nodes/{node}");
        self.until(&path, |node| node["state"] == state).await
    }

    pub(crate) async fn send(&self, node: &str, payload: Vec<u8>) -> Reply {
        reports::send(&self.uplink, node, payload, Duration::from_secs(20)).await
    }

    /// Sends a batch until the hub answers.
    pub(crate) async fn deliver(&self, batch: &ReportBatch) -> Reply {
        let until = Instant::now() + PATIENCE / 6;
        let payload = batch.to_payload(BatchCompression::Best).unwrap();
        loop {
            match self.send(&batch.node, payload.clone()).await {
                Reply::Nothing => {}
                reply => return reply,
            }
            assert!(Instant::now() < until, "no hub answers");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    /// Delivers the batch of these reports, all of which must be stored.
    pub(crate) async fn store(&self, node: &str, numbers: RangeInclusive<u64>) {
        self.deliver(&batch(node, numbers)).await.assert_stored();
    }

    pub(crate) async fn counts(&self, node: &str) -> Vec<u64> {
        let path = format!("/api/v1/clips?node={node}&limit=1000");
        let page = self.get(&path).await;
        let mut counts: Vec<u64> = page["clips"]
            .as_array()
            .unwrap()
            .iter()
            .map(|clip| clip["count"].as_u64().unwrap())
            .collect();
        counts.sort_unstable();
        counts
    }

    pub(crate) async fn put_status(&self, node: &str, status: &StatusMessage) {
        let payload = serde_json::to_vec(status).unwrap();
        let key = format!("albireo/@status/{node}");
        self.uplink.put(key, payload).await.unwrap();
    }

    /// The desired setting that the hub answers to a node's query.
    pub(crate) async fn pull(&self, node: &str) -> Desired {
        let request = json!({"v": VERSION, "revision": 0}).to_string();
        let query = self.uplink.get(format!("albireo/@pull/{node}")).payload(request);
        let replies = query.timeout(Duration::from_secs(20)).await.unwrap();
        let sample = replies.recv_async().await.unwrap().into_result().unwrap();
        albireo_wire::read(&sample.payload().to_bytes()).unwrap()
    }
}

/// A day before the tests, when their reports begin.
pub(crate) static YESTERDAY: LazyLock<u64> = LazyLock::new(|| now_ns() - 90_000_000_000_000);

/// The report of clip `number`, which began `number` × 40 s after `started_ns`; every second one has an audit of ten boxes.
pub(crate) fn report(node: &str, number: u64, started_ns: u64) -> ClipReport {
    use EnergyQuality::{Estimated, Measured, Partial};
    let begun_ns = started_ns + number * 40_000_000_000;
    let id = id(node, number, begun_ns + 40_000_000_000);
    let mut report = reports::clip_report(node, "front", number, id);
    report.started_ns = begun_ns;
    report.policy = "albireo".to_owned();
    report.threshold = Some(Threshold::new("u", 3e-4));
    report.energy.joules = Some(100.1 + number as f64 / 3.0);
    report.energy.saved_joules_estimated = Some(12.5);
    report.energy.quality = [Measured, Partial, Estimated][number as usize % 3];
    if number.is_multiple_of(2) {
        let paired = if number.is_multiple_of(4) { 9 } else { 8 };
        let audit = json!({
            "share": 0.02, "calls": 4, "detector_us": 120_000, "joules": 0.5,
            "sums": {
                "missed": 1, "missed_boxes": 3, "frames": 4, "detected": 10, "shown": 12, "paired": paired,
                "squares": {"detected": 30, "paired": 24, "detected_paired": 26},
            },
        });
        report.audit = Some(serde_json::from_value(audit).unwrap());
    }
    report
}

pub(crate) fn batch(node: &str, numbers: RangeInclusive<u64>) -> ReportBatch {
    batch_of(node, numbers, *YESTERDAY)
}

/// The batch of reports of a node that began its first clip at another time.
pub(crate) fn batch_of(node: &str, numbers: RangeInclusive<u64>, started_ns: u64) -> ReportBatch {
    let reports = numbers.map(|number| report(node, number, started_ns)).collect();
    reports::in_batch(node, reports)
}

pub(crate) fn names(page: &Value) -> Vec<&str> {
    page["nodes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|node| node["node"].as_str().unwrap())
        .collect()
}

pub(crate) fn status(run: u32, seq: u64) -> StatusMessage {
    let status = json!({
        "v": VERSION, "run": run, "started_ns": 1, "seq": seq, "t_ns": now_ns(), "health": "ready", "waiting": 0,
        "revision": 0,
    });
    serde_json::from_value(status).unwrap()
}

pub(crate) fn full_status(run: u32, seq: u64, reasons: &[(&str, &str)]) -> StatusMessage {
    let state = match reasons {
        [] => HealthState::Ready,
        _ => HealthState::Degraded,
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

/// Runs statements over a connection of its own.
pub(crate) async fn script(url: &str, statements: &'static str) {
    if let Some(file) = url.strip_prefix("sqlite:") {
        let database = rusqlite::Connection::open(file).unwrap();
        database.execute_batch(statements).unwrap();
        return;
    }
    use sqlx::{Connection as _, Executor as _};
    let mut connection = sqlx::PgConnection::connect(url).await.unwrap();
    connection.execute(sqlx::raw_sql(statements)).await.unwrap();
}

/// The whole number that a query finds, over a connection of its own.
pub(crate) async fn number(url: &str, query: &'static str) -> i64 {
    if let Some(file) = url.strip_prefix("sqlite:") {
        let database = rusqlite::Connection::open(file).unwrap();
        return database.query_row(query, [], |row| row.get(0)).unwrap();
    }
    use sqlx::Connection as _;
    let mut connection = sqlx::PgConnection::connect(url).await.unwrap();
    sqlx::query_scalar(query).fetch_one(&mut connection).await.unwrap()
}
