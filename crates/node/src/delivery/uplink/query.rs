//! A question to the hub, and what came of it.

use albireo_wire::{ReportRefusal, read};
use serde::de::DeserializeOwned;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};
use zenoh::Wait;
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

/// How often is looked whether the node stops.
const GLANCE: Duration = Duration::from_millis(100);

/// How long an answer is waited for once the node stops.
#[derive(Clone, Copy)]
pub(super) struct Patience<'a> {
    /// Whether it does.
    pub stop: &'a AtomicBool,
    /// How long from then on.
    pub then: Duration,
}

/// Asks, and waits for the first answer; no longer than `timeout` and `patience` allow.
pub(super) fn ask<T: DeserializeOwned>(
    querier: &Querier<'_>,
    payload: Vec<u8>,
    timeout: Duration,
    patience: Patience<'_>,
) -> Asked<T> {
    let (sender, replies) = channel();
    let sent = querier
        .get()
        .payload(payload)
        .callback(move |reply| {
            // The one who asked may have given up.
            let _ = sender.send(reply);
        })
        .wait();
    if let Err(error) = sent {
        return Asked::Nobody(error.to_string());
    }
    let until = Instant::now() + timeout;
    let mut reason = "no reply".to_owned();
    let mut stopped = None;
    loop {
        let now = Instant::now();
        if patience.stop.load(Ordering::Acquire) && stopped.is_none() {
            stopped = Some(now + patience.then);
        }
        if now >= until || stopped.is_some_and(|until| now >= until) {
            return Asked::Nobody("no reply in time".to_owned());
        }
        let reply = match replies.recv_timeout(GLANCE.min(until - now)) {
            Ok(reply) => reply,
            Err(RecvTimeoutError::Disconnected) => return Asked::Nobody(reason),
            Err(RecvTimeoutError::Timeout) => continue,
        };
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
}
