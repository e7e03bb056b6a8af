//! A group of batches in one transaction: what the database knows of them, and what is written for them.

use super::clip::{Clip, SetupRow, StoredClipRow};
use super::decode::{Batch, Received};
use super::fate::{BatchResult, Fate, Identity};
use super::limits::EntryLimit;
use super::tables::{MOST_CAMERA_NAMES, ReportCountsRow, ReportKey};
use crate::store::row::{Columns, IntoRow};
use crate::store::{Database, StoreError};
use albireo_service::clock::DAY_MS;
use albireo_wire::MOST_CAMERAS;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use uuid::Uuid;

/// The row of an invalid report.
struct SetAsideRow {
    node_id: i64,
    report_id: Option<String>,
    received_ms: i64,
    cause: String,
    body: String,
}

impl IntoRow for SetAsideRow {
    const TABLE: &'static str = "set_aside";

    fn columns(&self) -> Result<Columns<'static>, StoreError> {
        Ok(vec![
            ("node_id", self.node_id.into()),
            ("report_id", self.report_id.as_deref().into()),
            ("received_ms", self.received_ms.into()),
            ("cause", self.cause.as_str().into()),
            ("body", self.body.as_str().into()),
        ])
    }
}

/// The rows of a group.
pub(super) struct Group {
    now_ms: i64,
    /// The nodes' counts of reports, by name.
    nodes: HashMap<String, ReportCountsRow>,
    /// The ids of those of their cameras that the batches name, by node id and name.
    cameras: HashMap<i64, HashMap<String, i64>>,
    /// The identities that were not stored before this group.
    new: BTreeSet<Uuid>,
    /// New identities of reports that are refused.
    refused: BTreeSet<ReportKey>,
    setups: HashMap<SetupRow, i64>,
    clips: Vec<StoredClipRow>,
    aside: Vec<SetAsideRow>,
}

impl Group {
    /// Reads what the database knows of the batches' nodes, and stores the new identities, nodes and setups.
    pub(super) fn load(
        database: &mut dyn Database,
        batches: &[Batch],
        now_ms: i64,
    ) -> Result<Self, StoreError> {
        let mut names: Vec<&str> = batches.iter().map(|batch| batch.node.as_str()).collect();
        names.sort_unstable();
        names.dedup();
        let nodes = database.reporting_nodes(&names, now_ms)?;
        let cameras = database.cameras(&camera_names(batches, &nodes))?;
        let valid = batches
            .iter()
            .flat_map(|batch| &batch.reports)
            .filter_map(|report| report.content.as_ref().ok());
        let keys = valid.clone().map(|(key, _)| *key).collect();
        let new = database.new_reports(&keys)?;
        let new_clips = valid.filter(|(key, _)| new.contains(&key.id));
        let setups = database.setups(new_clips.map(|(_, clip)| &clip.setup).collect())?;
        Ok(Self {
            now_ms,
            nodes,
            cameras,
            setups,
            new,
            refused: BTreeSet::new(),
            clips: Vec::new(),
            aside: Vec::new(),
        })
    }

    /// Decides on each report of a batch, and collects its rows.
    pub(super) fn add(
        &mut self,
        database: &mut dyn Database,
        batch: &Batch,
        aside_limit: &mut EntryLimit,
    ) -> Result<BatchResult, StoreError> {
        let mut result = BatchResult::default();
        let mut node = self.nodes.remove(&batch.node).ok_or_else(|| lost("a node"))?;
        let rows_before = self.aside.len();
        let mut aside = Vec::new();
        for (index, report) in batch.reports.iter().enumerate() {
            let identity = self.identity(report);
            let doubt = report
                .doubt
                .as_ref()
                .filter(|doubt| !node.counts.lack(report.count, doubt.first));
            let cameras = self.cameras.entry(node.node_id).or_default();
            let fate = Fate::of(report, identity, doubt, |camera| {
                cameras.contains_key(camera) || node.cameras < MOST_CAMERA_NAMES
            });
            match &fate {
                Fate::Stored(key, clip) => {
                    let has_new_camera = self.store(database, node.node_id, *key, clip)?;
                    node.cameras += i64::from(has_new_camera);
                }
                Fate::TooOld { noted, .. } => self.refused.extend(noted),
                Fate::Invalid { reason } => {
                    if aside_limit.allows(&batch.node, "", self.now_ms) {
                        aside.push(index);
                        self.set_aside(node.node_id, report, reason);
                    }
                }
                Fate::Again => {}
            }
            result.add(report, &fate, &mut node);
        }
        for (row, text) in self.aside[rows_before..].iter_mut().zip(batch.texts(&aside)) {
            row.body = text;
        }
        result.end(&mut node, self.now_ms);
        self.nodes.insert(batch.node.clone(), node);
        Ok(result)
    }

