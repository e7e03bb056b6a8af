//! Holds reports in the file of the state directory, and in memory while that fails. Has no clock: callers pass times.

use super::OutboxCounts;
use super::disk::{Disk, Witness};
use super::salvage::salvage;
use super::table::{
    ACKNOWLEDGED, AGAIN, Concluded, Counters, REFUSED, StoredReport, Table, TableError, WAITING,
};
use albireo_service::clock::{DAY_MS, Now};
use albireo_wire::{
    ClipReport, LARGEST_REPORT_BYTES, MOST_REPORTS, ReportAge, ReportAnswer, ReportBatch, VERSION,
};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use uuid::Uuid;

/// The time for which acknowledged reports are kept in case a hub loses them, if there is room and a disk.
const KEPT_MS: i64 = 7 * DAY_MS;

/// The maximum number of reports rescued to memory from a file that cannot be written.
const MOST_RESCUED: usize = 2000;

/// The maximum size of a batch's reports, bytes: well below a hub's limit and, compressed, far below an uplink's.
pub(super) const BATCH_BYTES: usize = 1 << 20;

/// The maximum number of reports per batch.
const BATCH_REPORTS: usize = 400;
const _: () = assert!(BATCH_REPORTS <= MOST_REPORTS);

/// The number of reports after which the log is copied into the file: a damaged byte of the log hides all that was written
/// since.
const CHECKPOINT_REPORTS: usize = 100;

/// The time after which the log is copied into the file, however few reports are in it.
const CHECKPOINT_AFTER: Duration = Duration::from_secs(60);

/// Which reports a batch may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BatchScope {
    /// Those that no hub has.
    New,
    /// Behind them, those that a hub has lost.
    NewAndForgotten,
}

/// Reports that no hub has, and acknowledged ones that a hub may lose.
#[derive(Debug)]
pub(crate) struct Waiting {
    disk: Option<Box<dyn Disk>>,
    most_bytes: u64,
    /// The file, or a table in memory while the file cannot be used. Reports in memory move to the file once that can be
    /// opened again.
    pub(super) table: Table,
    /// True if the table is the file.
    is_on_disk: bool,
    /// True once a file was opened since the start.
    was_on_disk: bool,
    /// A damaged file that was set aside, whose reports are not copied yet.
    damaged: Option<PathBuf>,
    checkpoint_at: Option<Instant>,
    counts: OutboxCounts,
}

impl Waiting {
    /// Creates it without reports, for a node without a state directory.
    ///
    /// # Errors
    /// [`TableError`] if there is no memory for a table.
    pub(super) fn in_memory() -> Result<Self, TableError> {
        // There is no earlier count to continue.
        let counters = Counters {
            made: Some(0),
            ..Counters::default()
        };
        Self::new(None, 0, counters)
    }

    /// Creates it without reports and without an open file.
    ///
    /// # Errors
    /// [`TableError`] if there is no memory for a table.
    pub(super) fn on_disk(disk: Box<dyn Disk>, most_bytes: u64) -> Result<Self, TableError> {
        Self::new(Some(disk), most_bytes, Counters::default())
    }

    fn new(
        disk: Option<Box<dyn Disk>>,
        most_bytes: u64,
        counters: Counters,
    ) -> Result<Self, TableError> {
        Ok(Self {
            disk,
            most_bytes,
            table: Table::in_memory(counters)?,
            is_on_disk: false,
            was_on_disk: false,
            damaged: None,
            checkpoint_at: None,
            counts: OutboxCounts::default(),
        })
    }

    /// Opens the file and moves the reports in memory to it. Sets a damaged file aside and begins another.
    pub(super) fn open(&mut self, now: Now) -> Result<(), TableError> {
        let Err(error) = self.open_file(now) else {
            return Ok(());
        };
        self.fail(&error);
        if error.is_corruption() {
            return self.open_file(now);
        }
        Err(error)
    }

