//! Summarises each policy over the clips: means, differences to the baseline, and the Pareto frontier.

use crate::judge::{Accuracy, Matches};
use crate::result::{ClipResult, Energy, Provenance};
use crate::spec::BASELINE;
use crate::statistics::{half_interval, mean, p_value};
use crate::text::signed;
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
    /// The two-sided p of the paired t-test; `None` if it is undefined.
    pub p: Option<f64>,
}

/// How late objects are found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NewcomerSummary {
    /// Mean delay, frames.
    pub frames: f64,
    /// Mean delay, milliseconds; `None` if a clip has no frame rate.
    pub ms: Option<f64>,
    /// Mean share of objects that were never found.
    pub never_found: f64,
}

/// The figures of one policy over all frames, as if the clips were one. A long clip, a crowded one or one with many objects
/// counts for more here than in the means over clips.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Pooled {
    /// Share of skipped frames.
    pub skip_rate: f64,
    /// Number of boxes of the ground truth.
    pub truths: usize,
    /// AP@50 of the boxes that a node publishes.
    pub ap50: f64,
    /// mAP@50:95 of these boxes.
    pub map: f64,
    /// Number of objects that come near enough for their delay to be told; 0 if the ground truth does not number them.
    pub objects: usize,
    /// Mean delay of these objects, frames.
    pub delay_frames: Option<f64>,
    /// How many of them were never found.
    pub never_found: usize,
}

impl Pooled {
    /// Pools clips; `None` for fewer than two, and without ground truth.
    fn of(results: &[&ClipResult]) -> Option<Self> {
        if results.len() < 2 {
            return None;
        }
        let matches: Option<Vec<&Matches>> =
            results.iter().map(|result| result.matches.as_ref()).collect();
        let accuracy = Matches::joined(matches?)?.accuracy()?;
        let played: usize = results.iter().map(|result| result.frames).sum();
        let frames = played.max(1) as f64;
        let skipped = results.iter().map(|result| result.skip_rate() * result.frames as f64);
        let newcomers = || results.iter().filter_map(|result| result.newcomers);
        let objects: usize = newcomers().map(|found| found.objects).sum();
        let late: f64 = newcomers().map(|found| found.delay_frames * found.objects as f64).sum();
        Some(Self {
            skip_rate: skipped.sum::<f64>() / frames,
            truths: accuracy.truths,
            ap50: accuracy.ap50,
            map: accuracy.map,
            objects,
            delay_frames: (objects > 0).then(|| late / objects as f64),
            never_found: newcomers().map(|found| found.never_found).sum(),
        })
    }
}

/// What the figures of newcomers are, for the legend of a table.
pub(crate) const NEWCOMERS: &str = "New, ms: how late an object is found, in frames and milliseconds, from its first \
    box of 20 pixels height to its first published box (IoU 0.5); one that is never found (never) is late by its whole life.";

impl Difference {
    /// Summarises the differences in `values`; `None` if there are none.
    pub fn of(values: &[f64]) -> Option<Self> {
        let mean = mean(values.iter().copied())?;
        Some(Self {
            clips: values.len(),
            mean,
            interval: half_interval(values).map(|half| [mean - half, mean + half]),
            p: p_value(values),
        })
    }

    /// The same in another unit, such as points (100).
    pub(crate) fn scaled(self, factor: f64) -> Self {
        Self {
            mean: self.mean * factor,
            interval: self.interval.map(|ends| ends.map(|end| end * factor)),
            ..self
        }
    }

    /// `+24.1 [+18.2, +30.1]`.
    pub(crate) fn text(self, decimals: usize) -> String {
        let mean = signed(self.mean, decimals);
        match self.interval {
            None => mean,
            Some([lower, upper]) => {
                let [lower, upper] = [lower, upper].map(|end| signed(end, decimals));
                format!("{mean} [{lower}, {upper}]")
            }
        }
    }

