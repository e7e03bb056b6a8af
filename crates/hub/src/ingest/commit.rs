//! Writes a group of batches into one transaction: identities, clips, sums, counts, what was set aside, events.

use super::counters::IngestCounts;
use super::decode::{Batch, NotTaken, Taken};
use super::limits::EventLimits;
use super::plan::Seen;
use crate::presence::{Used, day_of};
use crate::store::tables::{ClipRow, EventRow, ReportCountsRow, SetAsideRow, SetupKey, SumRow};
use crate::store::{Database, StoreError};
use albireo_wire::{EnergyQuality, RefusedReport};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Length of the short sums, seconds.
const FIVE_MINUTES: i64 = 300;
/// Length of the long sums, seconds: days of UTC.
const DAY: i64 = 86_400;

/// Most cameras of a node.
pub(crate) const MOST_CAMERAS: usize = 64;

/// Most setups remembered: a threshold that changes all day must not fill the memory.
const MOST_SETUPS: usize = 10_000;

/// Names whose numbers are known. Forgotten after a failure: a number that was rolled back means nothing.
#[derive(Debug, Default)]
pub(crate) struct Numbers {
    nodes: HashMap<String, i64>,
    cameras: HashMap<i64, HashMap<String, i64>>,
    setups: HashMap<SetupKey, i64>,
}

impl Numbers {
    /// Forgets everything.
    pub(crate) fn forget(&mut self) {
        *self = Self::default();
    }

    /// The number of each of these nodes, in order, made where it is new at `now_ms`.
    pub(crate) fn nodes(
        &mut self,
        writing: &mut dyn Database,
        names: &[&str],
        now_ms: i64,
    ) -> Result<Vec<i64>, StoreError> {
        let new: BTreeSet<&str> = (names.iter().copied())
            .filter(|name| !self.nodes.contains_key(*name))
            .collect();
        let new: Vec<&str> = new.into_iter().collect();
        if !new.is_empty() {
            self.nodes.extend(writing.nodes(&new, now_ms)?);
        }
        let found = names.iter().map(|name| self.nodes.get(*name).copied());
        found.collect::<Option<_>>().ok_or_else(|| lost("a node"))
    }

    /// Learns the cameras of nodes, and makes those that are new where there is room for them.
    fn cameras(
        &mut self,
        writing: &mut dyn Database,
        wanted: &BTreeSet<(i64, &str)>,
    ) -> Result<(), StoreError> {
        for (node, _) in wanted {
            if !self.cameras.contains_key(node) {
                let cameras = writing.cameras_of(*node)?.into_iter();
                let cameras = cameras.map(|camera| (camera.name, camera.id)).collect();
                self.cameras.insert(*node, cameras);
            }
        }
        let mut new = Vec::new();
        for (node, name) in wanted {
            let known = self.cameras.entry(*node).or_default();
            if known.len() < MOST_CAMERAS && !known.contains_key(*name) {
                // Its number follows.
                known.insert((*name).to_owned(), 0);
                new.push((*node, *name));
            }
        }
        if !new.is_empty() {
            for camera in writing.add_cameras(&new)? {
                let known = self.cameras.entry(camera.node_id).or_default();
                known.insert(camera.name, camera.id);
            }
        }
        Ok(())
    }

    fn setups(
        &mut self,
        writing: &mut dyn Database,
        wanted: BTreeSet<&SetupKey>,
    ) -> Result<(), StoreError> {
        if self.setups.len() > MOST_SETUPS {
            self.setups.clear();
        }
        let new: Vec<&SetupKey> = wanted
            .into_iter()
            .filter(|setup| !self.setups.contains_key(*setup))
            .collect();
        if !new.is_empty() {
            self.setups.extend(writing.setups(&new)?);
        }
        Ok(())
    }
}

fn lost(what: &str) -> StoreError {
    StoreError::Statement(format!("{what} has no number after it was written"))
}

/// What the node of a batch is answered.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Outcome {
    /// Reports that are not stored.
    pub(crate) refused: Vec<RefusedReport>,
    /// Counts that the node is asked for.
    pub(crate) wanted: Vec<(u64, u64)>,
    /// Cameras of the node.
    pub(crate) cameras: usize,
}

