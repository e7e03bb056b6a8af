//! Simulates a hub with its real settings, rollouts, trials and database.

use super::super::hub::{HubFile, Image};
use super::super::timeline::BEGIN;
use albireo_hub::config::{HistoryConfig, PresenceConfig, TuningConfig};
use albireo_hub::ingest::Recorder;
use albireo_hub::presence::Fleet;
use albireo_hub::store::Store;
use albireo_hub::tuning::DesiredSettings;
use albireo_hub::tuning::Notice;
use albireo_hub::tuning::Tuner;
use albireo_hub::tuning::outcome::Outcome;
use albireo_hub::tuning::revision::NewRevision;
use albireo_hub::tuning::run::{Command, Kind, Phase, Run};
use albireo_hub::tuning::selector::Selector;
use albireo_service::clock::Now;
use albireo_wire::{DesiredSetting, Heartbeat, StatusMessage};
use std::future::Future;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use tokio::runtime::{Builder, Runtime};

struct Running {
    recorder: Recorder,
    fleet: Arc<Fleet>,
    desired: Arc<DesiredSettings>,
    tuner: Tuner,
    notices: Receiver<Notice>,
}

pub(super) struct Hub {
    pub(super) file: HubFile,
    runtime: Runtime,
    running: Option<Running>,
}

#[derive(Debug)]
pub(super) struct Desired {
    pub(super) revision: u64,
    pub(super) setting: DesiredSetting,
    pub(super) at_ms: i64,
    /// Where it comes from: `hand`, `rollout 3`, `trial 1`.
    origin: String,
}

impl Hub {
    pub(super) fn new(folder: &Path) -> Self {
        Self {
            file: HubFile::new(folder),
            // Long enough that a busy machine never reaches it in real time.
            runtime: Builder::new_current_thread()
                .enable_time()
                .start_paused(true)
                .build()
                .unwrap(),
            running: None,
        }
    }

    pub(super) fn is_on(&self) -> bool {
        self.running.is_some()
    }

    /// Starts the hub; returns `false` if its database cannot be opened.
    pub(super) fn switch_on(&mut self, now: Now) -> bool {
        if self.is_on() {
            return true;
        }
        let config = self.file.config();
        let fleet = Arc::new(Fleet::new(&PresenceConfig::default()));
        let (desired, notices) = DesiredSettings::new();
        let desired = Arc::new(desired);
        let opened = async {
            let store = Store::open(&config).await?;
            fleet.remember(store.nodes().await?, now.at);
            let tuner = Tuner::open(
                store.clone(),
                Arc::clone(&fleet),
                Arc::clone(&desired),
                TuningConfig::default(),
                "hub".to_owned(),
            )
            .await?;
            Ok::<_, albireo_hub::store::StoreError>((store, tuner))
        };
        let Ok((store, tuner)) = self.runtime.block_on(opened) else {
            return false;
        };
        self.running = Some(Running {
            recorder: Recorder::new(&store, &HistoryConfig::default(), now),
            fleet,
            desired,
            tuner,
            notices,
        });
        true
    }

    pub(super) fn crash(&mut self) {
        self.running = None;
    }

    /// Receives a status; returns true if the node must be asked for a full one.
    pub(super) fn hear(&self, node: &str, payload: &[u8], now: Now) -> bool {
        let Some(hub) = &self.running else {
            return false;
        };
        if Heartbeat::is_one(payload) {
            let sign = Heartbeat::read(payload).unwrap();
            return hub.fleet.alive(node, sign, now);
        }
        let message: StatusMessage = albireo_wire::read(payload).unwrap();
        hub.fleet.apply_status(node, message, now)
    }

    pub(super) fn answer(&self, node: &str) -> Option<Vec<u8>> {
        let hub = self.running.as_ref()?;
        let mut desired = hub.desired.of(node);
        desired.send_full_status = hub.fleet.needs_full_status(node);
        Some(serde_json::to_vec(&desired).unwrap())
    }

    /// The notified nodes, in an order independent of hash maps.
    pub(super) fn notices(&self) -> Vec<String> {
        let mut nodes: Vec<String> = self
            .running
            .iter()
            .flat_map(|hub| hub.notices.try_iter())
            .map(|notice| notice.node)
            .collect();
        nodes.sort_unstable();
        nodes
    }

    fn work<T, E: std::fmt::Debug>(&self, work: impl Future<Output = Result<T, E>>) {
        // A setting that cannot be given now is refused or given later.
        if let Err(error) = self.runtime.block_on(work) {
            tracing::debug!(?error, "not done");
        }
    }

    pub(super) fn tick(&mut self, now: Now) {
        let Some(mut hub) = self.running.take() else {
            return;
        };
        hub.fleet.sweep(now);
        let nodes = hub.fleet.take_dirty();
        if hub.recorder.record(&[], &nodes, now).is_err() {
            hub.fleet.give_back(nodes);
        }
        let at_ms = now.unix_ms;
        self.work(hub.tuner.follow(at_ms));
        self.work(hub.tuner.drive(at_ms));
        self.work(hub.tuner.learn());
        self.work(hub.tuner.find_drift(at_ms));
        self.running = Some(hub);
    }

