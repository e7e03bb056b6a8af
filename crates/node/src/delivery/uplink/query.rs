//! A question to the hub, and what came of it.

use albireo_wire::{ReportRefusal, read};
use serde::de::DeserializeOwned;
use zenoh::query::Querier;

/// What came of a question.
pub(super) enum Asked<T> {
    /// The hub's answer.
    Answered(T),
    /// The hub said no, in words.
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
        match reply.result() {
            Ok(sample) => match read::<T>(&sample.payload().to_bytes()) {
                Ok(answer) => return Asked::Answered(answer),
                Err(error) => reason = format!("an answer that cannot be read: {error}"),
            },
            Err(error) => match read::<ReportRefusal>(&error.payload().to_bytes()) {
                Ok(refusal) => return Asked::Refused(refusal),
                Err(_) => {
                    reason = String::from_utf8_lossy(&error.payload().to_bytes()).into_owned();
                }
            },
        }
    }
    Asked::Nobody(reason)
}
