//! A hub and a router as processes, and nodes that only send reports.

use super::{
    PATIENCE, albireo, clip_report, free_port, json_at, project, python, text_at, zenoh_session,
};
use albireo_wire::{ClipReport, ReportAnswer, ReportBatch, ReportRefusal, VERSION, read};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};
use tokio::process::{Child, Command};
use uuid::{Builder, Uuid};

/// `albireo hub`, running.
pub(crate) struct HubProcess {
    child: Child,
    /// The URL of its HTTP interface.
    pub(crate) http: String,
    log: tempfile::NamedTempFile,
}

/// A number from the environment, for longer runs by hand.
pub(crate) fn from_environment(name: &str, default: u64) -> u64 {
    std::env::var(name)
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(default)
}

/// A hub's settings, as environment variables of its process.
pub(crate) type Settings = Vec<(&'static str, String)>;

/// The Zenoh endpoint and the settings of a hub on free ports.
pub(crate) fn settings(database: &str) -> (String, Settings) {
    let zenoh = format!("tcp/127.0.0.1:{}", free_port());
    let settings = vec![
        ("ALBIREO_HTTP__LISTEN", format!("127.0.0.1:{}", free_port())),
        ("ALBIREO_ZENOH__LISTEN", format!("[\"{zenoh}\"]")),
        ("ALBIREO_DATABASE__URL", database.to_owned()),
        ("ALBIREO_INGEST__COMMIT_MS", "20".to_owned()),
    ];
    (zenoh, settings)
}

/// The settings of a hub that reaches its nodes through a router.
pub(crate) fn behind(router: &str, database: &str) -> Settings {
    let (_, mut settings) = settings(database);
    settings.retain(|(name, _)| *name != "ALBIREO_ZENOH__LISTEN");
    settings.extend([
        ("ALBIREO_ZENOH__MODE", "client".to_owned()),
        ("ALBIREO_ZENOH__CONNECT", format!("[\"{router}\"]")),
        ("ALBIREO_ZENOH__LISTEN", "[]".to_owned()),
    ]);
    settings
}

/// The URL of the database file `hub.db` in a folder.
pub(crate) fn sqlite(folder: &Path) -> String {
    format!("sqlite:{}", folder.join("hub.db").display())
}

impl HubProcess {
    /// Starts a hub without waiting until it is ready.
    pub(crate) fn start(settings: &[(&'static str, String)]) -> Self {
        let mut command = albireo();
        command.arg("hub");
        Self::start_as(command, settings)
    }

    /// Starts a hub with a command that wraps it in another program.
    pub(crate) fn start_as(mut command: Command, settings: &[(&'static str, String)]) -> Self {
        let mut named = settings.iter();
        let http = named.find(|(name, _)| *name == "ALBIREO_HTTP__LISTEN");
        let log = tempfile::NamedTempFile::new().expect("a log");
        command
            .envs(settings.iter().map(|(name, value)| (*name, value)))
            .kill_on_drop(true)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log.reopen().expect("the log is there"));
        Self {
            child: command.spawn().expect("the hub starts"),
            http: format!("http://{}", http.expect("an address of its own").1),
            log,
        }
    }

    pub(crate) fn id(&self) -> u32 {
        self.child.id().expect("the hub runs")
    }

    pub(crate) async fn kill(mut self) {
        self.child.kill().await.expect("the hub is killed");
    }

    /// The JSON answer at a path; null without an answer.
    pub(crate) async fn get(&self, path: &str) -> Value {
        json_at(&format!("{}{path}", self.http)).await
    }

    pub(crate) async fn metrics(&self) -> String {
        text_at(&format!("{}/metrics", self.http)).await
    }

    /// Asks until the answer satisfies `wanted`.
    pub(crate) async fn until(&self, path: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        let until = Instant::now() + PATIENCE;
        loop {
            let answer = self.get(path).await;
            if wanted(&answer) {
                return answer;
            }
            assert!(
                Instant::now() < until,
                "{path} stays at {answer}\n{}",
                std::fs::read_to_string(self.log.path()).unwrap_or_default()
            );
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    /// Waits until it accepts reports.
    pub(crate) async fn until_ready(&self) {
        self.until("/readyz", |answer| answer["ready"] == true)
            .await;
    }

    /// All clips of a node, page by page.
    pub(crate) async fn clips(&self, node: &str) -> Vec<Value> {
        let (mut clips, mut cursor) = (Vec::new(), String::new());
        loop {
            let path = format!("/api/v1/clips?node={node}&limit=1000{cursor}");
            let page = self.until(&path, |page| page["clips"].is_array()).await;
            clips.extend(page["clips"].as_array().expect("clips").iter().cloned());
            match page["next"].as_i64() {
                Some(next) => cursor = format!("&cursor={next}"),
                None => return clips,
            }
        }
    }
}

/// A Zenoh router as a process: Zenoh's Python binding, which shares no code with this project.
pub(crate) struct Router(Child);

impl Router {
    /// Starts a router without waiting until it listens.
    pub(crate) fn start(endpoint: &str) -> Self {
        let child = Command::new(python())
            .arg(project("tests/clients/router.py"))
            .arg(endpoint)
            .arg(project("config/zenoh-router.json5"))
            .kill_on_drop(true)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("Python starts: `make python`");
        Self(child)
    }

    pub(crate) async fn kill(mut self) {
        self.0.kill().await.expect("the router is killed");
    }
}

/// Writes a configuration of `albireo router` without access control to `folder`.
pub(crate) fn router_config(folder: &Path) -> PathBuf {
    let file = folder.join("router.json5");
    let endpoints = json!([format!("tcp/127.0.0.1:{}", free_port())]);
    let config = json!({"listen": {"endpoints": endpoints}});
    std::fs::write(&file, config.to_string()).expect("a file");
    file
}

/// The session of a node's uplink, which retries until its router answers.
pub(crate) async fn uplink(endpoint: &str) -> zenoh::Session {
    let retry = json!({"period_init_ms": 50, "period_max_ms": 200});
    let settings = [
        ("mode", json!("client")),
        ("connect/endpoints", json!([endpoint])),
        ("connect/timeout_ms", json!(-1)),
        ("connect/exit_on_failure", json!(false)),
        ("connect/retry", retry),
    ];
    zenoh_session(&settings).await.expect("a session")
}

/// The time now, nanoseconds since the Unix epoch.
pub(crate) fn now_ns() -> u64 {
    let now = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .expect("a clock after 1970");
    u64::try_from(now.as_nanos()).expect("a clock before 2554")
}

/// Sends the reports with those numbers, and returns the answer, if one comes.
pub(crate) async fn send(
    session: &zenoh::Session,
    node: &str,
    numbers: std::ops::RangeInclusive<u64>,
    begun_ns: u64,
) -> Option<Result<ReportAnswer, ReportRefusal>> {
    let batch = ReportBatch {
        v: VERSION,
        node: node.to_owned(),
        t_ms: now_ns() / 1_000_000,
        reports: numbers.map(|one| report(node, one, begun_ns)).collect(),
    };
    let payload = batch.to_payload(albireo_wire::BatchCompression::Best);
    let replies = session
        .get(format!("albireo/@report/{node}"))
        .payload(payload.expect("a batch that can be written"))
        .timeout(Duration::from_secs(2))
        .await
        .expect("a query");
    while let Ok(reply) = replies.recv_async().await {
        match reply.result() {
            Ok(sample) => {
                return Some(Ok(read(&sample.payload().to_bytes()).expect("an answer")));
            }
            Err(error) => {
                // Zenoh's own error, for a timeout, is no refusal.
                if let Ok(refusal) = read::<ReportRefusal>(&error.payload().to_bytes()) {
                    return Some(Err(refusal));
                }
            }
        }
    }
    None
}

/// Sends the reports of a node until they are acknowledged, and counts the refusals before that by reason.
pub(crate) async fn deliver(
    session: &zenoh::Session,
    node: &str,
    numbers: std::ops::RangeInclusive<u64>,
    begun_ns: u64,
) -> BTreeMap<String, u64> {
    let until = Instant::now() + PATIENCE;
    let mut refused = BTreeMap::new();
    loop {
        match send(session, node, numbers.clone(), begun_ns).await {
            Some(Ok(answer)) => {
                assert!(answer.refused.is_empty(), "{answer:?}");
                return refused;
            }
            Some(Err(refusal)) => {
                *refused.entry(format!("{:?}", refusal.reason)).or_default() += 1;
            }
            None => *refused.entry("no answer".to_owned()).or_default() += 1,
        }
        assert!(Instant::now() < until, "never acknowledged: {refused:?}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// An id that is unique per node, time and number.
fn id(node: &str, number: u64, begun_ns: u64) -> Uuid {
    let mut random = [0; 10];
    let name = node.bytes().fold(0_u16, |sum, byte| {
        sum.wrapping_mul(31).wrapping_add(byte.into())
    });
    random[..2].copy_from_slice(&name.to_be_bytes());
    random[2..].copy_from_slice(&number.to_be_bytes());
    Builder::from_unix_timestamp_millis(begun_ns / 1_000_000, &random).into_uuid()
}

pub(crate) fn report(node: &str, number: u64, begun_ns: u64) -> ClipReport {
    let mut report = clip_report(node, "front", number, id(node, number, begun_ns));
    report.started_ns = begun_ns + number * 1_000_000;
    report
}
