//! Reports on disk, and in memory while the disk fails. No clock: times are given.

use super::OutboxCounts;
use super::disk::Disk;
use super::table::{Answered, Counters, StoredReport, Table, TableError};
use albireo_service::clock::Now;
use albireo_wire::{
    ClipReport, LARGEST_REPORT_BYTES, MOST_REPORTS, ReportAnswer, ReportBatch, VERSION,
};
use std::collections::{BTreeSet, VecDeque};
use std::time::{Duration, Instant};
use uuid::Uuid;

/// Time between two attempts to use a disk that failed.
const DISK_RETRY: Duration = Duration::from_secs(2);

/// Most reports in memory while the disk fails.
pub(super) const MOST_IN_MEMORY: usize = 2000;

/// Bytes of a batch's reports at most: well below what a hub takes, and compressed far below what an uplink lets through.
pub(super) const BATCH_BYTES: usize = 1 << 20;

/// Most reports of a batch.
const BATCH_REPORTS: usize = 400;
const _: () = assert!(BATCH_REPORTS <= MOST_REPORTS);

/// Reports that no hub has, and those that one may lose again.
#[derive(Debug)]
pub(super) struct Waiting {
    disk: Option<Box<dyn Disk>>,
    most_bytes: u64,
    /// The open file; kept while it can be read, also when it cannot be written.
    table: Option<Table>,
    /// The file is set aside before it is opened again.
    damaged: bool,
    /// Reports that are not on disk.
    memory: VecDeque<StoredReport>,
    /// What hubs answered while the disk could not be written.
    unwritten: Answered,
    /// The reports of `unwritten`: they are on disk, and not to be sent.
    done: BTreeSet<Uuid>,
    counters: Counters,
    counts: OutboxCounts,
    pub(super) retry_at: Instant,
}

impl Waiting {
    /// Nothing waits yet, and nothing is open.
    pub(super) fn new(disk: Option<Box<dyn Disk>>, most_bytes: u64) -> Self {
        Self {
            counters: Counters {
                // Without a disk this run is all that there is to be counted.
                made: disk.is_none().then_some(0),
                ..Counters::default()
            },
            disk,
            most_bytes,
            table: None,
            damaged: false,
            memory: VecDeque::new(),
            unwritten: Answered::default(),
            done: BTreeSet::new(),
            counts: OutboxCounts::default(),
            retry_at: Instant::now(),
        }
    }

    /// Opens the file, and brings to it what waits in memory. One that is damaged is set aside.
    pub(super) fn open(&mut self, now: Now) -> Result<(), TableError> {
        let mut opened = self.try_open(now);
        if let Err(error) = &opened {
            self.fail(error, now);
            if self.damaged {
                opened = self.try_open(now);
            }
        }
        opened
    }

    fn try_open(&mut self, now: Now) -> Result<(), TableError> {
        self.open_table().and_then(|()| self.catch_up(now))
    }

    fn open_table(&mut self) -> Result<(), TableError> {
        let Some(disk) = &mut self.disk else {
            return Ok(());
        };
        if self.damaged {
            let aside = disk.set_aside()?;
            self.damaged = false;
            tracing::error!(
                aside = %aside.display(),
                "the file of clip reports is damaged and was set aside; those in it are not delivered"
            );
        }
        let table = disk.open().and_then(Table::new)?;
        // What was counted since the start goes on from what was counted before.
        let before = table.counters()?;
        let counters = &mut self.counters;
        counters.made = counters.made.max(before.made);
        counters.lost = counters.lost.max(before.lost);
        counters.undeliverable = counters.undeliverable.max(before.undeliverable);
        self.table = Some(table);
        Ok(())
    }

    /// Brings to the open file what could not be written before.
    fn catch_up(&mut self, now: Now) -> Result<(), TableError> {
        let Some(table) = &mut self.table else {
            return Ok(());
        };
        if !self.done.is_empty() {
            table.answered(&self.unwritten, &self.counters, now.unix_ms)?;
            self.unwritten = Answered::default();
            self.done.clear();
        }
        let mut counters = self.counters;
        let lost = table.insert(&self.memory, &mut counters, self.most_bytes)?;
        self.counters = counters;
        self.memory.clear();
        self.lose(lost, now);
        self.recount()?;
        if let Some(reason) = self.counts.failing.take() {
            tracing::info!(reason, "the state directory can be used again");
        }
        Ok(())
    }

