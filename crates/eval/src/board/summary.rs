//! Summarises the runs of a setup: means by policy, and paired differences to the baseline over the same clips.

use super::run::{ClipRun, SetupRuns};
use crate::spec::BASELINE;
use crate::statistics::mean;
use crate::summary::{Difference, by_policy, of_baseline};
use albireo_core::policy::FrameState;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// The figures of a setup.
pub(super) struct SetupSummary {
    /// The setup's title.
    pub title: String,
    /// What its joules include, and whether they are measured; empty without energy.
    pub energy_of: String,
    /// One entry per policy, the baseline first.
    pub policies: Vec<PolicyFigures>,
}

/// The figures of one policy in one setup: unweighted means over its clips, as in the paper.
pub(super) struct PolicyFigures {
    pub policy: String,
    pub clips: usize,
    pub frames: u64,
    pub dropped: u64,
    /// Frames that nobody labelled.
    pub unlabelled: u64,
    pub ap50: Option<f64>,
    pub map: Option<f64>,
    pub joules: Option<f64>,
    pub frame_ms: Option<f64>,
    /// Mean joules times mean time of a frame, J·ms/frame: how the paper's tables have it.
    pub edp: Option<f64>,
    /// Mean over the clips of joules times duration over frames: the paper's definition.
    pub edp_of_clips: Option<f64>,
    pub skip_rate: Option<f64>,
    /// Shares of E, P, E+I, I and AI.
    pub states: [Option<f64>; 5],
    pub detector_calls: f64,
    pub domains: BTreeMap<String, f64>,
    pub cores: Option<f64>,
    /// Share of the time in which the GPU was busy.
    pub gpu_utilisation: Option<f64>,
    pub memory_mb: Option<f64>,
    pub throttled: usize,
    /// `None` for the baseline, and if no clip was also played under it.
    pub change: Option<Changes>,
}

/// Paired differences to the baseline over the clips that both played.
pub(super) struct Changes {
    /// AP@50, points.
    pub ap50: Option<Difference>,
    /// mAP, points.
    pub map: Option<Difference>,
    /// Joules, percent of the baseline's mean.
    pub joules: Option<Difference>,
    /// Time of a frame, percent of the baseline's mean.
    pub frame_ms: Option<Difference>,
    /// EDP by the paper's tables, percent.
    pub edp: Option<f64>,
    /// Share of the clips that used fewer joules.
    pub clips_that_save: Option<f64>,
    /// How AP@50 changed clip by clip.
    pub clips: Option<ClipsOfAp>,
}

/// How many clips kept their AP@50.
pub(super) struct ClipsOfAp {
    pub as_good: usize,
    pub all: usize,
    /// Median drop of the others, points; `None` if there are none.
    pub median_drop: Option<f64>,
}

/// Summarises the runs of each setup.
pub(super) fn summarise_all(setups: &[SetupRuns]) -> Vec<SetupSummary> {
    let mut summaries = Vec::new();
    for SetupRuns { setup, runs } in setups {
        summaries.push(summarise(setup.title_among(setups), runs));
    }
    summaries
}

/// Summarises a setup's runs, the baseline first, the other policies in the order in which they first occur.
pub(super) fn summarise(title: String, runs: &[ClipRun]) -> SetupSummary {
    let mut by_policy = by_policy(runs, |run| &run.policy);
    by_policy.sort_by_key(|(policy, _)| *policy != BASELINE);
    let baseline = of_baseline(&by_policy, |run| &run.clip);
    let policies = by_policy.iter().map(|(policy, of_policy)| {
        let change = if *policy == BASELINE {
            None
        } else {
            changes(of_policy, &baseline)
        };
        figures(policy, of_policy, change)
    });
    SetupSummary {
        title,
        energy_of: energy_of(runs),
        policies: policies.collect(),
    }
}

/// What the joules of these runs include, and whether they are measured; empty without energy.
fn energy_of(runs: &[ClipRun]) -> String {
    let mut with_joules = runs.iter().filter(|run| run.joules.is_some());
    let is_estimated = with_joules.clone().any(|run| run.estimated);
    let Some(run) = with_joules.next() else {
        return String::new();
    };
    let how = if is_estimated {
        "estimated"
    } else {
        "measured"
    };
    let what = run.energy_of.strip_prefix("estimated: ").unwrap_or(&run.energy_of);
    format!("{how}: {what}")
}

