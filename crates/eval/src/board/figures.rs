//! Draws the figures of the joined runs.

use super::run::{ClipRun, SetupRuns};
use super::summary::{PolicyFigures, SetupSummary};
use crate::chart::{
    Axis, BarPart, Plot, PlotError, SOFT_INK, chart, color_of, mark, percent_label, plain_label,
    range, signed_label, stacked, state_parts,
};
use crate::spec::{BASELINE, short_label};
use albireo_core::policy::FrameState;
use plotters::prelude::*;
use std::collections::{BTreeSet, HashMap};

/// Draws the figures for which there are runs.
pub(super) fn figures(
    setups: &[SetupRuns],
    summaries: &[SetupSummary],
) -> Result<Vec<Plot>, PlotError> {
    let mut figures = Vec::new();
    let pareto = points(summaries, |policy| Some((policy.edp?, policy.ap50?)));
    if pareto.iter().any(|series| series.points.len() > 1) {
        figures.push(Plot {
            name: "ap50-against-edp",
            title: "Accuracy against the energy-delay product",
            caption: "Mean over the clips: a marker for each policy, a line for each setup, from the lowest EDP to the highest. \
                      Up and to the left is better.",
            svg: plane(&pareto)?,
        });
    }
    figures.push(Plot {
        name: "frame-states",
        title: "Frame states",
        caption: "Mean share of frames over the clips. E: screen says empty; P: predicted; E+I: screen, then detector; \
                  I: detector; AI: detector and a rescue.",
        svg: states(summaries)?,
    });
    let domains = domains(summaries);
    if domains.len() > 1 {
        let parts: Vec<BarPart<'_>> = domains
            .iter()
            .enumerate()
            .map(|(index, name)| BarPart {
                name,
                fill: color_of(index, name),
                ink: WHITE,
            })
            .collect();
        figures.push(Plot {
            name: "energy-by-domain",
            title: "Energy by domain",
            caption: "Joules of a clip, mean over the clips.",
            svg: stacked(&joules_by_domain(summaries, &domains), &parts, plain_label)?,
        });
    }
    for ChangeFigure {
        name,
        title,
        axis,
        states,
    } in CHANGES
    {
        let changes = changes(setups, states);
        // Without a screen no frame is in E.
        if all_points(&changes).any(|(share, _)| *share > 0.0) {
            figures.push(Plot {
                name,
                title,
                caption: "Each marker is one clip under one policy: how much AP@50 changed against vanilla, and how many frames \
                          went without the detector: called empty (E), predicted (P), or either.",
                svg: clips(&changes, axis)?,
            });
        }
    }
    let all_policies = usize::MAX;
    let totals = traces(setups, all_policies, &|domain| domain == "total");
    for (name, clip) in ["power-trace-1", "power-trace-2"].into_iter().zip(totals) {
        figures.push(Plot {
            name,
            title: "Power over a clip",
            caption: "The machine's power every 100 ms under each policy, from the clip's first frame on.",
            svg: powers(&clip)?,
        });
    }
    let vanilla_and_another = 2;
    let by_domain = traces(setups, vanilla_and_another, &|domain| domain != "total");
    for (name, clip) in ["power-domains-1", "power-domains-2"].into_iter().zip(by_domain) {
        figures.push(Plot {
            name,
            title: "Power over a clip, by domain",
            caption: "The power of each domain every 100 ms under vanilla and the first policy beside it.",
            svg: powers(&clip)?,
        });
    }
    Ok(figures)
}

