//! The paper's policy: the detector runs when an object's uncertainty becomes too large.
//!
//! Each frame first advances every object's filter. Without active objects, the empty-scene screen is asked, and unless
//! it reports "empty", the detector. With objects, the detector runs if any τ reaches the threshold `u`, any object's
//! age reaches T_max, or the periodic cap is due; otherwise the predicted boxes are the answer.

use super::Ablation;
use super::albireo_settings::{AlbireoSettings, PeriodicCap};
use super::{
    CallCause, Evidence, FrameHead, FrameState, InvalidThreshold, Need, ObjectRecord, Outcome,
    OutputBox, Policy, PolicyConfig, PolicyConfigError, ThresholdSpec,
};
use crate::detection::Detection;
use crate::objects::{Missed, ObjectStates};

/// Progress of the current frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum AlbireoPhase {
    /// The screen was asked.
    AwaitsScreen,
    /// Detections were requested, after the screen's "not empty" or without its verdict.
    AwaitsDetections { screened: bool },
    /// Decided.
    Decided(FrameState),
}

/// The Albireo policy.
#[derive(Clone, Debug)]
pub struct Albireo {
    name: &'static str,
    settings: AlbireoSettings,
    objects: ObjectStates,
    u: f64,
    /// `u` at the start of the frame.
    u_in_force: f64,
    frame: Option<FrameHead>,
    progress: AlbireoPhase,
    /// The reason for the detector call on the current frame.
    cause: Option<CallCause>,
    tau_max: Option<f64>,
    active: usize,
    /// Frames since the last detector answer.
    since_detector: u32,
    /// Index of the last frame that finished with all requested evidence.
    last_complete: Option<u64>,
    /// Boxes of a detector frame.
    boxes: Vec<OutputBox>,
    /// The state that [`Policy::rewind`] restores: a copy of this policy, kept for its buffers.
    saved: Option<Box<Self>>,
}

impl Albireo {
    /// The name in configuration and reports.
    pub const NAME: &'static str = "albireo";

    /// The threshold. τ is a sum of variances of shares of the picture: at 1 an object's position is unknown, and below
    /// 1e-9 the detector runs on every frame. The useful range is from the smallest τ of a predicted frame to τ after
    /// six frames of prediction since a detection; the paper goes to 1e-3, two frames.
    pub const THRESHOLD: ThresholdSpec = ThresholdSpec {
        name: "u",
        meaning: "The detector is skipped while every object's uncertainty is below this: higher saves \
                  more energy, lower is more accurate",
        minimum: 1e-9,
        maximum: 1.0,
        default: 3e-4,
        useful_minimum: 1.5e-4,
        useful_maximum: 1e-2,
    };

    /// Creates a policy with these settings and this threshold.
    ///
    /// # Errors
    /// [`PolicyConfigError`] if the threshold is invalid.
    pub fn new(settings: AlbireoSettings, u: f64) -> Result<Self, PolicyConfigError> {
        let u = Self::THRESHOLD.check(u)?;
        Ok(Self {
            name: Self::NAME,
            settings,
            objects: ObjectStates::new(settings.objects()),
            u,
            u_in_force: u,
            frame: None,
            progress: AlbireoPhase::Decided(FrameState::P),
            cause: None,
            tau_max: None,
            active: 0,
            since_detector: 0,
            last_complete: None,
            boxes: Vec::new(),
            saved: None,
        })
    }

    pub(super) fn from_config(config: &PolicyConfig) -> Result<Box<dyn Policy>, PolicyConfigError> {
        Ok(Box::new(Self::new(
            AlbireoSettings::of(config.profile),
            config.u,
        )?))
    }

    /// Creates a policy without some of its parts, under the name of the ablation.
    pub(super) fn ablated(
        ablation: Ablation,
        config: &PolicyConfig,
    ) -> Result<Box<dyn Policy>, PolicyConfigError> {
        let mut settings = AlbireoSettings::of(config.profile);
        ablation.apply(&mut settings);
        let mut policy = Self::new(settings, config.u)?;
        policy.name = ablation.name();
        Ok(Box::new(policy))
    }

