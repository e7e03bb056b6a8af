//! Commits a group of batches in one transaction: cursors, clips, sums, what was set aside, events.

use super::clip::{Facts, facts};
use super::decode::{Batch, Unread, unread};
use super::plan::{Outcome, Plan, below, plan};
use crate::config::HistoryConfig;
use crate::presence::Used;
use crate::store::rows::text;
use crate::store::tables::ClipRow;
use crate::store::tables::{EventRow, GapRow, InstanceRow, SetAsideRow, SumRow};
use crate::store::{Instance, SetupKey, StoreError, Writing};
use albireo_wire::EnergyQuality;
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet, HashMap};

const DAY_MS: i64 = 86_400_000;

/// Length of the short sums, seconds.
const FIVE_MINUTES: i64 = 300;
/// Length of the long sums, seconds: days of UTC.
const DAY: i64 = 86_400;

/// Names whose numbers are known. Forgotten after a failure: a number that was rolled back means nothing.
#[derive(Debug, Default)]
pub(crate) struct Numbers {
    nodes: HashMap<String, i64>,
    cameras: HashMap<(i64, String), i64>,
    setups: HashMap<SetupKey, i64>,
}

/// Most setups remembered: whoever turns a knob all day must not fill the memory.
const MOST_SETUPS: usize = 10_000;

/// What came of a group.
#[derive(Debug, Default)]
pub(crate) struct Committed {
    /// What each batch's node is told, in the order of the batches.
    pub(crate) outcomes: Vec<Outcome>,
    /// Clips written.
    pub(crate) clips: u64,
    /// Reports that were there already.
    pub(crate) again: u64,
    /// Reports set aside.
    pub(crate) set_aside: u64,
    /// Numbers found missing.
    pub(crate) missing: u64,
    /// Conflicts found.
    pub(crate) conflicts: u64,
    /// Clips of a node whose clock is off.
    pub(crate) clock_off: u64,
    /// Frames of the clips written.
    pub(crate) frames: u64,
    /// Those of them that skipped the detector.
    pub(crate) skipped: u64,
    /// What the audits of the clips written have found.
    pub(crate) audit: Audited,
    /// Energy of the clips written that have a figure, microjoules.
    pub(crate) energy_uj: u64,
    /// Whether there are new events.
    pub(crate) events: bool,
    /// Energy of the clips written, each with its node's place among the batches and the time it is filed under.
    pub(crate) used: Vec<(usize, i64, Used)>,
}

/// Sums of the audits of clips.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Audited {
    pub(crate) frames: u64,
    pub(crate) missed: u64,
    pub(crate) detected: u64,
    pub(crate) shown: u64,
    pub(crate) paired: u64,
}

impl Audited {
    fn add(&mut self, clip: &ClipRow) {
        let number = |column: Option<i64>| column.map_or(0, |n| u64::try_from(n).unwrap_or(0));
        self.frames += number(clip.audit_frames);
        self.missed += number(clip.audit_missed);
        self.detected += number(clip.audit_detected);
        self.shown += number(clip.audit_shown);
        self.paired += number(clip.audit_paired);
    }
}

impl Numbers {
    /// Forgets everything.
    pub(crate) fn forget(&mut self) {
        *self = Self::default();
    }

    /// The numbers of these nodes, looked up where they are not known.
    pub(crate) async fn nodes(
        &mut self,
        writing: &mut Writing<'_>,
        names: impl Iterator<Item = &str>,
        now_ms: i64,
    ) -> Result<(), StoreError> {
        let new: BTreeSet<String> = names
            .filter(|name| !self.nodes.contains_key(*name))
            .map(str::to_owned)
            .collect();
        let new: Vec<String> = new.into_iter().collect();
        self.nodes.extend(writing.nodes(&new, now_ms).await?);
        Ok(())
    }

    /// The number of a node that was looked up.
    pub(crate) fn node(&self, name: &str) -> Result<i64, StoreError> {
        self.nodes
            .get(name)
            .copied()
            .ok_or_else(|| lost("node", name))
    }
}

fn lost(what: &str, name: &str) -> StoreError {
    StoreError::Statement(format!(
        "the {what} `{name}` has no number after it was written"
    ))
}

/// A report that is to be written, with the instance it belongs to.
struct Pending {
    node: i64,
    instance: i64,
    camera: String,
    facts: Facts,
}

