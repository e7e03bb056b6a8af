//! Queries the hub, and reads its reply.

use super::Failure;
use albireo_wire::{MessageError, ReportRefusal, read};
use serde::de::DeserializeOwned;
use std::time::Duration;
use zenoh::query::Querier;

/// Queries the hub and waits for the first answer, at most until the querier's timeout.
pub(super) async fn ask<T: DeserializeOwned>(
    querier: &Querier<'_>,
    payload: Vec<u8>,
) -> Result<T, Failure> {
    let replies = match querier.get().payload(payload).await {
        Ok(replies) => replies,
        Err(error) => {
            tracing::debug!(%error, "the hub cannot be queried");
            return Err(Failure::Unanswered);
        }
    };
    while let Ok(reply) = replies.recv_async().await {
        let read = match reply.result() {
            Ok(sample) => read_reply(Ok(&sample.payload().to_bytes())),
            Err(error) => read_reply(Err(&error.payload().to_bytes())),
        };
        if !matches!(read, Err(Failure::Unanswered)) {
            return read;
        }
    }
    Err(Failure::Unanswered)
}

/// Reads a reply: an answer, or an error.
pub(crate) fn read_reply<T: DeserializeOwned>(reply: Result<&[u8], &[u8]>) -> Result<T, Failure> {
    let unreadable = |error: MessageError| {
        tracing::debug!(%error, "a reply from the hub cannot be read");
        Failure::Unanswered
    };
    match reply {
        Ok(answer) => read(answer).map_err(unreadable),
        Err(refusal) => {
            let refusal: ReportRefusal = read(refusal).map_err(unreadable)?;
            let reason = refusal.reason.as_str();
            tracing::warn!(reason, refusal.detail, "the hub refused a query");
            Err(Failure::Refused {
                at_least: Duration::from_millis(refusal.retry_after_ms.unwrap_or(0)),
                why: format!("{reason}: {}", refusal.detail),
            })
        }
    }
}
