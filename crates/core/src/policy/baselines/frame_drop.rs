//! Frame dropping with an event trigger: the detector runs on every n-th frame, and whenever something appears that no
//! object explains.
//!
//! After M. Henning, M. Buchholz and K. Dietmayer, "Advancing Frame-Dropping in Multi-Object Tracking-by-Detection
//! Systems Through Event-Based Detection Triggering" (2023, arXiv:2308.00330), and their work on frame dropping before
//! it: a tracker is fed with detections of some frames only, and an event, an object that another and cheaper sensor
//! sees and no track explains, calls the detector out of turn.
//!
//! Differences: their detector reads lidar, and the cheaper sensor is the camera with its own detector. Here there is
//! one camera and one detector, so an event comes from one of two cues:
//!
//! - **pixels**, which a node has: more than [`FrameDropSettings::component_size`] pixels in one piece of the halved
//!   grey picture have changed since the frame before, outside of all predicted boxes and a margin around them (the
//!   measure is that of `statues`). A moving camera changes everywhere, so there it is an event on nearly every frame;
//! - **boxes known beforehand** ([`FrameDrop::with_cue`]), for evaluation: what the second sensor sees of each frame. With the
//!   detector's own boxes that is a second sensor as good as the detector, and free: no system has it, and what it
//!   reaches is a bound on what any cue for new objects can bring.
//!
//! The tracker is Albireo's filter and matching, as under the other baselines, instead of theirs. A confirmed object
//! lives through two misses, with its predicted box.

use super::changed_region::ChangedRegion;
use crate::geometry::{BoundingBox, PictureSize};
use crate::objects::{Missed, ObjectState};
use crate::policy::tracker::{Tracker, check_setting};
use crate::policy::{
    CallCause, Evidence, FrameHead, FrameState, GreyPicture, Knob, KnobError, Need, ObjectRecord,
    Outcome, Policy, PolicyConfig, PolicyConfigError,
};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// An object explains a box of the cue when they overlap by this (intersection over union): the gate of the first stage
/// of matching.
const EXPLAINED_IOU: f64 = 0.25;

/// Around a predicted box, as a share of its side, changes are the object's own.
const MARGIN: f64 = 0.2;

/// Misses in a row that a confirmed object lives through.
const MISSES: u32 = 2;

/// The settings of the policy.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FrameDropSettings {
    /// The detector runs when its last call was this many frames ago, and at events.
    pub n: f64,
    /// A change outside of all predicted boxes is an event when it has more pixels in one piece, counted in the halved
    /// picture.
    pub component_size: f64,
    /// A pixel has changed when its grey value, 0 to 255, differs by this or more. At least 1.
    pub pixel_difference: u8,
}

impl Default for FrameDropSettings {
    fn default() -> Self {
        Self {
            n: FrameDrop::KNOB.default,
            component_size: 200.0,
            pixel_difference: 30,
        }
    }
}

/// Progress of the current frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FrameDropPhase {
    AwaitsPicture,
    AwaitsDetections,
    Decided(FrameState),
}

/// The policy of frame dropping with an event trigger.
#[derive(Clone, Debug)]
pub struct FrameDrop {
    settings: FrameDropSettings,
    tracker: Tracker,
    progress: FrameDropPhase,
    /// Why the detector is called for the current frame.
    cause: Option<CallCause>,
    /// Frames since the detector last answered, the current frame included; `None` before its first answer.
    since_call: Option<u32>,
    /// The detector was called for and has not answered since.
    owed: bool,
    /// What the second sensor sees, by frame index, where that is known beforehand.
    cue: Option<Arc<[Vec<BoundingBox>]>>,
    region: ChangedRegion,
    /// The last picture there was.
    pixels: Vec<u8>,
    size: Option<PictureSize>,
    /// The current picture, with the last one's pixels inside the predicted boxes.
    masked: Vec<u8>,
}

impl FrameDrop {
    /// The name in configuration and reports.
    pub const NAME: &'static str = "frame-drop";

    /// Frames from call to call where there is no event.
    pub const KNOB: Knob = Knob {
        name: "n",
        meaning: "The detector runs on one frame of so many, and when something shows up that no object explains: \
                  higher saves more energy, lower is more accurate",
        minimum: 1.0,
        maximum: 1000.0,
        default: 5.0,
        useful_minimum: 1.0,
        useful_maximum: 30.0,
    };

