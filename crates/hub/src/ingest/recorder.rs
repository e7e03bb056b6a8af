//! Writes groups of batches, each in one transaction, and builds their answers. It uses no thread, network or clock.

use super::counters::IngestCounts;
use super::decode::{Accepted, Batch, Rejected};
use super::limits::{ClockCheck, EVENTS, EntryLimit, SET_ASIDE};
use super::plan::Seen;
use crate::config::HistoryConfig;
use crate::presence::News;
use crate::store::retention::retain;
use crate::store::row::Row;
use crate::store::tables::EventRow;
use crate::store::{Access, Database, MOST_CAMERAS, Store, StoreError};
use albireo_service::clock::{DAY_MS, Now};
use albireo_wire::{RefusedReport, ReportAnswer};
use serde_json::{Value, json};
use std::collections::{BTreeSet, HashMap};
use std::time::{Duration, Instant};

/// Interval between two searches for old rows, after one that found none.
const RETENTION: Duration = Duration::from_secs(60);

/// Stores batches in a database.
pub struct Recorder {
    store: Store,
    database: Option<Box<dyn Database>>,
    history: HistoryConfig,
    event_limit: EntryLimit,
    aside_limit: EntryLimit,
    clock: ClockCheck,
    retention_due: Instant,
}

/// The result of a commit.
#[derive(Debug, Default)]
pub struct Recorded {
    /// The answer to each batch, in order.
    pub answers: Vec<ReportAnswer>,
    /// The number of cameras of each batch's node, in order.
    pub(crate) cameras: Vec<usize>,
    /// The additions to the counters.
    pub(crate) counts: IngestCounts,
    /// The events that it wrote.
    pub(crate) events: Vec<EventRow>,
}

impl Recorder {
    /// Creates a recorder, which connects at its first use.
    pub fn new(store: &Store, history: &HistoryConfig, now: Now) -> Self {
        Self {
            store: store.clone(),
            database: None,
            history: history.clone(),
            event_limit: EntryLimit::new(EVENTS),
            aside_limit: EntryLimit::new(SET_ASIDE),
            clock: ClockCheck::new(now.at, now.unix_ms),
            retention_due: now.at,
        }
    }

    /// True if the last transaction succeeded.
    pub(crate) const fn is_proven(&self) -> bool {
        self.database.is_some()
    }

    /// True if it is time to delete old rows.
    pub fn retention_is_due(&self, now: Instant) -> bool {
        self.retention_due <= now
    }

    /// Stores batches and `news` in one transaction. If `retention` is due, first deletes some old rows.
    ///
    /// # Errors
    /// When the database refuses the transaction: then nothing is stored.
    pub fn record(
        &mut self,
        batches: &[Batch],
        news: &News,
        retention: bool,
        now: Now,
    ) -> Result<Recorded, StoreError> {
        if retention {
            let more = self.retain(now).unwrap_or_else(|error| {
                tracing::warn!(%error, "old rows were not deleted; trying again in a minute");
                false
            });
            let pause = if more { Duration::ZERO } else { RETENTION };
            self.retention_due = now.at + pause;
        }
        // After an error the connection is dropped, which rolls the transaction back.
        let mut database = self.store.connect(Access::Write, self.database.take())?;
        database.begin()?;
        let events = news.write(&mut *database)?;
        let mut recorded = Recorded {
            events,
            ..Recorded::default()
        };
        if !batches.is_empty() {
            self.write(&mut *database, batches, now.unix_ms, &mut recorded)?;
        }
        database.insert("events", &recorded.events, "")?;
        database.commit()?;
        self.database = Some(database);
        for batch in batches {
            self.clock.note(&batch.node, batch.clocks_agree);
        }
        Ok(recorded)
    }

    /// Deletes some old rows. Returns true if there are more.
    fn retain(&mut self, now: Now) -> Result<bool, StoreError> {
        let mut database = self.store.connect(Access::Write, self.database.take())?;
        let is_believed = self.clock.is_believed(now.at, now.unix_ms);
        let more = retain(&mut *database, &self.history, now.unix_ms, is_believed)?;
        self.database = Some(database);
        Ok(more)
    }

