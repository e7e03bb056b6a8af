//! Writes groups of batches, each in one transaction, and builds their answers. It uses no thread, network or clock.

use super::counters::IngestCounts;
use super::decode::{Batch, Rejected};
use super::limits::{ClockCheck, EVENTS, EntryLimit, PRESENCE, SET_ASIDE};
use super::outcomes::Written;
use super::plan::{Doubt, Seen};
use super::retention::{DeleteOld, retain};
use super::tables::MOST_CAMERAS;
use crate::config::HistoryConfig;
use crate::presence::NodeView;
use crate::store::row::{Columns, beginning, event};
use crate::store::{Access, Database, Store, StoreError};
use albireo_service::clock::{DAY_MS, Now};
use albireo_wire::{RefusedReport, ReportAnswer};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::time::{Duration, Instant};

/// Interval between two searches for old rows, after one that found none.
const RETENTION: Duration = Duration::from_secs(60);

/// Most events of unreadable batches that wait for the database; further ones are dropped.
const MOST_EVENTS: usize = 1000;

/// Most reports that count as missing in one gap, and most of a node: more than a node makes in a year. A number that one node
/// invents must not be the fleet's figure.
const LARGEST_GAP: u64 = 1_000_000;
const MOST_MISSING: u64 = 32 * LARGEST_GAP;

/// Stores batches in a database.
pub struct Recorder {
    store: Store,
    database: Option<Box<dyn Database>>,
    history: HistoryConfig,
    /// Deletes old rows of other rooms' tables.
    delete_more: Option<DeleteOld>,
    /// Events of unreadable batches, which the next commit writes.
    events: Vec<Value>,
    event_limit: EntryLimit,
    presence_limit: EntryLimit,
    aside_limit: EntryLimit,
    clock: ClockCheck,
    retention_due: Instant,
    /// True if the next transaction writes a row in any case.
    proves_writing: bool,
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
    /// What is now stored for certain. Rows that are written anyway do not count: only a report, and the row of a proof.
    pub(super) written: Written,
}

impl Recorder {
    /// Creates a recorder, which connects at its first use.
    pub fn new(store: &Store, history: &HistoryConfig, now: Now) -> Self {
        Self {
            store: store.clone(),
            database: None,
            history: history.clone(),
            delete_more: None,
            events: Vec::new(),
            event_limit: EntryLimit::new(EVENTS),
            presence_limit: EntryLimit::new(PRESENCE),
            aside_limit: EntryLimit::new(SET_ASIDE),
            clock: ClockCheck::new(now.at, now.unix_ms),
            retention_due: now.at,
            proves_writing: false,
        }
    }

    /// Deletes old rows of other tables, too, when it deletes its own: it knows whether the clock may be believed.
    pub(crate) fn also_deletes(self, delete: DeleteOld) -> Self {
        Self {
            delete_more: Some(delete),
            ..self
        }
    }

    /// Lets the next transaction write a row in any case: it then shows whether the database accepts a commit.
    pub(super) fn prove_writing(&mut self) {
        self.proves_writing = true;
    }

    /// Notes that a batch of a node cannot be read.
    pub(super) fn unreadable(&mut self, node: &str, reason: &str, now_ms: i64) {
        if self.events.len() < MOST_EVENTS && self.event_limit.allows(node, "refused", now_ms) {
            let reason = beginning(reason);
            tracing::warn!(node, reason, "a batch cannot be read");
            let detail = json!({ "reason": reason });
            self.events.push(event(now_ms, "refused", node, detail));
        }
    }