    pub(super) fn set(&self, nodes: &[String], setting: DesiredSetting, now: Now) {
        let Some(hub) = &self.running else { return };
        let request = NewRevision {
            select: Selector::new(nodes).unwrap(),
            ..NewRevision::default()
        };
        self.work(hub.tuner.set(setting, request, "ops", now.unix_ms));
    }

    pub(super) fn begin(&self, kind: Kind, now: Now) {
        let Some(hub) = &self.running else { return };
        self.work(hub.tuner.begin(kind, "ops", now.unix_ms));
    }

    pub(super) fn command(&self, which: u64, command: Command, now: Now) {
        self.command_one_of("rollout", which, command, now);
    }

    /// Gives a command to one of the runs of a kind, if there is one.
    fn command_one_of(&self, kind: &str, which: u64, command: Command, now: Now) {
        let Some(hub) = &self.running else { return };
        let many = self.last(kind);
        if many > 0 {
            let id = (which % many).cast_signed() + 1;
            self.work(hub.tuner.command(kind, id, command, "ops", now.unix_ms));
        }
    }

    pub(super) fn end_trial(&self, which: u64, now: Now) {
        self.command_one_of("trial", which, Command::Return, now);
    }

    /// The number of the last rollout or trial.
    pub(super) fn last(&self, kind: &str) -> u64 {
        let query = format!("SELECT value FROM counters WHERE name = '{kind}'");
        self.file.number(&query).unsigned_abs()
    }

    pub(super) fn highest_revision(&self) -> u64 {
        self.last("revision")
    }

    /// The database as a power cut may leave it: as at `before` or after a commit since; `None` if it was checkpointed.
    pub(super) fn image_at_a_commit(&self, before: Image, cut: u64) -> Option<Image> {
        let begin = before.log.len();
        let Image { file, mut log } = self.file.read();
        if before.file != file || begin < 32 || log.len() < begin {
            return None;
        }
        // The write-ahead log (sqlite.org/fileformat2.html#walformat) begins with 32 bytes, in which the third word is the size of a
        // page; frames of 24 bytes and a page follow. The second word of a frame is 0, but for the last frame of a commit, where it
        // is the size of the database: behind such a frame the log may end as if the power was cut there.
        let word = |at: usize| u32::from_be_bytes(log[at..at + 4].try_into().unwrap());
        let frame = 24 + word(8) as usize;
        let mut ends = vec![begin];
        for at in (32..log.len()).step_by(frame) {
            let is_commit = word(at + 4) != 0;
            if at >= begin && is_commit {
                ends.push(at + frame);
            }
        }
        log.truncate(ends[cut as usize % ends.len()]);
        Some(Image { file, log })
    }

    pub(super) fn desired(&self, node: &str) -> Option<Desired> {
        let text = "SELECT d.revision, d.setting, r.at_ms, r.origin FROM desired d \
                    JOIN revisions r ON r.revision = d.revision WHERE node = ?";
        let read = |row: &rusqlite::Row<'_>| {
            Ok(Desired {
                revision: row.get::<_, i64>(0)?.unsigned_abs(),
                setting: serde_json::from_str(&row.get::<_, String>(1)?).unwrap(),
                at_ms: row.get::<_, i64>(2)? - BEGIN,
                origin: row.get(3)?,
            })
        };
        self.file.other.query_row(text, [node], read).ok()
    }

    /// Unanswered settings, running rollouts and trials, and nodes whose desired value is not that of the last run that gave them one.
    pub(super) fn unfinished(&self) -> Vec<String> {
        let mut wrong = Vec::new();
        let query = "SELECT count(*) FROM revision_nodes WHERE outcome IN ('pending', 'waiting')";
        let open = self.file.number(query);
        if open > 0 {
            wrong.push(format!("{open} settings are open"));
        }
        let text = "SELECT kind || ' ' || id, state, ended_ms IS NULL FROM runs";
        let mut select = self.file.other.prepare(text).unwrap();
        let mut rows = select.query([]).unwrap();
        while let Some(row) = rows.next().unwrap() {
            let name: String = row.get(0).unwrap();
            let state: String = row.get(1).unwrap();
            let is_running: bool = row.get(2).unwrap();
            let run: Run = serde_json::from_str(&state).unwrap();
            let phase = format!("{name} is {}", run.phase.name());
            if is_running {
                wrong.push(phase.clone());
            }
            for member in &run.members {
                let value = match (&run.kind, run.phase) {
                    (Kind::Rollout { to, .. }, Phase::Done)
                        if member.given.outcome != Outcome::Missed =>
                    {
                        *to
                    }
                    (_, Phase::Done | Phase::Returned) => member.before,
                    _ => continue,
                };
                let Some(desired) = self.desired(&member.node) else {
                    continue;
                };
                let is_last = member.given.revision > 0 && desired.origin == name;
                if is_last && desired.setting != DesiredSetting::Threshold(value) {
                    let node = &member.node;
                    wrong.push(format!("{phase}, but for {node} {desired:?} is desired"));
                }
            }
        }
        wrong
    }
}
