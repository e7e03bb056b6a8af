//! Classifies each frame of a camera as new, late, a duplicate, or part of another stream.
//!
//! - Frames with the same `stream` number (or none) form one stream if all have sequence numbers, or none has.
//! - A stream's numbers grow by one, by another constant step, or irregularly as times do ([`Numbering`], learnt from the
//!   numbers themselves). Between constant steps frames can be lost; between times nobody can tell.
//! - In a stream, a number at most [`NEAR`] steps above the highest is new; a number less than [`WINDOW`] steps below it
//!   is late or a duplicate. A frame without a number is the next one.
//! - A number further ahead is accepted once the next frame continues from it, by one step or by about the same difference
//!   again; until then it is stray.
//! - Every other frame is stray: it is counted but not processed, and changes nothing.
//! - Once the present stream has brought nothing new for the longer of [`SILENCE`] and five of its periods, or its
//!   publisher is gone, the next frame that is not part of it begins a new stream.

use std::time::Duration;
use tokio::time::Instant;

/// The number of past steps for which the tracker remembers whether their numbers arrived.
const WINDOW: i128 = 64;
/// The largest number of steps ahead that is accepted at once.
const NEAR: i128 = 8;
/// The largest number of frames accepted as lost: an hour at 30 frames per second.
const MAX_GAP: i128 = 108_000;
/// A stream that brings nothing new for this long, and for five of its periods, may be replaced by another.
const SILENCE: Duration = Duration::from_secs(1);
/// The number of differences between numbers by which a running stream's numbering is judged.
const RECENT: usize = 8;
/// The number of differences by which a new stream's numbering is judged.
const FIRST: usize = 3;
/// Differences from here on, all about equal, are times and not numbers of a link that loses most frames.
const LEAST_TIME: i128 = 4;

/// A camera's number of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameNumber {
    /// The sequence number, if the camera sends one.
    pub seq: Option<u64>,
    /// The numbering it belongs to, if the camera names it.
    pub stream: Option<u64>,
}

/// The relation of a frame to its camera's stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Arrival {
    /// A new frame.
    New {
        /// Its place: 0 for the first frame, counting lost frames. Grows with every new frame, also across streams.
        index: u64,
        /// The number of frames missing before it that were not told before.
        lost: u64,
        /// True if it begins a new stream. False for the very first frame.
        restarted: bool,
    },
    /// Its number has already arrived.
    Duplicate,
    /// A later number has already arrived.
    Late,
    /// It belongs to another stream.
    Stray,
}

/// Follows the numbers of one camera. It is called on reception, before the ring, for every sample with a readable
/// number, so that neither an overrun nor a rejected frame counts as a loss.
#[derive(Clone, Debug, Default)]
pub(crate) struct SequenceTracker {
    present: Option<Stream>,
    /// The place of the newest frame.
    index: Option<u64>,
}

/// How the numbers of a stream grow from one frame to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Numbering {
    /// By this step: by one, or by ten if the sender takes every tenth picture and keeps its number.
    Step(i128),
    /// Irregularly, by about this difference: times, such as milliseconds.
    Times(i128),
}

impl Numbering {
    /// The usual difference between the numbers of a frame and the one before it.
    const fn usual(self) -> i128 {
        match self {
            Self::Step(difference) | Self::Times(difference) => difference,
        }
    }

    /// The number of frames from one number to another that is larger by `difference`.
    fn frames(self, difference: i128) -> i128 {
        match self {
            Self::Step(step) => (difference / step).max(1),
            // Between times nobody can tell how many frames there were.
            Self::Times(_) => 1,
        }
    }
}

/// What a number means that is larger than the highest of its stream.
enum Forward {
    /// It continues the stream.
    Continues(Advance),
    /// The stream is over, and this is the first number of another.
    Begins,
    /// It is too far ahead to be believed before another one confirms it.
    Unconfirmed,
}

/// An accepted number's advance over the highest before it.
struct Advance {
    /// Frames from the highest number to this one.
    frames: i128,
    /// Lost frames to report now.
    lost: u64,
}

#[derive(Clone, Debug)]
struct Stream {
    id: Option<u64>,
    /// The highest number; `None` if its frames have no numbers.
    highest: Option<u64>,
    numbering: Numbering,
    /// The differences between its newest numbers, the newest last.
    recent: Vec<i128>,
    /// Until the numbering is known: the frames that would be lost if it counted by ones.
    opening: Option<u64>,
    /// Bit `k` is set if the number `k` steps below the highest has arrived.
    came: u64,
    /// By how much the last number that was too far ahead was above the highest.
    unconfirmed: Option<i128>,
    /// By how much its first number was above the highest of the stream before it.
    began_ahead: Option<i128>,
    /// Unusable samples since the highest number: that many of the missing numbers do not count as lost.
    unusable: u64,
    newest: Instant,
    /// The mean time between its frames, once there are two.
    period: Option<Duration>,
    /// True once its publisher has left.
    has_ended: bool,
}