    /// Writes `batches` into the transaction: identities of reports, clips, sums, counts, and invalid reports.
    fn write(
        &mut self,
        database: &mut dyn Database,
        batches: &[Batch],
        now_ms: i64,
        recorded: &mut Recorded,
    ) -> Result<(), StoreError> {
        let names: BTreeSet<&str> = batches.iter().map(|batch| batch.node.as_str()).collect();
        let names: Vec<&str> = names.into_iter().collect();
        let mut nodes = database.reporting_nodes(&names, now_ms)?;
        let accepted = batches.iter().flat_map(|batch| {
            let contents = batch.reports.iter().map(|report| report.content.as_ref());
            contents
                .flatten()
                .map(|accepted| (batch.node.as_str(), accepted))
        });
        let mut new =
            database.new_reports(&accepted.clone().map(|(_, accepted)| accepted.key).collect())?;
        let accepted: Vec<_> = accepted
            .filter(|(_, accepted)| new.contains(&accepted.key.id))
            .collect();
        let setups = accepted.iter().map(|(_, accepted)| &accepted.record.setup);
        let setups = database.setups(&setups.collect())?;
        let wanted = accepted.iter().map(|(node, accepted)| {
            let node = nodes.get(*node).ok_or_else(|| lost("a node"))?;
            Ok((node.node_id, accepted.record.camera.as_str()))
        });
        let wanted = wanted.collect::<Result<BTreeSet<_>, StoreError>>()?;
        let cameras = database.cameras(&names, wanted)?;

        let too_many = Rejected::Invalid {
            cause: format!("the node has {MOST_CAMERAS} cameras already"),
            body: String::new(),
        };
        let (mut clips, mut aside) = (Vec::new(), Vec::new());
        let (counts, events) = (&mut recorded.counts, &mut recorded.events);
        let mut event = |node: &str, kind: &'static str, detail: Value| {
            if self.event_limit.allows(node, kind, now_ms) {
                events.push(EventRow::new(now_ms, kind, node, detail));
            }
        };
        for batch in batches {
            let node = nodes.get_mut(&batch.node).ok_or_else(|| lost("a node"))?;
            let node_cameras = cameras.get(&node.node_id);
            let mut answer = ReportAnswer::default();
            let (mut invalid, mut clocks_off) = (0, 0);
            for report in &batch.reports {
                let mut is_new = false;
                let rejected = match &report.content {
                    // It was stored before, or earlier in this group.
                    Ok(accepted) if !new.remove(&accepted.key.id) => {
                        counts.again += 1;
                        None
                    }
                    Ok(accepted) => {
                        is_new = true;
                        match node_cameras.and_then(|all| all.get(&accepted.record.camera)) {
                            None => Some(&too_many),
                            Some(camera) => {
                                let setup = setups.get(&accepted.record.setup);
                                let setup = setup.ok_or_else(|| lost("a setup"))?;
                                clips.push(clip(accepted, *camera, *setup, now_ms));
                                *counts += counted(&accepted.record.row);
                                clocks_off += u64::from(!accepted.record.clock);
                                node.totals.stored += 1;
                                None
                            }
                        }
                    }
                    Err(rejected) => Some(rejected),
                };
                if let Some(rejected) = rejected {
                    let reason = match rejected {
                        Rejected::TooOld(reason) => {
                            counts.too_old += 1;
                            node.totals.refused += 1;
                            reason
                        }
                        Rejected::Invalid { cause, body } => {
                            invalid += 1;
                            if self.aside_limit.allows(&batch.node, "", now_ms) {
                                aside.push(json!({
                                    "node_id": node.node_id,
                                    "report_id": report.id.map(|id| id.to_string()),
                                    "received_ms": now_ms,
                                    "cause": cause,
                                    "body": body,
                                }));
                            }
                            cause
                        }
                    };
                    let reason = reason.clone();
                    let refused = report.id.map(|id| RefusedReport { id, reason });
                    answer.refused.extend(refused);
                    // A report that is not stored counts as missing.
                    continue;
                }
                let seen = report.count.map(|count| node.counts.see(count, is_new));
                let (kind, detail) = match seen {
                    Some(Seen::Gap(first, last)) => {
                        counts.missing += last - first + 1;
                        ("gap", json!({ "first": first, "last": last }))
                    }
                    Some(Seen::Reset) => {
                        counts.resets += 1;
                        node.totals.resets += 1;
                        ("reset", json!({ "count": report.count }))
                    }
                    Some(Seen::Expected) | None => continue,
                };
                event(&batch.node, kind, detail);
            }
            counts.set_aside += invalid;
            counts.clock_off += clocks_off;
            node.totals.set_aside += i64::try_from(invalid).unwrap_or(i64::MAX);
            node.totals.last_ms = now_ms.max(node.totals.last_ms);
            for (kind, what, count) in [
                ("set_aside", "reports", invalid),
                ("clock_off", "clips", clocks_off),
            ] {
                if count > 0 {
                    event(&batch.node, kind, json!({ what: count }));
                }
            }
            node.totals.missing = node.counts.missing();
            answer.missing = node.counts.wanted().to_vec();
            recorded.answers.push(answer);
            recorded.cameras.push(node_cameras.map_or(0, HashMap::len));
        }
        database.write_report_counts(nodes.into_values().collect())?;
        database.insert("set_aside", &aside, "")?;
        database.insert_clips(clips)
    }
}

fn lost(what: &str) -> StoreError {
    StoreError::Statement(format!("{what} has no id after it was written"))
}

/// The row of a clip.
fn clip(accepted: &Accepted, camera: i64, setup: i64, now_ms: i64) -> Row {
    let day = match accepted.key.day > 0 {
        true => accepted.key.day,
        false => now_ms.div_euclid(DAY_MS),
    };
    let mut row = accepted.record.row.clone();
    for (column, number) in [("day", day), ("camera_id", camera), ("setup_id", setup)] {
        row.insert(column.to_owned(), number.into());
    }
    row
}

/// The additions to the counters for a stored clip; null counts as 0.
fn counted(clip: &Row) -> IngestCounts {
    let count = |column: &str| clip.get(column).and_then(Value::as_u64).unwrap_or(0);
    IngestCounts {
        clips: 1,
        frames: count("frames"),
        frames_skipped: count("avoided_calls"),
        audit_frames: count("audit_frames"),
        audit_missed: count("audit_missed"),
        audit_detected: count("audit_detected"),
        audit_shown: count("audit_shown"),
        audit_paired: count("audit_paired"),
        energy_uj: count("energy_uj"),
        ..IngestCounts::default()
    }
}
