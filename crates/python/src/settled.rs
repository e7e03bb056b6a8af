//! The frames that become final when the next detector call is known.

use albireo_core::policy::{Outcome, OutputBox, SettledFrame, Settler};
use std::time::Duration;

/// A settled frame, copied from the settler's buffers.
pub(crate) struct Settled {
    pub number: u64,
    pub state: &'static str,
    /// False if it was emitted as answered, because no detector call came in time.
    pub settled: bool,
    pub boxes: Vec<OutputBox>,
}

impl From<SettledFrame<'_>> for Settled {
    fn from(frame: SettledFrame<'_>) -> Self {
        Self {
            number: frame.index,
            state: frame.state.as_str(),
            settled: frame.settled,
            boxes: frame.boxes.to_vec(),
        }
    }
}

/// A settler, and the frames that it has returned and nobody has taken.
pub(crate) struct Settling {
    settler: Settler,
    ready: Vec<Settled>,
}

impl Settling {
    /// Holds back at most `frames` frames: a frame's number is also its time.
    pub(crate) fn new(frames: u64) -> Self {
        Self {
            settler: Settler::new(Duration::from_secs(frames)),
            ready: Vec::new(),
        }
    }

    /// Receives the answer of a frame. `pending` is true if late detections will change it.
    pub(crate) fn frame(&mut self, index: u64, outcome: &Outcome, pending: bool) {
        let time = Duration::from_secs(index);
        let ready = &mut self.ready;
        self.settler.frame(index, time, outcome, pending, |frame| {
            ready.push(frame.into())
        });
    }

    /// Receives the final answer of a pending frame.
    pub(crate) fn late(&mut self, index: u64, outcome: &Outcome) {
        let ready = &mut self.ready;
        self.settler.late(index, outcome, |frame| ready.push(frame.into()));
    }

    /// Ends a stream: all frames that are held back are ready.
    pub(crate) fn end_stream(&mut self) {
        let ready = &mut self.ready;
        self.settler.end_stream(|frame| ready.push(frame.into()));
    }

    /// Takes the frames that are ready.
    pub(crate) fn take(&mut self) -> Vec<Settled> {
        std::mem::take(&mut self.ready)
    }
}
