//! The frames that become final when the next detector call is known.

use albireo_core::policy::{Outcome, OutputBox, SettledFrame, Settler};
use std::time::Duration;

/// A settled frame: its number, state, whether it was settled, and its boxes.
pub(crate) type Settled = (u64, &'static str, bool, Vec<OutputBox>);

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

    /// Receives the answer of frame `n`. `pending` is true if late detections will change it.
    pub(crate) fn frame(&mut self, n: u64, outcome: &Outcome, pending: bool) {
        let time = Duration::from_secs(n);
        let ready = &mut self.ready;
        self.settler.frame(n, time, outcome, pending, |frame| ready.push(row(&frame)));
    }

    /// Receives the final answer of a pending frame.
    pub(crate) fn late(&mut self, n: u64, outcome: &Outcome) {
        let ready = &mut self.ready;
        self.settler.late(n, outcome, |frame| ready.push(row(&frame)));
    }

    /// Ends a stream: all frames that are held back are ready.
    pub(crate) fn flush(&mut self) {
        let ready = &mut self.ready;
        self.settler.flush(|frame| ready.push(row(&frame)));
    }

    /// Takes the frames that are ready.
    pub(crate) fn take(&mut self) -> Vec<Settled> {
        std::mem::take(&mut self.ready)
    }
}

fn row(frame: &SettledFrame<'_>) -> Settled {
    (
        frame.index,
        frame.state.as_str(),
        frame.settled,
        frame.boxes.to_vec(),
    )
}
