//! Simulates a node: the real outbox on a real file, and the uplink's schedule.

use crate::NodeError;
use crate::delivery::outbox::tests::{Faults, FaultyDisk, report};
use crate::delivery::outbox::{Outbox, OutboxConfig, OutboxCounts, StateFile};
use crate::delivery::uplink::{Schedule, conclude, read_reply};
use albireo_service::clock::Now;
use albireo_wire::{BatchCompression, ClipReport, FrameStates, ReportAnswer, ReportBatch};
use rusqlite::Connection;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};
use uuid::{Builder, Uuid};

/// Longest pause before a node checks its outbox again.
const LONGEST_PAUSE: Duration = Duration::from_secs(900);

/// Longest time for which a program started by another test holds a lock of this process.
const LOCK_LIMIT: Duration = Duration::from_secs(20);

/// Opens something that locks its folder. A program started by another test shares the lock between fork and exec.
pub(super) fn until_unlocked<T>(open: impl Fn() -> Result<T, NodeError>) -> T {
    let began = Instant::now();
    loop {
        match open() {
            Err(error) if error.to_string().contains("another node") => {
                assert!(began.elapsed() < LOCK_LIMIT, "{error}");
                thread::yield_now();
            }
            opened => return opened.unwrap(),
        }
    }
}

pub(super) struct Node {
    pub(super) name: String,
    folder: PathBuf,
    faults: Arc<Faults>,
    outbox: Option<Outbox>,
    schedule: Schedule,
    /// How far its wall clock is ahead, ms.
    pub(super) clock_ms: i64,
    /// The request in flight.
    reply: Option<(u64, ReportBatch)>,
    /// Reports that exist only in memory.
    pub(super) in_memory: Vec<usize>,
    /// What a power cut leaves if commits are not synced.
    unsynced: Option<Vec<u8>>,
    /// An earlier state.
    pub(super) kept_state: Option<Vec<u8>>,
    pub(super) looks_at_ms: i64,
}

/// The serial number in an id made by [`Node::make`].
pub(super) fn serial(id: Uuid) -> usize {
    (id.as_u128() & 0xffff_ffff) as usize
}

/// The content of a database, including its log, as one file.
pub(super) fn image(file: &Path) -> Vec<u8> {
    let copy = file.with_extension("image");
    let db = Connection::open(file).unwrap();
    db.execute("VACUUM INTO ?", [copy.to_str()]).unwrap();
    let bytes = std::fs::read(&copy).unwrap();
    std::fs::remove_file(copy).unwrap();
    bytes
}

/// Replaces a database file.
pub(super) fn put(file: &Path, image: &[u8]) {
    for ending in ["-wal", "-shm"] {
        let mut beside = file.as_os_str().to_owned();
        beside.push(ending);
        let _ = std::fs::remove_file(beside);
    }
    std::fs::write(file, image).unwrap();
}

impl Node {
    /// Creates a node that is off, with `state` in its state directory.
    pub(super) fn new(name: String, folder: PathBuf, state: Option<&[u8]>) -> Self {
        std::fs::create_dir(&folder).unwrap();
        let node = Self {
            name,
            folder,
            faults: Arc::default(),
            outbox: None,
            schedule: Schedule::new(&OutboxConfig::default(), 0, Instant::now()),
            clock_ms: 0,
            reply: None,
            in_memory: Vec::new(),
            unsynced: None,
            kept_state: None,
            looks_at_ms: i64::MAX,
        };
        if let Some(state) = state {
            put(&node.file(), state);
        }
        node
    }

    pub(super) fn file(&self) -> PathBuf {
        self.folder.join("node.db")
    }

    pub(super) fn is_on(&self) -> bool {
        self.outbox.is_some()
    }

    pub(super) fn switch_on(&mut self, now: Now, random: u64) {
        let config = OutboxConfig::default();
        self.outbox = Some(until_unlocked(|| {
            let disk = FaultyDisk {
                file: StateFile::new(&self.folder),
                faults: Arc::clone(&self.faults),
            };
            let opened = Outbox::open_on(Box::new(disk), config.max_bytes, now);
            opened.map_err(NodeError::new)
        }));
        self.schedule = Schedule::new(&config, random, now.at);
        self.schedule.begin(now.at);
        let unsynced = self.file().exists() && !self.faults.syncs.load(Ordering::Relaxed);
        self.unsynced = unsynced.then(|| image(&self.file()));
    }

    /// Cuts the power; returns the reports lost because they existed only in memory.
    pub(super) fn crash(&mut self) -> Vec<usize> {
        (self.outbox, self.reply) = (None, None);
        if let Some(unsynced) = self.unsynced.take() {
            put(&self.file(), &unsynced);
        }
        std::mem::take(&mut self.in_memory)
    }

    /// A copy of the state on the disk.
    pub(super) fn state(&self) -> Option<Vec<u8>> {
        self.file().exists().then(|| image(&self.file()))
    }

