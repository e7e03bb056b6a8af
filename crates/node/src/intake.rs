//! From a Zenoh sample to the camera's ring: reads it as a frame, follows the sequence numbers, and
//! counts what cannot be used under its own name. Runs on Zenoh's receiving thread, so it never decodes.

use super::board::{CameraBoard, LatestFrame};
use super::rate_limit::RateLimit;
use crate::frame::{
    Arrival, Frame, FrameLimits, PayloadFormat, Pushed, RingSender, SequenceTracker, read_sample,
};
use albireo_wire::DroppedFrames;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;
use zenoh::sample::Sample;

/// Time between two log lines about dropped frames of one kind.
const LOG_PERIOD: Duration = Duration::from_secs(10);

/// A frame in the ring, with its place in the stream.
#[derive(Debug)]
pub(crate) struct Incoming {
    /// The frame, still encoded.
    pub frame: Frame,
    /// Its place in the stream, lost frames counted.
    pub index: u64,
    /// The camera began to number anew: a new stream.
    pub restarted: bool,
}

/// Dropped frames of one camera: counted on the board at once and kept for the open clip.
#[derive(Debug)]
pub(crate) struct DropCounts {
    board: Arc<CameraBoard>,
    state: Mutex<LedgerState>,
}

#[derive(Debug, Default)]
struct LedgerState {
    since_taken: DroppedFrames,
    limits: BTreeMap<&'static str, RateLimit>,
}

impl DropCounts {
    /// An empty ledger for the camera of `board`.
    pub(crate) fn new(board: Arc<CameraBoard>) -> Self {
        Self {
            board,
            state: Mutex::default(),
        }
    }

    /// Counts `number` frames dropped as `kind` and logs `reason`, not more often than every 10 s a kind.
    pub(crate) fn count(&self, kind: DropKind, number: u64, reason: &dyn std::fmt::Display) {
        let mut more = DroppedFrames::default();
        *kind.counter(&mut more) = number;
        self.board.record_dropped(&more);
        let mut state = self.lock();
        *kind.counter(&mut state.since_taken) += number;
        let limit = state
            .limits
            .entry(kind.as_str())
            .or_insert(RateLimit::new(LOG_PERIOD));
        if let Some(held_back) = limit.admit(Instant::now()) {
            drop(state);
            tracing::warn!(
                camera = self.board.name(),
                kind = kind.as_str(),
                number,
                held_back,
                "frame dropped: {reason}"
            );
        }
    }

    /// What was dropped since the last call: the open clip's share.
    pub(crate) fn take(&self) -> DroppedFrames {
        std::mem::take(&mut self.lock().since_taken)
    }

    fn lock(&self) -> MutexGuard<'_, LedgerState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Why a frame was not processed; each kind is a field of [`DroppedFrames`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum DropKind {
    /// Missing in the sequence.
    Lost,
    /// Pushed out of the ring.
    Overrun,
    /// After a later one.
    Late,
    /// There twice.
    Duplicate,
    /// Broken picture.
    Undecodable,
    /// Above a limit.
    Oversized,
    /// Of a kind not known.
    UnknownFormat,
}

impl DropKind {
    /// The name of the counter.
    pub(crate) const fn as_str(self) -> &'static str {
        match self {
            Self::Lost => "lost",
            Self::Overrun => "overrun",
            Self::Late => "late",
            Self::Duplicate => "duplicate",
            Self::Undecodable => "undecodable",
            Self::Oversized => "oversized",
            Self::UnknownFormat => "unknown_format",
        }
    }

    fn counter(self, dropped: &mut DroppedFrames) -> &mut u64 {
        match self {
            Self::Lost => &mut dropped.lost,
            Self::Overrun => &mut dropped.overrun,
            Self::Late => &mut dropped.late,
            Self::Duplicate => &mut dropped.duplicate,
            Self::Undecodable => &mut dropped.undecodable,
            Self::Oversized => &mut dropped.oversized,
            Self::UnknownFormat => &mut dropped.unknown_format,
        }
    }
}