    /// The p of the paired t-test with three decimals, or `-`.
    pub(crate) fn p_text(self) -> String {
        match self.p {
            None => "-".to_owned(),
            Some(p) if p < 0.001 => "<.001".to_owned(),
            Some(p) => format!("{p:.3}"),
        }
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
    /// Mean detector calls a second; `None` if a clip has no frame rate.
    pub calls_a_second: Option<f64>,
    /// Mean delay of settled frames, frames.
    #[serde(skip)]
    pub delay: f64,
    /// How late objects are found; `None` if the ground truth does not number them.
    pub newcomers: Option<NewcomerSummary>,
    /// Mean AP@50 of the boxes that a node publishes.
    pub ap50: Option<f64>,
    /// Mean AP@50 of all boxes of the policy.
    pub ap50_all: Option<f64>,
    /// Mean mAP@50:95 of the boxes that a node publishes.
    pub map: Option<f64>,
    /// Mean mAP@50:95 of all boxes of the policy.
    pub map_all: Option<f64>,
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
    /// AP@50 of all boxes minus that of the baseline's.
    pub ap50_all_change: Option<Difference>,
    /// mAP@50:95 of all boxes minus that of the baseline's.
    pub map_all_change: Option<Difference>,
    /// The delay of newcomers minus the baseline's, frames.
    pub newcomers_change: Option<Difference>,
    /// The figures over all frames of the clips; `None` for one clip.
    pub pooled: Option<Pooled>,
    /// True if no other policy has at least the skip rate and the AP@50, and more of one of the two.
    pub on_skip_frontier: bool,
}

/// What each policy has, policies in the order in which they first occur.
type ByPolicy<'a, T> = Vec<(&'a str, Vec<&'a T>)>;

/// Groups `results` by their policies.
pub(crate) fn by_policy<'a, T>(results: &'a [T], policy: fn(&T) -> &str) -> ByPolicy<'a, T> {
    let mut groups: ByPolicy<'a, T> = Vec::new();
    for result in results {
        let name = policy(result);
        match groups.iter_mut().find(|(group, _)| *group == name) {
            Some((_, of_policy)) => of_policy.push(result),
            None => groups.push((name, vec![result])),
        }
    }
    groups
}

/// The baseline's results by clip, with which those of other policies are compared.
pub(crate) fn of_baseline<'a, T>(
    groups: &ByPolicy<'a, T>,
    clip: fn(&T) -> &str,
) -> HashMap<&'a str, &'a T> {
    groups
        .iter()
        .filter(|(policy, _)| *policy == BASELINE)
        .flat_map(|(_, results)| results.iter().map(|&result| (clip(result), result)))
        .collect()
}

/// Summarises `results`, in the order in which the policies first occur.
pub fn summarise(results: &[ClipResult]) -> Vec<PolicySummary> {
    let is_any_judged = results.iter().any(|result| result.accuracy.is_some());
    let by_policy = by_policy(results, |result| &result.policy);
    let baseline = of_baseline(&by_policy, |result| &result.clip);
    let mut summaries: Vec<PolicySummary> = by_policy
        .iter()
        .map(|(policy, of_policy)| {
            let mut counted = of_policy.clone();
            counted.retain(|result| !is_any_judged || result.accuracy.is_some());
            let left_out = of_policy.len() - counted.len();
            summarise_policy(policy, &counted, left_out, &baseline)
        })
        .collect();
    mark_frontier(&mut summaries);
    summaries
}

/// The results of one policy on the clips, and those of the baseline on the same clips.
struct Means<'a> {
    results: &'a [&'a ClipResult],
    /// By clip; empty for the baseline itself.
    baseline: &'a HashMap<&'a str, &'a ClipResult>,
}