    /// The settings in use.
    pub fn settings(&self) -> &AlbireoSettings {
        &self.settings
    }

    /// Summarises the active objects and returns the reason why one of them calls the detector. Tentative objects are
    /// active, as in the published code; the paper does not say otherwise.
    fn survey(&mut self) -> Option<CallCause> {
        let (u, settings) = (self.u_in_force, &self.settings);
        let mut cause = None;
        let mut tau_max = f64::NEG_INFINITY;
        self.active = self.objects.states().len();
        for state in self.objects.states() {
            let tau = state.filter.tau();
            let uncertain = !settings.is_certain(tau, u);
            cause = match (cause, uncertain, state.confirmed) {
                (_, true, true) | (Some(CallCause::Uncertain), ..) => Some(CallCause::Uncertain),
                (_, true, false) => Some(CallCause::NewObject),
                (None, ..) if state.since_infer >= settings.t_max => Some(CallCause::ObjectCap),
                _ => cause,
            };
            tau_max = tau_max.max(tau);
        }
        self.tau_max = (self.active > 0).then_some(tau_max);
        cause
    }

    /// Copies the state of `other`, a copy of this policy, but not its settings and threshold.
    pub(super) fn copy_from(&mut self, other: &Self) {
        let Self {
            name: _,
            settings: _,
            objects,
            u: _,
            u_in_force,
            frame,
            progress,
            cause,
            tau_max,
            active,
            since_detector,
            last_complete,
            boxes,
            saved: _,
        } = other;
        self.objects.copy_from(objects);
        self.u_in_force = *u_in_force;
        self.frame = *frame;
        self.progress = *progress;
        self.cause = *cause;
        self.tau_max = *tau_max;
        self.active = *active;
        self.since_detector = *since_detector;
        self.last_complete = *last_complete;
        self.boxes.clone_from(boxes);
    }

    /// Returns what frame `index` needs, given the state of the objects.
    fn choose(&mut self, index: u64) -> Need {
        let called = self.survey();
        self.cause = if self.active == 0 {
            Some(CallCause::NoObjects)
        } else {
            called.or_else(|| {
                let due = self.periodic_cap_is_due(index);
                due.then_some(CallCause::PeriodicCap)
            })
        };
        let (progress, need) = if self.active == 0 && self.settings.asks_screen {
            (AlbireoPhase::AwaitsScreen, Need::Screen)
        } else if self.cause.is_some() {
            (
                AlbireoPhase::AwaitsDetections { screened: false },
                Need::Detections,
            )
        } else {
            (AlbireoPhase::Decided(FrameState::P), Need::Nothing)
        };
        self.progress = progress;
        need
    }

    fn periodic_cap_is_due(&self, index: u64) -> bool {
        let cap = self.settings.periodic_cap;
        match self.settings.periodic_cap_counts {
            PeriodicCap::SinceDetector => self.since_detector >= cap,
            PeriodicCap::FrameIndex => {
                let cap = u64::from(cap);
                // True if a multiple of the cap fell into the gap since the last complete frame.
                let gap = self
                    .last_complete
                    .is_some_and(|last| last / cap < index / cap);
                index.is_multiple_of(cap) || gap
            }
        }
    }

    fn take_detections(&mut self, detections: &[Detection], screened: bool) -> FrameState {
        self.since_detector = 0;
        let life_cycle = self.settings.life_cycle;
        let mut rescued = false;
        self.objects.observe(detections, |state| {
            let fate = life_cycle.missed(state);
            rescued |= fate == Missed::Rescued;
            fate
        });
        self.boxes.clear();
        self.settings
            .detector_frame(detections, &self.objects, self.u_in_force, &mut self.boxes);
        if screened {
            FrameState::EI
        } else if rescued {
            FrameState::AI
        } else {
            FrameState::I
        }
    }
}

