//! The delivery of clip reports, `{prefix}/@report/{node}`.
//!
//! A report gets its id ([`ClipReport::id`]) when it is created. A node writes each report to disk before it sends it,
//! and sends [`ReportBatch`]es as queries with a payload. A hub stores each id once and answers with a
//! [`ReportAnswer`] **after** the commit. Without a reply, after a [`ReportRefusal`] or after a time-out the node sends
//! the reports again, with growing pauses. So a report is delivered at least once, and its id makes that
//! exactly once, whatever disks are copied, restored or lost.

mod compression;

pub use compression::{BatchCompression, REPORT_DICTIONARY, decompress_batch};

use crate::version::{MessageError, VERSION};
use crate::{ClipReport, Desired};
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;
use utoipa::ToSchema;
use uuid::Uuid;

/// Most bytes of a batch once it is decompressed. A report is one to three kilobytes, so that a node sends a few hundred
/// at a time.
pub const LARGEST_BATCH_BYTES: usize = 2 << 20;

/// Most reports of a batch.
pub const MOST_REPORTS: usize = 1000;

/// Most bytes of a report as JSON.
pub const LARGEST_REPORT_BYTES: usize = 64 << 10;

/// Days for which a hub knows the ids of the reports that it has stored. It refuses an older report, because it cannot
/// know whether it was stored before.
pub const IDENTITY_DAYS: u32 = 30;

/// Reports of one node, the oldest first. On the wire: a byte with the dictionary's number, then JSON compressed with
/// Zstandard and that dictionary (`crates/wire/src/report/dictionary-1.json`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportBatch {
    /// Version.
    pub v: u32,
    /// Node; the same in each of the reports.
    pub node: String,
    /// The node's clock when it sent the batch, milliseconds since the Unix epoch: a hub sees from it whether the times in
    /// the reports can be believed.
    pub t_ms: u64,
    /// The reports.
    pub reports: Vec<ClipReport>,
}

/// Why a batch cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum BatchError {
    /// It is not compressed in any way known here, or it breaks off.
    #[error("cannot be decompressed: {0}")]
    Compression(#[from] std::io::Error),
    /// It was compressed against a dictionary that this program does not have.
    #[error("compressed with dictionary {0}; this program has dictionary {REPORT_DICTIONARY}")]
    UnknownDictionary(u8),
    /// It is larger than the limit.
    #[error("more than {LARGEST_BATCH_BYTES} bytes when decompressed")]
    TooLarge,
    /// Not the message expected.
    #[error(transparent)]
    Message(#[from] MessageError),
}

impl ReportBatch {
    /// The payload that goes over the wire.
    ///
    /// # Errors
    /// [`BatchError`] when it cannot be written; a batch made of reports that were read cannot fail.
    pub fn to_payload(&self, compression: BatchCompression) -> Result<Vec<u8>, BatchError> {
        let json = serde_json::to_vec(self).map_err(MessageError::from)?;
        Ok(compression.compress(&json)?)
    }

    /// Reads a payload.
    ///
    /// # Errors
    /// [`BatchError`] when it is not a batch of a version known here, or larger than [`LARGEST_BATCH_BYTES`].
    pub fn from_payload(payload: &[u8]) -> Result<Self, BatchError> {
        Ok(crate::read(&decompress_batch(payload)?)?)
    }
}

/// A report that a hub will never store.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RefusedReport {
    /// Its identity.
    #[schema(value_type = String, format = "uuid")]
    pub id: Uuid,
    /// Why, in words.
    pub reason: String,
}

/// The acknowledgement of a batch, sent after the hub's commit: every report of it is stored, but those that are refused.
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportAnswer {
    /// Version.
    pub v: u32,
    /// Identity of the hub's database. One that the node does not know has none of its reports: it sends again what it
    /// still has.
    #[schema(value_type = String, format = "uuid")]
    pub database: Uuid,
    /// Reports that will never be stored: they are too old, or make no sense.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub refused: Vec<RefusedReport>,
    /// Running counts of the node ([`ClipReport::count`]) that never came, from the first to the last of each range: the node
    /// sends again what it still has of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub missing: Vec<(u64, u64)>,
    /// What the hub desires of the node, so that a lost notice costs one report.
    pub desired: Option<Desired>,
}

impl ReportAnswer {
    /// The acknowledgement of a whole batch by that database.
    pub const fn new(database: Uuid) -> Self {
        Self {
            v: VERSION,
            database,
            refused: Vec::new(),
            missing: Vec::new(),
            desired: None,
        }
    }
}

/// Why a hub did not take a batch now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RefusalReason {
    /// The hub is overloaded, or the node has exceeded its quota; send the same batch later.
    Busy,
    /// The database cannot be reached or written; send the same batch later.
    Unavailable,
    /// The batch cannot be read; sending it again changes nothing, but it is not acknowledged.
    Unreadable,
}

/// The answer when a batch was not taken, sent as an error reply. Nothing of it is acknowledged.
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportRefusal {
    /// Version.
    pub v: u32,
    /// Why.
    pub reason: RefusalReason,
    /// The same in words.
    pub detail: String,
    /// When to try again, milliseconds.
    pub retry_after_ms: Option<u64>,
}
