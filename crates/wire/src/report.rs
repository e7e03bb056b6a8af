//! The delivery contract of clip reports, `{prefix}/@report/{node}`.
//!
//! A node keeps every report on its disk, numbered without a gap by its instance, before it sends anything. It sends
//! [`ReportBatch`]es as queries with a payload. A hub answers with [`ReportAnswer`] **after** it has committed; only
//! then does the node remove what is acknowledged. No reply, [`ReportRefusal`] or a time-out is not an
//! acknowledgement: the same batch is sent again, after a pause that grows. So a report is delivered at least once,
//! and the hub's cursor (the last number stored of an instance) makes it exactly once.

mod compression;

pub use compression::{BatchCompression, REPORT_DICTIONARY};

use crate::version::{MessageError, VERSION};
use crate::{ClipReport, Desired};
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;
use utoipa::ToSchema;

/// Most bytes of a batch once it is decompressed. A report is about 1 kB, so that a node sends a few hundred at
/// a time; the bound is what a hub is willing to hold of one that is not a node.
pub const LARGEST_BATCH_BYTES: u64 = 4 << 20;

/// Reports of one node, in the order of their numbers. On the wire it is JSON compressed with Zstandard against an example
/// batch, `crates/wire/src/report/dictionary-1.json`, behind a byte with that example's number.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct ReportBatch {
    /// Version.
    pub v: u32,
    /// Node.
    pub node: String,
    /// Instance of the node, 32 hexadecimal digits: made at its first start, and anew when its state directory is found
    /// on another machine or went back in time. Numbers count within it.
    pub instance: String,
    /// A short digest of the machine's identity, so that one instance on two machines is noticed; absent
    /// where the machine has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub machine: Option<String>,
    /// Number of the first report.
    pub first: u64,
    /// Number of the last report.
    pub last: u64,
    /// Reports that were lost before they could be sent (the outbox was full or its disk broken), since the
    /// instance began. A hub sees from it that a gap is known to the node.
    #[serde(default)]
    pub lost: u64,
    /// The reports: [`ClipReport::report`] is its number.
    pub reports: Vec<ClipReport>,
}

/// A batch as a hub reads it: the reports are kept as they came, so that one which cannot be read is set aside
/// alone.
#[derive(Debug, Deserialize)]
pub struct ReceivedBatch {
    /// Version.
    pub v: u32,
    /// Node.
    pub node: String,
    /// Instance of the node.
    pub instance: String,
    /// Digest of the machine's identity.
    #[serde(default)]
    pub machine: Option<String>,
    /// Number of the first report.
    pub first: u64,
    /// Number of the last report.
    pub last: u64,
    /// Reports the node lost before it could send them.
    #[serde(default)]
    pub lost: u64,
    /// The reports, unread.
    pub reports: Vec<Box<RawValue>>,
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
    /// It is larger than anybody may send.
    #[error("more than {LARGEST_BATCH_BYTES} bytes when decompressed")]
    TooLarge,
    /// Not the message expected.
    #[error(transparent)]
    Message(#[from] MessageError),
    /// Its own members contradict each other.
    #[error("{0}")]
    Inconsistent(&'static str),
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
}

impl ReceivedBatch {
    /// Reads a payload.
    ///
    /// # Errors
    /// [`BatchError`] when it is not a batch of a version known here, or larger than [`LARGEST_BATCH_BYTES`].
    pub fn from_payload(payload: &[u8]) -> Result<Self, BatchError> {
        let json = compression::decompress(payload, LARGEST_BATCH_BYTES)?;
        let batch: Self = crate::read(&json)?;
        if batch.instance.len() != 32 || !batch.instance.bytes().all(|b| b.is_ascii_hexdigit()) {
            return Err(BatchError::Inconsistent(
                "instance must have 32 hexadecimal digits",
            ));
        }
        if batch.reports.is_empty() {
            return Err(BatchError::Inconsistent("no reports"));
        }
        let span = batch.last.checked_sub(batch.first);
        if span.is_none_or(|span| span < batch.reports.len() as u64 - 1) {
            return Err(BatchError::Inconsistent(
                "more reports than numbers from first to last",
            ));
        }
        Ok(batch)
    }
}

/// The acknowledgement of a batch, sent after the hub's commit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportAnswer {
    /// Version.
    pub v: u32,
    /// Every report of the instance up to this number is stored and may be removed: the batch's last number, or a lower
    /// one where the rest must be sent again. Numbers begin at 1, so that 0 says that nothing is stored. Above the
    /// node's own last number it says that the node's state went back in time.
    pub stored: u64,
    /// What the hub desires of the node, so that a lost notice costs one report.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub desired: Option<Desired>,
}

impl ReportAnswer {
    /// The acknowledgement of everything up to `stored`.
    pub const fn new(stored: u64, desired: Option<Desired>) -> Self {
        Self {
            v: VERSION,
            stored,
            desired,
        }
    }
}

/// Why a hub did not take a batch now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RefusalReason {
    /// Too much to do; the same batch is welcome later.
    Busy,
    /// The database cannot be reached or written; the same batch is welcome later.
    Unavailable,
    /// The batch cannot be read; sending it again changes nothing, but it is not acknowledged.
    Unreadable,
    /// Its first number is taken by another report of the instance: the node's state went back in time (a restored
    /// disk), or another machine has a copy of it. The node makes a new instance, numbers what waits anew, and
    /// sends it again.
    Conflict,
}

/// The answer when a batch was not taken, sent as an error reply. Nothing of it is acknowledged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportRefusal {
    /// Version.
    pub v: u32,
    /// Why.
    pub reason: RefusalReason,
    /// The same in words.
    pub detail: String,
    /// When to try again, milliseconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub retry_after_ms: Option<u64>,
}
