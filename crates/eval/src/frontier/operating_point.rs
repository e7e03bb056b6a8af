//! A policy at one setting on all clips, and the setting at which it skips a given share of the frames.

use super::view::{ViewedClip, ViewedEvidence};
use crate::against_detector::{ComparedFrame, against_detector};
use crate::average_precision::{Classes, Interpolation, accuracy};
use crate::replay::{Scoring, replay};
use crate::scoring::DEFAULT_DECAY_U;
use crate::source::SourceError;
use crate::statistics::mean;
use albireo_core::detection::Detection;
use albireo_core::geometry::BoundingBox;
use albireo_core::policy::{
    Albireo, FrameDrop, Knob, Policy, PolicyConfig, PolicyConfigError, Profile,
};
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use serde::Serialize;

/// Why there is no figure.
#[derive(Debug, thiserror::Error)]
pub enum FrontierError {
    /// A policy cannot be built.
    #[error("policy {policy}: {source}")]
    Policy {
        /// What was asked for.
        policy: String,
        /// Why not.
        source: PolicyConfigError,
    },
    /// A policy asks for what stored detections do not have.
    #[error("policy {policy}, clip {clip}: {source}")]
    Source {
        /// The policy.
        policy: String,
        /// The clip.
        clip: String,
        /// What the clip does not have.
        source: SourceError,
    },
    /// No clip has both detections and ground truth.
    #[error("no clip has both stored detections and ground truth")]
    NoClips,
    /// The policy has nothing to turn.
    #[error("policy {policy} has no knob to meet a skip rate with")]
    NoKnob {
        /// The policy.
        policy: String,
    },
}

/// A policy that takes part.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    config: PolicyConfig,
    scoring: Scoring,
    /// `frame-drop` is told beforehand what the detector sees of each frame.
    ideal_cue: bool,
}

/// The name of `frame-drop` with that cue.
const IDEAL_CUE: &str = "frame-drop-ideal-cue";
/// A setting of `[policy.expected_loss]` at another value, `flow.price=0.1` on the command line.
#[derive(Clone, Debug, PartialEq)]
pub struct SettingValue {
    path: String,
    value: serde_json::Value,
}

/// A [`SettingValue`] that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not of the form SETTING=VALUE, for instance flow.price=0.1")]
pub struct NotASetting(String);

impl std::str::FromStr for SettingValue {
    type Err = NotASetting;

    fn from_str(text: &str) -> Result<Self, NotASetting> {
        let (path, value) = text
            .split_once('=')
            .ok_or_else(|| NotASetting(text.to_owned()))?;
        Ok(Self {
            path: path.trim().to_owned(),
            // What is no number or truth value is a word.
            value: serde_json::from_str(value).unwrap_or_else(|_| value.into()),
        })
    }
}

/// What a policy did with one clip.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ClipFigures {
    /// Name of the clip.
    pub clip: String,
    /// Share of its frames without the detector.
    pub skip_rate: f64,
    /// AP@50.
    pub ap50: f64,
    /// AP@75.
    pub ap75: f64,
    /// mAP@50:95.
    pub map: f64,
    /// Best F1 at IoU 0.50 and 0.75.
    pub f1: [f64; 2],
    /// Share of its frames of which a grey picture was looked at.
    pub looked: f64,
}

/// A policy at one setting.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OperatingPoint {
    /// Name of the policy.
    pub policy: String,
    /// The value of its knob.
    pub value: Option<f64>,
    /// Mean skip rate over the clips.
    pub skip_rate: f64,
    /// Mean AP@50.
    pub ap50: f64,
    /// Mean mAP@50:95.
    pub map: f64,
    /// Clip by clip.
    pub clips: Vec<ClipFigures>,
}

impl OperatingPoint {
    /// Whether this is what no system can do: it knows what it has not looked at.
    pub(super) fn is_bound(&self) -> bool {
        self.policy == IDEAL_CUE
    }

    /// The means over `clips`.
    pub(crate) fn of(policy: String, value: Option<f64>, clips: Vec<ClipFigures>) -> Self {
        let over = |of: fn(&ClipFigures) -> f64| mean(clips.iter().map(of)).unwrap_or_default();
        Self {
            policy,
            value,
            skip_rate: over(|clip| clip.skip_rate),
            ap50: over(|clip| clip.ap50),
            map: over(|clip| clip.map),
            clips,
        }
    }
}

/// One entry for all clips of a name: the mean of their figures.
pub(super) fn averaged(clips: &[ClipFigures]) -> Vec<ClipFigures> {
    let mut groups: Vec<Vec<&ClipFigures>> = Vec::new();
    for clip in clips {
        match groups.iter_mut().find(|group| group[0].clip == clip.clip) {
            Some(group) => group.push(clip),
            None => groups.push(vec![clip]),
        }
    }
    let average = |group: Vec<&ClipFigures>| {
        let over = |of: fn(&ClipFigures) -> f64| {
            mean(group.iter().map(|clip| of(clip))).unwrap_or_default()
        };
        ClipFigures {
            clip: group[0].clip.clone(),
            skip_rate: over(|clip| clip.skip_rate),
            ap50: over(|clip| clip.ap50),
            ap75: over(|clip| clip.ap75),
            map: over(|clip| clip.map),
            f1: [over(|clip| clip.f1[0]), over(|clip| clip.f1[1])],
            looked: over(|clip| clip.looked),
        }
    };
    groups.into_iter().map(average).collect()
}