    pub(in crate::policy) fn from_config(
        config: &PolicyConfig,
    ) -> Result<Box<dyn Policy>, PolicyConfigError> {
        Ok(Box::new(Self::new(config, None)?))
    }

    /// The policy with `cue` instead of pixels: what a second sensor sees, one list per frame, by frame index. Frames
    /// beyond it have no events.
    ///
    /// # Errors
    /// [`PolicyConfigError::Setting`] when a setting cannot be used.
    pub fn with_cue(
        config: &PolicyConfig,
        cue: Arc<[Vec<BoundingBox>]>,
    ) -> Result<Self, PolicyConfigError> {
        Self::new(config, Some(cue))
    }

    fn new(
        config: &PolicyConfig,
        cue: Option<Arc<[Vec<BoundingBox>]>>,
    ) -> Result<Self, PolicyConfigError> {
        let settings = config.frame_drop;
        let table = "frame_drop";
        check_setting(table, Self::KNOB, settings.n)?;
        let size = Knob {
            name: "component_size",
            minimum: 0.0,
            maximum: 1e9,
            ..Self::KNOB
        };
        check_setting(table, size, settings.component_size)?;
        if settings.pixel_difference == 0 {
            return Err(PolicyConfigError::Setting {
                table,
                reason: "`pixel_difference` is 0; it must be a whole number from 1 to 255"
                    .to_owned(),
            });
        }
        Ok(Self {
            settings,
            tracker: Tracker::from_config(config),
            progress: FrameDropPhase::Decided(FrameState::P),
            cause: None,
            since_call: None,
            owed: false,
            cue,
            region: ChangedRegion::default(),
            pixels: Vec::new(),
            size: None,
            masked: Vec::new(),
        })
    }

    /// Why the detector is called without any event.
    fn due(&self) -> Option<CallCause> {
        match self.since_call {
            None => Some(CallCause::Start),
            Some(frames) if f64::from(frames) >= self.settings.n => Some(CallCause::Schedule),
            Some(_) => self.owed.then_some(CallCause::Retry),
        }
    }

    fn call_detector(&mut self, cause: CallCause) -> Need {
        self.progress = FrameDropPhase::AwaitsDetections;
        self.cause = Some(cause);
        self.owed = true;
        Need::Detections
    }

    fn drop_frame(&mut self) -> Need {
        self.progress = FrameDropPhase::Decided(FrameState::P);
        self.cause = None;
        Need::Nothing
    }

    /// Whether the second sensor sees something in frame `index` that no object explains.
    fn is_cued(&self, cue: &[Vec<BoundingBox>], index: u64) -> bool {
        let seen = usize::try_from(index).ok().and_then(|index| cue.get(index));
        seen.into_iter().flatten().any(|seen| {
            let objects = self.tracker.objects.states();
            !objects.iter().any(|state| {
                let predicted = state.filter.bounding_box();
                predicted.intersection_over_union(*seen) >= EXPLAINED_IOU
            })
        })
    }

    /// Whether enough has changed outside of the predicted boxes. Keeps `picture` as the last one, unless it has not as
    /// many pixels as its size says.
    fn has_changed(&mut self, picture: GreyPicture<'_>) -> bool {
        let pixels = picture.pixels;
        if pixels.len() as u64 != picture.size.pixels() {
            return false;
        }
        let changed = self.size == Some(picture.size) && {
            self.masked.clear();
            self.masked.extend_from_slice(pixels);
            for state in self.tracker.objects.states() {
                let own = state.filter.bounding_box();
                hide(&mut self.masked, &self.pixels, picture.size, own);
            }
            let size = self.settings.component_size as u64;
            let (width, difference) = (picture.size.width as usize, self.settings.pixel_difference);
            (self.region).exceeds(width, &self.pixels, &self.masked, difference, size)
        };
        self.size = Some(picture.size);
        self.pixels.clear();
        self.pixels.extend_from_slice(pixels);
        changed
    }
}

