//! From a Zenoh sample to the camera's ring: reads it as a frame, follows the sequence numbers, and
//! counts what cannot be used under its own name. Runs on Zenoh's receiving thread, so it never decodes and never
//! waits; frames of which none is to be missed wait for their turn in [`held`]. A camera's loop that waits for a frame is
//! taken further right here, up to its answer or to the first evidence that it has to wait for.

mod held;
mod source;

pub(crate) use held::HeldFrames;
pub(crate) use source::SourceFeed;

use crate::camera::InPlace;
use crate::input::{
    Arrival, Frame, FrameOrder, PayloadFormat, Pushed, RejectedFrame, RingSender, SequenceTracker,
    read_sample,
};
use crate::rate_limit::RateLimit;
use crate::state::board::{CameraBoard, LatestFrame};
use albireo_service::clock::unix_nanoseconds;
use albireo_vision::picture::{EncodedPicture, FrameFault, FrameLimits};
use albireo_wire::DroppedFrames;
use parking_lot::{Mutex, MutexGuard};
use std::collections::BTreeMap;
use std::sync::Arc;
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
    /// Which stream it belongs to: grows each time the camera begins to number anew, also when the frame
    /// that showed it could not be used.
    pub epoch: u64,
}

/// Dropped frames of one camera: counted on the board at once and kept for the open clip.
#[derive(Debug)]
pub(crate) struct DropCounts {
    board: Arc<CameraBoard>,
    state: Mutex<DropState>,
}

#[derive(Debug, Default)]
struct DropState {
    since_taken: DroppedFrames,
    limits: BTreeMap<&'static str, RateLimit>,
}

impl DropCounts {
    /// No drops yet, for the camera of `board`.
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

    fn lock(&self) -> MutexGuard<'_, DropState> {
        self.state.lock()
    }
}

/// Why a frame was not processed; each kind is a field of [`DroppedFrames`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum DropKind {
    /// Missing in the sequence.
    Lost,
    /// Pushed out of the ring.
    Overrun,
    /// After a later one, or out of any order.
    Late,
    /// There twice.
    Duplicate,
    /// Broken picture.
    Undecodable,
    /// Above a limit.
    Oversized,
    /// Of a kind not known.
    UnknownFormat,
    /// The camera's loop did not run.
    Stopped,
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
            Self::Stopped => "stopped",
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
            Self::Stopped => &mut dropped.stopped,
        }
    }
}

impl From<&FrameFault> for DropKind {
    fn from(fault: &FrameFault) -> Self {
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
    drops: Arc<DropCounts>,
    ring: RingSender<Incoming>,
    format: PayloadFormat,
    limits: FrameLimits,
    stream: Mutex<Stream>,
    /// The camera's loop.
    camera: InPlace,
}

#[derive(Debug, Default)]
struct Stream {
    tracker: SequenceTracker,
    arrivals: u64,
    epoch: u64,
}

impl Intake {
    /// An intake that pushes into `ring`.
    pub(crate) fn new(
        board: Arc<CameraBoard>,
        drops: Arc<DropCounts>,
        ring: RingSender<Incoming>,
        format: PayloadFormat,
        limits: FrameLimits,
    ) -> Self {
        Self {
            board,
            drops,
            ring,
            format,
            limits,
            stream: Mutex::default(),
            camera: InPlace::default(),
        }
    }

    /// Takes `camera`, the loop that the frames are for, further where they arrive.
    #[must_use]
    pub(crate) fn advancing(mut self, camera: InPlace) -> Self {
        self.camera = camera;
        self
    }

    /// Takes one sample as it arrives.
    pub(crate) fn take(&self, sample: &Sample) {
        if sample.payload().as_shm().is_some() {
            self.board.count_shared_frame();
        }
        self.place(|arrival, format, limits| read_sample(sample, arrival, format, limits));
    }

    /// Takes one picture of a source that the node itself reads. `anew`: it is the first since the source was opened, so
    /// that nothing is known of what happened in between.
    pub(crate) fn take_picture(&self, picture: Result<EncodedPicture, FrameFault>, anew: bool) {
        if anew {
            self.stream.lock().epoch += 1;
        }
        self.place(|arrival, _, _| {
            let order = FrameOrder::default();
            match picture {
                Ok(picture) => Ok(Frame {
                    sequence: arrival,
                    order,
                    time_ns: unix_nanoseconds(),
                    clip: None,
                    payload_bytes: picture.bytes.len(),
                    picture,
                    received: Instant::now(),
                }),
                Err(fault) => Err(RejectedFrame {
                    sequence: None,
                    order,
                    clip: None,
                    fault,
                }),
            }
        });
    }