/// What came of a group.
#[derive(Debug, Default)]
pub(crate) struct Committed {
    /// What is answered to each batch, in order.
    pub(crate) outcomes: Vec<Outcome>,
    /// Events to be written.
    pub(crate) events: Vec<EventRow>,
    /// What is counted of it.
    pub(crate) counts: IngestCounts,
    /// What the clips written used and saved, each with its node's place among the batches and the time it is filed under.
    pub(crate) used: Vec<(usize, i64, Used)>,
}

impl Committed {
    fn count(&mut self, place: usize, taken: &Taken, clip: &ClipRow) {
        let number = |column: i64| u64::try_from(column).unwrap_or(0);
        let of = |column: Option<i64>| column.map_or(0, number);
        let skipped = number(clip.frames_e + clip.frames_p - clip.degraded);
        self.counts += IngestCounts {
            clips: 1,
            clock_off: u64::from(!taken.record.clock),
            frames: number(clip.frames),
            frames_skipped: skipped,
            audit_frames: of(clip.audit_frames),
            audit_missed: of(clip.audit_missed),
            audit_detected: of(clip.audit_detected),
            audit_shown: of(clip.audit_shown),
            audit_paired: of(clip.audit_paired),
            energy_uj: of(clip.energy_uj),
            ..IngestCounts::default()
        };
        let used = Used {
            uj: clip.energy_uj.unwrap_or(0),
            estimated: clip.quality == super::clip::quality_code(EnergyQuality::Estimated),
            frames: number(clip.frames),
            skipped,
            detected: of(clip.audit_detected),
            paired: of(clip.audit_paired),
        };
        self.used.push((place, clip.at_ms, used));
    }
}

