//! Summarises each policy over the clips: means, differences to the baseline, and the Pareto frontier.

use crate::judge::Accuracy;
use crate::result::{ClipResult, Energy, Provenance};
use crate::spec::BASELINE;
use crate::statistics::{half_interval, mean};
use serde::Serialize;
use std::collections::{BTreeMap, HashMap};

/// The mean difference of a figure to the baseline's on the same clips.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// The number of clips.
    pub clips: usize,
    /// Mean difference.
    pub mean: f64,
    /// Lower and upper end of its 95 % interval (paired t); `None` if it is undefined.
    pub interval: Option<[f64; 2]>,
}

impl Difference {
    /// Summarises the differences in `values`; `None` if there are none.
    pub fn of(values: &[f64]) -> Option<Self> {
        let mean = mean(values.iter().copied())?;
        Some(Self {
            clips: values.len(),
            mean,
            interval: half_interval(values).map(|half| [mean - half, mean + half]),
        })
    }
}

/// The figures of one policy over the clips. Means are unweighted over clips, as in the paper. If some clips have
/// ground truth, all figures are over these, so that accuracy and savings are about the same clips.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PolicySummary {
    /// The policy's label.
    pub policy: String,
    /// The number of clips that the figures are over.
    pub clips: usize,
    /// The number of clips left out because they lack the ground truth that others have.
    pub clips_without_truth: usize,
    /// The number of frames in the clips.
    pub frames: usize,
    /// Mean share of skipped frames.
    pub skip_rate: f64,
    /// Mean share of each state: E, P, E+I, I, AI.
    pub states: [f64; 5],
    /// Mean detector calls per clip.
    pub detector_frames: f64,
    /// Mean detector calls per frame.
    pub calls: f64,
    /// Mean delay of settled frames, frames.
    #[serde(skip)]
    pub delay: f64,
    /// Mean AP@50 of the boxes that a node publishes.
    pub ap50: Option<f64>,
    /// Mean AP@50 of all boxes of the policy.
    pub ap50_all: Option<f64>,
    /// Mean mAP@50:95.
    pub map: Option<f64>,
    /// Mean AP@75.
    pub ap75: Option<f64>,
    /// Mean F1 at IoU 0.5 of the boxes that are confident enough to be shown.
    pub f1_50_shown: Option<f64>,
    /// Mean HOTA.
    pub hota: Option<f64>,
    /// Mean IDF1.
    pub idf1: Option<f64>,
    /// Mean AP@50 of each class over the clips that have it.
    pub ap50_by_class: BTreeMap<String, f64>,
    /// Mean time inside the policy per frame, microseconds, measured here.
    pub decision_us: Option<f64>,
    /// Mean time per frame in milliseconds, and its provenance.
    pub frame_time_ms: Option<(f64, Provenance)>,
    /// Mean energy of a clip, projected.
    #[serde(rename = "projected_energy")]
    pub energy: Option<Energy>,
    /// AP@50 minus the baseline's; `None` for the baseline itself.
    pub ap50_change: Option<Difference>,
    /// AP@75 minus the baseline's.
    pub ap75_change: Option<Difference>,
    /// F1 of the shown boxes minus the baseline's.
    pub f1_50_shown_change: Option<Difference>,
    /// mAP@50:95 minus the baseline's.
    pub map_change: Option<Difference>,
    /// True if no other policy has at least the skip rate and the AP@50, and more of one of the two.
    pub on_skip_frontier: bool,
}

/// Summarises `results`, in the order in which the policies first occur.
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
    let change = |figure: fn(&Accuracy) -> f64| {
        let pairs = results.iter().filter_map(|result| {
            let other = baseline.get(result.clip.as_str())?;
            Some(figure(result.accuracy.as_ref()?) - figure(other.accuracy.as_ref()?))
        });
        Difference::of(&pairs.filter(|_| policy != BASELINE).collect::<Vec<f64>>())
    };
    let mut classes: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for result in results {
        for (class, accuracy) in &result.classes {
            classes.entry(class.clone()).or_default().push(accuracy.ap50);
        }
    }
    PolicySummary {
        policy: policy.to_owned(),
        clips: results.len(),
        clips_without_truth,
        frames,
        skip_rate: all(&|result| result.skip_rate()),
        states: std::array::from_fn(|state| all(&|result| result.state_shares()[state])),
        detector_frames: all(&|result| result.detector_frames as f64),
        calls: all(&|result| result.detector_frames as f64 / result.frames.max(1) as f64),
        delay: all(&|result| result.delay),
        ap50: over(&|result| result.accuracy.map(|accuracy| accuracy.ap50)),
        ap50_all: over(&|result| result.accuracy_all.map(|accuracy| accuracy.ap50)),
        map: over(&|result| result.accuracy.map(|accuracy| accuracy.map)),
        ap75: over(&|result| result.accuracy.map(|accuracy| accuracy.ap75)),
        f1_50_shown: over(&|result| result.accuracy.map(|accuracy| accuracy.f1_50_shown)),
        hota: over(&|result| result.tracking.map(|tracking| tracking.hota)),
        idf1: over(&|result| result.tracking.map(|tracking| tracking.idf1)),
        ap50_by_class: classes
            .into_iter()
            .filter_map(|(class, values)| Some((class, mean(values)?)))
            .collect(),
        decision_us: over(&|result| result.decision_us.map(|spread| spread.mean)),
        frame_time_ms: results.first().and_then(|first| {
            let mean = over(&|result| Some(result.frame_time?.milliseconds.mean))?;
            Some((mean, first.frame_time?.provenance))
        }),
        energy: results.first().and_then(|first| first.energy).map(|_| {
            let mean = |figure: fn(Energy) -> f64| all(&|result| result.energy.map_or(0.0, figure));
            Energy {
                joules: mean(|energy| energy.joules),
                duration_s: mean(|energy| energy.duration_s),
                edp: mean(|energy| energy.edp),
            }
        }),
        ap50_change: change(|accuracy| accuracy.ap50),
        ap75_change: change(|accuracy| accuracy.ap75),
        f1_50_shown_change: change(|accuracy| accuracy.f1_50_shown),
        map_change: change(|accuracy| accuracy.map),
        on_skip_frontier: false,
    }
}

/// Marks the policies that are on the Pareto frontier of skip rate and AP@50.
fn mark_frontier(summaries: &mut [PolicySummary]) {
    let figures = |summary: &PolicySummary| (summary.skip_rate, summary.ap50);
    let all: Vec<_> = summaries.iter().map(figures).collect();
    for summary in summaries {
        let (skip_rate, ap50) = figures(summary);
        let beats = |&(other_skip_rate, other_ap50): &(f64, Option<f64>)| {
            other_skip_rate >= skip_rate
                && other_ap50 >= ap50
                && (other_skip_rate > skip_rate || other_ap50 > ap50)
        };
        summary.on_skip_frontier = ap50.is_some() && !all.iter().any(beats);
    }
}

#[cfg(test)]
pub(crate) mod tests;