/// Writes `batches` into the transaction. Each is of another instance.
pub(crate) async fn write(
    writing: &mut Writing<'_>,
    numbers: &mut Numbers,
    batches: &[Batch],
    history: &HistoryConfig,
    now_ms: i64,
) -> Result<Committed, StoreError> {
    let names = batches.iter().map(|batch| batch.node.as_str());
    numbers.nodes(writing, names, now_ms).await?;
    let mut wanted = Vec::with_capacity(batches.len());
    for batch in batches {
        wanted.push((numbers.node(&batch.node)?, batch.instance.clone()));
    }
    let instances = writing.instances(&wanted, now_ms).await?;
    let mut found = Vec::with_capacity(batches.len());
    for key in &wanted {
        found.push(instances.get(key).ok_or_else(|| lost("instance", &key.1))?);
    }
    let suspects: Vec<(i64, i64)> = batches
        .iter()
        .zip(&found)
        .flat_map(|(batch, instance)| below(batch, instance).map(|number| (instance.id, number)))
        .collect();
    let known = writing.known(&suspects).await?;
    let kept_since_ms = now_ms - i64::from(history.clips_days.min(history.set_aside_days)) * DAY_MS;

    let mut group = Group::default();
    let mut committed = Committed::default();
    for (place, ((batch, instance), (node, _))) in
        batches.iter().zip(&found).zip(&wanted).enumerate()
    {
        group.place = place;
        let plan = plan(batch, instance, &known, kept_since_ms);
        group.add(batch, instance, *node, &plan, now_ms);
        committed.again += plan.again as u64;
        committed.missing += plan.missing.unsigned_abs();
        committed.conflicts += u64::from(plan.conflict.is_some());
        committed.outcomes.push(plan.outcome);
    }
    committed.clock_off = group.clock_off;
    committed.set_aside = writing.insert_new("set_aside", &group.set_aside).await?;
    writing.insert("gaps", &group.gaps).await?;
    writing.update_instances(&group.instances).await?;
    let clips = group.clips(writing, numbers).await?;
    committed.clips = writing.insert("clips", &clips).await?;
    for clip in &clips {
        let skipped = clip.frames_e + clip.frames_p - clip.degraded;
        committed.frames += u64::try_from(clip.frames).unwrap_or(0);
        committed.skipped += u64::try_from(skipped).unwrap_or(0);
        committed.audit.add(clip);
        committed.energy_uj += clip
            .energy_uj
            .map_or(0, |uj| u64::try_from(uj).unwrap_or(0));
    }
    writing
        .add_sums("sums_5m", &sums(&clips, FIVE_MINUTES))
        .await?;
    writing.add_sums("sums_day", &sums(&clips, DAY)).await?;
    committed.events = !group.events.is_empty();
    committed.used = std::mem::take(&mut group.used);
    writing.events(&group.events).await?;
    Ok(committed)
}

/// The sums of these clips over spans of so many seconds, in the order of their keys.
pub(crate) fn sums(clips: &[ClipRow], seconds: i64) -> Vec<SumRow> {
    let mut sums: BTreeMap<_, SumRow> = BTreeMap::new();
    for clip in clips {
        let bucket = clip.at_ms.div_euclid(seconds * 1000) * seconds;
        let one = SumRow::of(clip, bucket);
        sums.entry(one.key())
            .and_modify(|sum| sum.add(&one))
            .or_insert(one);
    }
    sums.into_values().collect()
}

/// What a group of batches writes.
#[derive(Default)]
struct Group {
    /// Place of the batch that is added.
    place: usize,
    used: Vec<(usize, i64, Used)>,
    pending: Vec<Pending>,
    set_aside: Vec<SetAsideRow>,
    gaps: Vec<GapRow>,
    instances: Vec<InstanceRow>,
    events: Vec<EventRow>,
    clock_off: u64,
}