impl Candidate {
    /// A policy of the paper, `NAME[:SETTING]`, decided and judged as in the published code.
    ///
    /// # Errors
    /// [`FrontierError::Policy`] when there is no such policy or setting.
    pub fn published(asked: &str) -> Result<Self, FrontierError> {
        Self::new(asked, Profile::Reference, Scoring::Reference)
    }

    /// A policy, `NAME[:SETTING]`, judged by what it reports.
    ///
    /// # Errors
    /// [`FrontierError::Policy`] when there is no such policy or setting.
    pub fn as_reported(asked: &str) -> Result<Self, FrontierError> {
        Self::new(asked, Profile::Paper, Scoring::Paper)
    }

    fn new(asked: &str, profile: Profile, scoring: Scoring) -> Result<Self, FrontierError> {
        let mut config = PolicyConfig {
            profile,
            ..PolicyConfig::default()
        };
        let selected = config.select(asked).and_then(|()| config.build());
        selected.map_err(|source| FrontierError::Policy {
            policy: asked.to_owned(),
            source,
        })?;
        Ok(Self {
            config,
            scoring,
            ideal_cue: false,
        })
    }

    /// `frame-drop` at `n` with a second sensor that is as good as the detector, and free.
    ///
    /// # Errors
    /// [`FrontierError::Policy`] when `n` is out of range.
    pub(super) fn frame_drop_with_ideal_cue(n: f64) -> Result<Self, FrontierError> {
        Ok(Self {
            ideal_cue: true,
            ..Self::as_reported(&format!("{}:{n}", FrameDrop::NAME))?
        })
    }

    fn name(&self) -> String {
        if self.ideal_cue {
            IDEAL_CUE.to_owned()
        } else {
            self.config.name.clone()
        }
    }

    /// This policy with one setting of expected-loss, by its path such as `life.least_visible`, at `value`.
    ///
    /// # Errors
    /// [`FrontierError::Policy`] when there is no such setting or it cannot have the value.
    pub(crate) fn with_expected_loss(
        &self,
        setting: &str,
        value: serde_json::Value,
    ) -> Result<Self, FrontierError> {
        self.with_settings(&[SettingValue {
            path: setting.to_owned(),
            value,
        }])
    }

    /// This policy with these settings of expected-loss beside those it has.
    ///
    /// # Errors
    /// [`FrontierError::Policy`] when there is no such setting or it cannot have the value.
    pub(crate) fn with_settings(&self, settings: &[SettingValue]) -> Result<Self, FrontierError> {
        let mut varied = self.clone();
        for setting in settings {
            let mut table = &mut varied.config.expected_loss;
            let mut path = setting.path.split('.').peekable();
            while let Some(key) = path.next() {
                if path.peek().is_none() {
                    table.insert(key.to_owned(), setting.value.clone());
                    break;
                }
                let inner = table.entry(key).or_insert_with(|| serde_json::json!({}));
                let serde_json::Value::Object(inner) = inner else {
                    break;
                };
                table = inner;
            }
        }
        varied.build()?;
        Ok(varied)
    }

    fn build(&self) -> Result<Box<dyn Policy>, FrontierError> {
        self.config.build().map_err(|source| FrontierError::Policy {
            policy: self.config.name.clone(),
            source,
        })
    }

    /// The policy for `clip`.
    fn build_for(&self, clip: &ViewedClip) -> Result<Box<dyn Policy>, FrontierError> {
        if !self.ideal_cue {
            return self.build();
        }
        let seen = |detections: &Vec<Detection>| -> Vec<BoundingBox> {
            let boxes = detections.iter();
            boxes.map(|detection| detection.bounding_box).collect()
        };
        // By index, which counts lost frames too: nothing is asked about those.
        let mut cue = Vec::new();
        for (&step, detections) in clip.steps.iter().zip(&clip.detections) {
            cue.resize(cue.len() + step.saturating_sub(1) as usize, Vec::new());
            cue.push(seen(detections));
        }
        let built = FrameDrop::with_cue(&self.config, cue.into());
        let policy = built.map_err(|source| FrontierError::Policy {
            policy: self.name(),
            source,
        })?;
        Ok(Box::new(policy))
    }

    fn knob(&self) -> Result<Option<(Knob, f64)>, FrontierError> {
        let policy = self.build()?;
        Ok(policy.knob().zip(policy.knob_value()))
    }