/// Writes `batches` into the transaction. Returns what the caller has to write and to answer.
pub(crate) fn write(
    writing: &mut dyn Database,
    numbers: &mut Numbers,
    limits: &mut EventLimits,
    batches: &[Batch],
    now_ms: i64,
) -> Result<Committed, StoreError> {
    let mut committed = Committed::default();
    let today = day_of(now_ms);
    if batches.is_empty() {
        return Ok(committed);
    }
    let names: Vec<&str> = batches.iter().map(|batch| batch.node.as_str()).collect();
    let nodes = numbers.nodes(writing, &names, now_ms)?;
    let distinct: BTreeSet<i64> = nodes.iter().copied().collect();
    let distinct: Vec<i64> = distinct.into_iter().collect();
    let mut known = writing.report_counts(&distinct, now_ms)?;
    let mut taken: Vec<(i64, &Taken)> = Vec::new();
    for (batch, node) in batches.iter().zip(&nodes) {
        let content = batch.reports.iter().map(|report| report.content.as_ref());
        taken.extend(content.flatten().map(|content| (*node, content)));
    }
    let keys = taken.iter().map(|(_, taken)| taken.key).collect();
    let mut new = writing.new_reports(&keys)?;
    taken.retain(|(_, taken)| new.contains(&taken.key.id));
    let cameras = taken
        .iter()
        .map(|(node, taken)| (*node, taken.record.camera.as_str()));
    numbers.cameras(writing, &cameras.collect())?;
    let setups = taken.iter().map(|(_, taken)| &taken.record.setup);
    numbers.setups(writing, setups.collect())?;

    let (mut clips, mut aside) = (Vec::new(), Vec::new());
    for (place, (batch, node)) in batches.iter().zip(&nodes).enumerate() {
        let row = (known.get_mut(node)).ok_or_else(|| lost("a node"))?;
        let mut outcome = Outcome::default();
        let (mut senseless, before) = (0, committed.counts.clock_off);
        let node_cameras = numbers.cameras.get(node);
        for report in &batch.reports {
            let mut is_new = false;
            let refused = match &report.content {
                Ok(taken) => {
                    // The same twice in one group is stored once.
                    is_new = new.remove(&taken.key.id);
                    let camera = node_cameras.and_then(|all| all.get(&taken.record.camera));
                    match (is_new, camera) {
                        (false, _) => {
                            committed.counts.again += 1;
                            None
                        }
                        (true, None) => {
                            let cause = format!("the node has {MOST_CAMERAS} cameras already");
                            Some((cause, Some(String::new())))
                        }
                        (true, Some(camera)) => {
                            let mut clip = taken.record.row.clone();
                            clip.day = match taken.key.day > 0 {
                                true => taken.key.day,
                                false => today,
                            };
                            clip.camera_id = *camera;
                            clip.setup_id = *(numbers.setups.get(&taken.record.setup))
                                .ok_or_else(|| lost("a setup"))?;
                            committed.count(place, taken, &clip);
                            row.stored += 1;
                            clips.push(clip);
                            None
                        }
                    }
                }
                Err(NotTaken::TooOld(reason)) => {
                    committed.counts.too_old += 1;
                    row.refused += 1;
                    Some((reason.clone(), None))
                }
                Err(NotTaken::Senseless { cause, body }) => {
                    Some((cause.clone(), Some(body.clone())))
                }
            };
            if let Some((reason, body)) = refused {
                if let Some(body) = body {
                    senseless += 1;
                    row.set_aside += 1;
                    if limits.may_set_aside(&batch.node, now_ms) {
                        aside.push(SetAsideRow {
                            node_id: *node,
                            report_id: report.id.map(|id| id.to_string()),
                            received_ms: now_ms,
                            cause: reason.clone(),
                            body,
                        });
                    }
                }
                if let Some(id) = report.id {
                    outcome.refused.push(RefusedReport { id, reason });
                }
                // A report that is not stored counts as one that never came.
                continue;
            }
            let event = match report.count.map(|count| row.counts.see(count, is_new)) {
                Some(Seen::Gap(first, last)) => {
                    committed.counts.missing += last - first + 1;
                    Some(("gap", json!({ "first": first, "last": last })))
                }
                Some(Seen::Reset) => {
                    committed.counts.resets += 1;
                    row.resets += 1;
                    Some(("reset", json!({ "count": report.count })))
                }
                Some(Seen::Expected) | None => None,
            };
            if let Some((kind, detail)) = event {
                limits.event(&mut committed.events, now_ms, kind, &batch.node, detail);
            }
        }
        committed.counts.set_aside += senseless;
        let off = committed.counts.clock_off - before;
        for (kind, what, count) in [
            ("set_aside", "reports", senseless),
            ("clock_off", "clips", off),
        ] {
            if count > 0 {
                let detail = json!({ what: count });
                limits.event(&mut committed.events, now_ms, kind, &batch.node, detail);
            }
        }
        row.last_ms = now_ms.max(row.last_ms);
        outcome.wanted = row.counts.wanted().to_vec();
        outcome.cameras = node_cameras.map_or(0, HashMap::len);
        committed.outcomes.push(outcome);
    }
    let rows: Vec<ReportCountsRow> = distinct
        .iter()
        .filter_map(|node| known.remove(node))
        .collect();
    writing.write_report_counts(&rows)?;
    writing.insert("set_aside", &aside, "")?;
    writing.insert("clips", &clips, "")?;
    writing.add_sums("sums_5m", &sums(&clips, FIVE_MINUTES))?;
    writing.add_sums("sums_day", &sums(&clips, DAY))?;
    Ok(committed)
}

/// The sums of these clips over spans of that many seconds, in the order of their keys: of each camera, and of the fleet.
fn sums(clips: &[ClipRow], seconds: i64) -> Vec<SumRow> {
    let mut sums: BTreeMap<_, SumRow> = BTreeMap::new();
    for clip in clips {
        let bucket = clip.at_ms.div_euclid(seconds * 1000) * seconds;
        for camera in [0, clip.camera_id] {
            let one = SumRow::of(clip, bucket, camera);
            sums.entry(one.key)
                .and_modify(|sum| sum.add(&one))
                .or_insert(one);
        }
    }
    sums.into_values().collect()
}
