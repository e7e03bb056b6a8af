//! A pause on an empty road: once looks have found nothing for a while, only every n-th frame is looked at.
//!
//! ```text
//! found   1 0 0 0 0 0 0 0 0 . . 0 . . 0 . . 1 1 1      `.` passed over, state E
//!           └──── after ──┘ └every┘     └ a look that finds something ends the pause
//! ```
//!
//! A second pause is for [pictures without news](super::still), whatever is tracked.
//!
//! The first is a screen that needs no picture: it answers the question that a [policy](Policy::takes_pause) asks while
//! nothing is tracked, not even tentatively. A look is an answer of the detector, or of a screen model that says
//! "empty". Lost frames count as time.

use super::still::{Memory, PassCause, Still, WIDTH};
use super::{
    BoxSource, CallCause, Evidence, FrameHead, FrameState, InvalidThreshold, Need, ObjectRecord,
    Outcome, Policy, ThresholdSpec,
};
use serde::{Deserialize, Serialize};

/// The pause in seconds, as it is configured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EmptyRoad {
    /// Seconds from one look at an empty road to the next; 0 looks at every frame.
    pub pause_s: f64,
    /// Seconds without a detection after which the road is empty.
    pub after_s: f64,
    /// Seconds from one look at a picture without news to the next; 0 compares no pictures.
    pub still_s: f64,
}

impl Default for EmptyRoad {
    fn default() -> Self {
        Self {
            pause_s: 0.0,
            after_s: 1.0,
            still_s: 0.0,
        }
    }
}

impl EmptyRoad {
    /// The longest pause, seconds: whoever wants longer ones does not want to see what comes.
    pub const LONGEST_PAUSE_S: f64 = 60.0;
    /// The longest time without a detection, seconds.
    pub const LONGEST_AFTER_S: f64 = 3600.0;

    /// A measured rate may be this much too low without costing a frame of the pause.
    const RATE_TOLERANCE: f64 = 1.02;

    /// Returns what is wrong, with the setting's name.
    pub fn problem(&self) -> Option<(&'static str, String)> {
        let settings = [
            ("pause_s", self.pause_s, Self::LONGEST_PAUSE_S),
            ("after_s", self.after_s, Self::LONGEST_AFTER_S),
            ("still_s", self.still_s, Self::LONGEST_PAUSE_S),
        ];
        for (name, value, most) in settings {
            if !(0.0..=most).contains(&value) {
                let reason = format!("must be a number of seconds from 0 to {most}, not {value}");
                return Some((name, reason));
            }
        }
        None
    }

    /// Converts to frames at `rate` frames per second: the pause is rounded down, the time before it up. Without a
    /// rate, every frame is looked at.
    pub fn frames(&self, rate: Option<f64>) -> PauseFrames {
        let rate = rate.unwrap_or(0.0);
        if !(rate.is_finite() && rate > 0.0) {
            return PauseFrames::OFF;
        }
        // Casts saturate, and turn what is not a number into 0.
        PauseFrames {
            every: (self.pause_s * rate * Self::RATE_TOLERANCE).floor() as u32,
            after: (self.after_s * rate / Self::RATE_TOLERANCE).ceil() as u32,
            still: (self.still_s * rate).round() as u32,
            second: (rate / Self::RATE_TOLERANCE).ceil() as u32,
        }
    }
}

/// The words for a policy that [takes no pause](Policy::takes_pause).
pub fn no_pause(policy: &str) -> String {
    format!(
        "policy `{policy}` takes no pause on an empty road: it is for policies that call the detector whenever nothing is \
         tracked, such as `albireo`"
    )
}

/// The pause in frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PauseFrames {
    /// One frame in this many is looked at while the road is empty; 0 and 1 look at every frame.
    pub every: u32,
    /// Frames in a row without a detection, at least one of them looked at, after which the road is empty.
    pub after: u32,
    /// One frame in this many is looked at while the picture has no news; 0 and 1 compare no pictures.
    pub still: u32,
    /// Frames per second, at least 1.
    pub second: u32,
}

impl PauseFrames {
    /// Every frame is looked at.
    pub const OFF: Self = Self {
        every: 0,
        after: 0,
        still: 0,
        second: 1,
    };
}

/// The frames since the last looks: all that the decision depends on.
#[derive(Clone, Copy, Debug, Default)]
struct Looks {
    /// Frames since something was found, or since the start.
    since_found: u32,
    /// Frames since the last look, or since the start.
    since_look: u32,
}

impl Looks {
    fn advance(&mut self, step: u32) {
        self.since_found = self.since_found.saturating_add(step);
        self.since_look = self.since_look.saturating_add(step);
    }

    fn looked(&mut self, found: bool) {
        self.since_look = 0;
        if found {
            self.since_found = 0;
        }
    }

    /// True if looks have found nothing for so long that the current frame belongs to a pause.
    fn is_empty(self, pause: PauseFrames) -> bool {
        pause.every > 1 && self.since_found > pause.after && self.since_look < self.since_found
    }

    /// True if the current frame can be passed over.
    fn passes(self, pause: PauseFrames) -> bool {
        self.is_empty(pause) && self.since_look < pause.every
    }
}

/// The progress of the current frame, and what the next ones depend on.
#[derive(Clone, Copy, Debug, Default)]
struct State {
    looks: Looks,
    need: Need,
    /// True if the frame is a look at an empty road, or at a picture without news.
    looking: bool,
    still: Still,
    /// What the policy needs if the picture, which is compared first, has news.
    wanted: Need,
    /// Why the frame is passed over.
    passed: Option<PassCause>,
}

/// A policy with a pause on an empty road.
pub struct WithPause {
    policy: Box<dyn Policy>,
    pause: PauseFrames,
    state: State,
    /// The state that [`Policy::rewind`] restores.
    saved: State,
    memory: Memory,
}