    /// The number of cameras of a batch's node, as far as they count for its share.
    pub(super) fn cameras_of(&self, batch: &Batch) -> usize {
        let cameras = self.nodes.get(&batch.node).map_or(0, |node| node.cameras);
        usize::try_from(cameras).unwrap_or(0).min(MOST_CAMERAS)
    }

    /// What is known of the identity of a report. An identity is new only for the first report of this group that has it.
    fn identity(&mut self, report: &Received) -> Identity {
        let Ok((key, _)) = &report.content else {
            return Identity::Known;
        };
        let was_new = self.new.remove(&key.id);
        if was_new {
            Identity::New
        } else if self.refused.contains(key) {
            Identity::Refused
        } else {
            Identity::Known
        }
    }

    /// Collects the row of a clip. Its camera is added if the node has not had it yet; returns true in that case.
    fn store(
        &mut self,
        database: &mut dyn Database,
        node_id: i64,
        key: ReportKey,
        clip: &Clip,
    ) -> Result<bool, StoreError> {
        let cameras = self.cameras.entry(node_id).or_default();
        let known = cameras.get(&clip.camera).copied();
        let camera_id = match known {
            Some(known) => known,
            None => {
                let added = database.add_camera(node_id, &clip.camera)?;
                cameras.insert(clip.camera.clone(), added);
                added
            }
        };
        let setup_id = *self.setups.get(&clip.setup).ok_or_else(|| lost("a setup"))?;
        // A day that is not believed is negative; the clip is kept from the day of its receipt on.
        let day = if key.day > 0 {
            key.day
        } else {
            self.now_ms.div_euclid(DAY_MS)
        };
        self.clips.push(StoredClipRow {
            day,
            camera_id,
            setup_id,
            clip: clip.row.clone(),
        });
        Ok(known.is_none())
    }

    /// Collects the row of an invalid report. Its text follows at the end of its batch, which is read once for all of them.
    fn set_aside(&mut self, node_id: i64, report: &Received, reason: &str) {
        self.aside.push(SetAsideRow {
            node_id,
            report_id: report.id.map(|id| id.to_string()),
            received_ms: self.now_ms,
            cause: reason.to_owned(),
            body: String::new(),
        });
    }

    /// Writes the collected rows.
    pub(super) fn write(self, database: &mut dyn Database) -> Result<(), StoreError> {
        database.forget_reports(&self.refused)?;
        let counts: Vec<_> = self.nodes.into_values().collect();
        database.write_report_counts(&counts)?;
        database.insert(&self.aside, "")?;
        database.insert_clips(&self.clips)
    }
}

/// The names of the cameras in the valid reports of batches, by the id of their node.
fn camera_names<'a>(
    batches: &'a [Batch],
    nodes: &HashMap<String, ReportCountsRow>,
) -> BTreeMap<i64, BTreeSet<&'a str>> {
    let mut names = BTreeMap::<i64, BTreeSet<&str>>::new();
    for batch in batches {
        let Some(node) = nodes.get(&batch.node) else {
            continue;
        };
        let of_node = names.entry(node.node_id).or_default();
        for report in &batch.reports {
            if let Ok((_, clip)) = &report.content {
                of_node.insert(&clip.camera);
            }
        }
    }
    names
}

fn lost(what: &str) -> StoreError {
    StoreError::Statement(format!("{what} has no id after it was written"))
}