fn figures(policy: &str, runs: &[&ClipRun], change: Option<Changes>) -> PolicyFigures {
    let mean_if_known =
        |figure: &dyn Fn(&ClipRun) -> Option<f64>| mean(runs.iter().filter_map(|run| figure(run)));
    // A mean over only some of the clips cannot be set beside that of a policy with all of them.
    let mean_if_all_known = |figure: &dyn Fn(&ClipRun) -> Option<f64>| {
        if runs.iter().all(|run| figure(run).is_some()) {
            mean_if_known(figure)
        } else {
            None
        }
    };
    let joules = mean_if_all_known(&|run| run.joules);
    let frame_ms = mean_if_all_known(&|run| run.frame_ms);
    let calls = mean(runs.iter().map(|run| run.detector_calls as f64));
    let mut domains = BTreeMap::new();
    for name in runs.iter().flat_map(|run| run.domains.keys()) {
        if let Some(joules) = mean_if_all_known(&|run| run.domains.get(name).copied()) {
            domains.insert(name.clone(), joules);
        }
    }
    PolicyFigures {
        policy: policy.to_owned(),
        clips: runs.len(),
        frames: runs.iter().map(|run| run.frames).sum(),
        dropped: runs.iter().map(|run| run.dropped).sum(),
        unlabelled: runs.iter().map(|run| run.unlabelled).sum(),
        ap50: mean_if_known(&|run| run.ap50),
        map: mean_if_known(&|run| run.map),
        joules,
        frame_ms,
        edp: joules.zip(frame_ms).map(|(joules, ms)| joules * ms),
        edp_of_clips: mean_if_all_known(&|run| run.edp()),
        skip_rate: mean_if_all_known(&|run| run.skip_rate()),
        states: FrameState::ALL.map(|state| mean_if_all_known(&|run| run.share_of(&[state]))),
        detector_calls: calls.unwrap_or_default(),
        domains,
        cores: mean_if_all_known(&|run| run.cores()),
        gpu_utilisation: mean_if_all_known(&|run| run.gpu_utilisation),
        memory_mb: mean_if_all_known(&|run| run.memory_mb),
        throttled: runs.iter().filter(|run| run.throttled).count(),
        change,
    }
}

impl SetupSummary {
    /// True for each policy if no other has at least its AP@50 and at most its EDP, and is better in one of the two; for none
    /// without both figures.
    pub(super) fn on_frontier(&self) -> Vec<bool> {
        let figures = |policy: &PolicyFigures| Some((policy.ap50?, policy.edp?));
        let known: Vec<(f64, f64)> = self.policies.iter().filter_map(figures).collect();
        let is_best = |(ap50, edp): (f64, f64)| {
            let is_beaten = known.iter().any(|(other_ap50, other_edp)| {
                (*other_ap50 >= ap50 && *other_edp < edp)
                    || (*other_ap50 > ap50 && *other_edp <= edp)
            });
            !is_beaten
        };
        self.policies
            .iter()
            .map(|policy| figures(policy).is_some_and(is_best))
            .collect()
    }
}

/// A clip's runs under a policy, and under the baseline.
struct RunPair<'a> {
    own: &'a ClipRun,
    before: &'a ClipRun,
}

/// A figure of a clip under a policy, and under the baseline.
struct Pair {
    own: f64,
    before: f64,
}

/// Compares runs with the baseline's on the same clips; `None` if there are no such clips.
fn changes(runs: &[&ClipRun], baseline: &HashMap<&str, &ClipRun>) -> Option<Changes> {
    let mut run_pairs: Vec<RunPair<'_>> = Vec::new();
    for &own in runs {
        if let Some(&before) = baseline.get(own.clip.as_str()) {
            run_pairs.push(RunPair { own, before });
        }
    }
    if run_pairs.is_empty() {
        return None;
    }
    let both = |figure: &dyn Fn(&ClipRun) -> Option<f64>| -> Vec<Pair> {
        let known = run_pairs.iter().filter_map(|runs| {
            Some(Pair {
                own: figure(runs.own)?,
                before: figure(runs.before)?,
            })
        });
        known.collect()
    };
    let points = |pairs: &[Pair]| {
        let differences: Vec<f64> =
            pairs.iter().map(|pair| 100.0 * (pair.own - pair.before)).collect();
        Difference::of(&differences)
    };
    let percent = |pairs: &[Pair]| {
        let base = mean(pairs.iter().map(|pair| pair.before)).filter(|base| *base > 0.0)?;
        let differences: Vec<f64> = pairs.iter().map(|pair| pair.own - pair.before).collect();
        Some(Difference::of(&differences)?.scaled(100.0 / base))
    };
    let ap50 = both(&|run| run.ap50);
    let joules = both(&|run| run.joules);
    let times = both(&|run| run.frame_ms);
    // The EDP multiplies means over the same clips: those whose joules and times are both known.
    let joules_of_edp = both(&|run| run.frame_ms.and(run.joules));
    let times_of_edp = both(&|run| run.joules.and(run.frame_ms));
    let edp = |figure: fn(&Pair) -> f64| {
        let mean_joules = mean(joules_of_edp.iter().map(figure))?;
        let mean_ms = mean(times_of_edp.iter().map(figure))?;
        Some(mean_joules * mean_ms)
    };
    let edp_before = edp(|pair| pair.before).filter(|before| *before > 0.0);
    let edps = edp(|pair| pair.own).zip(edp_before);
    let one_if_saved = |pair: &Pair| if pair.own < pair.before { 1.0 } else { 0.0 };
    Some(Changes {
        map: points(&both(&|run| run.map)),
        joules: percent(&joules),
        frame_ms: percent(&times),
        edp: edps.map(|(own, before)| 100.0 * (own / before - 1.0)),
        clips_that_save: mean(joules.iter().map(one_if_saved)),
        clips: clips_of(&ap50),
        ap50: points(&ap50),
    })
}