impl Group {
    fn add(&mut self, batch: &Batch, instance: &Instance, node: i64, plan: &Plan, now_ms: i64) {
        let mut latest = instance.latest_started_ns;
        let (mut clips, mut aside, mut off) = (0, 0, 0);
        for report in plan
            .store
            .iter()
            .filter_map(|place| batch.reports.get(*place))
        {
            let read = match &report.content {
                Err(Unread { cause, body }) => Err((cause.clone(), body.clone())),
                Ok(content) => facts(content, report.number, now_ms)
                    .map(|facts| (content, facts))
                    .map_err(|cause| {
                        let raw = serde_json::to_string(content).unwrap_or_default();
                        let Unread { cause, body } = unread(cause, &raw);
                        (cause, body)
                    }),
            };
            match read {
                Ok((content, facts)) => {
                    clips += 1;
                    if facts.clock {
                        latest = latest.max(facts.row.started_ns);
                    } else {
                        off += 1;
                    }
                    if let Some(uj) = facts.row.energy_uj {
                        let estimated = content.energy.quality == EnergyQuality::Estimated;
                        let used = Used { uj, estimated };
                        self.used.push((self.place, facts.row.at_ms, used));
                    }
                    self.pending.push(Pending {
                        node,
                        instance: instance.id,
                        camera: content.camera.clone(),
                        facts,
                    });
                }
                Err((cause, body)) => {
                    aside += 1;
                    self.set_aside.push(SetAsideRow {
                        node_id: node,
                        instance_id: Some(instance.id),
                        report: Some(report.number),
                        received_ms: now_ms,
                        cause: text(&cause),
                        body: text(&body),
                    });
                }
            }
        }
        for gap in &plan.gaps {
            self.gaps.push(GapRow {
                instance_id: instance.id,
                first_report: gap.first,
                last_report: gap.last,
                noticed_ms: now_ms,
                cause: gap.cause.to_owned(),
            });
            let detail = json!({ "instance": batch.instance, "first": gap.first, "last": gap.last, "cause": gap.cause });
            self.tell(now_ms, "gap", batch, detail);
        }
        if let Some(reason) = &plan.conflict {
            let detail =
                json!({ "instance": batch.instance, "machine": batch.machine, "reason": reason });
            self.tell(now_ms, "conflict", batch, detail);
        }
        if aside > 0 {
            let detail = json!({ "instance": batch.instance, "reports": aside });
            self.tell(now_ms, "set_aside", batch, detail);
        }
        if off > 0 {
            let detail = json!({ "instance": batch.instance, "clips": off });
            self.tell(now_ms, "clock_off", batch, detail);
        }
        self.clock_off += off;
        self.instances.push(InstanceRow {
            id: instance.id,
            machine: instance
                .machine
                .clone()
                .or_else(|| batch.machine.as_deref().map(text)),
            next_report: plan.next_report,
            last_ms: now_ms.max(instance.last_ms),
            latest_started_ns: latest,
            reports: instance.reports + clips,
            set_aside: instance.set_aside + aside,
            missing: instance.missing + plan.missing,
            lost: instance.lost.max(batch.lost),
            conflicts: instance.conflicts + i64::from(plan.conflict.is_some()),
        });
    }

    fn tell(&mut self, at_ms: i64, kind: &str, batch: &Batch, detail: serde_json::Value) {
        self.events.push(EventRow {
            at_ms,
            kind: kind.to_owned(),
            node: Some(batch.node.clone()),
            detail: text(&detail.to_string()),
        });
    }

    /// The rows of the clips, with the numbers of their cameras and setups.
    async fn clips(
        &mut self,
        writing: &mut Writing<'_>,
        numbers: &mut Numbers,
    ) -> Result<Vec<ClipRow>, StoreError> {
        let cameras: BTreeSet<(i64, String)> = self
            .pending
            .iter()
            .map(|pending| (pending.node, pending.camera.clone()))
            .filter(|camera| !numbers.cameras.contains_key(camera))
            .collect();
        let cameras: Vec<_> = cameras.into_iter().collect();
        numbers.cameras.extend(writing.cameras(&cameras).await?);
        if numbers.setups.len() > MOST_SETUPS {
            numbers.setups.clear();
        }
        let setups: BTreeSet<SetupKey> = self
            .pending
            .iter()
            .map(|pending| pending.facts.setup.clone())
            .filter(|setup| !numbers.setups.contains_key(setup))
            .collect();
        let setups: Vec<_> = setups.into_iter().collect();
        numbers.setups.extend(writing.setups(&setups).await?);
        let mut rows = Vec::with_capacity(self.pending.len());
        for pending in self.pending.drain(..) {
            let camera = (pending.node, pending.camera);
            let mut row = pending.facts.row;
            row.instance_id = pending.instance;
            row.camera_id = *numbers
                .cameras
                .get(&camera)
                .ok_or_else(|| lost("camera", &camera.1))?;
            row.setup_id = *numbers
                .setups
                .get(&pending.facts.setup)
                .ok_or_else(|| lost("setup", &pending.facts.setup.policy))?;
            rows.push(row);
        }
        Ok(rows)
    }
}
