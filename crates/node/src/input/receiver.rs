//! Receives a camera's frames: reads them, follows their numbers, counts unusable ones, and puts the rest into the
//! camera's ring. Runs on Zenoh's receiving threads, so it neither decodes nor waits.

use super::read::{RawSample, read_frame};
use super::sequence::{Arrival, SequenceTracker};
use super::source::SourcePicture;
use super::{Delivery, Frame, FrameNumber, InputCounter, PayloadFormat, Pushed, Ring};
use crate::frame::LatestFrame;
use albireo_core::geometry::BoundingBox;
use albireo_service::clock::unix_nanoseconds;
use albireo_service::rate_limit::RateLimit;
use albireo_vision::picture::{FrameFault, FrameLimits, Mount};
use albireo_wire::{DropKind, FrameAnswer, VERSION};
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use tokio::time::Instant;
use zenoh::Wait;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::query::Query;
use zenoh::sample::Sample;

/// The time between two log lines about dropped frames of one kind.
const LOG_PERIOD: Duration = Duration::from_secs(10);
/// The same for frames replaced by a newer one, when a live camera is faster than its detector.
const REPLACED_LOG_PERIOD: Duration = Duration::from_secs(3600);

/// The maximum number of answers to queries that wait for the network.
const MAX_ANSWERS: usize = 64;

/// A frame in the ring, with its place in the stream.
#[derive(Debug)]
pub(crate) struct SequencedFrame {
    /// The frame, still encoded.
    pub frame: Frame,
    /// Its place in the stream, counting lost frames.
    pub index: u64,
    /// The number of its stream. It grows whenever a new stream begins, even if the frame that showed it is
    /// unusable.
    pub epoch: u64,
    /// True if what it shows is not to be trusted: its source's decoder has complained since the last whole key frame.
    pub is_broken: bool,
    /// The frame's query, if it came as one: its sender waits for the [answer](FrameReceiver::answer), given when the
    /// frame is taken from the ring, before it sends the next frame.
    pub query: Option<Query>,
}

/// The kind of frames with that fault.
pub(crate) fn kind_of(fault: &FrameFault) -> DropKind {
    match fault {
        FrameFault::Undecodable(_) => DropKind::Undecodable,
        FrameFault::Oversized(_) => DropKind::Oversized,
        FrameFault::UnknownFormat(_) => DropKind::UnknownFormat,
    }
}

/// How the frames of one camera are received.
#[derive(Clone, Debug)]
pub(crate) struct ReceiverSettings {
    /// The camera's name.
    pub camera: String,
    /// The format of its payloads.
    pub format: PayloadFormat,
    /// The frames that its loop sees when they arrive faster than it works.
    pub delivery: Delivery,
    /// The maximum number of frames that wait for the loop.
    pub ring: usize,
    /// Limits of its frames.
    pub limits: FrameLimits,
    /// How it is mounted, if its pictures do not stay as they are sent.
    pub mount: Option<Arc<Mount>>,
}

/// The receiving end of one camera.
#[derive(Debug)]
pub(crate) struct FrameReceiver {
    settings: ReceiverSettings,
    counter: Arc<InputCounter>,
    /// Limits the log, for each kind of dropped frames.
    log_limits: Mutex<BTreeMap<DropKind, RateLimit>>,
    replaced_limit: RateLimit,
    /// The frames that wait for the camera's loop.
    pub ring: Ring<SequencedFrame>,
    stream: Mutex<StreamState>,
    /// Sends answers, off the threads that must not wait for the network.
    runtime: Handle,
    /// One permit per answer that waits for the network.
    answers: Arc<Semaphore>,
}

/// The camera's number of a sample, and the frame, if it is usable.
type NumberedFrame = (FrameNumber, Result<Frame, FrameFault>);

/// How a frame came.
struct Origin {
    /// The query by which it came, if it did.
    query: Option<Query>,
    /// True if what it shows is not to be trusted.
    is_broken: bool,
}

impl Origin {
    const PUT: Self = Self {
        query: None,
        is_broken: false,
    };

    fn query(query: Query) -> Self {
        Self {
            query: Some(query),
            ..Self::PUT
        }
    }
}

/// A frame that will not be processed.
struct Refused {
    kind: DropKind,
    reason: String,
}

#[derive(Debug, Default)]
struct StreamState {
    tracker: SequenceTracker,
    arrivals: u64,
    epoch: u64,
}

