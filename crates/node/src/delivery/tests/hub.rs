//! Simulates a hub: the real decoder and writer on one database, which two processes may share.

use super::node::{frames, image, put};
use albireo_hub::config::{DatabaseConfig, HistoryConfig};
use albireo_hub::ingest::{Batch, Recorder, decode};
use albireo_hub::presence::News;
use albireo_hub::store::Store;
use albireo_service::clock::Now;
use albireo_wire::{RefusalReason, ReportRefusal, VERSION};
use rusqlite::Connection;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use uuid::Uuid;

/// The node's index and the number of its request.
pub(super) type Asker = (usize, u64);

/// An answer or a refusal.
pub(super) type Reply = Result<Vec<u8>, Vec<u8>>;

/// A process of the hub.
#[derive(Default)]
pub(super) struct Process {
    recorder: Option<Recorder>,
    /// How far its wall clock is ahead, ms.
    pub(super) clock_ms: i64,
    waiting: Vec<(Asker, Batch)>,
}

/// The hub's database file, and a connection of another program, which locks everybody out while the disk is "full".
pub(super) struct HubFile {
    file: PathBuf,
    pub(super) other: Connection,
    is_full: bool,
    backup: Option<Vec<u8>>,
}

impl HubFile {
    /// Creates an empty database.
    pub(super) fn new(folder: &Path) -> Self {
        let file = folder.join("hub.db");
        put(&file, &empty(folder));
        Self {
            other: Connection::open(&file).unwrap(),
            file,
            is_full: false,
            backup: None,
        }
    }

    pub(super) fn config(&self) -> DatabaseConfig {
        database(&self.file)
    }

    /// Makes the disk full, so that nothing can be written, or frees it.
    pub(super) fn fill(&mut self, is_full: bool) {
        if self.is_full != is_full {
            let text = if is_full {
                "BEGIN IMMEDIATE"
            } else {
                "ROLLBACK"
            };
            self.other.execute_batch(text).unwrap();
            self.is_full = is_full;
        }
    }

    /// Makes a backup, which is impossible while the disk is full.
    pub(super) fn back_up(&mut self) {
        if !self.is_full {
            self.backup = Some(image(&self.file));
        }
    }

    /// The last backup.
    pub(super) fn backup(&self) -> Option<Vec<u8>> {
        self.backup.clone()
    }

    /// Replaces the database and its write-ahead log while the hub is off.
    pub(super) fn restore(&mut self, database: &[u8], log: &[u8]) {
        let was_full = self.is_full;
        self.fill(false);
        self.other = Connection::open_in_memory().unwrap();
        put(&self.file, database);
        if !log.is_empty() {
            std::fs::write(self.log_file(), log).unwrap();
        }
        self.other = Connection::open(&self.file).unwrap();
        self.fill(was_full);
    }

    fn log_file(&self) -> PathBuf {
        self.file.with_extension("db-wal")
    }

    /// The number that a query returns.
    pub(super) fn number(&self, query: &str) -> i64 {
        self.other.query_row(query, [], |row| row.get(0)).unwrap()
    }

    /// Contents of the file and of its write-ahead log.
    pub(super) fn read(&self) -> (Vec<u8>, Vec<u8>) {
        let log = std::fs::read(self.log_file()).unwrap_or_default();
        (std::fs::read(&self.file).unwrap(), log)
    }
}

pub(super) struct Hub {
    pub(super) file: HubFile,
    store: Store,
    history: HistoryConfig,
    pub(super) processes: [Process; 2],
}

fn database(file: &Path) -> DatabaseConfig {
    DatabaseConfig {
        url: format!("sqlite:{}", file.display()),
        timeout_ms: 1,
    }
}

fn open(config: &DatabaseConfig) -> Store {
    let runtime = tokio::runtime::Builder::new_current_thread().build();
    runtime.unwrap().block_on(Store::open(config)).unwrap()
}

/// An empty database.
fn empty(folder: &Path) -> Vec<u8> {
    static EMPTY: OnceLock<Vec<u8>> = OnceLock::new();
    EMPTY
        .get_or_init(|| {
            let file = folder.join("empty.db");
            drop(open(&database(&file)));
            image(&file)
        })
        .clone()
}

impl Hub {
    pub(super) fn new(folder: &Path, identity: u64) -> Self {
        let file = HubFile::new(folder);
        let identity = Uuid::from_u64_pair(identity, identity).to_string();
        let named = "UPDATE hub_meta SET value = ? WHERE key = 'identity'";
        file.other.execute(named, [identity]).unwrap();
        let years = 36_500;
        Self {
            store: open(&file.config()),
            file,
            // Clips stay, so that they can be counted at the end; only ids that are too old are deleted.
            history: HistoryConfig {
                clips_days: years,
                five_minutes_days: years,
                events_days: years,
                set_aside_days: years,
            },
            processes: Default::default(),
        }
    }

