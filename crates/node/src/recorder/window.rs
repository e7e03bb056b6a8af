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
    always: bool,
    held: VecDeque<RecordedFrame>,
    held_bytes: usize,
    /// True if frames went for want of memory, before their time.
    is_short: bool,
    until: Option<Instant>,
}

impl Window {
    pub(super) const fn new(before: Duration, after: Duration, always: bool) -> Self {
        Self {
            before,
            after,
            always,
            held: VecDeque::new(),
            held_bytes: 0,
            is_short: false,
            until: None,
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
        while let Some(first) = self.held.front()
            && (self.before.is_zero()
                || self.held_bytes > MOST_HELD_BYTES
                || oldest.is_some_and(|oldest| first.at < oldest))
        {
            self.is_short =
                !self.before.is_zero() && oldest.is_some_and(|oldest| first.at >= oldest);
            self.held_bytes -= first.picture.bytes.len();
            self.held.pop_front();
        }
        None
    }

    /// An event at this time. Returns the frames before it, which are to be recorded, and for how long before it there are
    /// some if memory held fewer than were wanted.
    pub(super) fn event(&mut self, at: Instant) -> (VecDeque<RecordedFrame>, Option<Duration>) {
        if !self.has_length() {
            return (VecDeque::new(), None);
        }
        let until = at + self.after;
        self.until = Some(self.until.map_or(until, |before| before.max(until)));
        let oldest = at.checked_sub(self.before);
        self.held_bytes = 0;
        let mut held = std::mem::take(&mut self.held);
        held.retain(|frame| oldest.is_none_or(|oldest| frame.at >= oldest));
        let is_short = std::mem::take(&mut self.is_short);
        let held_for = match held.front() {
            Some(first) if is_short => Some(at.saturating_duration_since(first.at)),
            _ => None,
        };
        (held, held_for)
    }

    /// True if a frame of this time is recorded.
    pub(super) fn is_recording(&self, at: Instant) -> bool {
        self.always || self.until.is_some_and(|until| at <= until)
    }

    /// True if recordings have a length: without one, only frames of the audit are recorded.
    pub(super) fn has_length(&self) -> bool {
        self.always || !(self.before + self.after).is_zero()
    }
}