/// Counts the clips whose AP@50 did not fall, and takes the median drop of the others.
fn clips_of(ap50: &[Pair]) -> Option<ClipsOfAp> {
    if ap50.is_empty() {
        return None;
    }
    let mut drops: Vec<f64> = ap50
        .iter()
        .map(|pair| 100.0 * (pair.before - pair.own))
        .filter(|drop| *drop > 0.0)
        .collect();
    drops.sort_by(f64::total_cmp);
    Some(ClipsOfAp {
        as_good: ap50.len() - drops.len(),
        all: ap50.len(),
        median_drop: crate::statistics::quantile(&drops, 0.5),
    })
}

/// Whether the saving by skipping and the saving by another setup multiply.
pub(super) struct Composition {
    /// From which setup to which other one, in their parts that differ.
    pub setups: String,
    pub policy: String,
    pub clips: usize,
    /// Savings of joules: skipping alone, the other setup alone, and both together as measured. Shares of the baseline.
    pub skipping: f64,
    pub other: f64,
    pub together: f64,
    /// `1 − (1 − skipping)(1 − other)`.
    pub expected: f64,
    /// How much more joules both together use than the product says: a factor with its 95 % interval (geometric mean
    /// over the clips, paired t of the logarithms).
    pub factor: f64,
    pub interval: Option<[f64; 2]>,
}

/// Compares each pair of setups of one machine, in both of which a policy and the baseline were measured on the same
/// clips.
pub(super) fn compositions(setups: &[SetupRuns]) -> Vec<Composition> {
    let mut found = Vec::new();
    for from in setups {
        for to in setups {
            if from.setup.machine != to.setup.machine || from.setup == to.setup {
                continue;
            }
            let policies: BTreeSet<&str> = from
                .runs
                .iter()
                .map(|run| run.policy.as_str())
                .filter(|policy| *policy != BASELINE)
                .collect();
            found.extend(policies.into_iter().filter_map(|policy| compose(from, to, policy)));
        }
    }
    found
}

/// The joules of a clip in two setups, under the baseline and under a policy.
struct ClipJoules {
    /// In the first setup under the baseline.
    base: f64,
    /// In the first setup under the policy.
    skipping: f64,
    /// In the second setup under the baseline.
    other: f64,
    /// In the second setup under the policy.
    both: f64,
}

/// The clips of which all four energies are known and above zero.
fn joules_of_clips(from: &SetupRuns, to: &SetupRuns, policy: &str) -> Vec<ClipJoules> {
    let joules = |setup: &SetupRuns, policy: &str| -> BTreeMap<String, f64> {
        setup
            .runs
            .iter()
            .filter(|run| run.policy == policy)
            .filter_map(|run| Some((run.clip.clone(), run.joules?)))
            .collect()
    };
    let all_skipping = joules(from, policy);
    let all_other = joules(to, BASELINE);
    let all_both = joules(to, policy);
    let mut clips = Vec::new();
    for (clip, base) in joules(from, BASELINE) {
        let Some(&skipping) = all_skipping.get(&clip) else {
            continue;
        };
        let Some(&other) = all_other.get(&clip) else {
            continue;
        };
        let Some(&both) = all_both.get(&clip) else {
            continue;
        };
        // The logarithm of their quotients is taken.
        if [base, skipping, other, both].iter().all(|joules| *joules > 0.0) {
            clips.push(ClipJoules {
                base,
                skipping,
                other,
                both,
            });
        }
    }
    clips
}

fn compose(from: &SetupRuns, to: &SetupRuns, policy: &str) -> Option<Composition> {
    let clips = joules_of_clips(from, to, policy);
    if clips.is_empty() {
        return None;
    }
    let total = |figure: fn(&ClipJoules) -> f64| clips.iter().map(figure).sum::<f64>();
    let base = total(|clip| clip.base);
    // The savings start at the setup that uses more without skipping.
    if total(|clip| clip.other) >= base {
        return None;
    }
    let saving = |figure: fn(&ClipJoules) -> f64| 1.0 - total(figure) / base;
    let logs: Vec<f64> = clips
        .iter()
        .map(|clip| {
            let log_of = |joules: f64| (joules / clip.base).ln();
            log_of(clip.both) - log_of(clip.skipping) - log_of(clip.other)
        })
        .collect();
    let log = Difference::of(&logs)?;
    let skipping = saving(|clip| clip.skipping);
    let other = saving(|clip| clip.other);
    Some(Composition {
        setups: from.setup.change_to(&to.setup),
        policy: policy.to_owned(),
        clips: clips.len(),
        skipping,
        other,
        together: saving(|clip| clip.both),
        expected: 1.0 - (1.0 - skipping) * (1.0 - other),
        factor: log.mean.exp(),
        interval: log.interval.map(|ends| ends.map(f64::exp)),
    })
}