impl FrameReceiver {
    /// Creates the receiver of a camera, whose frames `counter` counts. Call it on the runtime that sends its answers.
    pub(crate) fn new(settings: ReceiverSettings, counter: Arc<InputCounter>) -> Self {
        let most_bytes = settings.limits.max_payload_bytes;
        Self {
            counter,
            log_limits: Mutex::default(),
            replaced_limit: RateLimit::new(REPLACED_LOG_PERIOD),
            ring: Ring::new(settings.delivery, settings.ring, most_bytes),
            settings,
            stream: Mutex::default(),
            runtime: Handle::current(),
            answers: Arc::new(Semaphore::new(MAX_ANSWERS)),
        }
    }

    /// Receives a frame that came as a put.
    pub(crate) fn take(&self, sample: &Sample) {
        self.counter.arrivals.whole_frame();
        self.place(Origin::PUT, |arrival| self.read(sample.into(), arrival));
    }

    /// Receives a frame that came as a query. If there is no room, the query ends without an answer.
    pub(crate) fn take_query(&self, query: Query) {
        let origin = Origin::query(query.clone());
        self.counter.arrivals.whole_frame();
        self.place(origin, |arrival| self.read((&query).into(), arrival));
    }

    /// Answers the sender of a frame that came as a query: the frame's turn has come, or the reason it will not be
    /// processed. If too many answers wait, the query ends without one, and the sender repeats it.
    pub(crate) fn answer(&self, query: Option<Query>, refused: Option<&str>) {
        let Some(query) = query else { return };
        let Ok(place) = Arc::clone(&self.answers).try_acquire_owned() else {
            return;
        };
        let answer = FrameAnswer {
            v: VERSION,
            refused: refused.map(str::to_owned),
        };
        self.runtime.spawn_blocking(move || {
            if let Err(error) = send_answer(&query, &answer) {
                tracing::debug!(%error, "a frame's sender was not answered");
            }
            drop(place);
        });
    }

    /// True if the camera's mask hides that box.
    pub(crate) fn hides(&self, bounding_box: BoundingBox) -> bool {
        let mount = self.settings.mount.as_ref();
        mount.is_some_and(|mount| mount.hides(bounding_box))
    }

    fn read(&self, raw: RawSample<'_>, arrival: u64) -> NumberedFrame {
        let raw = RawSample { arrival, ..raw };
        read_frame(raw, self.settings.format, &self.settings.limits)
    }

    /// Receives a picture of a source that the node reads itself. A broken one is not given to the detector; a recorded one
    /// has the time and the clip of its recording.
    pub(crate) fn take_picture(&self, taken: SourcePicture) {
        let time_ns = taken.recorded.as_ref().and_then(|recorded| recorded.time_ns);
        let clip = taken.recorded.map(|recorded| recorded.drive);
        if taken.is_reopened {
            self.stream.lock().epoch += 1;
        }
        let origin = Origin {
            query: None,
            is_broken: taken.is_broken,
        };
        self.place(origin, |arrival| {
            let frame = taken.picture.map(|picture| Frame {
                sequence: arrival,
                time_ns: time_ns.unwrap_or_else(unix_nanoseconds),
                clip,
                position: None,
                picture,
                received: Instant::now(),
            });
            (FrameNumber::default(), frame)
        });
    }

    /// Records that the publisher of a stream appeared.
    pub(crate) fn publisher_came(&self, stream: u64) {
        self.stream.lock().tracker.publisher_came(stream);
    }

    /// Records that the publisher of a stream left.
    pub(crate) fn publisher_left(&self, stream: u64) {
        self.stream.lock().tracker.publisher_left(stream);
    }

    /// Numbers the result of `read` and puts it into the ring.
    fn place(&self, origin: Origin, read: impl FnOnce(u64) -> NumberedFrame) {
        // One lock over reading, numbering and pushing keeps the order of arrival if Zenoh calls from several
        // threads.
        let mut stream = self.stream.lock();
        let query = origin.query.clone();
        if let Some(query) = &query
            && !self.ring.has_room(query.payload().map_or(0, ZBytes::len))
        {
            return;
        }
        let placed = match self.admit(&mut stream, origin, read) {
            Ok(frame) => self.push(frame),
            Err(refused) => Err(refused),
        };
        // The next frame need not wait for this one's answer.
        drop(stream);
        if let Err(Refused { kind, reason }) = placed {
            self.count_dropped(kind, 1, &reason);
            self.answer(query, Some(&reason));
        }
    }

