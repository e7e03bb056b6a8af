//! Parses a batch into reports with their figures, or with the reason that they are not stored. It uses no database,
//! network or clock.

use super::clip::{Clip, clip};
use super::plan::{Doubt, Present, key};
use super::tables::ReportKey;
use crate::store::row::beginning;
use albireo_wire::{
    ClipReport, MOST_REPORTS, ReportAge, VERSION, check_camera_name, check_version,
    decompress_batch,
};
use bytes::Bytes;
use serde::Deserialize;
use serde_json::value::RawValue;
use uuid::Uuid;

/// Most bytes of a report that are set aside with it. Those of nodes have one to three kilobytes.
const LONGEST_ASIDE: usize = 16 << 10;

/// A parsed batch.
#[derive(Debug)]
pub struct Batch {
    pub(crate) node: String,
    /// What came, for the texts of reports that are set aside.
    payload: Bytes,
    /// Bytes of its JSON.
    pub(crate) bytes: usize,
    /// True if the clocks of hub and node agree.
    pub(crate) clocks_agree: bool,
    pub(crate) reports: Vec<Received>,
}

/// A report of a batch.
#[derive(Debug)]
pub(crate) struct Received {
    /// Its identity, if it has one.
    pub(crate) id: Option<Uuid>,
    pub(crate) count: Option<u64>,
    /// Its clip, to be stored under that key unless the key is known.
    pub(crate) content: Result<(ReportKey, Box<Clip>), Rejected>,
    /// The doubt whether it was stored before, if its key is not known.
    pub(crate) doubt: Option<Doubt>,
}

impl Received {
    const fn rejected(id: Option<Uuid>, count: Option<u64>, rejected: Rejected) -> Self {
        Self {
            id,
            count,
            content: Err(rejected),
            doubt: None,
        }
    }
}

/// The reason that a report is not stored.
#[derive(Debug)]
pub(crate) enum Rejected {
    /// It is older than the identities that the hub keeps.
    TooOld { reason: String },
    /// It is invalid.
    Invalid { reason: String },
}

/// A batch with unparsed reports, so that an invalid one does not make its batch invalid.
#[derive(Deserialize)]
struct RawBatch<'a> {
    v: u32,
    node: String,
    t_ms: u64,
    #[serde(default)]
    ages: Vec<ReportAge>,
    #[serde(borrow)]
    reports: Vec<&'a RawValue>,
}

impl Batch {
    /// The texts of these reports as they came, or the beginnings of long ones. The batch is read once more, because few
    /// reports are set aside, and the texts of all would be ten times as large as what came.
    pub(crate) fn texts(&self, reports: &[usize]) -> Vec<String> {
        if reports.is_empty() {
            return Vec::new();
        }
        let json = decompress_batch(&self.payload).unwrap_or_default();
        let batch = serde_json::from_slice::<RawBatch<'_>>(&json).ok();
        let mut texts = Vec::with_capacity(reports.len());
        for report in reports {
            let raw = batch.as_ref().and_then(|batch| batch.reports.get(*report));
            let text = raw.map_or("", |raw| raw.get());
            texts.push(text[..text.floor_char_boundary(LONGEST_ASIDE)].to_owned());
        }
        texts
    }
}

/// Parses the payload of a query on the key of `node`, received at `hub_ms`, milliseconds since the Unix epoch.
///
/// # Errors
/// The reason that the whole batch is refused. An invalid report in it is no reason.
pub fn decode(node: &str, payload: &Bytes, hub_ms: i64) -> Result<Batch, String> {
    let json = decompress_batch(payload).map_err(|error| error.to_string())?;
    // A batch is read once: only one that cannot be read is searched for another version.
    let batch: RawBatch<'_> = serde_json::from_slice(&json)
        .or_else(|_| albireo_wire::read(&json))
        .map_err(|error| error.to_string())?;
    check_version(batch.v).map_err(|error| error.to_string())?;
    if batch.node != node {
        let other = batch.node;
        return Err(format!(
            "the batch was sent on the key of node `{node}` but names node `{other}`"
        ));
    }
    match batch.reports.len() {
        0 => return Err("the batch has no reports".to_owned()),
        1..=MOST_REPORTS => {}
        many => return Err(format!("{many} reports, more than {MOST_REPORTS}")),
    }
    let present = Present {
        hub_ms,
        node_ms: i64::try_from(batch.t_ms).unwrap_or(i64::MAX),
    };
    // Ages that do not belong to these reports say nothing.
    let ages = if batch.ages.len() == batch.reports.len() {
        batch.ages
    } else {
        Vec::new()
    };
    let mut reports = Vec::with_capacity(batch.reports.len());
    for (index, raw) in batch.reports.iter().enumerate() {
        let age = ages.get(index).copied();
        reports.push(parse(node, raw.get(), present, age));
    }
    Ok(Batch {
        node: batch.node,
        payload: payload.clone(),
        bytes: json.len(),
        clocks_agree: present.clocks_agree(),
        reports,
    })
}

/// Parses one report. If it is invalid, at least its identity and count are read, where it has them.
fn parse(node: &str, raw: &str, present: Present, age: Option<ReportAge>) -> Received {
    #[derive(Default, Deserialize)]
    #[serde(default)]
    struct Known {
        id: Option<Uuid>,
        count: Option<u64>,
    }
    let report: ClipReport = match serde_json::from_str(raw) {
        Ok(report) => report,
        Err(error) => {
            let known: Known = serde_json::from_str(raw).unwrap_or_default();
            let invalid = invalid(&error.to_string());
            return Received::rejected(known.id, known.count, invalid);
        }
    };
    let id = Some(report.id);
    let behind_ms = present.behind_when_made(report.id, age);
    let present_then = present.when_made(report.id, age);
    let clip = match checked_clip(node, &report, present_then, behind_ms) {
        Ok(clip) => clip,
        Err(reason) => return Received::rejected(id, report.count, invalid(&reason)),
    };
    let (key, doubt) = match key(report.id, present_then, age) {
        Ok(found) => found,
        Err(reason) => {
            return Received::rejected(id, report.count, Rejected::TooOld { reason });
        }
    };
    Received {
        id,
        count: report.count,
        content: Ok((key, Box::new(clip))),
        doubt,
    }
}

/// The clip of a report of `node`; an error is the reason that the report is invalid.
fn checked_clip(
    node: &str,
    report: &ClipReport,
    present: Present,
    behind_ms: Option<i64>,
) -> Result<Clip, String> {
    if report.v != VERSION {
        return Err(format!("version {} is not known, only {VERSION}", report.v));
    }
    if report.node != node {
        let other = &report.node;
        return Err(format!(
            "the report names node `{other}`, in a batch of node `{node}`"
        ));
    }
    check_camera_name(&report.camera).map_err(|error| error.to_string())?;
    clip(report, present, behind_ms)
}

fn invalid(reason: &str) -> Rejected {
    Rejected::Invalid {
        reason: beginning(reason),
    }
}