    /// Numbers what `read` reads and puts it into the ring, in the place of the oldest frame if there is no room.
    fn place(
        &self,
        read: impl FnOnce(u64, PayloadFormat, &FrameLimits) -> Result<Frame, RejectedFrame>,
    ) {
        // One lock over reading, numbering and pushing keeps the order of arrival where Zenoh calls from
        // more than one thread.
        let mut stream = self.stream.lock();
        let Ok(incoming) = self.admit(&mut stream, read) else {
            return;
        };
        let (pushed, wake) = self.ring.push_newest_quietly(incoming);
        // What became of it is counted.
        let _ = self.pushed(pushed);
        // The next frame need not wait for this one's answer to get into the ring.
        drop(stream);
        if let Some(wake) = wake
            && !(wake.only_this && self.camera.advance())
        {
            wake.waker.wake();
        }
    }

    /// Numbers what `read` reads and puts it into the ring when there is room.
    ///
    /// # Errors
    /// Why it will not be processed; it was counted.
    async fn place_in_turn(
        &self,
        read: impl FnOnce(u64, PayloadFormat, &FrameLimits) -> Result<Frame, RejectedFrame>,
    ) -> Result<(), String> {
        let incoming = self.admit(&mut self.stream.lock(), read)?;
        self.pushed(self.ring.push(incoming).await)
    }

    /// Counts what is missing, and what cannot be used.
    ///
    /// # Errors
    /// Why it cannot be used.
    fn admit(
        &self,
        stream: &mut Stream,
        read: impl FnOnce(u64, PayloadFormat, &FrameLimits) -> Result<Frame, RejectedFrame>,
    ) -> Result<Incoming, String> {
        let arrival = stream.arrivals;
        stream.arrivals += 1;
        let read = read(arrival, self.format, &self.limits);
        let tracker = &mut stream.tracker;
        let place = match &read {
            Ok(frame) if frame.order.numbered => {
                Some(tracker.arrive(frame.sequence, frame.clip.as_ref(), &frame.order))
            }
            Ok(_) => Some(tracker.arrive_without_number()),
            Err(rejected) => match rejected.sequence {
                Some(sequence) => {
                    Some(tracker.arrive(sequence, rejected.clip.as_ref(), &rejected.order))
                }
                None => {
                    tracker.arrive_unreadable();
                    None
                }
            },
        };
        if let Some(Arrival::New {
            lost, restarted, ..
        }) = place
        {
            stream.epoch += u64::from(restarted);
            if lost > 0 {
                self.drops.count(
                    DropKind::Lost,
                    lost,
                    &"numbers are missing in the camera's sequence",
                );
            }
        }
        let frame = match read {
            Ok(frame) => frame,
            Err(rejected) => {
                return Err(
                    self.refuse(DropKind::from(&rejected.fault), rejected.fault.to_string())
                );
            }
        };
        let sequence = frame.sequence;
        let number = format_args!("sequence number {sequence}");
        let index = match place {
            Some(Arrival::New { index, .. }) => index,
            Some(Arrival::Duplicate) => {
                return Err(self.refuse(DropKind::Duplicate, format!("{number} came before")));
            }
            Some(Arrival::Late { .. }) | None => {
                return Err(self.refuse(DropKind::Late, format!("{number} came after a later one")));
            }
            Some(Arrival::Stray) => {
                return Err(self.refuse(DropKind::Late, format!("{number} is far from all others")));
            }
        };
        self.board.set_latest_frame(LatestFrame {
            seq: sequence,
            picture: frame.picture.clone(),
        });
        Ok(Incoming {
            frame,
            index,
            epoch: stream.epoch,
        })
    }

    /// Counts a frame that will not be processed, and gives back why.
    fn refuse(&self, kind: DropKind, reason: String) -> String {
        self.drops.count(kind, 1, &reason);
        reason
    }

    /// Counts what was pushed out by a frame, or the frame itself if it came too late.
    fn pushed(&self, pushed: Pushed<Incoming>) -> Result<(), String> {
        match pushed {
            Pushed::Queued => Ok(()),
            Pushed::Closed(_) => Err(self.refuse(
                DropKind::Stopped,
                "the camera's loop does not run: it has failed, or the node stops".to_owned(),
            )),
            Pushed::Replaced(_) => {
                self.drops.count(
                    DropKind::Overrun,
                    1,
                    &"a newer frame came before its turn (camera.ring, camera.delivery)",
                );
                Ok(())
            }
        }
    }
}

#[cfg(test)]
mod tests;
