//! Interpolates the boxes between two detector calls once the second call is known: for recordings, counting and
//! training data, which do not need their boxes at once.
//!
//! A frame on which the detector ran (`I`, `AI`, `E+I`) or that the screen found empty (`E`) is unchanged. Frames
//! between two of these are emitted once the second has arrived:
//!
//! | object | box | confidence |
//! | --- | --- | --- |
//! | reported at both ends, detected at the second | on the straight line between both | mean of both |
//! | detected first at the second | where it was detected | half of that at the second, falling to 0 at the first |
//! | missed at the second (rescued) | as answered | three quarters |
//! | gone at the second | as answered | half |

use super::{BoxSource, FrameState, Outcome, OutputBox};
use crate::geometry::BoundingBox;
use std::collections::VecDeque;
use std::time::Duration;

/// Maximum number of frames held back, regardless of their times.
const MOST_FRAMES: usize = 256;

/// Factor on the confidence of an object that is gone at the next call.
const GONE: f64 = 0.5;

/// Factor on the confidence of an object that the next call missed.
const MISSED: f64 = 0.75;

/// Share of a new object's confidence just before the call that found it. It falls to 0 at the previous call.
const NEW: f64 = 0.5;

/// An emitted frame: each once, in order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SettledFrame<'a> {
    /// Index in the stream.
    pub index: u64,
    /// State of the frame.
    pub state: FrameState,
    /// False for a frame emitted as answered because no call came in time.
    pub settled: bool,
    /// Boxes of the frame.
    pub boxes: &'a [OutputBox],
}

/// A frame held back, or the last call.
#[derive(Clone, Debug)]
struct Buffered {
    index: u64,
    time: Duration,
    state: FrameState,
    pending: bool,
    boxes: Vec<OutputBox>,
}

impl Buffered {
    fn finish(&mut self, outcome: &Outcome) {
        self.pending = false;
        self.state = outcome.state;
        self.boxes.clone_from(&outcome.boxes);
    }

    /// Returns the frame as answered.
    fn as_answered(&self, settled: bool) -> SettledFrame<'_> {
        SettledFrame {
            index: self.index,
            state: self.state,
            settled,
            boxes: &self.boxes,
        }
    }
}

/// Holds frames back until they can be interpolated between two calls.
#[derive(Clone, Debug)]
pub struct Settler {
    longest_delay: Duration,
    /// Frames since the last call, in order.
    buffer: VecDeque<Buffered>,
    /// The last call before these frames.
    call: Option<Buffered>,
    /// Index of the last frame received.
    last: Option<u64>,
    /// The boxes of the frame being emitted.
    drawn: Vec<OutputBox>,
    /// Spare buffers for future frames.
    spare: Vec<Vec<OutputBox>>,
}

impl Settler {
    /// Holds a frame back for at most `longest_delay` of the frames' own time, and for at most 256 frames.
    pub fn new(longest_delay: Duration) -> Self {
        Self {
            longest_delay,
            buffer: VecDeque::new(),
            call: None,
            last: None,
            drawn: Vec::new(),
            spare: Vec::new(),
        }
    }