    fn open_file(&mut self, now: Now) -> Result<(), TableError> {
        let Some(disk) = &mut self.disk else {
            return Ok(());
        };
        let mut file = Table::new(disk.open()?, self.most_bytes)?;
        let is_salvage = self.damaged.is_some();
        if let Some(damaged) = self.damaged.take()
            && let Err(error) = salvage(&damaged, &mut file)
        {
            tracing::error!(%error, "nothing more can be read of the damaged file");
        }
        // The counts since the start continue the earlier ones.
        let before = file.counters;
        file.counters = file.counters.max(self.table.counters);
        let in_memory = self.table.reports(REFUSED, usize::MAX)?;
        let lost = file.insert(&in_memory)?;
        if (is_salvage || !self.was_on_disk)
            && let Some(witness) = disk.witness()
            // A witness that is older than the file knows nothing more.
            && (is_salvage || before.made < Some(witness.made))
        {
            let gone = recount(&mut file, witness)?;
            if gone > 0 {
                self.counts.last_loss = Some(now.at);
                tracing::error!(
                    reports = gone,
                    "clip reports lost: the file that held them was damaged or replaced"
                );
            }
        }
        let count = file.count()?;
        self.counts.status.waiting = count.waiting;
        self.counts.again = count.again;
        self.table = file;
        self.is_on_disk = true;
        self.was_on_disk = true;
        self.lose(lost, now);
        self.counts.failing = None;
        Ok(())
    }

    /// Tries a failed disk again. May write a file.
    pub(crate) fn retry_disk(&mut self, now: Now) {
        if self.counts.failing.is_some() {
            // `open` records the reason.
            let _ = self.open(now);
        }
        self.checkpoint(now);
    }

    /// Copies the log into the file if much, or something old, is only in the log. Writes a file.
    fn checkpoint(&mut self, now: Now) {
        if !self.is_on_disk || self.table.written == 0 {
            self.checkpoint_at = None;
            return;
        }
        let at = *self.checkpoint_at.get_or_insert(now.at + CHECKPOINT_AFTER);
        if self.table.written >= CHECKPOINT_REPORTS || now.at >= at {
            self.checkpoint_at = None;
            if let Err(error) = self.table.checkpoint() {
                tracing::debug!(%error, "the log of reports is not copied now");
            }
        }
    }

    /// Records that the file cannot be used, continues in memory, and sets a damaged file aside.
    fn fail(&mut self, error: &TableError) {
        // The readiness logs it.
        self.counts.failing = Some(format!("the state directory cannot be used: {error}"));
        self.counts.disk_failures += 1;
        if self.is_on_disk {
            self.is_on_disk = false;
            if let Err(error) = self.rescue() {
                tracing::warn!(%error, "clip reports on the disk cannot be read now");
            }
        }
        if !error.is_corruption() {
            return;
        }
        let Some(disk) = &mut self.disk else {
            return;
        };
        match disk.set_aside() {
            Ok(aside) => {
                tracing::error!(
                    aside = %aside.display(), %error,
                    "the file of clip reports is damaged and was set aside; what can be read of it is copied"
                );
                self.damaged = Some(aside);
            }
            Err(error) => tracing::debug!(%error, "a damaged file cannot be set aside"),
        }
    }

    /// Replaces the file by a table in memory with the waiting reports that can be read.
    fn rescue(&mut self) -> Result<(), TableError> {
        let counters = self.table.counters;
        let file = std::mem::replace(&mut self.table, Table::in_memory(counters)?);
        let rescued = match file.reports(AGAIN, MOST_RESCUED) {
            Ok(found) => self.table.insert(&found).map(drop),
            Err(error) => Err(error),
        };
        // The rest is not lost: it is on the disk, and returns with it.
        self.table.counters = counters;
        rescued
    }

