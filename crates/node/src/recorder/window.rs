//! Decides which frames of a camera are recorded: all, or those around events.

use super::RecordedFrame;
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// The most bytes of pictures that a camera holds for the time before an event: ten seconds of 30 pictures of 200 kB.
pub(super) const MOST_HELD_BYTES: usize = 64 << 20;

/// The frames of one camera before an event, and the end of the recording that is running.
#[derive(Debug)]
pub(super) struct Window {
    before: Duration,
    after: Duration,
    /// True if every frame is recorded, and not those around events alone.
    is_always: bool,
    held: VecDeque<RecordedFrame>,
    held_bytes: usize,
    /// True if frames went for want of memory, before their time.
    is_short: bool,
    until: Option<Instant>,
}

/// The frames before an event, which are to be recorded.
pub(super) struct FramesBefore {
    pub frames: VecDeque<RecordedFrame>,
    /// For how long before the event there are some, if memory held fewer than were wanted.
    pub shortened_to: Option<Duration>,
}

impl Window {
    /// Records the frames around events.
    pub(super) const fn around_events(before: Duration, after: Duration) -> Self {
        Self {
            before,
            after,
            is_always: false,
            held: VecDeque::new(),
            held_bytes: 0,
            is_short: false,
            until: None,
        }
    }

    /// Records every frame.
    pub(super) fn always(before: Duration, after: Duration) -> Self {
        Self {
            is_always: true,
            ..Self::around_events(before, after)
        }
    }

    /// True if a frame of this time is recorded, or held in case that something happens.
    pub(super) fn takes(&self, at: Instant) -> bool {
        !self.before.is_zero() || self.is_recording(at)
    }

    /// Takes a frame. Returns it if it is to be recorded now.
    pub(super) fn frame(&mut self, frame: RecordedFrame) -> Option<RecordedFrame> {
        if self.is_recording(frame.at) {
            return Some(frame);
        }
        let oldest = frame.at.checked_sub(self.before);
        self.held_bytes += frame.picture.bytes.len();
        self.held.push_back(frame);
        while let Some(first) = self.held.front() {
            let is_too_old = oldest.is_some_and(|oldest| first.at < oldest);
            let has_room = self.held_bytes <= MOST_HELD_BYTES;
            if !self.before.is_zero() && !is_too_old && has_room {
                break;
            }
            self.is_short =
                !self.before.is_zero() && oldest.is_some_and(|oldest| first.at >= oldest);
            self.held_bytes -= first.picture.bytes.len();
            self.held.pop_front();
        }
        None
    }

    /// An event at this time.
    pub(super) fn event(&mut self, at: Instant) -> FramesBefore {
        if !self.has_length() {
            return FramesBefore {
                frames: VecDeque::new(),
                shortened_to: None,
            };
        }
        let until = at + self.after;
        self.until = Some(self.until.map_or(until, |before| before.max(until)));
        let oldest = at.checked_sub(self.before);
        self.held_bytes = 0;
        let mut frames = std::mem::take(&mut self.held);
        frames.retain(|frame| oldest.is_none_or(|oldest| frame.at >= oldest));
        let shortened_to = match frames.front() {
            Some(first) if self.is_short => Some(at.saturating_duration_since(first.at)),
            _ => None,
        };
        self.is_short = false;
        FramesBefore {
            frames,
            shortened_to,
        }
    }

    /// True if a frame of this time is recorded.
    pub(super) fn is_recording(&self, at: Instant) -> bool {
        self.is_always || self.until.is_some_and(|until| at <= until)
    }

    /// True if recordings have a length: without one, only frames of the audit are recorded.
    pub(super) fn has_length(&self) -> bool {
        self.is_always || !self.before.is_zero() || !self.after.is_zero()
    }
}