/// The power over each clip that has a trace, in the first setup with any. Each of the first `policies` policies,
/// vanilla before the others, has a series for each domain that `is_drawn` chooses.
fn traces(
    setups: &[SetupRuns],
    policies: usize,
    is_drawn: &dyn Fn(&str) -> bool,
) -> Vec<ClipTrace> {
    let is_traced = |setup: &&SetupRuns| setup.runs.iter().any(|run| !run.traces.is_empty());
    let Some(setup) = setups.iter().find(is_traced) else {
        return Vec::new();
    };
    let mut clips: Vec<(&str, Vec<&ClipRun>)> = Vec::new();
    for run in &setup.runs {
        if !run.traces.keys().any(|domain| is_drawn(domain)) {
            continue;
        }
        match clips.iter_mut().find(|(clip, _)| *clip == run.clip) {
            Some((_, runs)) => runs.push(run),
            None => clips.push((&run.clip, vec![run])),
        }
    }
    let mut drawn = Vec::new();
    for (clip, mut runs) in clips {
        runs.sort_by_key(|run| run.policy != BASELINE);
        let mut series = Vec::new();
        for run in runs.into_iter().take(policies) {
            let policy = short_label(&run.policy);
            for (domain, trace) in run.traces.iter().filter(|(domain, _)| is_drawn(domain)) {
                let name = match domain.as_str() {
                    "total" => policy.to_owned(),
                    part => format!("{policy} {part}"),
                };
                let points = trace.iter().map(|[seconds, watts]| (*seconds, *watts)).collect();
                series.push(Series { name, points });
            }
        }
        let clip = clip.to_owned();
        drawn.push(ClipTrace { clip, series });
    }
    drawn
}

/// The power over a clip.
struct ClipTrace {
    clip: String,
    series: Vec<Series>,
}

/// Draws a line per series.
fn powers(ClipTrace { clip, series }: &ClipTrace) -> Result<String, PlotError> {
    let words = format!("Seconds of {clip}");
    let seconds = Axis {
        name: &words,
        range: range(
            all_points(series).map(|(seconds, _)| *seconds).chain([0.0]),
            0.02,
        ),
        label: plain_label,
    };
    let watts = Axis {
        name: "Watts",
        range: range(
            all_points(series).map(|(_, watts)| *watts).chain([0.0]),
            0.06,
        ),
        label: plain_label,
    };
    chart(seconds, watts, &names(series), |plane| {
        for (index, Series { name, points }) in series.iter().enumerate() {
            let color = color_of(index, name);
            plane.draw_series(LineSeries::new(points.iter().copied(), color))?;
        }
        Ok(())
    })
}

/// Points that belong together.
struct Series {
    name: String,
    points: Vec<(f64, f64)>,
}

fn all_points(series: &[Series]) -> impl Iterator<Item = &(f64, f64)> {
    series.iter().flat_map(|series| &series.points)
}

/// A point for each policy of a setup, from left to right; a series for each setup.
fn points(
    summaries: &[SetupSummary],
    point: impl Fn(&PolicyFigures) -> Option<(f64, f64)>,
) -> Vec<Series> {
    let series = |summary: &SetupSummary| {
        let mut points: Vec<_> = summary.policies.iter().filter_map(&point).collect();
        points.sort_by(|(left, _), (right, _)| left.total_cmp(right));
        Series {
            name: summary.title.clone(),
            points,
        }
    };
    summaries.iter().map(series).collect()
}

fn names(series: &[Series]) -> Vec<(usize, &str)> {
    series.iter().map(|series| series.name.as_str()).enumerate().collect()
}

/// Draws AP@50 against EDP, a series per setup.
fn plane(series: &[Series]) -> Result<String, PlotError> {
    let edp = Axis {
        name: "Energy-delay product, J·ms/frame",
        range: range(all_points(series).map(|(edp, _)| *edp), 0.08),
        label: plain_label,
    };
    let ap50 = Axis {
        name: "AP@50",
        range: range(all_points(series).map(|(_, ap50)| *ap50), 0.1),
        label: plain_label,
    };
    chart(edp, ap50, &names(series), |plane| {
        for (index, Series { name, points }) in series.iter().enumerate() {
            let color = color_of(index, name);
            plane.draw_series(LineSeries::new(points.iter().copied(), color))?;
            mark(plane, points, index, color.filled())?;
        }
        Ok(())
    })
}

/// Draws a bar for each setup and policy.
fn states(summaries: &[SetupSummary]) -> Result<String, PlotError> {
    let mut rows: Vec<(String, Vec<f64>)> = Vec::new();
    for (name, figures) in each(summaries) {
        rows.push((name, figures.states.into_iter().flatten().collect()));
    }
    stacked(&rows, &state_parts(), percent_label)
}

/// Each policy of each setup, with a name: that of the policy if there is one setup only.
fn each(summaries: &[SetupSummary]) -> impl Iterator<Item = (String, &PolicyFigures)> {
    let has_one_setup = summaries.len() == 1;
    summaries.iter().flat_map(move |summary| {
        summary.policies.iter().map(move |figures| {
            let policy = short_label(&figures.policy);
            let name = if has_one_setup {
                policy.to_owned()
            } else {
                format!("{}: {policy}", summary.title)
            };
            (name, figures)
        })
    })
}