impl Means<'_> {
    /// The mean over the clips that have the figure.
    fn over(&self, figure: impl Fn(&ClipResult) -> Option<f64>) -> Option<f64> {
        mean(self.results.iter().filter_map(|result| figure(result)))
    }

    /// The mean of a figure that every clip has; 0 without clips.
    fn all(&self, figure: impl Fn(&ClipResult) -> f64) -> f64 {
        self.over(|result| Some(figure(result))).unwrap_or_default()
    }

    /// The mean, if every clip has the figure: a mean over only some of them would not be that of the others' frames.
    fn if_all(&self, figure: impl Fn(&ClipResult) -> Option<f64>) -> Option<f64> {
        if self.results.iter().all(|result| figure(result).is_some()) {
            self.over(figure)
        } else {
            None
        }
    }

    /// The mean difference to the baseline on the same clips.
    fn change(&self, figure: impl Fn(&ClipResult) -> Option<f64>) -> Option<Difference> {
        let pairs = self.results.iter().filter_map(|result| {
            let other = self.baseline.get(result.clip.as_str())?;
            Some(figure(result)? - figure(other)?)
        });
        Difference::of(&pairs.collect::<Vec<f64>>())
    }

    /// How late objects are found.
    fn newcomers(&self) -> Option<NewcomerSummary> {
        let frames = self.over(|result| Some(result.newcomers?.delay_frames))?;
        let never = |result: &ClipResult| {
            let found = result.newcomers?;
            Some(found.never_found as f64 / found.objects as f64)
        };
        // Only if every clip has a frame rate: frames of the others would be left out of the milliseconds.
        let ms = if self.results.iter().all(|result| result.frame_rate.is_some()) {
            self.over(|result| result.newcomer_ms())
        } else {
            None
        };
        Some(NewcomerSummary {
            frames,
            ms,
            never_found: self.over(never).unwrap_or_default(),
        })
    }

    /// AP@50 of each class over the clips that have it.
    fn ap50_by_class(&self) -> BTreeMap<String, f64> {
        let mut classes: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        for result in self.results {
            for (class, accuracy) in &result.classes {
                classes.entry(class.clone()).or_default().push(accuracy.ap50);
            }
        }
        classes
            .into_iter()
            .filter_map(|(class, values)| Some((class, mean(values)?)))
            .collect()
    }

    /// The projected energy of a clip.
    fn energy(&self) -> Option<Energy> {
        // It is projected for all clips of a run or for none.
        self.results.first()?.energy?;
        let mean = |figure: fn(Energy) -> f64| self.all(|result| result.energy.map_or(0.0, figure));
        Some(Energy {
            joules: mean(|energy| energy.joules),
            duration_s: mean(|energy| energy.duration_s),
            edp: mean(|energy| energy.edp),
        })
    }
}

fn summarise_policy(
    policy: &str,
    results: &[&ClipResult],
    clips_without_truth: usize,
    baseline: &HashMap<&str, &ClipResult>,
) -> PolicySummary {
    // The baseline does not differ from itself.
    let none = HashMap::new();
    let baseline = if policy == BASELINE { &none } else { baseline };
    let means = Means { results, baseline };
    let accuracy =
        |figure: fn(&Accuracy) -> f64| means.over(|result| Some(figure(&result.accuracy?)));
    let accuracy_all =
        |figure: fn(&Accuracy) -> f64| means.over(|result| Some(figure(&result.accuracy_all?)));
    let change =
        |figure: fn(&Accuracy) -> f64| means.change(|result| Some(figure(&result.accuracy?)));
    let change_all =
        |figure: fn(&Accuracy) -> f64| means.change(|result| Some(figure(&result.accuracy_all?)));
    PolicySummary {
        policy: policy.to_owned(),
        clips: results.len(),
        clips_without_truth,
        frames: results.iter().map(|result| result.frames).sum(),
        skip_rate: means.all(ClipResult::skip_rate),
        states: std::array::from_fn(|state| means.all(|result| result.state_shares()[state])),
        detector_frames: means.all(|result| result.detector_frames as f64),
        calls: means.all(|result| result.detector_frames as f64 / result.frames.max(1) as f64),
        calls_a_second: means.if_all(ClipResult::calls_a_second),
        delay: means.all(|result| result.delay),
        newcomers: means.newcomers(),
        ap50: accuracy(|accuracy| accuracy.ap50),
        ap50_all: accuracy_all(|accuracy| accuracy.ap50),
        map: accuracy(|accuracy| accuracy.map),
        map_all: accuracy_all(|accuracy| accuracy.map),
        ap75: accuracy(|accuracy| accuracy.ap75),
        f1_50_shown: accuracy(|accuracy| accuracy.f1_50_shown),
        hota: means.over(|result| Some(result.tracking?.hota)),
        idf1: means.over(|result| Some(result.tracking?.idf1)),
        ap50_by_class: means.ap50_by_class(),
        decision_us: means.over(|result| Some(result.decision_us?.mean)),
        frame_time_ms: results.first().and_then(|first| {
            let mean = means.over(|result| Some(result.frame_time?.milliseconds.mean))?;
            Some((mean, first.frame_time?.provenance))
        }),
        energy: means.energy(),
        ap50_change: change(|accuracy| accuracy.ap50),
        ap75_change: change(|accuracy| accuracy.ap75),
        f1_50_shown_change: change(|accuracy| accuracy.f1_50_shown),
        map_change: change(|accuracy| accuracy.map),
        ap50_all_change: change_all(|accuracy| accuracy.ap50),
        map_all_change: change_all(|accuracy| accuracy.map),
        newcomers_change: means.change(|result| Some(result.newcomers?.delay_frames)),
        pooled: Pooled::of(results),
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