    /// Does `work` on the file, or in memory if that fails.
    fn work<T: Default>(&mut self, work: impl Fn(&mut Table) -> Result<T, TableError>) -> T {
        let work_and_count = |table: &mut Table| Ok((work(table)?, table.count()?));
        let checked = match &self.disk {
            Some(disk) if self.is_on_disk => disk.check(),
            _ => Ok(()),
        };
        let mut outcome = match checked {
            Ok(()) => work_and_count(&mut self.table),
            Err(error) => Err(error),
        };
        if let Err(error) = &outcome
            && self.is_on_disk
        {
            // The table is in memory from here on.
            self.fail(error);
            outcome = work_and_count(&mut self.table);
        }
        match outcome {
            Ok((done, count)) => {
                self.counts.status.waiting = count.waiting;
                self.counts.again = count.again;
                self.testify(count.oldest);
                done
            }
            Err(error) => {
                tracing::error!(%error, "clip reports cannot be kept in memory");
                T::default()
            }
        }
    }

    /// Notes the counts beside the file; `oldest` is the lowest count that waits.
    fn testify(&self, oldest: Option<u64>) {
        let Counters {
            made,
            lost,
            undeliverable,
        } = self.table.counters;
        let (Some(disk), Some(made)) = (&self.disk, made) else {
            return;
        };
        disk.testify(Witness {
            made,
            lost,
            undeliverable,
            settled: match oldest {
                Some(oldest) => oldest.saturating_sub(1),
                None => made,
            },
        });
    }

    /// Keeps reports in order and sets their running counts. Writes a file.
    pub(crate) fn insert(&mut self, reports: &mut [ClipReport], now: Now) {
        let mut rows = Vec::with_capacity(reports.len());
        for report in reports {
            let made = &mut self.table.counters.made;
            *made = made.map(|made| made + 1);
            report.count = *made;
            self.counts.kept += 1;
            // Cannot fail: a report holds numbers and text. An empty row would count as undeliverable.
            let json = serde_json::to_vec(report).unwrap_or_default();
            rows.push(StoredReport {
                id: report.id,
                count: report.count,
                state: WAITING,
                acknowledged_ms: 0,
                json,
                made: Some(now.uptime),
                sent: false,
                checksum: None,
            });
        }
        let lost = self.work(|table| table.insert(&rows));
        self.lose(lost, now);
        self.checkpoint(now);
    }

    fn lose(&mut self, reports: u64, now: Now) {
        if reports > 0 {
            self.counts.last_loss = Some(now.at);
            tracing::warn!(reports, "clip reports lost: there is no room for them");
        }
    }

    /// The oldest reports to send, as reports of `node`. Unreadable reports are counted as undeliverable. Reads, and may
    /// write, a file.
    pub(crate) fn batch(&mut self, node: &str, scope: BatchScope, now: Now) -> Option<ReportBatch> {
        let BatchRead {
            reports,
            unreadable,
        } = self.work(|table| read(table, node, scope));
        if !unreadable.is_empty() {
            self.conclude(&unreadable, &[], now);
        }
        if reports.is_empty() {
            return None;
        }
        // First, so that after a crash nobody takes them for reports that were never sent.
        let ids: Vec<Uuid> = reports
            .iter()
            .filter(|report| !report.stored.sent)
            .map(|report| report.stored.id)
            .collect();
        if !ids.is_empty() {
            self.work(|table| table.note_sent(&ids));
        }
        let mut batch = ReportBatch {
            v: VERSION,
            node: node.to_owned(),
            t_ms: u64::try_from(now.unix_ms).unwrap_or(0),
            ages: Vec::with_capacity(reports.len()),
            reports: Vec::with_capacity(reports.len()),
        };
        for ReadReport { stored, report } in reports {
            batch.ages.push(ReportAge {
                made_s: stored.made.and_then(|made| now.uptime.since(made)),
                // The state directory may have belonged to another node, which sent it.
                first: !stored.sent && report.node == node,
            });
            batch.reports.push(ClipReport {
                node: node.to_owned(),
                ..report
            });
        }
        Some(batch)
    }