impl Stream {
    /// A frame's number less the highest number; `None` if the frame belongs to another stream.
    fn difference(&self, number: &FrameNumber) -> Option<i128> {
        if self.id != number.stream {
            return None;
        }
        match (self.highest, number.seq) {
            (None, None) => Some(1),
            (Some(highest), Some(seq)) => Some(i128::from(seq) - i128::from(highest)),
            _ => None,
        }
    }

    fn is_over(&self, now: Instant) -> bool {
        let patience = self.period.unwrap_or_default().saturating_mul(5);
        self.has_ended || now.saturating_duration_since(self.newest) >= patience.max(SILENCE)
    }

    /// True if a number this much larger than another may follow it without any confirmation.
    fn is_near(&self, difference: i128) -> bool {
        (1..=NEAR * self.numbering.usual()).contains(&difference)
    }

    /// True if the number follows one that was too far ahead to be accepted.
    fn is_confirmed(&self, difference: i128) -> bool {
        self.unconfirmed.is_some_and(|before| self.is_near(difference - before))
    }

    /// The numbering in which this number is the next but one, if the last number that was too far ahead, or that began
    /// this stream after a silence, was ahead by about the same difference.
    fn wider(&self, difference: i128) -> Option<Numbering> {
        let last_two = if let Some(before) = self.unconfirmed {
            [before, difference - before]
        } else {
            [self.began_ahead?, difference]
        };
        numbering_of(&last_two)
    }

    /// Judges a number above the highest by `difference`.
    fn forward(&mut self, number: &FrameNumber, difference: i128, now: Instant) -> Forward {
        if self.is_near(difference) {
            return Forward::Continues(self.advance(number, difference, now));
        }
        if let Some(wider) = self.wider(difference) {
            self.number_by(wider);
            self.opening = None;
            let advance = self.advance(number, difference, now);
            // The frame between arrived, too: nothing is lost.
            return Forward::Continues(Advance { lost: 0, ..advance });
        }
        let is_gap = difference <= MAX_GAP * self.numbering.usual();
        let is_over = self.is_over(now);
        if is_gap && (is_over || self.is_confirmed(difference)) {
            return Forward::Continues(self.advance(number, difference, now));
        }
        if is_over {
            return Forward::Begins;
        }
        self.unconfirmed = Some(difference);
        if is_gap {
            self.unusable = self.unusable.saturating_add(1);
        }
        Forward::Unconfirmed
    }

    /// Accepts the frame with this number, above the highest by `difference`.
    fn advance(&mut self, number: &FrameNumber, difference: i128, now: Instant) -> Advance {
        self.learn(difference);
        let frames = self.numbering.frames(difference);
        self.highest = number.seq;
        self.came = match frames {
            1..WINDOW => self.came << frames | 1,
            _ => 1,
        };
        self.unconfirmed = None;
        self.began_ahead = None;
        let since = now.saturating_duration_since(self.newest) / u32::try_from(frames).unwrap_or(1);
        self.period = Some(match self.period {
            Some(period) => period.saturating_mul(7).saturating_add(since) / 8,
            None => since,
        });
        self.newest = now;
        // Frames that came, but could not be used, are counted already.
        let unusable = std::mem::take(&mut self.unusable);
        let missing = (frames as u64 - 1).saturating_sub(unusable);
        let lost = self.losses_to_report(difference, missing);
        Advance { frames, lost }
    }

    /// Classifies a number that is `below` the highest by so much, or the highest itself.
    fn behind(&mut self, below: i128) -> Arrival {
        let usual = self.numbering.usual();
        if below >= WINDOW * usual {
            return Arrival::Stray;
        }
        let is_remembered = matches!(self.numbering, Numbering::Step(_)) && below % usual == 0;
        if below == 0 || is_remembered {
            let bit = 1 << (below / usual);
            let has_come = self.came & bit != 0;
            self.came |= bit;
            if has_come {
                return Arrival::Duplicate;
            }
        }
        // The numbers between were sent: frames that change places in pairs do not show a step of two.
        self.recent.clear();
        Arrival::Late
    }

    /// Judges the numbering by the newest differences.
    ///
    /// A smaller step is believed sooner than a larger one, because a link that loses frames makes large steps, and nothing
    /// makes small ones.
    fn learn(&mut self, difference: i128) {
        if self.recent.len() == RECENT {
            self.recent.remove(0);
        }
        self.recent.push(difference);
        let newest = &self.recent[self.recent.len().saturating_sub(FIRST)..];
        let all_equal = newest.len() == FIRST && newest.iter().all(|one| *one == difference);
        match self.numbering {
            Numbering::Times(_) if all_equal => self.number_by(Numbering::Step(difference)),
            Numbering::Times(usual) => {
                let mean = (usual * 7 + difference) / 8;
                self.number_by(Numbering::Times(mean.max(1)));
            }
            Numbering::Step(step) if all_equal && difference < step => {
                self.number_by(Numbering::Step(difference));
            }
            Numbering::Step(step) if step > 1 && difference % step != 0 => {
                self.number_by(Numbering::Times(step));
            }
            Numbering::Step(step) => {
                if self.recent.len() == RECENT
                    && let Some(shown) = numbering_of(&self.recent)
                    && shown.usual() > step
                {
                    self.number_by(shown);
                }
            }
        }
    }

