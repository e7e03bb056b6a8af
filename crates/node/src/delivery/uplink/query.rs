//! A question to the hub, and what came of it.

use albireo_wire::{ReportRefusal, read};
use serde::de::DeserializeOwned;
use zenoh::query::Querier;

/// What came of a question.
pub(crate) enum Asked<T> {
    /// The hub's answer.
    Answered(T),
    /// The hub refused, with its reason.
    Refused(ReportRefusal),
    /// Nobody answered, or nothing that can be read.
    Nobody(String),
}

/// Asks, and waits for the first answer, no longer than the querier does.
pub(super) async fn ask<T: DeserializeOwned>(querier: &Querier<'_>, payload: Vec<u8>) -> Asked<T> {
    let replies = match querier.get().payload(payload).await {
        Ok(replies) => replies,
        Err(error) => return Asked::Nobody(error.to_string()),
    };
    let mut reason = "no reply".to_owned();
    while let Ok(reply) = replies.recv_async().await {
        let asked = match reply.result() {
            Ok(sample) => read_reply(Ok(&sample.payload().to_bytes())),
            Err(error) => read_reply(Err(&error.payload().to_bytes())),
        };
        match asked {
            Asked::Nobody(unread) => reason = unread,
            asked => return asked,
        }
    }
    Asked::Nobody(reason)
}

/// Reads a reply: an answer, or an error.
pub(crate) fn read_reply<T: DeserializeOwned>(reply: Result<&[u8], &[u8]>) -> Asked<T> {
    match reply {
        Ok(answer) => read::<T>(answer).map_or_else(
            |error| Asked::Nobody(format!("an answer that cannot be read: {error}")),
            Asked::Answered,
        ),
        Err(refusal) => read::<ReportRefusal>(refusal).map_or_else(
            |_| Asked::Nobody(String::from_utf8_lossy(refusal).into_owned()),
            Asked::Refused,
        ),
    }
}