    /// Applies a hub's answer to `batch` and returns the number of reports it has stored. Writes a file.
    pub(crate) fn answered(&mut self, batch: &ReportBatch, answer: &ReportAnswer, now: Now) -> u64 {
        let refused: BTreeMap<Uuid, &str> = answer
            .refused
            .iter()
            .map(|refused| (refused.id, refused.reason.as_str()))
            .collect();
        let mut concluded = Vec::with_capacity(batch.reports.len());
        for ClipReport { id, .. } in &batch.reports {
            let mut state = ACKNOWLEDGED;
            if let Some(reason) = refused.get(id) {
                tracing::error!(%id, reason, "the hub rejected a clip report");
                state = REFUSED;
            }
            concluded.push(Concluded { id: *id, state });
        }
        let stored = self.conclude(&concluded, &answer.missing, now);
        self.counts.acknowledged += stored;
        self.checkpoint(now);
        stored
    }

    /// Sets the states of reports that are not waiting any more, and returns the number of those that a hub has.
    fn conclude(&mut self, concluded: &[Concluded], missing: &[(u64, u64)], now: Now) -> u64 {
        let refused = concluded.iter().filter(|report| report.state == REFUSED).count() as u64;
        self.table.counters.undeliverable += refused;
        self.counts.refused += refused;
        if refused > 0 {
            self.counts.last_refusal = Some(now.at);
        }
        let kept_ms = if self.disk.is_some() { KEPT_MS } else { -1 };
        self.work(|table| table.conclude(concluded, missing, now.unix_ms, kept_ms));
        concluded.len() as u64 - refused
    }

    /// Returns the counts, and the state of the disk.
    pub(super) fn counts(&self) -> OutboxCounts {
        let mut counts = self.counts.clone();
        counts.status.lost = self.table.counters.lost;
        counts.status.undeliverable = self.table.counters.undeliverable;
        counts.status.durable = self.is_on_disk;
        counts
    }
}

/// Continues the counts of the second witness, and counts what it saw and the file does not have as lost. Returns that number.
fn recount(file: &mut Table, witness: Witness) -> Result<u64, TableError> {
    let seen = Counters {
        made: Some(witness.made),
        lost: witness.lost,
        undeliverable: witness.undeliverable,
    };
    let there = file.count_between(witness.settled, witness.made)?;
    let gone = witness.made.saturating_sub(witness.settled).saturating_sub(there);
    file.counters = file.counters.max(seen);
    file.counters.lost += gone;
    // Writes the counters.
    file.insert(&[])?;
    Ok(gone)
}

/// What the table has for a batch.
#[derive(Default)]
struct BatchRead {
    reports: Vec<ReadReport>,
    /// The unreadable ones with their new state.
    unreadable: Vec<Concluded>,
}

/// A report that can be sent.
struct ReadReport {
    /// As it is stored.
    stored: StoredReport,
    /// As it is sent.
    report: ClipReport,
}

fn read(table: &Table, node: &str, scope: BatchScope) -> Result<BatchRead, TableError> {
    let mut found = BatchRead::default();
    let mut bytes = 0;
    // Those that a hub has lost follow those that none has.
    let last_state = match scope {
        BatchScope::New => WAITING,
        BatchScope::NewAndForgotten => AGAIN,
    };
    for stored in table.reports(last_state, BATCH_REPORTS)? {
        bytes += stored.json.len();
        match parse(&stored) {
            Ok(_) if bytes > BATCH_BYTES && !found.reports.is_empty() => break,
            Ok(report) => found.reports.push(ReadReport { stored, report }),
            Err(reason) => {
                let id = stored.id;
                tracing::error!(node, %id, reason, "a clip report cannot be sent");
                found.unreadable.push(Concluded { id, state: REFUSED });
            }
        }
    }
    Ok(found)
}

fn parse(report: &StoredReport) -> Result<ClipReport, String> {
    if report.json.len() > LARGEST_REPORT_BYTES {
        let size = report.json.len();
        return Err(format!("{size} bytes are more than a hub accepts"));
    }
    if !report.is_intact() {
        return Err("it was damaged on the disk: its checksum is wrong".to_owned());
    }
    serde_json::from_slice(&report.json).map_err(|error| error.to_string())
}