    /// Tries a disk that failed again, when it is time.
    pub(super) fn retry_disk(&mut self, now: Now) {
        if self.counts.failing.is_none() || now.at < self.retry_at {
            return;
        }
        if self.table.is_some() {
            match self.check().and_then(|()| self.catch_up(now)) {
                Ok(()) => return,
                // A new connection would be no better.
                Err(error) if error.passes_by_itself() => return self.fail(&error, now),
                Err(_) => self.table = None,
            }
        }
        // The reason is noted there.
        let _ = self.open(now);
    }

    fn check(&self) -> Result<(), TableError> {
        self.disk.as_ref().map_or(Ok(()), |disk| disk.check())
    }

    /// Takes note that nothing can be kept on disk.
    fn fail(&mut self, error: &TableError, now: Now) {
        let reason = format!("the state directory cannot be used: {error}");
        if self.counts.failing.as_deref() != Some(reason.as_str()) {
            tracing::error!("{reason}; clip reports wait in memory");
        }
        self.counts.failing = Some(reason);
        self.counts.disk_failures += 1;
        self.retry_at = now.at + DISK_RETRY;
        if error.is_corruption() {
            self.table = None;
            self.damaged = true;
        }
    }

    /// Keeps reports, in order, and gives them their running counts.
    pub(super) fn insert(&mut self, reports: &mut [ClipReport], now: Now) {
        self.retry_disk(now);
        let mut rows = Vec::with_capacity(reports.len());
        for report in reports {
            self.counters.made = self.counters.made.map(|made| made + 1);
            report.count = self.counters.made;
            self.counts.kept += 1;
            rows.push(StoredReport {
                id: report.id,
                count: report.count,
                // A report holds numbers and text: writing it cannot fail. An empty row would count as undeliverable.
                json: serde_json::to_vec(report).unwrap_or_default(),
            });
        }
        let written = self.write(&rows, now);
        if let Err(error) = &written {
            self.fail(error, now);
        }
        if !written.unwrap_or(false) {
            self.memory.extend(rows);
            let lost = self.memory.len().saturating_sub(MOST_IN_MEMORY);
            self.memory.drain(..lost);
            self.counters.lost += lost as u64;
            self.lose(lost as u64, now);
        }
    }

    /// Writes reports to the disk; `false` where there is none to write to.
    fn write(&mut self, rows: &[StoredReport], now: Now) -> Result<bool, TableError> {
        if self.counts.failing.is_some() {
            return Ok(false);
        }
        self.check()?;
        let Some(table) = &mut self.table else {
            return Ok(false);
        };
        let mut counters = self.counters;
        let mut inserted = table.insert(rows, &mut counters, self.most_bytes);
        if let Err(error) = &inserted
            && error.is_full()
            && table.make_room()?
        {
            inserted = table.insert(rows, &mut counters, self.most_bytes);
        }
        let lost = inserted?;
        self.counters = counters;
        self.lose(lost, now);
        self.recount()?;
        Ok(true)
    }

    fn lose(&mut self, reports: u64, now: Now) {
        if reports > 0 {
            self.counts.last_loss = Some(now.at);
            tracing::warn!(reports, "clip reports lost: there is no room for them");
        }
    }

    fn recount(&mut self) -> Result<(), TableError> {
        if let Some(table) = &self.table {
            (self.counts.waiting, self.counts.again) = table.waiting()?;
        }
        Ok(())
    }

    /// The oldest reports to be sent, as reports of `node`, with those that a hub has lost if they go
    /// `again` now. One that cannot be read is counted as undeliverable.
    pub(super) fn batch(&mut self, node: &str, again: bool, now: Now) -> Option<ReportBatch> {
        loop {
            let (reports, unreadable) = self.read(node, again, now);
            if unreadable.is_empty() || !reports.is_empty() {
                self.remove(unreadable, now);
                return (!reports.is_empty()).then(|| ReportBatch {
                    v: VERSION,
                    node: node.to_owned(),
                    t_ms: u64::try_from(now.unix_ms).unwrap_or(0),
                    reports,
                });
            }
            self.remove(unreadable, now);
        }
    }

