//! The comparison itself: expected-loss against schedules in the same tracker, and against the paper's
//! policies, each at equal skip rate.

use super::hindsight::Hindsight;
use super::operating_point::{Candidate, FrontierError, OperatingPoint};
use super::view::{View, ViewedClip};
use crate::data::Clip;
use crate::statistics::{PairedT, mean, paired_t};
use albireo_core::policy::{AdaptiveRate, ExpectedLoss, FixedSkip, Vanilla};
use serde::Serialize;

/// Skip rates at which expected-loss is compared with even spacing.
const SKIP_RATES: [f64; 9] = [0.10, 0.24, 0.38, 0.49, 0.60, 0.65, 0.70, 0.75, 0.80];

/// Confidences at which Vanilla is run, whatever the view's: the paper's, and one that lets in what a
/// detector is unsure of. The latter is the honest baseline of a policy that sees unsure detections.
const VANILLA_CONFIDENCES: [f64; 2] = [0.5, 0.1];

/// Policies with settings of the paper.
const PUBLISHED: [&str; 11] = [
    "albireo:3e-4",
    "albireo:5e-4",
    "albireo:7e-4",
    "albireo:1e-3",
    "fixed-skip:2",
    "fixed-skip:3",
    "fixed-skip:5",
    "ctd:0.9",
    "ctd:0.7",
    "ctd:0.5",
    "ctd:0.3",
];

/// The number of skipped frames of FixedSkip, with the objects of expected-loss.
const IN_TRACKER: [f64; 3] = [2.0, 3.0, 5.0];

/// Settings of the adaptive rate after Contoli et al.
const DRIFTS: [f64; 4] = [0.05, 0.1, 0.2, 0.4];

/// Frames from call to call without an event, of frame dropping after Henning et al.
const DROPS: [f64; 3] = [3.0, 5.0, 10.0];

/// Skip rates at which the best fixed N in hindsight is taken.
const HINDSIGHT: [f64; 5] = [0.38, 0.49, 0.60, 0.70, 0.80];

/// Names of the oracle, with the objects of expected-loss and in the published form.
const HINDSIGHT_NAMES: [&str; 2] = ["best-n-in-tracker (hindsight)", "best-n (hindsight)"];

/// Differences clip by clip, positive where expected-loss is better.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PairedDifference {
    /// Mean difference of AP@50.
    pub ap50: f64,
    /// Its paired t-test and 95 % confidence interval; `None` where undefined.
    pub ap50_t: Option<PairedT>,
    /// Mean difference of mAP@50:95.
    pub map: f64,
    /// Its paired t-test; `None` where undefined.
    pub map_t: Option<PairedT>,
    /// Clips whose AP@50 is worse under expected-loss.
    pub worse_clips: usize,
    /// The clip that loses most, and how much, if one loses.
    pub worst: Option<(String, f64)>,
}

impl PairedDifference {
    /// `ours` minus `other`; both must have the same clips.
    pub fn new(ours: &OperatingPoint, other: &OperatingPoint) -> Self {
        let pairs = || ours.clips.iter().zip(&other.clips);
        let ap50: Vec<f64> = pairs().map(|(a, b)| a.ap50 - b.ap50).collect();
        let map: Vec<f64> = pairs().map(|(a, b)| a.map - b.map).collect();
        let worst = pairs()
            .map(|(a, b)| (a.clip.clone(), a.ap50 - b.ap50))
            .filter(|(_, difference)| *difference < 0.0)
            .min_by(|a, b| a.1.total_cmp(&b.1));
        Self {
            ap50: mean(ap50.iter().copied()).unwrap_or_default(),
            ap50_t: paired_t(&ap50),
            map: mean(map.iter().copied()).unwrap_or_default(),
            map_t: paired_t(&map),
            worse_clips: ap50.iter().filter(|difference| **difference < 0.0).count(),
            worst,
        }
    }
}

/// Another policy, and expected-loss at its skip rate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EqualSkip {
    /// The other policy.
    pub other: OperatingPoint,
    /// Expected-loss at the same mean skip rate.
    pub ours: OperatingPoint,
    /// The differences.
    pub difference: PairedDifference,
}

