//! A hub and a router as processes, and nodes that only send reports.

mod protected;
mod reports;

pub(crate) use super::postgres::{on_both, sqlite};
pub(crate) use protected::Protected;
pub(crate) use reports::{Reply, clip_report, in_batch, now_ns, uplink, zenoh_session};

use super::{PATIENCE, albireo, free_port, json_at, process, python, text_at};
use albireo_wire::{BatchCompression, ClipReport};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};
use tokio::process::{Child, Command};

pub(crate) struct HubProcess {
    child: Child,
    pub(crate) http: String,
    log: tempfile::NamedTempFile,
    /// A database of its own, removed with the hub.
    _database: Option<tempfile::TempDir>,
}

/// A number from the environment, for longer runs by hand.
pub(crate) fn from_environment(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap())
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
    settings.extend([
        ("ALBIREO_ZENOH__MODE", "client".to_owned()),
        ("ALBIREO_ZENOH__CONNECT", format!("[\"{router}\"]")),
        ("ALBIREO_ZENOH__LISTEN", "[]".to_owned()),
    ]);
    settings
}

impl HubProcess {
    /// The Zenoh endpoint of a ready hub with a new database and these further settings, and the hub.
    pub(crate) async fn fresh(more: Settings) -> (String, Self) {
        let folder = tempfile::tempdir().expect("a folder");
        let (zenoh, mut settings) = settings(&sqlite(folder.path()));
        settings.extend(more);
        let mut hub = Self::start(&settings);
        hub._database = Some(folder);
        hub.until_ready().await;
        (zenoh, hub)
    }

    /// Starts a hub without waiting until it is ready.
    pub(crate) fn start(settings: &[(&'static str, String)]) -> Self {
        Self::start_as(albireo(), settings)
    }

    /// Starts a hub with a command that wraps the program.
    pub(crate) fn start_as(mut command: Command, settings: &[(&'static str, String)]) -> Self {
        let http = settings.iter().find(|(name, _)| *name == "ALBIREO_HTTP__LISTEN");
        let log = tempfile::NamedTempFile::new().expect("a log");
        command
            .arg("hub")
            .envs(settings.iter().map(|(name, value)| (*name, value)))
            .stdout(Stdio::null())
            .stderr(log.reopen().expect("the log is there"));
        Self {
            child: command.spawn().expect("the hub starts"),
            http: format!("http://{}", http.expect("an address of its own").1),
            log,
            _database: None,
        }
    }

    pub(crate) fn id(&self) -> u32 {
        self.child.id().expect("the hub runs")
    }

    pub(crate) async fn kill(mut self) {
        self.child.kill().await.expect("the hub is killed");
    }

    pub(crate) async fn get(&self, path: &str) -> Value {
        json_at(&format!("{}{path}", self.http)).await
    }

    pub(crate) async fn metrics(&self) -> String {
        text_at(&format!("{}/metrics", self.http)).await
    }

    pub(crate) async fn until(&self, path: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        let until = Instant::now() + PATIENCE / 3;
        loop {
            let answer = self.get(path).await;
            if wanted(&answer) {
                return answer;
            }
            let log = std::fs::read_to_string(self.log.path()).unwrap_or_default();
            assert!(Instant::now() < until, "{path} stays at {answer}\n{log}");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    pub(crate) async fn until_ready(&self) {
        self.until("/readyz", |page| page["ready"] == true).await;
    }

    pub(crate) async fn clips(&self, node: &str) -> Vec<Value> {
        let mut clips = Vec::new();
        let mut cursor = String::new();
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

    /// Asserts that it has the reports 1 to `made` of a node, each once, and returns their clips.
    pub(crate) async fn has_each_once(&self, node: &str, made: u64) -> Vec<Value> {
        let clips = self.clips(node).await;
        let mut counts: Vec<_> = clips.iter().map(|clip| clip["count"].as_u64()).collect();
        counts.sort_unstable();
        let expected: Vec<_> = (1..=made).map(Some).collect();
        assert_eq!(counts, expected, "{node}: none missing, none twice");
        clips
    }
}

/// Starts a Zenoh router without waiting until it listens: Zenoh's Python binding, which shares no code with this project.
pub(crate) fn router(endpoint: &str) -> Child {
    process(python())
        .args(["tests/clients/router.py", endpoint])
        .arg("config/zenoh-router.json5")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("Python starts: `make python`")
}

/// Writes a configuration of `albireo router` without access control to `folder`.
pub(crate) fn router_config(folder: &Path) -> PathBuf {
    let file = folder.join("router.json5");
    let endpoints = json!([format!("tcp/127.0.0.1:{}", free_port())]);
    let config = json!({"listen": {"endpoints": endpoints}});
    std::fs::write(&file, config.to_string()).expect("a file");
    file
}

pub(crate) async fn send(
    session: &zenoh::Session,
    node: &str,
    numbers: std::ops::RangeInclusive<u64>,
    begun_ns: u64,
) -> Reply {
    let reports = numbers.map(|one| report(node, one, begun_ns)).collect();
    let payload = in_batch(node, reports).to_payload(BatchCompression::Best);
    reports::send(session, node, payload.unwrap(), Duration::from_secs(2)).await
}

/// Sends the reports of a node until they are acknowledged.
pub(crate) async fn deliver(
    session: &zenoh::Session,
    node: &str,
    numbers: std::ops::RangeInclusive<u64>,
    begun_ns: u64,
) {
    let until = Instant::now() + PATIENCE / 3;
    loop {
        let reply = send(session, node, numbers.clone(), begun_ns).await;
        if matches!(reply, Reply::Answer(_)) {
            return reply.assert_stored();
        }
        assert!(Instant::now() < until, "never acknowledged: {reply:?}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

pub(crate) fn report(node: &str, number: u64, begun_ns: u64) -> ClipReport {
    let mut report = clip_report(node, "front", number, reports::id(node, number, begun_ns));
    report.started_ns = begun_ns + number * 1_000_000;
    report
}
