//! Reads a batch as it came: each report with its figures, or why it is not taken. No database, no network, no clock.

use super::clip::{ClipRecord, record};
use super::plan::{Present, key};
use crate::store::ReportKey;
use albireo_wire::{
    BatchError, ClipReport, MOST_REPORTS, MessageError, ReportBatch, VERSION, check_segment,
    decompress_batch,
};
use serde::Deserialize;
use serde_json::value::RawValue;
use uuid::Uuid;

/// Most of a report that makes no sense that is kept, bytes.
const KEPT: usize = 2 << 10;

/// A batch that was read.
#[derive(Debug)]
pub struct Batch {
    pub(crate) node: String,
    /// Bytes of its JSON.
    pub(crate) bytes: usize,
    /// Whether the node's clock can be believed.
    pub(crate) clocks_agree: bool,
    pub(crate) reports: Vec<Received>,
}

/// A report of a batch.
#[derive(Debug)]
pub(crate) struct Received {
    /// Its identity, where it has one.
    pub(crate) id: Option<Uuid>,
    pub(crate) count: Option<u64>,
    pub(crate) content: Result<Taken, NotTaken>,
}

/// A report to be stored, unless it was before.
#[derive(Debug)]
pub(crate) struct Taken {
    pub(crate) key: ReportKey,
    pub(crate) record: Box<ClipRecord>,
}

/// Why a report is not stored.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum NotTaken {
    /// It is older than identities are known.
    TooOld(String),
    /// It makes no sense; with the beginning of what came.
    Senseless { cause: String, body: String },
}

/// Why a whole batch is not taken.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// It cannot be read.
    #[error(transparent)]
    Batch(#[from] BatchError),
    /// It came on another node's key.
    #[error("it came on the key of node `{key}` and says that it is of node `{batch}`")]
    OtherNode {
        /// The node of the key.
        key: String,
        /// The node that the batch names.
        batch: String,
    },
    /// It has nothing in it.
    #[error("no reports")]
    Empty,
    /// It has too much in it.
    #[error("{0} reports, above {MOST_REPORTS}")]
    TooMany(usize),
}

impl From<serde_json::Error> for DecodeError {
    fn from(error: serde_json::Error) -> Self {
        Self::Batch(MessageError::from(error).into())
    }
}

/// A batch whose reports are left as they came.
#[derive(Deserialize)]
struct RawBatch<'a> {
    v: u32,
    node: String,
    t_ms: u64,
    #[serde(borrow)]
    reports: Vec<&'a RawValue>,
}

/// Reads the payload of a query on the key of `node`, received at `hub_ms`, milliseconds since the Unix epoch.
///
/// # Errors
/// [`DecodeError`]: nothing of it is taken. A report in it that makes no sense does not make the batch unreadable.
pub fn decode(node: &str, payload: &[u8], hub_ms: i64) -> Result<Batch, DecodeError> {
    let json = decompress_batch(payload)?;
    let (v, of, t_ms, reports) = match serde_json::from_slice::<ReportBatch>(&json) {
        Ok(batch) => {
            let reports = batch.reports.into_iter().map(Ok).collect();
            (batch.v, batch.node, batch.t_ms, reports)
        }
        // One report that cannot be read does not make its batch unreadable.
        Err(_) => {
            let batch: RawBatch<'_> = serde_json::from_slice(&json)?;
            if batch.reports.len() > MOST_REPORTS {
                return Err(DecodeError::TooMany(batch.reports.len()));
            }
            let reports: Vec<_> = batch.reports.into_iter().map(read).collect();
            (batch.v, batch.node, batch.t_ms, reports)
        }
    };
    if v != VERSION {
        return Err(BatchError::from(MessageError::Version { found: v }).into());
    }
    if of != node {
        return Err(DecodeError::OtherNode {
            key: node.to_owned(),
            batch: of,
        });
    }
    match reports.len() {
        0 => return Err(DecodeError::Empty),
        1..=MOST_REPORTS => {}
        many => return Err(DecodeError::TooMany(many)),
    }
    let present = Present {
        hub_ms,
        node_ms: i64::try_from(t_ms).unwrap_or(i64::MAX),
    };
    let received = |report: Result<ClipReport, Received>| match report {
        Ok(report) => take(node, &report, present),
        Err(unread) => unread,
    };
    Ok(Batch {
        node: of,
        bytes: json.len(),
        clocks_agree: present.clocks_agree(),
        reports: reports.into_iter().map(received).collect(),
    })
}

/// Reads one report; as far as it goes where it cannot be read.
fn read(raw: &RawValue) -> Result<ClipReport, Received> {
    #[derive(Default, Deserialize)]
    #[serde(default)]
    struct Known {
        id: Option<Uuid>,
        count: Option<u64>,
    }
    serde_json::from_str(raw.get()).map_err(|error: serde_json::Error| {
        let known: Known = serde_json::from_str(raw.get()).unwrap_or_default();
        Received {
            id: known.id,
            count: known.count,
            content: Err(senseless(error.to_string(), raw.get())),
        }
    })
}

fn take(node: &str, report: &ClipReport, present: Present) -> Received {
    let content = check(node, report)
        .and_then(|()| record(report, present))
        .map_err(|cause| senseless(cause, &serde_json::to_string(report).unwrap_or_default()))
        .and_then(|record| {
            let key = key(report.id, present).map_err(NotTaken::TooOld)?;
            let record = Box::new(record);
            Ok(Taken { key, record })
        });
    Received {
        id: Some(report.id),
        count: report.count,
        content,
    }
}

fn check(node: &str, report: &ClipReport) -> Result<(), String> {
    if report.v != VERSION {
        return Err(format!("version {} is not known here", report.v));
    }
    if report.node != node {
        let other = &report.node;
        return Err(format!(
            "it is of node `{other}`, in a batch of node `{node}`"
        ));
    }
    check_segment("camera name", &report.camera).map_err(|error| error.to_string())
}

fn senseless(cause: String, raw: &str) -> NotTaken {
    let body = raw[..raw.floor_char_boundary(KEPT)].to_owned();
    let cause = cause[..cause.floor_char_boundary(KEPT)].to_owned();
    NotTaken::Senseless { cause, body }
}
