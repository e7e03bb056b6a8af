//! What looking at pixels brings: expected-loss with and without optical flow, evenly spaced calls with and without it,
//! and the paper's policy, each at the same skip rate, at several frame rates of the same footage.
//!
//! A clip at a lower frame rate is as many clips as it can begin with frames; they are judged each by itself and
//! averaged, so that a clip stays one sample of the paired tests.

use super::operating_point::{
    Candidate, ClipFigures, FrontierError, OperatingPoint, SettingValue, averaged,
};
use super::view::ViewedClip;
use crate::footage::Sieve;
use crate::pictures::PicturedClip;
use crate::statistics::{PairedT, mean, paired_t};
use albireo_core::policy::{Albireo, ExpectedLoss};
use serde::Serialize;

/// Policies without a setting of their own: each is turned until it skips what the others skip.
pub(super) const COMPARED: [&str; 6] = [
    ExpectedLoss::NAME,
    ExpectedLoss::FLOW_NAME,
    ExpectedLoss::EVEN_SKIP_NAME,
    ExpectedLoss::EVEN_SKIP_FLOW_NAME,
    Albireo::NAME,
    "albireo+flow",
];

/// What is subtracted from what.
const DIFFERENCES: [(&str, &str); 5] = [
    (ExpectedLoss::FLOW_NAME, ExpectedLoss::NAME),
    (ExpectedLoss::FLOW_NAME, ExpectedLoss::EVEN_SKIP_FLOW_NAME),
    (
        ExpectedLoss::EVEN_SKIP_FLOW_NAME,
        ExpectedLoss::EVEN_SKIP_NAME,
    ),
    (ExpectedLoss::FLOW_NAME, Albireo::NAME),
    ("albireo+flow", Albireo::NAME),
];

/// A skip rate that is missed by more is not the same skip rate.
const LARGEST_MISS: f64 = 0.03;

/// A figure that is compared.
type Figure = fn(&ClipFigures) -> f64;

/// The figures that are compared, with their names.
pub(super) const FIGURES: [(&str, Figure); 5] = [
    ("AP@50", |clip| clip.ap50),
    ("AP@75", |clip| clip.ap75),
    ("mAP", |clip| clip.map),
    ("F1@50", |clip| clip.f1[0]),
    ("F1@75", |clip| clip.f1[1]),
];

/// Each of `pictured` at `rate` frames a second, or as recorded, as clips for each frame it can begin with; without those
/// of which nothing is left to be judged.
pub fn all_at_rate(
    pictured: &[PicturedClip],
    rate: Option<f64>,
    confidence: f64,
) -> Vec<Vec<ViewedClip>> {
    let clips = pictured.iter().map(|clip| at_rate(clip, rate, confidence));
    clips.filter(|phases| !phases.is_empty()).collect()
}

/// `pictured` at `rate` frames a second, or as recorded: a clip for each frame it can begin with. Without ground truth,
/// or without a box in it, there are none.
fn at_rate(pictured: &PicturedClip, rate: Option<f64>, confidence: f64) -> Vec<ViewedClip> {
    let clip = &pictured.clip;
    let (Some(detections), Some(truth)) = (&clip.detections, &clip.truth) else {
        return Vec::new();
    };
    let own = clip.frame_rate.unwrap_or(1.0);
    let sieve = Sieve::new(own, rate.unwrap_or(own));
    let phase = |first: usize| {
        let taken = (first..clip.frames).filter(|frame| sieve.takes((frame - first) as u64));
        let mut viewed = ViewedClip::new(clip);
        viewed.grey_width = pictured.small_width;
        for frame in taken {
            let seen = detections.get(frame).map_or(&[][..], Vec::as_slice);
            let truth = truth.get(frame).cloned().unwrap_or_default();
            viewed.arrive(1, seen, confidence, truth);
            viewed.grey.extend(pictured.small.get(frame).cloned());
        }
        viewed.has_truth().then_some(viewed)
    };
    (0..sieve.phases()).filter_map(phase).collect()
}

/// One policy at one skip rate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PolicyAtSkip {
    /// The policy.
    pub policy: String,
    /// The value of its knob; `None` where every clip has its own.
    pub value: Option<f64>,
    /// Whether it comes as near to the skip rate as counts.
    pub met: bool,
    /// Clip by clip, averaged over the frames that a clip can begin with.
    pub clips: Vec<ClipFigures>,
}

impl PolicyAtSkip {
    fn new(point: &OperatingPoint, asked: f64) -> Self {
        Self {
            policy: point.policy.clone(),
            value: point.value,
            met: (point.skip_rate - asked).abs() <= LARGEST_MISS,
            clips: averaged(&point.clips),
        }
    }

    /// The mean of a figure over the clips.
    pub fn mean(&self, of: Figure) -> f64 {
        mean(self.clips.iter().map(of)).unwrap_or_default()
    }
}