    /// Receives the answer of frame `index`, whose picture has this `time`, and emits every frame that can be settled
    /// or has waited too long. A `pending` frame gets its final answer by [`late`](Self::late). An index not above the
    /// previous one begins a new stream: the frames held back are emitted first.
    pub fn frame(
        &mut self,
        index: u64,
        time: Duration,
        outcome: &Outcome,
        pending: bool,
        mut each: impl FnMut(SettledFrame<'_>),
    ) {
        if self.last.is_some_and(|last| index <= last) {
            self.end_stream(&mut each);
        }
        self.last = Some(index);
        let mut frame = Buffered {
            index,
            time,
            state: outcome.state,
            pending,
            boxes: self.spare.pop().unwrap_or_default(),
        };
        frame.boxes.clone_from(&outcome.boxes);
        self.buffer.push_back(frame);
        self.settle(&mut each);
        self.tick(time, each);
    }

    /// Returns the frame time at which the oldest frame held back will have exceeded the longest delay.
    pub fn deadline(&self) -> Option<Duration> {
        let oldest = self.buffer.front()?;
        let last = oldest.time.saturating_add(self.longest_delay);
        Some(last.saturating_add(Duration::from_nanos(1)))
    }

    /// Emits, as answered, the frames that have waited too long at `time`, because a stream may pause.
    pub fn tick(&mut self, time: Duration, mut each: impl FnMut(SettledFrame<'_>)) {
        while self.deadline().is_some_and(|deadline| deadline <= time)
            || self.buffer.len() > MOST_FRAMES
        {
            self.give_up_oldest(&mut each);
        }
    }

    /// Receives the final answer of a pending frame. If the frame was already emitted as answered, later frames are
    /// still interpolated from this answer. Any other index is ignored.
    pub fn late(&mut self, index: u64, outcome: &Outcome, mut each: impl FnMut(SettledFrame<'_>)) {
        if let Some(buffer) = self.buffer.iter_mut().find(|buffer| buffer.index == index) {
            if buffer.pending {
                buffer.finish(outcome);
                self.settle(&mut each);
            }
            return;
        }
        let is_past = self.last.is_some_and(|last| index <= last);
        let is_newest = self.call.as_ref().is_none_or(|call| call.index < index);
        if is_past && is_newest && outcome.state != FrameState::P {
            let mut call = self.call.take().unwrap_or_else(|| Buffered {
                index,
                time: Duration::ZERO,
                state: outcome.state,
                pending: false,
                boxes: self.spare.pop().unwrap_or_default(),
            });
            call.index = index;
            call.finish(outcome);
            self.call = Some(call);
        }
    }

    /// Emits the frames held back, as answered, at the end of a clip.
    pub fn flush(&mut self, mut each: impl FnMut(SettledFrame<'_>)) {
        while !self.buffer.is_empty() {
            self.give_up_oldest(&mut each);
        }
    }

    /// Emits the frames held back, as answered, and forgets the stream: later frames have other objects, so that none is
    /// interpolated from what was before.
    pub fn end_stream(&mut self, each: impl FnMut(SettledFrame<'_>)) {
        self.flush(each);
        let call = self.call.take();
        self.recycle(call);
        self.last = None;
    }

    /// Emits all frames up to the last call whose boxes are known.
    fn settle(&mut self, each: &mut impl FnMut(SettledFrame<'_>)) {
        loop {
            let Some(predicted) = self
                .buffer
                .iter()
                .position(|frame| frame.pending || frame.state != FrameState::P)
            else {
                return;
            };
            if self.buffer[predicted].pending {
                return;
            }
            // Behind each frame that goes, the call moves one place to the front.
            for call_at in (0..predicted).rev() {
                self.draw_oldest(call_at, each);
            }
            let call = self.buffer.pop_front();
            if let Some(call) = &call {
                each(call.as_answered(true));
            }
            let before = std::mem::replace(&mut self.call, call);
            self.recycle(before);
        }
    }

    /// Emits the oldest frame, interpolated between the last call and the one that is then at `call_at`.
    fn draw_oldest(&mut self, call_at: usize, each: &mut impl FnMut(SettledFrame<'_>)) {
        let frame = self.buffer.pop_front();
        match (&frame, &self.call, self.buffer.get(call_at)) {
            (Some(frame), Some(from), Some(to)) => {
                draw(frame, from, to, &mut self.drawn);
                each(SettledFrame {
                    boxes: &self.drawn,
                    ..frame.as_answered(true)
                });
            }
            // Before the first call there is nothing to interpolate from.
            (Some(frame), ..) => each(frame.as_answered(false)),
            (None, ..) => {}
        }
        self.recycle(frame);
    }

    fn give_up_oldest(&mut self, each: &mut impl FnMut(SettledFrame<'_>)) {
        let frame = self.buffer.pop_front();
        if let Some(frame) = &frame {
            each(frame.as_answered(false));
        }
        self.recycle(frame);
    }

    fn recycle(&mut self, frame: Option<Buffered>) {
        self.spare.extend(frame.map(|frame| frame.boxes));
    }
}

/// Overwrites `drawn` with the boxes of `frame`, which lies between the calls `from` and `to`.
fn draw(frame: &Buffered, from: &Buffered, to: &Buffered, drawn: &mut Vec<OutputBox>) {
    drawn.clear();
    for own in &frame.boxes {
        if let Some(belief) = belief(own, from, to) {
            drawn.push(OutputBox {
                confidence: belief * own.confidence,
                ..*own
            });
        }
    }
    let share = (frame.index - from.index) as f64 / (to.index - from.index) as f64;
    for end in &to.boxes {
        if end.source != BoxSource::Detected || end.object.is_none() {
            continue;
        }
        let source = BoxSource::Predicted;
        if let Some(start) = find(from, end) {
            drawn.push(OutputBox {
                bounding_box: between(start.bounding_box, end.bounding_box, share),
                confidence: (start.confidence + end.confidence) / 2.0,
                source,
                ..*end
            });
        } else if find(frame, end).is_none() {
            drawn.push(OutputBox {
                confidence: NEW * share * end.confidence,
                source,
                ..*end
            });
        }
    }
}

/// Returns the factor on the confidence of a box as answered, given what the second call found; `None` if a box on the
/// line between the calls replaces it.
fn belief(own: &OutputBox, from: &Buffered, to: &Buffered) -> Option<f64> {
    if own.object.is_none() {
        return Some(1.0);
    }
    match find(to, own) {
        Some(end) if end.source == BoxSource::Detected => {
            let is_at_both_ends = find(from, own).is_some();
            if is_at_both_ends { None } else { Some(1.0) }
        }
        Some(_) => Some(MISSED),
        None => Some(GONE),
    }
}

/// Returns the box in `frame` of the same object as `known`.
fn find<'a>(frame: &'a Buffered, known: &OutputBox) -> Option<&'a OutputBox> {
    frame.boxes.iter().find(|other| other.object == known.object)
}

fn between(start: BoundingBox, end: BoundingBox, share: f64) -> BoundingBox {
    let line = |start: f64, end: f64| start + share * (end - start);
    BoundingBox {
        center_x: line(start.center_x, end.center_x),
        center_y: line(start.center_y, end.center_y),
        width: line(start.width, end.width),
        height: line(start.height, end.height),
    }
}

#[cfg(test)]
mod tests;
