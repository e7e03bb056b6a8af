//! Simulates a node: the real outbox on a real file, and the uplink's schedule.

use super::hub::Reply;
use crate::NodeError;
use crate::delivery::uplink::{HubPresence, Schedule, conclude, read_reply};
use crate::outbox::tests::{Faults, report};
use crate::outbox::{MAX_BYTES, Outbox, OutboxConfig, OutboxCounts};
use albireo_service::clock::Now;
use albireo_wire::{ClipReport, FrameStates, ReportAnswer, ReportBatch};
use rusqlite::Connection;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};
use uuid::{Builder, Uuid};

/// Opens something that locks its folder; a program that another test starts shares the lock between fork and exec.
pub(super) fn until_unlocked<T>(open: impl Fn() -> Result<T, NodeError>) -> T {
    let began = Instant::now();
    loop {
        match open() {
            Err(error) if error.to_string().contains("another node") => {
                assert!(began.elapsed().as_secs() < 20, "{error}");
                thread::yield_now();
            }
            opened => return opened.unwrap(),
        }
    }
}

/// What a running node has.
struct Running {
    outbox: Outbox,
    schedule: Schedule,
}

/// A batch that waits for a reply.
struct SentBatch {
    /// The number of the request.
    question: u64,
    batch: Rc<ReportBatch>,
}

/// What a node does next.
pub(super) struct NextStep {
    /// The batch that it sends now.
    pub(super) batch: Option<Rc<ReportBatch>>,
    /// The time until it is to be polled again.
    pub(super) pause: Duration,
}