    pub(super) fn keep_state(&mut self) {
        self.kept_state = self.state().or(self.kept_state.take());
    }

    pub(super) fn fill_disk(&self, is_full: bool) {
        self.faults.is_full.store(is_full, Ordering::Relaxed);
    }

    /// Reports on the disk.
    pub(super) fn kept(&self) -> BTreeSet<usize> {
        if !self.file().exists() {
            return BTreeSet::new();
        }
        let db = Connection::open(self.file()).unwrap();
        let mut select = db.prepare("SELECT id FROM report").unwrap();
        let ids = select.query_map([], |row| Ok(Uuid::from_bytes(row.get(0)?)));
        ids.unwrap().map(|id| serial(id.unwrap())).collect()
    }

    /// Makes a report and stores it in the outbox.
    pub(super) fn make(&mut self, number: usize, random: u16, now: Now) {
        let Some(outbox) = &self.outbox else { return };
        let mut bytes = [0; 10];
        bytes[..2].copy_from_slice(&random.to_be_bytes());
        bytes[6..].copy_from_slice(&(number as u32).to_be_bytes());
        let frames = frames(number);
        let made = ClipReport {
            id: Builder::from_unix_timestamp_millis(now.unix_ms.unsigned_abs(), &bytes).into_uuid(),
            node: self.name.clone(),
            clip: number.to_string(),
            part: (number % 3) as u32,
            started_ns: now.unix_ms.unsigned_abs() * 1_000_000,
            frames,
            states: FrameStates {
                i: frames,
                ..FrameStates::default()
            },
            ..report(0)
        };
        outbox.insert(&mut [made], now);
        self.in_memory.push(number);
        self.note_durable();
    }

    /// What the outbox says is on its disk is no longer in memory only.
    fn note_durable(&mut self) {
        if (self.counts()).is_some_and(|counts| counts.status.durable) {
            self.in_memory.clear();
        }
    }

    /// Looks what is to be sent: the payload, as the question of that number; and when to look again.
    pub(super) fn look(&mut self, question: u64, now: Now) -> (Option<Vec<u8>>, Duration) {
        let Some(outbox) = &self.outbox else {
            return (None, LONGEST_PAUSE);
        };
        outbox.retry_disk(now);
        let mut payload = None;
        if let Some(again) = (self.schedule).next_batch(&outbox.counts(), false, now.at) {
            match outbox.batch(&self.name, again, now) {
                Some(batch) => {
                    payload = Some(batch.to_payload(BatchCompression::Quick).unwrap());
                    self.reply = Some((question, batch));
                }
                None => self.schedule.batch_ended(&Ok(()), now.at),
            }
        }
        let latest = now.at + LONGEST_PAUSE;
        let next = self.schedule.next_look(latest, now.at) - now.at;
        let next = if outbox.counts().failing.is_some() {
            next.min(Duration::from_secs(20))
        } else {
            next
        };
        self.note_durable();
        (payload, next)
    }

    /// True while the node waits for the reply to this request.
    pub(super) fn awaits(&self, question: u64) -> bool {
        self.reply
            .as_ref()
            .is_some_and(|(reply, _)| *reply == question)
    }

    /// Receives a reply, or `None` after the timeout; returns the reports that the hub refuses permanently.
    pub(super) fn take(&mut self, reply: Option<Result<&[u8], &[u8]>>, now: Now) -> Vec<usize> {
        let (Some(outbox), Some((_, batch))) = (&self.outbox, self.reply.take()) else {
            return Vec::new();
        };
        let reply = read_reply::<ReportAnswer>(reply.unwrap_or(Err(b"no reply")));
        let refused = (reply.as_ref()).map_or_else(|_| Vec::new(), |answer| answer.refused.clone());
        let outcome = conclude(outbox, &batch, reply, now);
        if outcome.is_ok() {
            // Acknowledged reports no longer wait in memory.
            let sent: BTreeSet<usize> = batch.reports.iter().map(|one| serial(one.id)).collect();
            self.in_memory.retain(|number| !sent.contains(number));
        }
        self.schedule.batch_ended(&outcome, now.at);
        self.note_durable();
        refused.iter().map(|refused| serial(refused.id)).collect()
    }

    /// Counts of the outbox; `None` while the node is off.
    pub(super) fn counts(&self) -> Option<OutboxCounts> {
        self.outbox.as_ref().map(Outbox::counts)
    }

    /// True if everything has been delivered.
    pub(super) fn is_settled(&self) -> bool {
        let is_empty = |counts: OutboxCounts| {
            counts.status.waiting + counts.again == 0 && counts.status.durable
        };
        self.reply.is_none() && self.counts().is_some_and(is_empty)
    }
}

/// Number of frames of a report.
pub(super) fn frames(number: usize) -> u64 {
    1 + (number % 97) as u64
}