/// Vanilla at one confidence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reference {
    /// Detections below this are not shown.
    pub confidence: f64,
    /// Its figures.
    pub point: OperatingPoint,
    /// The skip rate at which expected-loss is as accurate; `None` if it never is or always is.
    pub crossing: Option<f64>,
}

/// All comparisons in one view.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ViewStudy {
    /// The view.
    pub view: View,
    /// Number of clips.
    pub clips: usize,
    /// Expected-loss with the detector on every frame.
    pub without_skips: OperatingPoint,
    /// Against evenly spaced calls in the same tracker, by rising skip rate.
    pub even: Vec<EqualSkip>,
    /// Against FixedSkip in the same tracker.
    pub in_tracker: Vec<EqualSkip>,
    /// Against the paper's policies.
    pub published: Vec<EqualSkip>,
    /// Against policies after other papers: an adaptive rate, and frame dropping with an ideal cue for new objects.
    pub adaptive: Vec<EqualSkip>,
    /// Against the best fixed N of each clip, known after the fact.
    pub hindsight: Vec<EqualSkip>,
    /// Vanilla.
    pub vanilla: Vec<Reference>,
}

/// All comparisons.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Study {
    /// What was evaluated.
    pub title: String,
    /// One entry a view.
    pub views: Vec<ViewStudy>,
}

/// Number of comparisons in one view, for a progress bar.
const STEPS: usize = 1
    + SKIP_RATES.len()
    + IN_TRACKER.len()
    + PUBLISHED.len()
    + DRIFTS.len()
    + DROPS.len()
    + HINDSIGHT_NAMES.len() * HINDSIGHT.len();

impl Study {
    /// How often `done` is called for so many views.
    pub const fn steps(views: usize) -> usize {
        STEPS * views
    }
}

/// Compares in every one of `views`; `done` is called after each comparison.
///
/// # Errors
/// [`FrontierError`] when no clip can be judged or a policy fails.
pub fn study(
    title: &str,
    clips: &[Clip],
    views: &[View],
    done: &dyn Fn(),
) -> Result<Study, FrontierError> {
    let views = views
        .iter()
        .map(|view| study_view(view, clips, done))
        .collect::<Result<Vec<_>, _>>()?;
    Ok(Study {
        title: title.to_owned(),
        views,
    })
}

fn look(view: &View, clips: &[Clip]) -> Result<Vec<ViewedClip>, FrontierError> {
    let viewed: Vec<_> = clips.iter().filter_map(|clip| view.look(clip)).collect();
    if viewed.is_empty() {
        return Err(FrontierError::NoClips);
    }
    Ok(viewed)
}

fn study_view(view: &View, clips: &[Clip], done: &dyn Fn()) -> Result<ViewStudy, FrontierError> {
    let viewed = look(view, clips)?;
    let ours = Candidate::as_reported(ExpectedLoss::NAME)?;
    let against = |other: OperatingPoint| {
        let ours = ours.at_skip_rate(other.skip_rate, &viewed)?;
        let difference = PairedDifference::new(&ours, &other);
        done();
        Ok(EqualSkip {
            other,
            ours,
            difference,
        })
    };
    let without_skips =
        Candidate::as_reported(&format!("{}:0", ExpectedLoss::NAME))?.run(&viewed)?;
    done();
    let spaced = Candidate::as_reported(ExpectedLoss::EVEN_SKIP_NAME)?;
    let even = SKIP_RATES
        .iter()
        .map(|&skip_rate| against(spaced.at_skip_rate(skip_rate, &viewed)?))
        .collect::<Result<Vec<_>, FrontierError>>()?;
    let in_tracker = IN_TRACKER
        .iter()
        .map(|n| {
            let asked = format!("{}:{n}", ExpectedLoss::FIXED_SKIP_NAME);
            against(Candidate::as_reported(&asked)?.run(&viewed)?)
        })
        .collect::<Result<Vec<_>, FrontierError>>()?;
    let published = PUBLISHED
        .iter()
        .map(|asked| against(Candidate::published(asked)?.run(&viewed)?))
        .collect::<Result<Vec<_>, FrontierError>>()?;
    let adaptive = (DRIFTS.iter())
        .map(|drift| Candidate::as_reported(&format!("{}:{drift}", AdaptiveRate::NAME)))
        .chain(DROPS.map(Candidate::frame_drop_with_ideal_cue))
        .map(|candidate| against(candidate?.run(&viewed)?))
        .collect::<Result<Vec<_>, FrontierError>>()?;
    let mut hindsight = Vec::new();
    for name in HINDSIGHT_NAMES {
        let oracle = Hindsight::new(
            name,
            |n| match name == HINDSIGHT_NAMES[0] {
                true => Candidate::as_reported(&format!("{}:{n}", ExpectedLoss::FIXED_SKIP_NAME)),
                false => Candidate::published(&format!("{}:{n}", FixedSkip::NAME)),
            },
            &viewed,
        )?;
        for skip_rate in HINDSIGHT {
            hindsight.push(against(oracle.at_skip_rate(skip_rate))?);
        }
    }
    let vanilla = VANILLA_CONFIDENCES
        .iter()
        .map(|&confidence| {
            let view = View {
                confidence,
                ..view.clone()
            };
            let point = Candidate::as_reported(Vanilla::NAME)?.run(&look(&view, clips)?)?;
            Ok(Reference {
                confidence,
                crossing: crossing(&without_skips, &even, point.ap50),
                point,
            })
        })
        .collect::<Result<Vec<_>, FrontierError>>()?;
    Ok(ViewStudy {
        view: view.clone(),
        clips: viewed.len(),
        without_skips,
        even,
        in_tracker,
        published,
        adaptive,
        hindsight,
        vanilla,
    })
}