    fn number_by(&mut self, numbering: Numbering) {
        if self.numbering != numbering {
            self.numbering = numbering;
            // Its bits are places in the numbering before.
            self.came = 0;
        }
    }

    /// The lost frames to report now, `missing` of them new. In the opening they are kept until the numbering is known, so
    /// that a camera that numbers by fives does not begin with losses.
    fn losses_to_report(&mut self, difference: i128, missing: u64) -> u64 {
        let Some(kept) = self.opening else {
            return missing;
        };
        let kept = kept.saturating_add(missing);
        if difference != 1 && self.numbering == Numbering::Step(1) {
            if self.recent.len() < FIRST {
                self.opening = Some(kept);
                return 0;
            }
            if let Some(wider) = numbering_of(&self.recent) {
                self.number_by(wider);
                self.came = 1;
            }
        }
        self.opening = None;
        match self.numbering {
            Numbering::Step(1) => kept,
            _ => 0,
        }
    }
}

/// The numbering that these differences show: all the same, or all about the same and too large for counts.
fn numbering_of(differences: &[i128]) -> Option<Numbering> {
    let least = *differences.iter().min()?;
    let most = *differences.iter().max()?;
    if least < 1 {
        None
    } else if least == most {
        Some(Numbering::Step(least))
    } else if least >= LEAST_TIME && most <= 2 * least {
        Some(Numbering::Times(least))
    } else {
        None
    }
}

impl SequenceTracker {
    /// Classifies the next number in the order of arrival, of a usable frame or not.
    pub(crate) fn arrive(&mut self, number: &FrameNumber, now: Instant) -> Arrival {
        let Some(present) = &mut self.present else {
            return self.begin(number, None, now);
        };
        let difference = present.difference(number);
        if let Some(above) = difference
            && above > 0
        {
            return match present.forward(number, above, now) {
                Forward::Continues(advance) => Arrival::New {
                    index: self.next_index(advance.frames),
                    lost: advance.lost,
                    restarted: false,
                },
                Forward::Begins => self.begin(number, Some(above), now),
                Forward::Unconfirmed => Arrival::Stray,
            };
        }
        if present.is_over(now) {
            return self.begin(number, None, now);
        }
        match difference {
            Some(difference) => present.behind(-difference),
            None => Arrival::Stray,
        }
    }

    /// Counts a sample with an unreadable number.
    pub(crate) fn arrive_unreadable(&mut self) {
        if let Some(present) = &mut self.present {
            present.unusable = present.unusable.saturating_add(1);
        }
    }

    /// Records that the publisher of a stream appeared.
    pub(crate) fn publisher_came(&mut self, stream: u64) {
        if let Some(present) = self.present_with_id(stream) {
            present.has_ended = false;
        }
    }

    /// Records that the publisher of a stream left.
    pub(crate) fn publisher_left(&mut self, stream: u64) {
        if let Some(present) = self.present_with_id(stream) {
            present.has_ended = true;
        }
    }

    fn present_with_id(&mut self, id: u64) -> Option<&mut Stream> {
        self.present.as_mut().filter(|present| present.id == Some(id))
    }

    /// Begins a stream with this number, which is `ahead` of the highest of the present stream, if that is known.
    fn begin(&mut self, number: &FrameNumber, ahead: Option<i128>, now: Instant) -> Arrival {
        let restarted = self.present.is_some();
        self.present = Some(Stream {
            id: number.stream,
            highest: number.seq,
            numbering: Numbering::Step(1),
            recent: Vec::with_capacity(RECENT),
            opening: Some(0),
            came: 1,
            unconfirmed: None,
            began_ahead: ahead,
            unusable: 0,
            newest: now,
            period: None,
            has_ended: false,
        });
        Arrival::New {
            index: self.next_index(1),
            lost: 0,
            restarted,
        }
    }

    /// Moves on by so many frames; returns the place of the newest, which is 0 for the first.
    fn next_index(&mut self, frames: i128) -> u64 {
        let frames = u64::try_from(frames).unwrap_or(u64::MAX);
        let index = match self.index {
            Some(newest) => newest.saturating_add(frames),
            None => 0,
        };
        self.index = Some(index);
        index
    }
}

#[cfg(test)]
mod tests;