impl WithPause {
    /// Adds a pause to `policy`. If it [takes none](Policy::takes_pause), nothing changes.
    pub fn new(policy: Box<dyn Policy>, pause: PauseFrames) -> Self {
        Self {
            policy,
            pause,
            state: State::default(),
            saved: State::default(),
            memory: Memory::default(),
        }
    }

    /// Changes the pause for the frames that follow.
    pub fn set_pause(&mut self, pause: PauseFrames) {
        self.pause = pause;
    }

    /// The reason why the newest picture has no news, and the number of frames since it last had some.
    pub fn no_news(&self) -> Option<(PassCause, u32)> {
        self.state.still.cause(self.pause)
    }

    /// Asks for the picture before what the policy needs, if it should be compared.
    fn compare_first(&mut self, need: Need) -> Need {
        let may_call = matches!(need, Need::Screen | Need::Detections);
        // A policy that looks at pictures itself gets no other ones.
        let has_own_pictures = self.policy.pictures().is_some();
        if may_call && !has_own_pictures && self.state.still.is_due(self.pause) {
            self.state.wanted = need;
            return Need::SmallGreyPicture { width: WIDTH };
        }
        need
    }

    /// Takes the picture that is compared. If it has no news, what the detector found at its last look stands.
    fn compare(&mut self, evidence: Evidence<'_>) -> Need {
        let mut need = std::mem::take(&mut self.state.wanted);
        let still = &mut self.state.still;
        let passed = still.compare(evidence, &mut self.memory, self.pause);
        let is_look = passed.is_none() && still.cause(self.pause).is_some();
        self.state.passed = passed;
        self.state.looking |= is_look;
        if passed.is_none() {
            return need;
        }
        let found = &self.memory.found;
        if need == Need::Screen {
            let empty = found.is_empty();
            need = self.policy.answer(Evidence::Screen { empty });
        }
        match need {
            Need::Detections => self.policy.answer(Evidence::Detections(found)),
            _ => need,
        }
    }

    fn ask(&mut self, need: Need) -> Need {
        self.state.need = need;
        need
    }
}

impl Policy for WithPause {
    fn name(&self) -> &'static str {
        self.policy.name()
    }

    fn threshold_spec(&self) -> Option<ThresholdSpec> {
        self.policy.threshold_spec()
    }

    fn threshold(&self) -> Option<f64> {
        self.policy.threshold()
    }

    fn set_threshold(&mut self, value: f64) -> Result<(), InvalidThreshold> {
        self.policy.set_threshold(value)
    }

    fn set_join(&mut self, share: f64) {
        self.policy.set_join(share);
    }

    fn begin(&mut self, frame: FrameHead) -> Need {
        let step = frame.step.max(1);
        self.state.looks.advance(step);
        self.state.still.advance(step);
        self.state.looking = false;
        self.state.wanted = Need::Nothing;
        self.state.passed = None;
        let mut need = self.policy.begin(frame);
        if need == Need::Screen && self.policy.takes_pause() {
            let looks = self.state.looks;
            self.state.looking = looks.is_empty(self.pause);
            if looks.passes(self.pause) {
                need = self.policy.answer(Evidence::Screen { empty: true });
                self.state.passed = Some(PassCause::EmptyRoad);
            }
        }
        let need = self.compare_first(need);
        self.ask(need)
    }

    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        if self.state.wanted != Need::Nothing {
            let need = self.compare(evidence);
            return self.ask(need);
        }
        let State {
            looks, still, need, ..
        } = &mut self.state;
        match (*need, evidence) {
            (Need::Screen, Evidence::Screen { empty: true }) => looks.looked(false),
            (Need::Detections, Evidence::Detections(found)) => {
                looks.looked(!found.is_empty());
                if self.pause.still > 1 {
                    still.looked();
                    self.memory.looked(found);
                }
            }
            _ => {}
        }
        let need = self.policy.answer(evidence);
        self.ask(need)
    }

    fn pictures(&self) -> Option<Need> {
        self.policy.pictures()
    }

    fn longest_pause(&self) -> Option<u32> {
        self.policy.longest_pause()
    }

    fn takes_pause(&self) -> bool {
        self.policy.takes_pause()
    }

    fn can_rewind(&self) -> bool {
        self.policy.can_rewind()
    }

    fn save(&mut self) {
        self.saved = self.state;
        self.policy.save();
    }

    fn rewind(&mut self) {
        self.state = self.saved;
        self.policy.rewind();
    }

    /// A call at the end of a pause has the pause as its cause, unless a screen model asked for it. In a frame without
    /// news no detector ran, and the boxes are those of the last look.
    fn finish(&mut self, outcome: &mut Outcome) {
        self.policy.finish(outcome);
        outcome.passed = self.state.passed;
        if matches!(outcome.passed, Some(PassCause::Unchanged | PassCause::Dark)) {
            outcome.cause = None;
            outcome.state = if outcome.boxes.is_empty() {
                FrameState::E
            } else {
                FrameState::P
            };
            for found in &mut outcome.boxes {
                found.source = BoxSource::Predicted;
            }
        }
        if self.state.looking && outcome.cause.is_some_and(|cause| cause != CallCause::Screen) {
            outcome.cause = Some(CallCause::EmptyRoad);
        }
    }

    fn reset(&mut self) {
        self.state = State::default();
        self.memory = Memory::default();
        self.policy.reset();
    }

    fn objects(&self, visit: &mut dyn FnMut(&ObjectRecord)) {
        self.policy.objects(visit);
    }

    fn rejected_detections(&self) -> u64 {
        self.policy.rejected_detections()
    }
}

#[cfg(test)]
mod tests;