/// Where expected-loss last is as accurate as `ap50`, linear between the points compared.
fn crossing(without_skips: &OperatingPoint, even: &[EqualSkip], ap50: f64) -> Option<f64> {
    let ours = std::iter::once(without_skips).chain(even.iter().map(|equal| &equal.ours));
    let line: Vec<(f64, f64)> = ours.map(|point| (point.skip_rate, point.ap50)).collect();
    let last = line.iter().rposition(|&(_, y)| y >= ap50)?;
    let (&(x0, y0), &(x1, y1)) = (line.get(last)?, line.get(last + 1)?);
    Some(x0 + (x1 - x0) * (y0 - ap50) / (y0 - y1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frontier::ClipFigures;

    fn point(skip_rate: f64, ap50: &[f64]) -> OperatingPoint {
        let clips: Vec<_> = ap50
            .iter()
            .enumerate()
            .map(|(index, &ap50)| ClipFigures {
                clip: format!("clip {index}"),
                skip_rate,
                ap50,
                map: ap50 / 2.0,
                ..ClipFigures::default()
            })
            .collect();
        OperatingPoint {
            policy: "a policy".to_owned(),
            value: None,
            skip_rate,
            ap50: mean(ap50.iter().copied()).expect("there are clips"),
            map: 0.0,
            clips,
        }
    }

    #[test]
    fn differences_are_taken_clip_by_clip_and_the_worst_is_named() {
        let difference = PairedDifference::new(
            &point(0.5, &[0.8, 0.6, 0.7]),
            &point(0.5, &[0.7, 0.65, 0.5]),
        );
        assert!((difference.ap50 - 0.25 / 3.0).abs() < 1e-12);
        assert!((difference.map - 0.125 / 3.0).abs() < 1e-12);
        assert_eq!(difference.worse_clips, 1);
        let (clip, worst) = difference.worst.expect("one clip loses");
        assert_eq!(clip, "clip 1");
        assert!((worst + 0.05).abs() < 1e-12);
        let t = difference.ap50_t.expect("three pairs");
        assert!(t.lower < difference.ap50 && difference.ap50 < t.upper);
    }

    #[test]
    fn the_crossing_lies_between_the_points_around_it() {
        let equal = |skip_rate, ap50| EqualSkip {
            other: point(skip_rate, &[0.0]),
            ours: point(skip_rate, &[ap50]),
            difference: PairedDifference::new(&point(0.0, &[0.0]), &point(0.0, &[0.0])),
        };
        let even = [equal(0.5, 0.72), equal(0.7, 0.68)];
        let start = point(0.0, &[0.76]);
        let found = crossing(&start, &even, 0.7).expect("it is crossed");
        assert!((found - 0.6).abs() < 1e-12);
        assert_eq!(crossing(&start, &even, 0.9), None);
        assert_eq!(crossing(&start, &even, 0.1), None);
    }
}