    pub(super) fn switch_on(&mut self, process: usize, now: Now) {
        let recorder = Recorder::new(&self.store, &self.history, now);
        self.processes[process].recorder = Some(recorder);
    }

    pub(super) fn is_on(&self, process: usize) -> bool {
        self.processes[process].recorder.is_some()
    }

    /// Kills the process; its pending requests are never answered.
    pub(super) fn crash(&mut self, process: usize) {
        self.processes[process].recorder = None;
        self.processes[process].waiting.clear();
    }

    /// Accepts a batch for the next commit; returns `false` if the process is off.
    pub(super) fn take(
        &mut self,
        process: usize,
        node: &str,
        from: Asker,
        payload: &[u8],
        now: Now,
    ) -> bool {
        let process = &mut self.processes[process];
        if process.recorder.is_some() {
            let batch = decode(node, payload, now.unix_ms).unwrap();
            process.waiting.push((from, batch));
        }
        process.recorder.is_some()
    }

    /// Commits the waiting batches; returns the replies.
    pub(super) fn commit(&mut self, process: usize, now: Now) -> Vec<(Asker, Reply)> {
        let process = &mut self.processes[process];
        let Some(recorder) = &mut process.recorder else {
            return Vec::new();
        };
        let (from, batches): (Vec<_>, Vec<_>) =
            std::mem::take(&mut process.waiting).into_iter().unzip();
        let retention = recorder.retention_is_due(now.at);
        match recorder.record(&batches, &News::default(), retention, now) {
            Ok(recorded) => {
                let answers = recorded
                    .answers
                    .iter()
                    .map(|answer| Ok(serde_json::to_vec(answer).unwrap()));
                from.into_iter().zip(answers).collect()
            }
            Err(error) => {
                let refusal = ReportRefusal {
                    v: VERSION,
                    reason: RefusalReason::Unavailable,
                    detail: error.to_string(),
                    retry_after_ms: Some(5000),
                };
                let refusal = serde_json::to_vec(&refusal).unwrap();
                from.into_iter()
                    .map(|from| (from, Err(refusal.clone())))
                    .collect()
            }
        }
    }

    /// How many times each report is stored.
    pub(super) fn stored(&self) -> BTreeMap<usize, u32> {
        let mut stored = BTreeMap::new();
        let text = "SELECT clip, frames FROM clips";
        let mut select = self.file.other.prepare(text).unwrap();
        let mut rows = select.query([]).unwrap();
        while let Some(row) = rows.next().unwrap() {
            let number: usize = row.get::<_, String>(0).unwrap().parse().unwrap();
            assert_eq!(row.get::<_, i64>(1).unwrap().unsigned_abs(), frames(number));
            *stored.entry(number).or_default() += 1;
        }
        stored
    }

    /// Checks that the tables of the database agree.
    pub(super) fn check(&self) -> Result<(), String> {
        let sums = |what: &str, table: &str| -> (i64, i64, i64) {
            let text = format!(
                "SELECT COALESCE(sum({what}), 0), COALESCE(sum(frames), 0), COALESCE(sum(duration_us), 0) FROM {table}"
            );
            let read = |row: &rusqlite::Row<'_>| Ok((row.get(0)?, row.get(1)?, row.get(2)?));
            self.file.other.query_row(&text, [], read).unwrap()
        };
        let clips = sums("part = 0", "clips");
        // Camera 0 holds the fleet's sums.
        for table in [
            "sums_5m WHERE camera_id > 0",
            "sums_5m WHERE camera_id = 0",
            "sums_day WHERE camera_id > 0",
            "sums_day WHERE camera_id = 0",
        ] {
            let summed = sums("clips", table);
            if summed != clips {
                return Err(format!(
                    "{table} has {summed:?}, the clips add up to {clips:?}"
                ));
            }
        }
        let number = |query| self.file.number(query);
        let (counted, stored) = (
            number("SELECT COALESCE(sum(stored), 0) FROM report_counts"),
            number("SELECT count(*) FROM clips"),
        );
        if counted != stored {
            return Err(format!(
                "{counted} reports are counted as stored, {stored} are"
            ));
        }
        let longest = number("SELECT COALESCE(max(length(missing)), 0) FROM report_counts");
        let senseless = number("SELECT count(*) FROM set_aside");
        if longest > 1000 || senseless > 0 {
            return Err(format!(
                "ranges of {longest} bytes, {senseless} reports set aside"
            ));
        }
        Ok(())
    }
}