impl From<&crate::frame::FrameFault> for DropKind {
    fn from(fault: &crate::frame::FrameFault) -> Self {
        use crate::frame::FrameFault;
        match fault {
            FrameFault::Undecodable { .. } => Self::Undecodable,
            FrameFault::Oversized { .. } => Self::Oversized,
            FrameFault::UnknownFormat { .. } => Self::UnknownFormat,
        }
    }
}

/// The receiving end of one camera.
#[derive(Debug)]
pub(crate) struct Intake {
    board: Arc<CameraBoard>,
    ledger: Arc<DropCounts>,
    ring: RingSender<Incoming>,
    format: PayloadFormat,
    limits: FrameLimits,
    stream: Mutex<Stream>,
}

#[derive(Debug, Default)]
struct Stream {
    tracker: SequenceTracker,
    arrivals: u64,
}

impl Intake {
    /// An intake that pushes into `ring`.
    pub(crate) fn new(
        board: Arc<CameraBoard>,
        ledger: Arc<DropCounts>,
        ring: RingSender<Incoming>,
        format: PayloadFormat,
        limits: FrameLimits,
    ) -> Self {
        Self {
            board,
            ledger,
            ring,
            format,
            limits,
            stream: Mutex::default(),
        }
    }

    /// Takes one sample as it arrives.
    pub(crate) fn take(&self, sample: &Sample) {
        // One lock over reading and numbering keeps the order of arrival where Zenoh calls from more
        // than one thread.
        let mut stream = self.stream.lock().unwrap_or_else(PoisonError::into_inner);
        let arrival = stream.arrivals;
        stream.arrivals += 1;
        let read = read_sample(sample, arrival, self.format, &self.limits);
        let (sequence, clip) = match &read {
            Ok(frame) => (Some(frame.sequence), frame.clip.clone()),
            Err(rejected) => (rejected.sequence, rejected.clip.clone()),
        };
        let place = sequence.map(|sequence| stream.tracker.arrive(sequence, clip.as_ref()));
        drop(stream);

        if let Some(Arrival::New { lost, .. }) = place
            && lost > 0
        {
            self.ledger.count(
                DropKind::Lost,
                lost,
                &"numbers are missing in the camera's sequence",
            );
        }
        match read {
            Err(rejected) => {
                self.ledger
                    .count(DropKind::from(&rejected.fault), 1, &rejected.fault);
            }
            Ok(frame) => self.place(frame, place),
        }
    }

    /// Puts a usable frame into the ring if its number is new.
    fn place(&self, frame: Frame, place: Option<Arrival>) {
        let (index, restarted) = match place {
            Some(Arrival::New {
                index, restarted, ..
            }) => (index, restarted),
            Some(Arrival::Duplicate) => {
                let sequence = frame.sequence;
                return self.ledger.count(
                    DropKind::Duplicate,
                    1,
                    &format_args!("sequence number {sequence} came before"),
                );
            }
            Some(Arrival::Late { .. }) | None => {
                let sequence = frame.sequence;
                return self.ledger.count(
                    DropKind::Late,
                    1,
                    &format_args!("sequence number {sequence} came after a later one"),
                );
            }
        };
        self.board.set_latest_frame(LatestFrame {
            seq: frame.sequence,
            picture: frame.picture.clone(),
        });
        let pushed = self.ring.push_blocking(Incoming {
            frame,
            index,
            restarted,
        });
        match pushed {
            // A camera stopped on purpose takes no more frames: nothing to count.
            Pushed::Queued | Pushed::Closed(_) => {}
            Pushed::Replaced(_) => self.ledger.count(
                DropKind::Overrun,
                1,
                &"a newer frame came before its turn (camera.ring, camera.delivery)",
            ),
        }
    }
}
