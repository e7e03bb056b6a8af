//! Simulates a hub: the real decoder and writer on one database, which two processes may share.

use super::node::{frames, image, put};
use albireo_hub::config::{DatabaseConfig, HistoryConfig};
use albireo_hub::ingest::{Batch, Recorder};
use albireo_hub::store::Store;
use albireo_service::clock::Now;
use albireo_wire::{RefusalReason, ReportRefusal, VERSION};
use rusqlite::Connection;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Who waits for a reply.
#[derive(Clone, Copy, Debug)]
pub(super) struct Asker {
    /// The node's index.
    pub(super) node: usize,
    /// The number of its request.
    pub(super) question: u64,
}

pub(super) type Reply = Result<Vec<u8>, Vec<u8>>;

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
    pub(super) backup: Option<Image>,
}

/// A copy of a database.
#[derive(Clone)]
pub(super) struct Image {
    pub(super) file: Vec<u8>,
    /// Its write-ahead log, empty if there is none.
    pub(super) log: Vec<u8>,
}

impl HubFile {
    pub(super) fn new(folder: &Path) -> Self {
        let file = folder.join("hub.db");
        put(&file, empty(folder));
        Self {
            other: Connection::open(&file).unwrap(),
            file,
            backup: None,
        }
    }

    pub(super) fn config(&self) -> DatabaseConfig {
        database(&self.file)
    }

    /// Makes the disk full, so that nothing can be written.
    pub(super) fn fill(&mut self) {
        if !self.is_full() {
            self.other.execute_batch("BEGIN IMMEDIATE").unwrap();
        }
    }

    /// Frees the disk.
    pub(super) fn free(&mut self) {
        if self.is_full() {
            self.other.execute_batch("ROLLBACK").unwrap();
        }
    }

    fn is_full(&self) -> bool {
        !self.other.is_autocommit()
    }

    /// Makes a backup, which is impossible while the disk is full.
    pub(super) fn back_up(&mut self) {
        if !self.is_full() {
            self.backup = Some(Image {
                file: image(&self.file),
                log: Vec::new(),
            });
        }
    }

    /// Replaces the database and its write-ahead log while the hub is off.
    pub(super) fn restore(&mut self, image: &Image) {
        let was_full = self.is_full();
        self.free();
        self.other = Connection::open_in_memory().unwrap();
        put(&self.file, &image.file);
        if !image.log.is_empty() {
            std::fs::write(self.log_file(), &image.log).unwrap();
        }
        self.other = Connection::open(&self.file).unwrap();
        if was_full {
            self.fill();
        }
    }

    fn log_file(&self) -> PathBuf {
        self.file.with_extension("db-wal")
    }

    pub(super) fn number(&self, query: &str) -> i64 {
        self.other.query_row(query, [], |row| row.get(0)).unwrap()
    }

    pub(super) fn read(&self) -> Image {
        Image {
            file: std::fs::read(&self.file).unwrap(),
            log: std::fs::read(self.log_file()).unwrap_or_default(),
        }
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
    tokio::runtime::Builder::new_current_thread()
        .build()
        .unwrap()
        .block_on(Store::open(config))
        .unwrap()
}

/// An empty database, the same in each run.
fn empty(folder: &Path) -> &'static [u8] {
    static EMPTY: OnceLock<Vec<u8>> = OnceLock::new();
    EMPTY.get_or_init(|| {
        let file = folder.join("empty.db");
        drop(open(&database(&file)));
        image(&file)
    })
}

impl Hub {
    pub(super) fn new(folder: &Path) -> Self {
        let file = HubFile::new(folder);
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

    /// Accepts a batch for the next commit.
    pub(super) fn take(&mut self, process: usize, from: Asker, batch: Batch) {
        self.processes[process].waiting.push((from, batch));
    }

    pub(super) fn commit(&mut self, process: usize, now: Now) -> Vec<(Asker, Reply)> {
        let process = &mut self.processes[process];
        let Some(recorder) = &mut process.recorder else {
            return Vec::new();
        };
        let (from, batches): (Vec<_>, Vec<_>) =
            std::mem::take(&mut process.waiting).into_iter().unzip();
        let recorded = recorder.record(&batches, &[], now);
        let replies: Vec<Reply> = match recorded {
            Ok(recorded) => recorded
                .answers
                .iter()
                .map(serde_json::to_vec)
                .map(|answer| Ok(answer.unwrap()))
                .collect(),
            Err(error) => {
                let refusal = ReportRefusal {
                    v: VERSION,
                    reason: RefusalReason::Unavailable,
                    detail: error.to_string(),
                    retry_after_ms: Some(5000),
                };
                vec![Err(serde_json::to_vec(&refusal).unwrap()); from.len()]
            }
        };
        from.into_iter().zip(replies).collect()
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

    /// The time under which each report is stored, milliseconds since the Unix epoch.
    pub(super) fn dates(&self) -> BTreeMap<usize, i64> {
        let mut select = self.file.other.prepare("SELECT clip, at_ms FROM clips").unwrap();
        let date = |row: &rusqlite::Row<'_>| {
            let number = row.get::<_, String>(0)?.parse().unwrap();
            Ok((number, row.get(1)?))
        };
        select.query_map([], date).unwrap().collect::<Result<_, _>>().unwrap()
    }

    /// Asserts that the tables of the database agree.
    pub(super) fn check(&self) {
        let number = |query: &str| self.file.number(query);
        let sums = |table: &str, clips: &str| {
            [clips, "frames", "duration_us"]
                .map(|what| number(&format!("SELECT COALESCE(sum({what}), 0) FROM {table}")))
        };
        let clips = sums("clips", "part = 0");
        // Camera 0 holds the fleet's sums.
        for table in [
            "sums_5m WHERE camera_id > 0",
            "sums_5m WHERE camera_id = 0",
            "sums_hour WHERE camera_id > 0",
            "sums_hour WHERE camera_id = 0",
        ] {
            assert_eq!(sums(table, "clips"), clips, "{table}");
        }
        let counted = number("SELECT COALESCE(sum(stored), 0) FROM report_counts");
        let stored = number("SELECT count(*) FROM clips");
        assert_eq!(counted, stored, "reports counted as stored");
        let longest = number("SELECT COALESCE(max(length(ranges)), 0) FROM report_counts");
        assert!(longest <= 1000, "ranges of {longest} bytes");
        let set_aside = number("SELECT count(*) FROM set_aside");
        assert_eq!(set_aside, 0, "reports set aside");
    }
}
