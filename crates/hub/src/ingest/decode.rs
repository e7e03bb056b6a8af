//! A batch as it came, read: each report with its number, or why it cannot be read. No database, no network.

use albireo_wire::{BatchError, ClipReport, ReceivedBatch, check_segment};
use serde::Deserialize;

/// Most of an unreadable report that is kept, bytes.
const KEPT: usize = 64 << 10;

/// A batch that was read.
#[derive(Debug)]
pub(crate) struct Batch {
    pub(crate) node: String,
    pub(crate) instance: String,
    pub(crate) machine: Option<String>,
    pub(crate) last: i64,
    pub(crate) lost: i64,
    /// In the order of their numbers, which grow.
    pub(crate) reports: Vec<Numbered>,
}

/// A report and its number within the instance.
#[derive(Debug)]
pub(crate) struct Numbered {
    pub(crate) number: i64,
    pub(crate) content: Result<Box<ClipReport>, Unread>,
}

/// A report that cannot be read.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Unread {
    pub(crate) cause: String,
    pub(crate) body: String,
}

/// Why a whole batch cannot be taken.
#[derive(Debug, thiserror::Error)]
pub(crate) enum DecodeError {
    /// It cannot be read.
    #[error(transparent)]
    Batch(#[from] BatchError),
    /// It came on another node's key.
    #[error("it came on the key of node `{key}` and says that it is of node `{batch}`")]
    OtherNode { key: String, batch: String },
    /// A number that no database holds.
    #[error("number {0} is too large")]
    Number(u64),
}

/// Reads the payload of a query on the key of `node`.
pub(crate) fn decode(node: &str, payload: &[u8]) -> Result<Batch, DecodeError> {
    let received = ReceivedBatch::from_payload(payload)?;
    if received.node != node {
        return Err(DecodeError::OtherNode {
            key: node.to_owned(),
            batch: received.node,
        });
    }
    // One below the largest, so that a cursor can stand behind the last.
    let number = |value: u64| match i64::try_from(value) {
        Ok(value) if value < i64::MAX => Ok(value),
        _ => Err(DecodeError::Number(value)),
    };
    let (first, last) = (number(received.first)?, number(received.last)?);
    let mut reports = Vec::with_capacity(received.reports.len());
    let mut next = first;
    let mut left = received.reports.len() as i64;
    for raw in &received.reports {
        left -= 1;
        // What is behind must have room up to the last number.
        let highest = last - left;
        let (number, content) = read(raw.get(), next, highest);
        reports.push(Numbered { number, content });
        next = number + 1;
    }
    Ok(Batch {
        node: received.node,
        instance: received.instance.to_ascii_lowercase(),
        machine: received.machine,
        last,
        lost: i64::try_from(received.lost).unwrap_or(i64::MAX),
        reports,
    })
}

/// One report and its number: its own where it tells one that can be, else the next.
fn read(raw: &str, next: i64, highest: i64) -> (i64, Result<Box<ClipReport>, Unread>) {
    #[derive(Deserialize)]
    struct Number {
        report: u64,
    }
    let told = serde_json::from_str::<Number>(raw)
        .ok()
        .and_then(|told| i64::try_from(told.report).ok());
    let number = told
        .filter(|number| (next..=highest).contains(number))
        .unwrap_or(next);
    let content = match albireo_wire::read::<ClipReport>(raw.as_bytes()) {
        Err(error) => Err(error.to_string()),
        Ok(report) if i64::try_from(report.report) != Ok(number) => Err(format!(
            "its number {} does not follow in its batch, where {number} is next",
            report.report
        )),
        Ok(report) => match check_segment("camera name", &report.camera) {
            Err(error) => Err(error.to_string()),
            Ok(()) => Ok(Box::new(report)),
        },
    };
    let content = content.map_err(|cause| unread(cause, raw));
    (number, content)
}

/// What is kept of a report that cannot be read.
pub(crate) fn unread(cause: String, raw: &str) -> Unread {
    let mut end = raw.len().min(KEPT);
    while !raw.is_char_boundary(end) {
        end -= 1;
    }
    Unread {
        cause,
        body: raw[..end].to_owned(),
    }
}