    fn read(&mut self, node: &str, again: bool, now: Now) -> (Vec<ClipReport>, Vec<Uuid>) {
        let (mut reports, mut unreadable, mut bytes) = (Vec::new(), Vec::new(), 0);
        let mut take = |report: &StoredReport| {
            if self.done.contains(&report.id) {
                return true;
            }
            match readable(report, node) {
                Ok(read) => {
                    bytes += report.json.len();
                    let full = reports.len() == BATCH_REPORTS || bytes > BATCH_BYTES;
                    if full && !reports.is_empty() {
                        return false;
                    }
                    reports.push(read);
                }
                Err(reason) => {
                    tracing::error!(id = %report.id, reason, "a clip report cannot be sent");
                    unreadable.push(report.id);
                }
            }
            true
        };
        let mut failed = None;
        if let Some(table) = &self.table {
            failed = table.due(again, |report| take(&report)).err();
        }
        for report in &self.memory {
            if !take(report) {
                break;
            }
        }
        if let Some(error) = failed {
            self.table = None;
            self.fail(&error, now);
        }
        (reports, unreadable)
    }

    /// Removes reports that will never be delivered.
    fn remove(&mut self, removed: Vec<Uuid>, now: Now) {
        if !removed.is_empty() {
            self.counters.undeliverable += removed.len() as u64;
            let answered = Answered {
                removed,
                ..Answered::default()
            };
            self.finish(answered, now);
        }
    }

    /// Takes a hub's answer to `batch`; how many reports it has stored.
    pub(super) fn answered(&mut self, batch: &ReportBatch, answer: &ReportAnswer, now: Now) -> u64 {
        let sent: BTreeSet<Uuid> = batch.reports.iter().map(|report| report.id).collect();
        let refused: BTreeSet<Uuid> = (answer.refused.iter())
            .filter(|refused| sent.contains(&refused.id))
            .map(|refused| {
                tracing::error!(id = %refused.id, refused.reason, "the hub refuses a clip report");
                refused.id
            })
            .collect();
        let stored = (sent.len() - refused.len()) as u64;
        self.counters.undeliverable += refused.len() as u64;
        self.counts.acknowledged += stored;
        let answered = Answered {
            acknowledged: sent.difference(&refused).copied().collect(),
            removed: refused.into_iter().collect(),
            database: Some(answer.database),
            missing: answer.missing.clone(),
        };
        self.finish(answered, now);
        stored
    }

    /// Writes what was answered, or notes it until the disk can be written.
    fn finish(&mut self, answered: Answered, now: Now) {
        let ids = answered.acknowledged.iter().chain(&answered.removed);
        let mut done: BTreeSet<Uuid> = ids.copied().collect();
        // What is in memory is nowhere else.
        self.memory.retain(|report| !done.remove(&report.id));
        if self.counts.failing.is_none()
            && let Some(table) = &mut self.table
        {
            let written = table.answered(&answered, &self.counters, now.unix_ms);
            match written.and_then(|()| self.recount()) {
                Ok(()) => return,
                Err(error) => self.fail(&error, now),
            }
        }
        if self.disk.is_some() {
            // Which reports the hub misses it will say again.
            self.unwritten.acknowledged.extend(answered.acknowledged);
            self.unwritten.removed.extend(answered.removed);
            self.done.extend(done);
        }
    }

    #[cfg(test)]
    pub(super) fn table(&self) -> &Table {
        self.table.as_ref().unwrap()
    }

    /// How it is.
    pub(super) fn counts(&self) -> OutboxCounts {
        let in_memory = self.memory.len() as u64;
        let on_disk = self.counts.waiting.saturating_sub(self.done.len() as u64);
        OutboxCounts {
            waiting: on_disk + in_memory,
            in_memory,
            lost: self.counters.lost,
            undeliverable: self.counters.undeliverable,
            durable: self.table.is_some() && self.counts.failing.is_none(),
            ..self.counts.clone()
        }
    }
}

/// A stored report as one of `node`: the state directory may have been another's.
fn readable(report: &StoredReport, node: &str) -> Result<ClipReport, String> {
    if report.json.len() > LARGEST_REPORT_BYTES {
        let size = report.json.len();
        return Err(format!("{size} bytes are more than a hub takes"));
    }
    let mut read: ClipReport =
        serde_json::from_slice(&report.json).map_err(|error| error.to_string())?;
    node.clone_into(&mut read.node);
    Ok(read)
}
