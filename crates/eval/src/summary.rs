//! One line a policy: means over the clips, differences to the baseline clip by clip, tests, frontiers.

use crate::pareto::{Choice, frontier};
use crate::result::{ClipResult, Energy, Provenance};
use crate::spec::BASELINE;
use crate::statistics::{PairedT, mean, paired_t};
use serde::Serialize;
use std::collections::{BTreeMap, HashMap};

/// Differences of one figure to the baseline's on the same clips.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Clips compared.
    pub clips: usize,
    /// Mean difference.
    pub mean: f64,
    /// Paired t-test; `None` where it is undefined.
    pub t: Option<PairedT>,
}

impl Difference {
    /// The differences in `values`; `None` without any.
    pub fn of(values: &[f64]) -> Option<Self> {
        Some(Self {
            clips: values.len(),
            mean: mean(values.iter().copied())?,
            t: paired_t(values),
        })
    }
}

/// A policy against the baseline.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// AP@50, shares of 1.
    pub ap50: Option<Difference>,
    /// mAP@50:95, shares of 1.
    pub map: Option<Difference>,
    /// Joules per clip.
    pub energy: Option<Difference>,
    /// EDP per clip.
    pub edp: Option<Difference>,
    /// Milliseconds per frame.
    pub frame_time: Option<Difference>,
    /// Clips whose AP@50 is the baseline's or better.
    pub clips_keeping_ap50: usize,
}

/// Means of energy figures; only clips of one provenance are averaged.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct EnergySummary {
    /// Where the figures come from.
    pub provenance: Provenance,
    /// Clips that have them.
    pub clips: usize,
    /// Mean joules per clip.
    pub joules: f64,
    /// Mean EDP per clip, J·ms/frame.
    pub edp: f64,
}

/// One policy over the clips. Means are unweighted over clips, as in the paper. Where some clips have ground
/// truth, all figures are over these, so that accuracy and savings speak of the same clips.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PolicySummary {
    /// Its label.
    pub policy: String,
    /// Number of clips the figures are over.
    pub clips: usize,
    /// Clips left out of the figures because they lack the ground truth that others have.
    pub clips_without_truth: usize,
    /// Frames in the clips.
    pub frames: usize,
    /// Mean share of skipped frames.
    pub skip_rate: f64,
    /// Share of skipped frames over all frames of the clips.
    pub skip_rate_pooled: f64,
    /// Mean share of each state: E, P, E+I, I, AI.
    pub states: [f64; 5],
    /// Mean detector calls per clip.
    pub detector_frames: f64,
    /// Boxes scored in the clips.
    pub boxes: usize,
    /// Mean AP@50.
    pub ap50: Option<f64>,
    /// Mean mAP@50:95.
    pub map: Option<f64>,
    /// Mean AP@75.
    pub ap75: Option<f64>,
    /// Mean F1 at IoU 0.5 and each clip's best confidence.
    pub f1_50: Option<f64>,
    /// Mean F1 at IoU 0.5 of the boxes with confidence to be shown.
    pub f1_50_shown: Option<f64>,
    /// Mean HOTA.
    pub hota: Option<f64>,
    /// Mean IDF1.
    pub idf1: Option<f64>,
    /// Mean precision at IoU 0.50.
    pub precision: Option<f64>,
    /// Mean recall at IoU 0.50.
    pub recall: Option<f64>,
    /// Mean AP@50 with last confidences, under the published scoring.
    pub ap50_last_confidence: Option<f64>,
    /// Mean mAP with last confidences, under the published scoring.
    pub map_last_confidence: Option<f64>,
    /// Mean AP@50 of each class over the clips that have it.
    pub ap50_by_class: BTreeMap<String, f64>,
    /// Mean time inside the policy per frame, microseconds, measured here.
    pub decision_us: Option<f64>,
    /// Mean time per frame in milliseconds and where it comes from.
    pub frame_time_ms: Option<(f64, Provenance)>,
    /// Energy.
    pub energy: Option<EnergySummary>,
    /// Against the baseline; `None` for the baseline itself.
    pub against_baseline: Option<Comparison>,
    /// Whether no other policy has as many skips and as much AP@50 and more of one.
    pub on_skip_frontier: bool,
}

/// Sums up `results`, in the order in which the policies first occur.
pub fn summarise(results: &[ClipResult]) -> Vec<PolicySummary> {
    let judged = results.iter().any(|result| result.accuracy.is_some());
    let mut order: Vec<&str> = Vec::new();
    let mut by_policy: HashMap<&str, Vec<&ClipResult>> = HashMap::new();
    for result in results {
        by_policy
            .entry(&result.policy)
            .or_insert_with(|| {
                order.push(&result.policy);
                Vec::new()
            })
            .push(result);
    }
    let baseline: HashMap<&str, &ClipResult> = by_policy
        .get(BASELINE)
        .into_iter()
        .flatten()
        .map(|result| (result.clip.as_str(), *result))
        .collect();
    let mut summaries: Vec<PolicySummary> = order
        .into_iter()
        .map(|policy| {
            let mut counted = by_policy[policy].clone();
            counted.retain(|result| !judged || result.accuracy.is_some());
            let left_out = by_policy[policy].len() - counted.len();
            summarise_policy(policy, &counted, left_out, &baseline)
        })
        .collect();
    mark_frontier(&mut summaries);
    summaries
}