/// A difference between two policies, clip by clip.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PixelDifference {
    /// What the other is subtracted from.
    pub policy: String,
    /// The other.
    pub other: String,
    /// Of each of [`FIGURES`]: the mean and its paired t-test.
    pub figures: Vec<(f64, Option<PairedT>)>,
    /// Clips on which AP@75 is lower.
    pub worse: usize,
}

impl PixelDifference {
    fn between(policy: &PolicyAtSkip, other: &PolicyAtSkip) -> Self {
        let of = |figure: Figure| -> Vec<f64> {
            let pairs = policy.clips.iter().zip(&other.clips);
            pairs.map(|(a, b)| figure(a) - figure(b)).collect()
        };
        let figure = |(_, figure): &(&str, Figure)| {
            let differences = of(*figure);
            let mean = mean(differences.iter().copied()).unwrap_or_default();
            (mean, paired_t(&differences))
        };
        let ap75 = of(|clip| clip.ap75);
        Self {
            policy: policy.policy.clone(),
            other: other.policy.clone(),
            figures: FIGURES.iter().map(figure).collect(),
            worse: ap75.iter().filter(|difference| **difference < 0.0).count(),
        }
    }
}

/// All policies at one skip rate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SkipStudy {
    /// The skip rate.
    pub skip_rate: f64,
    /// With one setting for all clips.
    pub policies: Vec<PolicyAtSkip>,
    /// Their differences.
    pub differences: Vec<PixelDifference>,
    /// Flow with the trigger against flow with evenly spaced calls, each clip turned to the skip rate by itself.
    pub by_clip: PixelDifference,
}

/// All skip rates at one frame rate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RateStudy {
    /// Frames a second; `None` for as recorded.
    pub rate: Option<f64>,
    /// The clips.
    pub clips: Vec<String>,
    /// Frames in all.
    pub frames: usize,
    /// By rising skip rate.
    pub skips: Vec<SkipStudy>,
}

/// Compares at `rates` and `skip_rates`, with `settings` of expected-loss other than its own; `done` is called after each policy at each skip rate.
///
/// # Errors
/// [`FrontierError`] when no clip can be judged or a policy fails.
pub fn pixel_study(
    pictured: &[PicturedClip],
    rates: &[Option<f64>],
    skip_rates: &[f64],
    confidence: f64,
    settings: &[SettingValue],
    done: &dyn Fn(),
) -> Result<Vec<RateStudy>, FrontierError> {
    let study = |rate: &Option<f64>| {
        let clips = all_at_rate(pictured, *rate, confidence);
        if clips.is_empty() {
            return Err(FrontierError::NoClips);
        }
        let skips = skip_rates.iter();
        Ok(RateStudy {
            rate: *rate,
            clips: clips.iter().map(|phases| phases[0].name.clone()).collect(),
            frames: clips.iter().map(|phases| phases[0].steps.len()).sum(),
            skips: skips
                .map(|&skip_rate| skip_study(&clips, skip_rate, settings, done))
                .collect::<Result<_, _>>()?,
        })
    };
    rates.iter().map(study).collect()
}

/// Steps of a study at so many frame and skip rates, for a progress bar.
pub const fn pixel_steps(rates: usize, skip_rates: usize) -> usize {
    rates * skip_rates * (COMPARED.len() + 2)
}

fn skip_study(
    clips: &[Vec<ViewedClip>],
    skip_rate: f64,
    settings: &[SettingValue],
    done: &dyn Fn(),
) -> Result<SkipStudy, FrontierError> {
    let all: Vec<ViewedClip> = clips.iter().flatten().cloned().collect();
    let policies = (COMPARED.iter())
        .map(|name| {
            let candidate = Candidate::as_reported(name)?.with_settings(settings)?;
            let point = candidate.at_skip_rate(skip_rate, &all)?;
            done();
            Ok(PolicyAtSkip::new(&point, skip_rate))
        })
        .collect::<Result<Vec<_>, FrontierError>>()?;
    let find = |name: &str| policies.iter().find(|policy| policy.policy == name);
    let differences = (DIFFERENCES.iter())
        .filter_map(|(policy, other)| find(policy).zip(find(other)))
        .filter(|(policy, other)| policy.met && other.met)
        .map(|(policy, other)| PixelDifference::between(policy, other))
        .collect();
    let each = |name: &str| {
        let candidate = Candidate::as_reported(name)?.with_settings(settings)?;
        let mut figures = Vec::new();
        for phases in clips {
            figures.extend(candidate.at_skip_rate(skip_rate, phases)?.clips);
        }
        done();
        Ok::<_, FrontierError>(PolicyAtSkip {
            policy: name.to_owned(),
            value: None,
            met: true,
            clips: averaged(&figures),
        })
    };
    let by_clip = PixelDifference::between(
        &each(ExpectedLoss::FLOW_NAME)?,
        &each(ExpectedLoss::EVEN_SKIP_FLOW_NAME)?,
    );
    Ok(SkipStudy {
        skip_rate,
        policies,
        differences,
        by_clip,
    })
}
