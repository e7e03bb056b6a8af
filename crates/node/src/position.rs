//! Where the node is: positions in its frames' attachments, or those of a receiver (gpsd, NMEA) that it reads itself.

mod config;
mod receiver;
mod sentences;

pub use config::PositionConfig;
pub(crate) use config::PositionSource;
pub(crate) use receiver::follow;
pub use sentences::positions_in;

use albireo_service::rate_limit::RateLimit;
use albireo_wire::Position;
use parking_lot::Mutex;
use serde::Serialize;
use std::time::Duration;
use tokio::time::Instant;
use utoipa::ToSchema;

/// A position of a receiver serves the frames of this time: it may miss some seconds under a bridge.
const FRESH: Duration = Duration::from_secs(10);
/// A receiver that gives nothing readable for this long is a fault.
const SILENT: Duration = Duration::from_secs(30);
/// For how long a position that could not be used is a fault.
const REFUSED_FOR: Duration = Duration::from_secs(60);
/// The most bytes of a reason that are kept: a sender may have made it long.
const LONGEST_REASON: usize = 200;
/// The time between two log lines about positions.
const LOG_PERIOD: Duration = Duration::from_secs(60);

/// The newest position, and what became of the others.
#[derive(Debug)]
pub(crate) struct Positions {
    source: PositionSource,
    known: Mutex<Known>,
}

/// A position of the receiver.
#[derive(Clone, Copy, Debug)]
struct ReceivedPosition {
    position: Position,
    at: Instant,
}

/// Why a position could not be used.
#[derive(Debug)]
struct RefusedPosition {
    reason: String,
    at: Instant,
}

#[derive(Debug)]
struct Known {
    newest: Option<ReceivedPosition>,
    /// What the receiver does instead of giving a position, in words; empty after a position.
    words: String,
    /// The last time at which the receiver answered readably.
    heard: Instant,
    received: u64,
    of_frames: u64,
    refused: u64,
    ignored: u64,
    last_refused: Option<RefusedPosition>,
    log_limit: RateLimit,
}

/// Where positions come from, and how many came; never the position itself.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(crate) struct PositionStatus {
    /// `position.source` of the configuration.
    source: String,
    /// True if frames now have a position from the receiver.
    is_known: bool,
    /// What the receiver does; empty without one.
    words: String,
    /// Positions of the receiver since the start.
    received: u64,
    /// Positions in attachments of frames that were used.
    of_frames: u64,
    /// Positions that could not be used, or lines of a receiver that could not be read.
    refused: u64,
    /// Positions in attachments that were ignored because `position.source` is off.
    ignored: u64,
    /// The reason why the last one could not be used.
    #[serde(skip_serializing_if = "Option::is_none")]
    last_refused: Option<String>,
}

impl Positions {
    /// Creates it without a position.
    pub(crate) fn new(config: &PositionConfig) -> Self {
        Self {
            source: config.source.clone(),
            known: Mutex::new(Known {
                newest: None,
                words: String::new(),
                heard: Instant::now(),
                received: 0,
                of_frames: 0,
                refused: 0,
                ignored: 0,
                last_refused: None,
                log_limit: RateLimit::new(LOG_PERIOD),
            }),
        }
    }

    /// The position of a frame of this camera: `own`, of its attachment, else the receiver's if that is fresh.
    pub(crate) fn of_frame(
        &self,
        camera: &str,
        own: Option<&Result<Position, String>>,
    ) -> Option<Position> {
        let mut known = self.known.lock();
        if self.source == PositionSource::Off {
            if own.is_some() {
                known.ignored += 1;
                known.log_limit.log(|_| {
                    tracing::info!(
                        camera,
                        "positions in frames are ignored: position.source is off"
                    );
                });
            }
            return None;
        }
        match own {
            Some(Ok(position)) => {
                known.of_frames += 1;
                return Some(*position);
            }
            Some(Err(reason)) => known.refuse(format!("a frame of {camera}: {reason}")),
            None => {}
        }
        known.fresh()
    }

    /// Takes a position of the receiver.
    fn found(&self, position: Position) {
        let at = Instant::now();
        let mut known = self.known.lock();
        known.received += 1;
        known.heard = at;
        known.words.clear();
        known.newest = Some(ReceivedPosition { position, at });
    }

    /// Notes that the receiver works and has no position.
    fn searching(&self, words: &str) {
        let mut known = self.known.lock();
        known.heard = Instant::now();
        if known.fresh().is_none() {
            known.words = words.to_owned();
        }
    }

    /// Notes what the receiver says instead of a position, unless it has just said whether it has one.
    fn answering(&self, words: &str) {
        let mut known = self.known.lock();
        let has_said_nothing = known.newest.is_none() && known.words.is_empty();
        if has_said_nothing || known.heard.elapsed() >= SILENT {
            known.words = words.to_owned();
        }
    }

    /// Notes what keeps the receiver from answering.
    fn failing(&self, words: String) {
        self.known.lock().words = words;
    }

    fn refuse(&self, reason: String) {
        self.known.lock().refuse(reason);
    }

    /// Where positions come from, and how many came.
    pub(crate) fn status(&self) -> PositionStatus {
        let known = self.known.lock();
        PositionStatus {
            source: self.source.to_string(),
            is_known: known.fresh().is_some(),
            words: known.words(),
            received: known.received,
            of_frames: known.of_frames,
            refused: known.refused,
            ignored: known.ignored,
            last_refused: known.last_refused.as_ref().map(|refused| refused.reason.clone()),
        }
    }

    /// Why positions are missing. A receiver that sees no satellites, as in a garage, is no fault.
    pub(crate) fn fault(&self) -> Option<String> {
        let known = self.known.lock();
        if self.source.is_receiver() && known.heard.elapsed() >= SILENT {
            let source = &self.source;
            let words = known.words();
            let reason = if words.is_empty() {
                format!("{source} has not answered yet")
            } else {
                format!("{source} gives no position: {words}")
            };
            return Some(reason);
        }
        let last = known.last_refused.as_ref()?;
        if last.at.elapsed() >= REFUSED_FOR {
            return None;
        }
        let reason = &last.reason;
        let refused = known.refused;
        Some(format!("{reason} ({refused} since the start)"))
    }
}

impl Known {
    fn fresh(&self) -> Option<Position> {
        let newest = self.newest?;
        (newest.at.elapsed() < FRESH).then_some(newest.position)
    }

    fn words(&self) -> String {
        let Some(newest) = self.newest else {
            return self.words.clone();
        };
        if !self.words.is_empty() {
            return self.words.clone();
        }
        let age = newest.at.elapsed();
        if age < FRESH {
            "it gives positions".to_owned()
        } else {
            format!("its last position is {} s old", age.as_secs())
        }
    }

    fn refuse(&mut self, mut reason: String) {
        self.refused += 1;
        reason.truncate(reason.floor_char_boundary(LONGEST_REASON));
        self.log_limit.log(|held_back| {
            tracing::warn!(held_back, "position not used: {reason}");
        });
        self.last_refused = Some(RefusedPosition {
            reason,
            at: Instant::now(),
        });
    }
}

#[cfg(test)]
mod tests;