/// Puts the pixels of `before` into `picture` where `own` lies, with its margin.
fn hide(picture: &mut [u8], before: &[u8], size: PictureSize, own: BoundingBox) {
    // Casts of numbers beyond the range saturate, and what is no number becomes 0.
    let span = |center: f64, side: f64, pixels: u32| {
        let half = side * (0.5 + MARGIN);
        let least = ((center - half) * f64::from(pixels)).floor().max(0.0);
        let most = ((center + half) * f64::from(pixels)).ceil();
        (
            least as usize,
            (most.max(0.0) as usize).min(pixels as usize),
        )
    };
    let (left, right) = span(own.center_x, own.width, size.width);
    let (top, bottom) = span(own.center_y, own.height, size.height);
    if left >= right {
        return;
    }
    for row in top..bottom {
        let start = row * size.width as usize;
        let range = start + left..start + right;
        if let (Some(to), Some(from)) = (picture.get_mut(range.clone()), before.get(range)) {
            to.copy_from_slice(from);
        }
    }
}

impl Policy for FrameDrop {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn knob(&self) -> Option<Knob> {
        Some(Self::KNOB)
    }

    fn knob_value(&self) -> Option<f64> {
        Some(self.settings.n)
    }

    fn set_knob(&mut self, value: f64) -> Result<(), KnobError> {
        self.settings.n = Self::KNOB.check(value)?;
        Ok(())
    }

    fn begin(&mut self, frame: FrameHead) -> Need {
        self.tracker.begin(frame);
        self.since_call = self
            .since_call
            .map(|frames| frames.saturating_add(frame.step.max(1)));
        self.cause = None;
        match &self.cue {
            // A picture is wanted of every frame, for the next one is compared with it.
            None => {
                self.progress = FrameDropPhase::AwaitsPicture;
                Need::GreyPicture
            }
            Some(cue) => match self.due() {
                Some(cause) => self.call_detector(cause),
                None if self.is_cued(cue, frame.index) => self.call_detector(CallCause::NewObject),
                None => self.drop_frame(),
            },
        }
    }

    /// Without the picture there is no event, and the schedule alone decides. A detector that was called for and failed is
    /// called again on the next frame.
    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        match (self.progress, evidence) {
            (FrameDropPhase::AwaitsPicture, evidence) => {
                let changed = match evidence {
                    Evidence::GreyPicture(picture) => self.has_changed(picture),
                    _ => false,
                };
                match self.due() {
                    Some(cause) => self.call_detector(cause),
                    None if changed => self.call_detector(CallCause::Changed),
                    None => self.drop_frame(),
                }
            }
            (FrameDropPhase::AwaitsDetections, Evidence::Detections(detections)) => {
                self.tracker.observe(detections, missed);
                self.since_call = Some(0);
                self.owed = false;
                self.progress = FrameDropPhase::Decided(FrameState::I);
                Need::Nothing
            }
            (FrameDropPhase::AwaitsDetections | FrameDropPhase::Decided(_), _) => Need::Nothing,
        }
    }

    fn foresee(&self, _: FrameHead) -> Need {
        match self.cue {
            None => Need::GreyPicture,
            Some(_) => Need::Nothing,
        }
    }

    fn finish(&mut self, outcome: &mut Outcome) {
        let (state, degraded) = match self.progress {
            FrameDropPhase::Decided(state) => (state, false),
            FrameDropPhase::AwaitsPicture | FrameDropPhase::AwaitsDetections => {
                (FrameState::P, true)
            }
        };
        outcome.clear(state, degraded);
        outcome.cause = self.cause;
        self.tracker.finish(state, outcome);
    }

    fn reset(&mut self) {
        self.tracker.clear();
        self.progress = FrameDropPhase::Decided(FrameState::P);
        self.cause = None;
        self.since_call = None;
        self.owed = false;
        self.size = None;
    }

    fn objects(&self, visit: &mut dyn FnMut(&ObjectRecord)) {
        self.tracker.visit(visit);
    }

    fn rejected_detections(&self) -> u64 {
        self.tracker.objects.rejected_detections()
    }
}

fn missed(state: &mut ObjectState) -> Missed {
    state.misses = state.misses.saturating_add(1);
    if state.confirmed && state.misses <= MISSES {
        Missed::Rescued
    } else {
        Missed::Removed
    }
}

#[cfg(test)]
mod tests;
