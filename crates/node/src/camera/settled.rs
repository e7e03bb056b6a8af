//! Publishes each frame once more, in order, with its boxes drawn between two detector calls.

use super::answer::box_messages;
use super::publishing::Outlet;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{MinConfidence, Outcome, OutputBox, SettledFrame, Settler};
use albireo_wire::{SettledMessage, VERSION};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// What the message of a settled frame says besides its boxes.
pub(super) struct FrameLabel {
    pub seq: u64,
    pub t_ns: u64,
    pub clip: Arc<str>,
    pub picture: PictureSize,
}

/// The settled frames of one camera.
pub(crate) struct SettledStream {
    settler: Settler,
    out: Out,
    outlet: Arc<Outlet>,
    start: Instant,
}

/// The messages that are due, and what they are made from.
struct Out {
    /// Of the frames held back, in order.
    labels: VecDeque<FrameLabel>,
    due: Vec<Vec<u8>>,
    boxes: Vec<OutputBox>,
    min_confidence: MinConfidence,
    class_names: Arc<[String]>,
}

impl SettledStream {
    /// Holds a frame back for at most `longest`.
    pub(crate) fn new(
        longest: Duration,
        outlet: Arc<Outlet>,
        min_confidence: MinConfidence,
        class_names: Arc<[String]>,
    ) -> Self {
        Self {
            settler: Settler::new(longest),
            out: Out {
                labels: VecDeque::new(),
                due: Vec::new(),
                boxes: Vec::new(),
                min_confidence,
                class_names,
            },
            outlet,
            start: Instant::now(),
        }
    }

    /// Takes the answer of frame `index`, as the policy gave it. A frame of another clip ends the clip before it.
    pub(super) fn frame(
        &mut self,
        index: u64,
        label: FrameLabel,
        outcome: &Outcome,
        pending: bool,
    ) {
        if (self.out.labels.back()).is_some_and(|last| last.clip != label.clip) {
            self.flush();
        }
        let time = self.start.elapsed();
        let out = &mut self.out;
        out.labels.push_back(label);
        self.settler
            .frame(index, time, outcome, pending, |frame| out.write(&frame));
    }

    /// Takes the final answer of a pending frame.
    pub(super) fn late(&mut self, index: u64, outcome: &Outcome) {
        let out = &mut self.out;
        self.settler.late(index, outcome, |frame| out.write(&frame));
    }

    /// When [`tick`](Self::tick) should be called, should no frame come before.
    pub(super) fn deadline(&self) -> Option<Instant> {
        Some(self.start + self.settler.deadline()?)
    }

    /// Gives up the frames that have waited for too long.
    pub(super) fn tick(&mut self) {
        let out = &mut self.out;
        self.settler
            .tick(self.start.elapsed(), |frame| out.write(&frame));
    }

    /// Ends the clip: nothing is held back any more.
    pub(super) fn flush(&mut self) {
        let out = &mut self.out;
        self.settler.flush(|frame| out.write(&frame));
    }

    /// Publishes what is due.
    pub(super) fn publish(&mut self) {
        for json in self.out.due.drain(..) {
            self.outlet.put(json);
        }
    }
}

impl Out {
    fn write(&mut self, frame: &SettledFrame<'_>) {
        let Some(label) = self.labels.pop_front() else {
            return;
        };
        self.boxes.clear();
        self.boxes.extend_from_slice(frame.boxes);
        self.min_confidence.select(&mut self.boxes);
        let message = SettledMessage {
            v: VERSION,
            seq: label.seq,
            t_ns: label.t_ns,
            clip: label.clip.to_string(),
            state: frame.state,
            settled: frame.settled,
            width: label.picture.width,
            height: label.picture.height,
            boxes: box_messages(&self.boxes, label.picture, &self.class_names),
        };
        match serde_json::to_vec(&message) {
            Ok(json) => self.due.push(json),
            Err(error) => tracing::error!(seq = label.seq, %error, "settled frame not written"),
        }
    }
}
