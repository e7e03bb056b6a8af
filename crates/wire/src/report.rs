//! The delivery of clip reports on `{prefix}/@report/{node}`.
//!
//! A report gets its id ([`ClipReport::id`]) when it is created. A node writes each report to disk before sending it,
//! and sends [`ReportBatch`]es as queries with a payload. A hub stores each id once and answers with a [`ReportAnswer`]
//! **after** the commit. Without a reply, after a [`ReportRefusal`] or after a timeout, the node sends the reports
//! again, with growing pauses. So a report is delivered at least once, and its id makes that exactly once, even if
//! disks are copied, restored or lost.

mod compression;

pub use compression::{BatchCompression, REPORT_DICTIONARY, decompress_batch};

use crate::version::{MessageError, VERSION};
use crate::{ClipReport, Desired};
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;
use utoipa::ToSchema;
use uuid::Uuid;

/// Maximum size of a decompressed batch, bytes. A report has one to three kilobytes, so a node sends a few hundred at a
/// time.
pub const LARGEST_BATCH_BYTES: usize = 2 << 20;

/// Maximum number of reports per batch.
pub const MOST_REPORTS: usize = 1000;

/// Maximum size of a report as JSON, bytes.
pub const LARGEST_REPORT_BYTES: usize = 64 << 10;

/// Days for which a hub keeps the ids of stored reports. It refuses an older report if it cannot know whether the
/// report was stored before.
pub const IDENTITY_DAYS: u32 = 30;

/// Reports of one node, oldest first. On the wire: one byte with the dictionary's number, then JSON compressed with
/// Zstandard and that dictionary (`crates/wire/src/report/dictionary-1.json`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportBatch {
    /// Version of the message.
    pub v: u32,
    /// Name of the node; the same in every report.
    pub node: String,
    /// The node's clock when it sent the batch, milliseconds since the Unix epoch, from which a hub checks that the
    /// times in the reports are plausible.
    pub t_ms: u64,
    /// What the node knows of the age of each report, in the same order: its wall clock may have been wrong, and set
    /// since. Empty from nodes that do not say it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ages: Vec<ReportAge>,
    /// The reports, at most [`MOST_REPORTS`].
    pub reports: Vec<ClipReport>,
}

/// What a node knows of a report's age without its wall clock.
#[skip_serializing_none]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ReportAge {
    /// Seconds since it was made, by a clock that nobody sets; absent if the machine was started since then.
    pub made_s: Option<u64>,
    /// True if this node made it and never sent it before.
    #[serde(default)]
    pub first: bool,
}

impl ReportBatch {
    /// Returns the payload to send.
    ///
    /// # Errors
    /// [`MessageError`] if it cannot be written; a batch of reports that were read cannot fail.
    pub fn to_payload(&self, compression: BatchCompression) -> Result<Vec<u8>, MessageError> {
        let json = serde_json::to_vec(self)?;
        let payload = compression.compress(&json)?;
        Ok(payload)
    }

    /// Reads a payload.
    ///
    /// # Errors
    /// [`MessageError`] if it is not a batch of a known version, or is larger than [`LARGEST_BATCH_BYTES`].
    pub fn from_payload(payload: &[u8]) -> Result<Self, MessageError> {
        let json = decompress_batch(payload)?;
        crate::read(&json)
    }
}

/// A report that a hub will never store.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RefusedReport {
    /// The report's id.
    #[schema(value_type = String, format = "uuid")]
    pub id: Uuid,
    /// Why it will never be stored, human-readable.
    pub reason: String,
}

/// The acknowledgement of a batch, sent after the hub's commit: all its reports are stored, except the refused ones.
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportAnswer {
    /// Version of the message.
    pub v: u32,
    /// Reports that will never be stored: they are too old or invalid.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub refused: Vec<RefusedReport>,
    /// Ranges, inclusive, of the node's report counts ([`ClipReport::count`]) that never arrived: the node resends
    /// those that it still has.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub missing: Vec<(u64, u64)>,
    /// The desired setting of the node, so that a lost notice costs one report.
    pub desired: Option<Desired>,
}

impl Default for ReportAnswer {
    /// The acknowledgement of a whole batch.
    fn default() -> Self {
        Self {
            v: VERSION,
            refused: Vec::new(),
            missing: Vec::new(),
            desired: None,
        }
    }
}

/// The reason why a hub did not accept a batch now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RefusalReason {
    /// The hub is overloaded or the node has exceeded its quota; send the same batch later.
    Busy,
    /// The database is unreachable or cannot be written; send the same batch later.
    Unavailable,
    /// The batch is unreadable; sending it again changes nothing, but it is not acknowledged.
    Unreadable,
}

impl RefusalReason {
    /// The word for it, as on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Busy => "busy",
            Self::Unavailable => "unavailable",
            Self::Unreadable => "unreadable",
        }
    }
}

/// The answer to a batch that was not accepted, sent as an error reply. None of its reports is acknowledged.
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportRefusal {
    /// Version of the message.
    pub v: u32,
    /// The kind of refusal, by which the node decides what to do.
    pub reason: RefusalReason,
    /// What happened, human-readable.
    pub detail: String,
    /// Time to wait before trying again, milliseconds.
    pub retry_after_ms: Option<u64>,
}