impl Policy for Albireo {
    fn name(&self) -> &'static str {
        self.name
    }

    fn threshold_spec(&self) -> Option<ThresholdSpec> {
        Some(Self::THRESHOLD)
    }

    fn threshold(&self) -> Option<f64> {
        Some(self.u)
    }

    fn set_threshold(&mut self, value: f64) -> Result<(), InvalidThreshold> {
        self.u = Self::THRESHOLD.check(value)?;
        Ok(())
    }

    fn begin(&mut self, frame: FrameHead) -> Need {
        self.frame = Some(frame);
        self.u_in_force = self.u;
        let frames = frame.step.max(1);
        self.since_detector = self.since_detector.saturating_add(frames);
        self.objects.predict(frame.picture, frames);
        self.choose(frame.index)
    }

    /// If the screen is unavailable, the detector is requested, and the frame is `I`, not `E+I`. Evidence that was not
    /// requested counts as unavailable.
    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        match (self.progress, evidence) {
            (AlbireoPhase::AwaitsScreen, Evidence::Screen { empty: true }) => {
                self.progress = AlbireoPhase::Decided(FrameState::E);
                self.cause = None;
                Need::Nothing
            }
            (AlbireoPhase::AwaitsScreen, evidence) => {
                let screened = matches!(evidence, Evidence::Screen { .. });
                if screened {
                    self.cause = Some(CallCause::Screen);
                }
                self.progress = AlbireoPhase::AwaitsDetections { screened };
                Need::Detections
            }
            (AlbireoPhase::AwaitsDetections { screened }, Evidence::Detections(detections)) => {
                let state = self.take_detections(detections, screened);
                self.progress = AlbireoPhase::Decided(state);
                Need::Nothing
            }
            // Unchanged, so that `finish` detects the missing detections.
            (AlbireoPhase::AwaitsDetections { .. } | AlbireoPhase::Decided(_), _) => Need::Nothing,
        }
    }

    fn longest_pause(&self) -> Option<u32> {
        Some(self.settings.t_max.min(self.settings.periodic_cap))
    }

    fn finish(&mut self, outcome: &mut Outcome) {
        let (state, degraded) = match self.progress {
            AlbireoPhase::Decided(state) => (state, false),
            AlbireoPhase::AwaitsScreen | AlbireoPhase::AwaitsDetections { .. } => {
                (FrameState::P, true)
            }
        };
        if let (Some(frame), false) = (self.frame, degraded) {
            self.last_complete = Some(frame.index);
        }
        outcome.clear(state, degraded);
        outcome.cause = self.cause;
        outcome.tau_max = self.tau_max;
        outcome.active = self.active;
        match state {
            FrameState::E => {}
            FrameState::P => {
                self.settings
                    .predicted(&self.objects, self.u_in_force, &mut outcome.boxes);
            }
            FrameState::EI | FrameState::I | FrameState::AI => {
                outcome.boxes.extend_from_slice(&self.boxes);
            }
        }
    }

    fn can_rewind(&self) -> bool {
        true
    }

    fn save(&mut self) {
        let mut saved = (self.saved.take()).unwrap_or_else(|| Box::new(self.clone()));
        saved.copy_from(self);
        self.saved = Some(saved);
    }

    fn rewind(&mut self) {
        if let Some(saved) = self.saved.take() {
            self.copy_from(&saved);
            self.saved = Some(saved);
        }
    }

    fn reset(&mut self) {
        self.objects.clear();
        self.frame = None;
        self.progress = AlbireoPhase::Decided(FrameState::P);
        self.cause = None;
        self.tau_max = None;
        self.active = 0;
        self.since_detector = 0;
        self.last_complete = None;
    }

    fn objects(&self, visit: &mut dyn FnMut(&ObjectRecord)) {
        for state in self.objects.states() {
            visit(&ObjectRecord::from(state));
        }
    }

    fn rejected_detections(&self) -> u64 {
        self.objects.rejected_detections()
    }
}

#[cfg(test)]
mod tests;
