//! Publishes each frame again, in order, with its boxes interpolated between two detector calls.

use super::CameraParts;
use crate::input::receiver::SequencedFrame;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{Outcome, SettledFrame, Settler};
use albireo_wire::{SettledMessage, VERSION, box_messages};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// The settled frames of one camera.
pub(super) struct SettledStream {
    settler: Settler,
    /// The messages of the frames held back, in order, without boxes.
    waiting: VecDeque<SettledMessage>,
    parts: Arc<CameraParts>,
    start: Instant,
}

impl SettledStream {
    /// Creates a stream that holds frames back for at most `longest`.
    pub(super) fn new(longest: Duration, parts: &Arc<CameraParts>) -> Self {
        Self {
            settler: Settler::new(longest),
            waiting: VecDeque::new(),
            parts: Arc::clone(parts),
            start: Instant::now(),
        }
    }

    /// Adds a frame's answer as the policy gave it. A frame of another clip ends the previous clip.
    pub(super) fn frame(
        &mut self,
        incoming: &SequencedFrame,
        clip: &str,
        outcome: &Outcome,
        pending: bool,
    ) {
        if self.waiting.back().is_some_and(|last| last.clip != clip) {
            self.settler.flush(|frame| release(&mut self.waiting, &self.parts, &frame));
        }
        let frame = &incoming.frame;
        self.waiting.push_back(SettledMessage {
            v: VERSION,
            seq: frame.sequence,
            t_ns: frame.time_ns,
            clip: clip.to_owned(),
            state: outcome.state,
            settled: false,
            width: frame.picture.size.width,
            height: frame.picture.size.height,
            boxes: Vec::new(),
        });
        let time = self.start.elapsed();
        self.settler.frame(incoming.index, time, outcome, pending, |frame| {
            release(&mut self.waiting, &self.parts, &frame);
        });
    }

    /// Adds the final answer of a pending frame.
    pub(super) fn late(&mut self, index: u64, outcome: &Outcome) {
        self.settler.late(index, outcome, |frame| {
            release(&mut self.waiting, &self.parts, &frame);
        });
    }

    /// The time to call [`tick`](Self::tick) if no frame arrives before.
    pub(super) fn deadline(&self) -> Option<Instant> {
        Some(self.start + self.settler.deadline()?)
    }

    /// Releases the frames that have waited too long.
    pub(super) fn tick(&mut self) {
        self.settler.tick(self.start.elapsed(), |frame| {
            release(&mut self.waiting, &self.parts, &frame);
        });
    }

    /// Ends the stream of a policy: releases all frames held back.
    pub(super) fn end_stream(&mut self) {
        self.settler.end_stream(|frame| release(&mut self.waiting, &self.parts, &frame));
    }
}

/// Publishes the oldest message that waits, with the boxes of `frame`.
fn release(waiting: &mut VecDeque<SettledMessage>, parts: &CameraParts, frame: &SettledFrame<'_>) {
    let Some(mut message) = waiting.pop_front() else {
        return;
    };
    let mut boxes = frame.boxes.to_vec();
    boxes.retain(|one| !parts.receiver.hides(one.bounding_box));
    parts.min_confidence.select(&mut boxes);
    let size = PictureSize::new(message.width, message.height);
    message.state = frame.state;
    message.settled = frame.settled;
    message.boxes = box_messages(&boxes, size, &parts.class_names);
    if let Some(outlet) = &parts.settled {
        outlet.put(&message);
    }
}