    /// Finds a frame's place in the stream, and counts the missing ones before it.
    ///
    /// # Errors
    /// [`Refused`] if the frame is unusable.
    fn admit(
        &self,
        stream: &mut StreamState,
        origin: Origin,
        read: impl FnOnce(u64) -> NumberedFrame,
    ) -> Result<SequencedFrame, Refused> {
        let (number, read) = read(stream.arrivals);
        stream.arrivals += 1;
        let arrival = match &read {
            Err(_) if number.seq.is_none() => {
                stream.tracker.arrive_unreadable();
                Arrival::Stray
            }
            _ => stream.tracker.arrive(&number, Instant::now()),
        };
        if let Arrival::New {
            lost, restarted, ..
        } = arrival
        {
            stream.epoch += u64::from(restarted);
            if lost > 0 {
                let reason = "numbers are missing in the camera's sequence";
                self.count_dropped(DropKind::Lost, lost, &reason);
            }
        }
        let mut frame = read.map_err(|fault| Refused {
            kind: kind_of(&fault),
            reason: fault.to_string(),
        })?;
        frame.picture = frame.picture.mounted(self.settings.mount.as_ref());
        let sequence = frame.sequence;
        let refused = |kind, reason| {
            Err(Refused {
                kind,
                reason: format!("sequence number {sequence} {reason}"),
            })
        };
        match arrival {
            Arrival::Duplicate => refused(DropKind::Duplicate, "has already arrived"),
            Arrival::Late => refused(DropKind::Late, "arrived after a later one"),
            Arrival::Stray => refused(
                DropKind::Stray,
                "belongs to a stream other than the camera's current one",
            ),
            Arrival::New { index, .. } => {
                let latest = LatestFrame::new(sequence, frame.picture.clone());
                self.counter.set_latest_frame(latest);
                Ok(SequencedFrame {
                    frame,
                    index,
                    epoch: stream.epoch,
                    is_broken: origin.is_broken,
                    query: origin.query,
                })
            }
        }
    }

    /// Counts `number` frames that will not be processed, and logs `reason` at limited intervals.
    pub(crate) fn count_dropped(&self, kind: DropKind, number: u64, reason: &dyn fmt::Display) {
        self.counter.count(kind, number, reason);
        let mut limits = self.log_limits.lock();
        let limit = limits.entry(kind).or_insert(RateLimit::new(LOG_PERIOD));
        let camera = self.settings.camera.as_str();
        // At a stop frames are dropped as they must be; a loop that has failed is told by its own line.
        let is_expected = kind == DropKind::Stopped;
        let kind = kind.name();
        limit.log(|held_back| {
            if is_expected {
                tracing::info!(camera, kind, number, held_back, "frame dropped: {reason}");
            } else {
                tracing::warn!(camera, kind, number, held_back, "frame dropped: {reason}");
            }
        });
    }

    /// Counts a frame that a newer one replaced: a live camera that is faster than its detector is no fault.
    fn count_replaced(&self) {
        let reason = "a newer frame arrived before its turn (camera.delivery)";
        let kind = DropKind::Overrun;
        self.counter.count(kind, 1, &reason);
        let camera = self.settings.camera.as_str();
        self.replaced_limit.log(|held_back| {
            let kind = kind.name();
            tracing::info!(camera, kind, held_back, "frame dropped: {reason}");
        });
    }

    /// Puts a frame into the ring, and counts the one that it replaces.
    ///
    /// # Errors
    /// [`Refused`] if it is not queued.
    fn push(&self, frame: SequencedFrame) -> Result<(), Refused> {
        let bytes = frame.frame.picture.bytes.len();
        let refused = |kind, reason: &str| {
            Err(Refused {
                kind,
                reason: reason.to_owned(),
            })
        };
        match self.ring.push(frame, bytes) {
            Pushed::Queued => Ok(()),
            Pushed::Replaced => {
                self.count_replaced();
                Ok(())
            }
            Pushed::Full => refused(
                DropKind::Overrun,
                "too many frames are waiting: send them as queries, not as puts, to be held back (camera.delivery)",
            ),
            Pushed::Closed => refused(
                DropKind::Stopped,
                "the camera's loop is not running: it has failed, or the node is stopping",
            ),
        }
    }
}

/// Answers the query of a frame.
fn send_answer(query: &Query, answer: &FrameAnswer) -> zenoh::Result<()> {
    let bytes = serde_json::to_vec(answer)?;
    query.reply(query.key_expr(), bytes).encoding(Encoding::APPLICATION_JSON).wait()
}

#[cfg(test)]
mod tests;