    /// Stores batches, and the states of `nodes`, in one transaction. If it is time, first deletes some old rows.
    ///
    /// # Errors
    /// When the database refuses the transaction: then nothing is stored.
    pub fn record(
        &mut self,
        batches: &[Batch],
        nodes: &[NodeView],
        now: Now,
    ) -> Result<Recorded, StoreError> {
        if self.retention_due <= now.at {
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
        let mut events = database.write_nodes(nodes)?;
        events.retain(|event| {
            let node = event["node"].as_str().unwrap_or_default();
            self.presence_limit.allows(node, "node", now.unix_ms)
        });
        events.extend_from_slice(&self.events);
        let mut recorded = match batches {
            [] => Recorded::default(),
            _ => self.write(&mut *database, batches, now.unix_ms, &mut events)?,
        };
        database.insert("events", &events, "")?;
        if self.proves_writing {
            database.prove_writing(now.unix_ms)?;
        }
        database.commit()?;
        recorded.written = if recorded.counts.clips > 0 {
            Written::Reports
        } else if self.proves_writing {
            Written::Rows
        } else {
            Written::Nothing
        };
        self.proves_writing = false;
        self.database = Some(database);
        self.events.clear();
        for batch in batches {
            self.clock.note(&batch.node, batch.clocks_agree);
        }
        Ok(recorded)
    }

    /// Deletes some old rows. Returns true if there are more.
    fn retain(&mut self, now: Now) -> Result<bool, StoreError> {
        let mut database = self.store.connect(Access::Write, self.database.take())?;
        let is_believed = self.clock.is_believed(now.at, now.unix_ms);
        let more = retain(
            &mut *database,
            &self.history,
            self.delete_more,
            now.unix_ms,
            is_believed,
        )?;
        self.database = Some(database);
        Ok(more)
    }

    /// Writes `batches` into the transaction: identities of reports, clips, sums, counts, and invalid reports.
    fn write(
        &mut self,
        database: &mut dyn Database,
        batches: &[Batch],
        now_ms: i64,
        events: &mut Vec<Value>,
    ) -> Result<Recorded, StoreError> {
        let names: BTreeSet<&str> = batches.iter().map(|batch| batch.node.as_str()).collect();
        let names: Vec<&str> = names.into_iter().collect();
        let mut nodes = database.reporting_nodes(&names, now_ms)?;
        let mut cameras = database.cameras(&names)?;
        let reports = batches.iter().flat_map(|batch| &batch.reports);
        let accepted = reports.filter_map(|report| report.content.as_ref().ok());
        let mut new = database.new_reports(&accepted.clone().map(|(key, _)| *key).collect())?;
        let setups = accepted.filter(|(key, _)| new.contains(&key.id));
        let setups = database.setups(setups.map(|(_, clip)| &clip.setup).collect())?;

        let too_many = Rejected {
            reason: format!("the node has {MOST_CAMERAS} cameras already"),
            text: Some(String::new()),
        };
        let mut clips = Vec::new();
        let mut aside = Vec::new();
        let mut refused = BTreeSet::new();
        let mut recorded = Recorded::default();
        let counts = &mut recorded.counts;
        let mut note = |node: &str, kind: &'static str, detail: Value| {
            if self.event_limit.allows(node, kind, now_ms) {
                events.push(event(now_ms, kind, node, detail));
            }
        };
        for batch in batches {
            let node = nodes.get_mut(&batch.node).ok_or_else(|| lost("a node"))?;
            let cameras = cameras.entry(node.node_id).or_default();
            let mut answer = ReportAnswer::default();
            let mut invalid = 0;
            let mut clocks_off = 0;
            let mut too_old = None;
            for report in &batch.reports {
                let mut is_new = false;
                let mut rejected = None;
                let doubtful = report.doubt.as_ref().map(|doubt| Rejected {
                    reason: doubt.reason.clone(),
                    text: None,
                });
                let cleared = |doubt: &Doubt| node.counts.lack(report.count, doubt.first);
                let is_doubtful = !report.doubt.as_ref().is_none_or(cleared);
                match &report.content {
                    Err(why) => rejected = Some(why),
                    Ok((key, _))
                        if is_doubtful && (new.remove(&key.id) || refused.contains(key)) =>
                    {
                        refused.insert(*key);
                        rejected = doubtful.as_ref();
                    }
                    // It was stored before, or earlier in this group.
                    Ok((key, _)) if !new.remove(&key.id) => counts.again += 1,
                    Ok((key, clip)) => {
                        is_new = true;
                        let mut camera = cameras.get(&clip.camera).copied();
                        if camera.is_none() && cameras.len() < MOST_CAMERAS {
                            let added = database.add_camera(node.node_id, &clip.camera)?;
                            cameras.insert(clip.camera.clone(), added);
                            camera = Some(added);
                        }
                        if let Some(camera) = camera {
                            let setup = setups.get(&clip.setup);
                            let setup = *setup.ok_or_else(|| lost("a setup"))?;
                            let today = now_ms.div_euclid(DAY_MS);
                            let day = if key.day > 0 { key.day } else { today };
                            let mut row = clip.row.clone();
                            let more = [("day", day), ("camera_id", camera), ("setup_id", setup)];
                            row.extend(more.map(|(column, number)| (column, number.into())));
                            *counts += counted(&row);
                            clips.push(row);
                            clocks_off += u64::from(!clip.clock);
                            node.totals.stored += 1;
                        } else {
                            rejected = Some(&too_many);
                        }
                    }
                }
                if let Some(Rejected { reason, text }) = rejected {
                    if let Some(text) = text {
                        invalid += 1;
                        if self.aside_limit.allows(&batch.node, "", now_ms) {
                            aside.push(json!({
                                "node_id": node.node_id,
                                "report_id": report.id.map(|id| id.to_string()),
                                "received_ms": now_ms,
                                "cause": reason,
                                "body": text,
                            }));
                        }
                    } else {
                        counts.too_old += 1;
                        node.totals.refused += 1;
                        let (reports, _) = too_old.get_or_insert_with(|| (0_u64, reason.clone()));
                        *reports += 1;
                    }
                    let reason = reason.clone();
                    let refused = report.id.map(|id| RefusedReport { id, reason });
                    answer.refused.extend(refused);
                    // A report that is not stored counts as missing.
                    continue;
                }
                let seen = report.count.map(|count| node.counts.see(count, is_new));
                let (kind, detail) = match seen {
                    Some(Seen::Gap(first, last)) => {
                        let missing = (last - first + 1).min(LARGEST_GAP);
                        counts.missing = counts.missing.saturating_add(missing);
                        let detail = json!({ "first": first, "last": last, "missing": missing });
                        ("gap", detail)
                    }
                    Some(Seen::Reset) => {
                        counts.resets += 1;
                        node.totals.resets += 1;
                        ("reset", json!({ "count": report.count }))
                    }
                    Some(Seen::Expected) | None => continue,
                };
                note(&batch.node, kind, detail);
            }
            counts.set_aside += invalid;
            counts.clock_off += clocks_off;
            node.totals.set_aside += i64::try_from(invalid).unwrap_or(i64::MAX);
            node.totals.last_ms = now_ms.max(node.totals.last_ms);
            if let Some((reports, reason)) = too_old {
                note(
                    &batch.node,
                    "refused",
                    json!({ "reports": reports, "reason": reason }),
                );
            }
            for (kind, what, count) in [
                ("set_aside", "reports", invalid),
                ("clock_off", "clips", clocks_off),
            ] {
                if count > 0 {
                    note(&batch.node, kind, json!({ what: count }));
                }
            }
            node.totals.missing = node.counts.missing().min(MOST_MISSING);
            answer.missing = node.counts.wanted().to_vec();
            recorded.answers.push(answer);
            recorded.cameras.push(cameras.len());
        }
        database.forget_reports(&refused)?;
        database.write_report_counts(nodes.into_values().collect())?;
        database.insert("set_aside", &aside, "")?;
        database.insert_clips(clips)?;
        Ok(recorded)
    }
}

fn lost(what: &str) -> StoreError {
    StoreError::Statement(format!("{what} has no id after it was written"))
}

/// The additions to the counters for a stored clip; null counts as 0.
fn counted(clip: &Columns<'_>) -> IngestCounts {
    let count = |column: &str| {
        let found = clip.iter().find(|(name, _)| *name == column);
        found.and_then(|(_, value)| value.as_u64()).unwrap_or(0)
    };
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