    /// This policy with its knob at `value`, which is kept inside the knob's range.
    fn at(&self, knob: &Knob, value: f64) -> Result<Self, FrontierError> {
        let mut turned = self.clone();
        let value = value.clamp(knob.minimum, knob.maximum);
        turned
            .config
            .set_argument(&format!("{value:e}"))
            .map_err(|source| FrontierError::Policy {
                policy: self.config.name.clone(),
                source,
            })?;
        Ok(turned)
    }

    /// Runs the policy over `clips` and judges it.
    ///
    /// # Errors
    /// [`FrontierError`] of the first clip that fails.
    pub fn run(&self, clips: &[ViewedClip]) -> Result<OperatingPoint, FrontierError> {
        let value = self.knob()?.map(|(_, value)| value);
        let figures = over_clips(clips, |clip| self.run_clip(clip, true))?;
        Ok(OperatingPoint::of(self.name(), value, figures))
    }

    /// What the policy shows on the frames of `clip` without the detector, beside what the detector finds there.
    ///
    /// # Errors
    /// [`FrontierError`] when the policy cannot be built or fails.
    pub fn against_detector(&self, clip: &ViewedClip) -> Result<Vec<ComparedFrame>, FrontierError> {
        let mut policy = self.build_for(clip)?;
        let mut source = ViewedEvidence(clip);
        against_detector(policy.as_mut(), &mut source, &clip.detections).map_err(|source| {
            FrontierError::Source {
                policy: self.name(),
                clip: clip.name.clone(),
                source,
            }
        })
    }

    /// The setting at which the mean skip rate over `clips` is nearest to `skip_rate`, found by bisection:
    /// the skip rate grows with the knob.
    ///
    /// # Errors
    /// [`FrontierError::NoKnob`] without a knob; others as in [`run`](Self::run).
    pub fn at_skip_rate(
        &self,
        skip_rate: f64,
        clips: &[ViewedClip],
    ) -> Result<OperatingPoint, FrontierError> {
        let (knob, _) = self.knob()?.ok_or_else(|| FrontierError::NoKnob {
            policy: self.config.name.clone(),
        })?;
        // Bisected on the square root: fine where the knob is small, without shunning zero.
        let (mut low, mut high) = (knob.minimum.sqrt(), knob.maximum.sqrt());
        let mut best = (f64::INFINITY, self.clone());
        // Nearer than half a frame cannot be come.
        let frames: usize = clips.iter().map(|clip| clip.steps.len()).sum();
        let near = 2e-4f64.max(0.5 / frames.max(1) as f64);
        for _ in 0..18 {
            let middle = (low + high) / 2.0;
            let candidate = self.at(&knob, middle * middle)?;
            let figures = over_clips(clips, |clip| candidate.run_clip(clip, false))?;
            let reached = mean(figures.iter().map(|clip| clip.skip_rate)).unwrap_or_default();
            if (reached - skip_rate).abs() < best.0 {
                best = ((reached - skip_rate).abs(), candidate);
            }
            if best.0 <= near {
                break;
            }
            if reached < skip_rate {
                low = middle;
            } else {
                high = middle;
            }
        }
        best.1.run(clips)
    }

    /// Accuracy is left at zero unless `judged`.
    fn run_clip(&self, clip: &ViewedClip, judged: bool) -> Result<ClipFigures, FrontierError> {
        let mut policy = self.build_for(clip)?;
        let decay_u = match policy.knob() {
            Some(knob) if knob.name == Albireo::KNOB.name => self.config.u,
            _ => DEFAULT_DECAY_U,
        };
        let mut source = ViewedEvidence(clip);
        let replayed = replay(policy.as_mut(), &mut source, self.scoring, decay_u, false).map_err(
            |source| FrontierError::Source {
                policy: self.config.name.clone(),
                clip: clip.name.clone(),
                source,
            },
        )?;
        let skipped = replayed
            .frames
            .iter()
            .filter(|frame| frame.state.is_skipped() && !frame.degraded);
        let skip_rate = skipped.count() as f64 / replayed.frames.len().max(1) as f64;
        let accuracy = judged
            .then(|| {
                let (classes, area) = (Classes::Pooled, Interpolation::AllPoints);
                accuracy(&replayed.boxes, &clip.truth, classes, area)
            })
            .flatten();
        let looked = replayed.frames.iter().filter(|frame| frame.looked);
        let looked = looked.count() as f64 / replayed.frames.len().max(1) as f64;
        let figures = ClipFigures {
            clip: clip.name.clone(),
            skip_rate,
            looked,
            ..ClipFigures::default()
        };
        Ok(match accuracy {
            None => figures,
            Some(accuracy) => ClipFigures {
                ap50: accuracy.ap50,
                ap75: accuracy.ap75,
                map: accuracy.map,
                f1: [accuracy.f1_50, accuracy.f1_75],
                ..figures
            },
        })
    }
}

/// `work` for every clip, on as many threads as the machine has, in the order of the clips.
fn over_clips(
    clips: &[ViewedClip],
    work: impl Fn(&ViewedClip) -> Result<ClipFigures, FrontierError> + Sync + Send,
) -> Result<Vec<ClipFigures>, FrontierError> {
    clips.par_iter().map(work).collect()
}
