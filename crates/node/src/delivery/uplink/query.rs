//! A query to the hub, and its reply.

use super::Outcome;
use albireo_wire::{ReportRefusal, read};
use serde::de::DeserializeOwned;
use std::time::Duration;
use zenoh::query::Querier;

/// The hub's reply to a query.
pub(crate) enum HubReply<T> {
    /// Its answer.
    Answer(T),
    /// It refused, with its reason.
    Refusal(ReportRefusal),
    /// No reply came, or none that can be read: why.
    Missing(String),
}

impl<T> HubReply<T> {
    /// What came of the query, and the answer if there is one.
    pub(super) fn outcome(self) -> (Outcome, Option<T>) {
        match self {
            Self::Answer(answer) => (Outcome::Done, Some(answer)),
            Self::Refusal(refusal) => {
                tracing::warn!(reason = ?refusal.reason, refusal.detail, "the hub refuses");
                let at_least = refusal.retry_after_ms.map(Duration::from_millis);
                (Outcome::Refused(at_least), None)
            }
            Self::Missing(reason) => {
                tracing::debug!(reason, "the hub does not answer");
                (Outcome::Unanswered, None)
            }
        }
    }
}

/// Queries the hub and waits for the first answer, no longer than the querier does.
pub(super) async fn ask<T: DeserializeOwned>(
    querier: &Querier<'_>,
    payload: Vec<u8>,
) -> HubReply<T> {
    let replies = match querier.get().payload(payload).await {
        Ok(replies) => replies,
        Err(error) => return HubReply::Missing(error.to_string()),
    };
    let mut reason = "no reply".to_owned();
    while let Ok(reply) = replies.recv_async().await {
        let parsed = match reply.result() {
            Ok(sample) => read_reply(Ok(&sample.payload().to_bytes())),
            Err(error) => read_reply(Err(&error.payload().to_bytes())),
        };
        match parsed {
            HubReply::Missing(unread) => reason = unread,
            parsed => return parsed,
        }
    }
    HubReply::Missing(reason)
}

/// Reads a reply: an answer, or an error.
pub(crate) fn read_reply<T: DeserializeOwned>(reply: Result<&[u8], &[u8]>) -> HubReply<T> {
    match reply {
        Ok(answer) => read::<T>(answer).map_or_else(
            |error| HubReply::Missing(format!("an answer that cannot be read: {error}")),
            HubReply::Answer,
        ),
        Err(refusal) => read::<ReportRefusal>(refusal).map_or_else(
            |_| HubReply::Missing(String::from_utf8_lossy(refusal).into_owned()),
            HubReply::Refusal,
        ),
    }
}