#[derive(Default)]
pub(super) struct Node {
    pub(super) name: String,
    folder: PathBuf,
    pub(super) faults: Arc<Faults>,
    running: Option<Running>,
    /// How far its wall clock is ahead, ms.
    pub(super) clock_ms: i64,
    /// The number of times that its machine was started.
    pub(super) boot: u64,
    sent: Option<SentBatch>,
    /// Reports that exist only in memory.
    pub(super) in_memory: Vec<usize>,
    pub(super) kept_state: Option<Vec<u8>>,
    pub(super) looks_at_ms: Option<i64>,
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
            ..Self::default()
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
        self.running.is_some()
    }

    pub(super) fn switch_on(&mut self, now: Now, random: u64) {
        let config = OutboxConfig::default();
        let outbox = until_unlocked(|| {
            self.faults.open(&self.folder, MAX_BYTES, now).map_err(NodeError::new)
        });
        let mut schedule = Schedule::new(&config, random, now.at);
        schedule.begin(now.at);
        self.running = Some(Running { outbox, schedule });
    }

    /// Cuts the power; returns the reports lost because they existed only in memory.
    pub(super) fn crash(&mut self) -> Vec<usize> {
        self.end();
        self.boot += 1;
        std::mem::take(&mut self.in_memory)
    }

    /// Ends the program and not its machine.
    pub(super) fn end(&mut self) {
        self.running = None;
        self.sent = None;
    }

    pub(super) fn state(&self) -> Option<Vec<u8>> {
        self.file().exists().then(|| image(&self.file()))
    }

    pub(super) fn keep_state(&mut self) {
        self.kept_state = self.state().or(self.kept_state.take());
    }

    /// Reports that are in the file.
    pub(super) fn kept(&self) -> BTreeSet<usize> {
        if !self.file().exists() {
            return BTreeSet::new();
        }
        self.select("SELECT id FROM report")
    }

    /// Reports that are in the file and will not be sent.
    pub(super) fn refused(&self) -> BTreeSet<usize> {
        self.select("SELECT id FROM report WHERE state = 3")
    }

    fn select(&self, text: &str) -> BTreeSet<usize> {
        let db = Connection::open(self.file()).unwrap();
        let mut select = db.prepare(text).unwrap();
        select
            .query_map([], |row| Ok(Uuid::from_bytes(row.get(0)?)))
            .unwrap()
            .map(|id| serial(id.unwrap()))
            .collect()
    }

    /// Flips one bit of a file of the node, which is off: of the reports', or of their counts.
    pub(super) fn flip(&self, random: u64) {
        let name = if random.is_multiple_of(8) {
            "node.count"
        } else {
            "node.db"
        };
        let file = self.folder.join(name);
        let mut bytes = std::fs::read(&file).unwrap_or_default();
        if !bytes.is_empty() {
            let place = (random >> 16) as usize % bytes.len();
            bytes[place] ^= 1 << (random >> 8 & 7);
            std::fs::write(file, bytes).unwrap();
        }
    }

    pub(super) fn make(&mut self, number: usize, random: u16, now: Now) {
        let Some(running) = &self.running else {
            return;
        };
        let mut bytes = [0; 10];
        bytes[..2].copy_from_slice(&random.to_be_bytes());
        bytes[6..].copy_from_slice(&(number as u32).to_be_bytes());
        let frames = frames(number);
        let unix_ms = now.unix_ms.max(0).unsigned_abs();
        let made = ClipReport {
            id: Builder::from_unix_timestamp_millis(unix_ms, &bytes).into_uuid(),
            node: self.name.clone(),
            clip: number.to_string(),
            part: (number % 3) as u32,
            started_ns: unix_ms * 1_000_000,
            frames,
            states: FrameStates {
                i: frames,
                ..FrameStates::default()
            },
            ..report(0)
        };
        running.outbox.change(|waiting| waiting.insert(&mut [made], now));
        self.in_memory.push(number);
        self.note_durable();
    }

    /// What the outbox says is on its disk is no longer in memory only.
    fn note_durable(&mut self) {
        if self.is_durable() {
            self.in_memory.clear();
        }
    }

    /// What the node does next; `None` while it is off. A batch is the request number `question`.
    pub(super) fn poll(&mut self, question: u64, now: Now) -> Option<NextStep> {
        let Running { outbox, schedule } = self.running.as_mut()?;
        outbox.change(|waiting| waiting.retry_disk(now));
        let mut next = None;
        let counts = outbox.counts();
        if let Some(scope) = schedule.next_batch(&counts, HubPresence::UNWATCHED, now.at) {
            match outbox.change(|waiting| waiting.batch(&self.name, scope, now)) {
                Some(batch) => {
                    let batch = Rc::new(batch);
                    next = Some(Rc::clone(&batch));
                    self.sent = Some(SentBatch { question, batch });
                }
                None => schedule.batch_ended(&Ok(()), now.at),
            }
        }
        let longest_s = if outbox.counts().failing.is_some() {
            20
        } else {
            900
        };
        let latest = now.at + Duration::from_secs(longest_s);
        let pause = schedule.next_due(latest, now.at) - now.at;
        self.note_durable();
        Some(NextStep { batch: next, pause })
    }

    /// Receives a reply, if it waits for that one; returns the reports that the hub refuses permanently.
    pub(super) fn take(&mut self, question: u64, reply: &Reply, now: Now) -> Vec<usize> {
        let Some(Running { outbox, schedule }) = &mut self.running else {
            return Vec::new();
        };
        let Some(SentBatch { batch, .. }) = self.sent.take_if(|sent| sent.question == question)
        else {
            return Vec::new();
        };
        let reply = reply.as_deref().map_err(Vec::as_slice);
        let answer = read_reply::<ReportAnswer>(reply);
        let refused = answer
            .iter()
            .flat_map(|answer| &answer.refused)
            .map(|refusal| serial(refusal.id))
            .collect();
        let outcome = conclude(outbox, &batch, answer, now);
        if outcome.is_ok() {
            // Acknowledged reports no longer wait in memory.
            let sent: BTreeSet<usize> = batch.reports.iter().map(|one| serial(one.id)).collect();
            self.in_memory.retain(|number| !sent.contains(number));
        }
        schedule.batch_ended(&outcome, now.at);
        self.note_durable();
        refused
    }

    pub(super) fn counts(&self) -> Option<OutboxCounts> {
        self.running.as_ref().map(|running| running.outbox.counts())
    }

    pub(super) fn is_durable(&self) -> bool {
        self.counts().is_some_and(|counts| counts.status.durable)
    }

    pub(super) fn is_settled(&self) -> bool {
        let is_empty = |counts: OutboxCounts| counts.status.waiting + counts.again == 0;
        self.sent.is_none() && self.is_durable() && self.counts().is_some_and(is_empty)
    }
}

/// The number of frames in a report, which tells it from its neighbours.
pub(super) fn frames(number: usize) -> u64 {
    1 + (number % 97) as u64
}