fn summarise_policy(
    policy: &str,
    results: &[&ClipResult],
    clips_without_truth: usize,
    baseline: &HashMap<&str, &ClipResult>,
) -> PolicySummary {
    let over = |figure: &dyn Fn(&ClipResult) -> Option<f64>| {
        mean(results.iter().filter_map(|result| figure(result)))
    };
    let all = |figure: &dyn Fn(&ClipResult) -> f64| {
        over(&|result| Some(figure(result))).unwrap_or_default()
    };
    let frames = results.iter().map(|result| result.frames).sum::<usize>();
    let skipped = results
        .iter()
        .map(|result| result.states.skipped(result.degraded_frames))
        .sum::<usize>();
    let mut classes: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for result in results {
        for (class, accuracy) in &result.classes {
            classes
                .entry(class.clone())
                .or_default()
                .push(accuracy.ap50);
        }
    }
    PolicySummary {
        policy: policy.to_owned(),
        clips: results.len(),
        clips_without_truth,
        frames,
        skip_rate: all(&|result| result.skip_rate()),
        skip_rate_pooled: skipped as f64 / frames as f64,
        states: std::array::from_fn(|state| all(&|result| result.states.shares()[state])),
        detector_frames: all(&|result| result.detector_frames as f64),
        boxes: results.iter().map(|result| result.boxes).sum(),
        ap50: over(&|result| result.accuracy.map(|accuracy| accuracy.ap50)),
        map: over(&|result| result.accuracy.map(|accuracy| accuracy.map)),
        ap75: over(&|result| result.accuracy.map(|accuracy| accuracy.ap75)),
        f1_50: over(&|result| result.accuracy.map(|accuracy| accuracy.f1_50)),
        f1_50_shown: over(&|result| result.accuracy.map(|accuracy| accuracy.f1_50_shown)),
        hota: over(&|result| result.tracking.map(|tracking| tracking.hota)),
        idf1: over(&|result| result.tracking.map(|tracking| tracking.idf1)),
        precision: over(&|result| result.accuracy.map(|accuracy| accuracy.precision)),
        recall: over(&|result| result.accuracy.map(|accuracy| accuracy.recall)),
        ap50_last_confidence: over(&|result| {
            result
                .accuracy_last_confidence
                .map(|accuracy| accuracy.ap50)
        }),
        map_last_confidence: over(&|result| {
            result.accuracy_last_confidence.map(|accuracy| accuracy.map)
        }),
        ap50_by_class: classes
            .into_iter()
            .filter_map(|(class, values)| Some((class, mean(values)?)))
            .collect(),
        decision_us: over(&|result| result.decision_us.map(|spread| spread.mean)),
        frame_time_ms: first_provenance(results, |result| {
            result
                .frame_time
                .map(|time| (time.milliseconds.mean, time.provenance))
        }),
        energy: summarise_energy(results),
        against_baseline: (policy != BASELINE && !baseline.is_empty())
            .then(|| compare(results, baseline)),
        on_skip_frontier: false,
    }
}

/// The mean of a figure over the clips that share the provenance of the first clip that has it.
fn first_provenance(
    results: &[&ClipResult],
    figure: impl Fn(&ClipResult) -> Option<(f64, Provenance)>,
) -> Option<(f64, Provenance)> {
    let (_, wanted) = results.iter().find_map(|result| figure(result))?;
    let values = results
        .iter()
        .filter_map(|result| figure(result))
        .filter(|(_, provenance)| *provenance == wanted)
        .map(|(value, _)| value);
    Some((mean(values)?, wanted))
}

fn summarise_energy(results: &[&ClipResult]) -> Option<EnergySummary> {
    let energies = || results.iter().filter_map(|result| result.energy);
    let provenance = energies().next()?.provenance;
    let same = || energies().filter(|energy| energy.provenance == provenance);
    Some(EnergySummary {
        provenance,
        clips: same().count(),
        joules: mean(same().map(|energy| energy.joules))?,
        edp: mean(same().map(|energy| energy.edp))?,
    })
}

/// A figure of a clip and how it is known.
type Figure<'a> = dyn Fn(&ClipResult) -> Option<(f64, Option<Provenance>)> + 'a;

fn compare(results: &[&ClipResult], baseline: &HashMap<&str, &ClipResult>) -> Comparison {
    // Measured is compared with measured and projected with projected, never across.
    let differences = |figure: &Figure<'_>| {
        let pairs = results.iter().filter_map(|result| {
            let other = baseline.get(result.clip.as_str())?;
            let ((value, kind), (other, other_kind)) = (figure(result)?, figure(other)?);
            (kind == other_kind).then_some(value - other)
        });
        pairs.collect::<Vec<f64>>()
    };
    let ap50 = differences(&|result| Some((result.accuracy?.ap50, None)));
    let energy = |figure: fn(&Energy) -> f64| {
        Difference::of(&differences(&|result| {
            let energy = result.energy?;
            Some((figure(&energy), Some(energy.provenance)))
        }))
    };
    Comparison {
        clips_keeping_ap50: ap50.iter().filter(|&&difference| difference >= 0.0).count(),
        ap50: Difference::of(&ap50),
        map: Difference::of(&differences(&|result| Some((result.accuracy?.map, None)))),
        energy: energy(|energy| energy.joules),
        edp: energy(|energy| energy.edp),
        frame_time: Difference::of(&differences(&|result| {
            let time = result.frame_time?;
            Some((time.milliseconds.mean, Some(time.provenance)))
        })),
    }
}

fn mark_frontier(summaries: &mut [PolicySummary]) {
    let choices: Vec<Choice> = summaries
        .iter()
        .map(|summary| Choice {
            cost: -summary.skip_rate,
            value: summary.ap50.unwrap_or(f64::NAN),
        })
        .collect();
    for index in frontier(&choices) {
        summaries[index].on_skip_frontier = true;
    }
}

#[cfg(test)]
mod tests;