/// The names of all domains but the total.
fn domains(summaries: &[SetupSummary]) -> Vec<&str> {
    let policies = summaries.iter().flat_map(|summary| &summary.policies);
    let names: BTreeSet<&str> =
        policies.flat_map(|policy| policy.domains.keys()).map(String::as_str).collect();
    names.into_iter().filter(|name| *name != "total").collect()
}

/// The joules of each of `domains`, in each setup under each policy.
fn joules_by_domain(summaries: &[SetupSummary], domains: &[&str]) -> Vec<(String, Vec<f64>)> {
    let joules = |figures: &PolicyFigures| {
        let in_domain = |name: &&str| figures.domains.get(*name).copied().unwrap_or(0.0);
        domains.iter().map(in_domain).collect()
    };
    each(summaries)
        .filter(|(_, figures)| !figures.domains.is_empty())
        .map(|(name, figures)| (name, joules(figures)))
        .collect()
}

/// A figure of changes against the share of frames without the detector.
struct ChangeFigure {
    name: &'static str,
    title: &'static str,
    /// The words at the axis of the share.
    axis: &'static str,
    /// The states whose share it is.
    states: &'static [FrameState],
}

const CHANGES: [ChangeFigure; 3] = [
    ChangeFigure {
        name: "clips-ap50-change",
        title: "Change of accuracy clip by clip, by frames in E or P",
        axis: "Frames in E or P, %",
        states: &[FrameState::E, FrameState::P],
    },
    ChangeFigure {
        name: "clips-ap50-change-e",
        title: "Change of accuracy clip by clip, by frames in E",
        axis: "Frames in E, %",
        states: &[FrameState::E],
    },
    ChangeFigure {
        name: "clips-ap50-change-p",
        title: "Change of accuracy clip by clip, by frames in P",
        axis: "Frames in P, %",
        states: &[FrameState::P],
    },
];

/// The share of frames (percent) and change of AP@50 (points) of every clip, by setup and policy.
fn changes(setups: &[SetupRuns], states: &[FrameState]) -> Vec<Series> {
    let mut series: Vec<Series> = Vec::new();
    for SetupRuns { setup, runs } in setups {
        let title = setup.title_among(setups);
        let baseline: HashMap<&str, f64> = runs
            .iter()
            .filter(|run| run.policy == BASELINE)
            .filter_map(|run| Some((run.clip.as_str(), run.ap50?)))
            .collect();
        for run in runs.iter().filter(|run| run.policy != BASELINE) {
            let (Some(own), Some(before)) = (run.ap50, baseline.get(run.clip.as_str())) else {
                continue;
            };
            let Some(share) = run.share_of(states) else {
                continue;
            };
            let policy = short_label(&run.policy);
            let name = if setups.len() == 1 {
                policy.to_owned()
            } else {
                format!("{title}: {policy}")
            };
            let point = (share * 100.0, (own - before) * 100.0);
            match series.iter_mut().find(|other| other.name == name) {
                Some(known) => known.points.push(point),
                None => series.push(Series {
                    name,
                    points: vec![point],
                }),
            }
        }
    }
    series
}

/// Draws a marker per clip, across the share that `words` describe.
fn clips(series: &[Series], words: &str) -> Result<String, PlotError> {
    let across = range(all_points(series).map(|(share, _)| *share), 0.05);
    let change = Axis {
        name: "Change of AP@50, percentage points",
        range: range(
            all_points(series).map(|(_, points)| *points).chain([0.0]),
            0.06,
        ),
        label: signed_label,
    };
    let shares = Axis {
        name: words,
        range: across.clone(),
        label: plain_label,
    };
    chart(shares, change, &names(series), |plane| {
        let ends = [(across.start, 0.0), (across.end, 0.0)];
        plane.draw_series(LineSeries::new(ends, SOFT_INK))?;
        for (index, Series { name, points }) in series.iter().enumerate() {
            let color = color_of(index, name).mix(0.6);
            mark(plane, points, index, color.filled())?;
        }
        Ok(())
    })
}
