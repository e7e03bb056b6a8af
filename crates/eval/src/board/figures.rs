//! Draws the figures of the joined runs.

use super::run::{ClipRun, SetupRuns};
use super::summary::{PolicyFigures, SetupSummary};
use crate::chart::{
    Axis, BarPart, Plot, PlotError, SOFT_INK, chart, color_of, mark, range, stacked, state_parts,
};
use crate::spec::{BASELINE, short_label};
use albireo_core::policy::FrameState;
use plotters::prelude::*;
use std::collections::HashMap;

/// Draws the figures for which there are runs.
pub(super) fn figures(
    setups: &[SetupRuns],
    summaries: &[SetupSummary],
) -> Result<Vec<Plot>, PlotError> {
    let mut figures = Vec::new();
    let pareto = points(summaries, |of| Some((of.edp?, of.ap50?)));
    if pareto.iter().any(|(_, points)| points.len() > 1) {
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
    let (parts, rows) = domains(summaries);
    if parts.len() > 1 {
        let parts: Vec<BarPart<'_>> = parts
            .iter()
            .enumerate()
            .map(|(at, name)| (name.as_str(), color_of(at, name), WHITE))
            .collect();
        figures.push(Plot {
            name: "energy-by-domain",
            title: "Energy by domain",
            caption: "Joules of a clip, mean over the clips.",
            svg: stacked(&rows, &parts, &|joules| format!("{joules:.0}"))?,
        });
    }
    for (name, [title, axis], states) in CHANGES {
        let changes = changes(setups, states);
        // Without a screen no frame is in E.
        if changes.iter().flat_map(|(_, points)| points).any(|(share, _)| *share > 0.0) {
            figures.push(Plot {
                name,
                title,
                caption: "Each marker is one clip under one policy: how much AP@50 changed against vanilla, and how many frames \
                          went without the detector: called empty (E), predicted (P), or either.",
                svg: clips(&changes, axis)?,
            });
        }
    }
    let of_total = ["power-trace-1", "power-trace-2"];
    for (name, clip) in of_total
        .into_iter()
        .zip(traces(setups, usize::MAX, &|domain| domain == "total"))
    {
        figures.push(Plot {
            name,
            title: "Power over a clip",
            caption: "The machine's power every 100 ms under each policy, from the clip's first frame on.",
            svg: powers(&clip)?,
        });
    }
    let by_domain = ["power-domains-1", "power-domains-2"];
    for (name, clip) in by_domain.into_iter().zip(traces(setups, 2, &|domain| domain != "total")) {
        figures.push(Plot {
            name,
            title: "Power over a clip, by domain",
            caption: "The power of each domain every 100 ms under vanilla and the first policy beside it.",
            svg: powers(&clip)?,
        });
    }
    Ok(figures)
}

/// The power of the domains `is_drawn` over each clip that has a trace, of the first setup with any: a series for each of
/// the first `policies` policies and domain.
fn traces(
    setups: &[SetupRuns],
    policies: usize,
    is_drawn: &dyn Fn(&str) -> bool,
) -> Vec<(String, Vec<Series>)> {
    let is_traced = |of: &&SetupRuns| of.runs.iter().any(|run| !run.traces.is_empty());
    let mut clips: Vec<(&str, Vec<&ClipRun>)> = Vec::new();
    for run in setups.iter().find(is_traced).iter().flat_map(|of| &of.runs) {
        if !run.traces.keys().any(|domain| is_drawn(domain)) {
            continue;
        }
        match clips.iter_mut().find(|(clip, _)| *clip == run.clip) {
            Some((_, runs)) => runs.push(run),
            None => clips.push((&run.clip, vec![run])),
        }
    }
    let drawn = clips.into_iter().map(|(clip, mut runs)| {
        runs.sort_by_key(|run| run.policy != BASELINE);
        let series = runs.into_iter().take(policies).flat_map(|run| {
            let domains = run.traces.iter().filter(|(domain, _)| is_drawn(domain));
            domains.map(|(domain, trace)| {
                let policy = short_label(&run.policy);
                let name = match domain.as_str() {
                    "total" => policy.to_owned(),
                    part => format!("{policy} {part}"),
                };
                let points = trace.iter().map(|[seconds, watts]| (*seconds, *watts));
                (name, points.collect())
            })
        });
        (clip.to_owned(), series.collect())
    });
    drawn.collect()
}

/// Draws a line per series.
fn powers((clip, series): &(String, Vec<Series>)) -> Result<String, PlotError> {
    let all = || series.iter().flat_map(|(_, points)| points);
    let name = format!("Seconds of {clip}");
    let seconds = Axis {
        name: &name,
        range: range(all().map(|at| at.0).chain([0.0]), 0.02),
        label: &|seconds| format!("{seconds:.1}"),
    };
    let watts = Axis {
        name: "Watts",
        range: range(all().map(|at| at.1).chain([0.0]), 0.06),
        label: &|watts| format!("{watts:.1}"),
    };
    chart(seconds, watts, &names(series), |plane| {
        for (index, (policy, points)) in series.iter().enumerate() {
            let color = color_of(index, policy);
            plane.draw_series(LineSeries::new(points.iter().copied(), color))?;
        }
        Ok(())
    })
}

/// Points of a series, and its name.
type Series = (String, Vec<(f64, f64)>);

fn points(
    summaries: &[SetupSummary],
    point: impl Fn(&PolicyFigures) -> Option<(f64, f64)>,
) -> Vec<Series> {
    summaries
        .iter()
        .map(|summary| {
            let mut points: Vec<_> = summary.policies.iter().filter_map(&point).collect();
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            (summary.title.clone(), points)
        })
        .collect()
}

fn names(series: &[Series]) -> Vec<(usize, &str)> {
    series.iter().map(|(name, _)| name.as_str()).enumerate().collect()
}

/// Draws AP@50 against EDP, a series per setup.
fn plane(series: &[Series]) -> Result<String, PlotError> {
    let all = || series.iter().flat_map(|(_, points)| points);
    let edp = Axis {
        name: "Energy-delay product, J·ms/frame",
        range: range(all().map(|at| at.0), 0.08),
        label: &|edp| format!("{edp:.0}"),
    };
    let ap50 = Axis {
        name: "AP@50",
        range: range(all().map(|at| at.1), 0.1),
        label: &|ap50| format!("{ap50:.3}"),
    };
    chart(edp, ap50, &names(series), |plane| {
        for (index, (name, points)) in series.iter().enumerate() {
            let color = color_of(index, name);
            plane.draw_series(LineSeries::new(points.iter().copied(), color))?;
            mark(plane, points, index, color.filled())?;
        }
        Ok(())
    })
}

/// Draws a bar for each setup and policy.
fn states(summaries: &[SetupSummary]) -> Result<String, PlotError> {
    let rows: Vec<(String, Vec<f64>)> =
        each(summaries).map(|(name, of)| (name, of.states.to_vec())).collect();
    stacked(&rows, &state_parts(), &|share| {
        format!("{:.0} %", share * 100.0)
    })
}

/// Each policy of each setup, with a name: that of the policy if there is one setup only.
fn each(summaries: &[SetupSummary]) -> impl Iterator<Item = (String, &PolicyFigures)> {
    let one = summaries.len() == 1;
    summaries.iter().flat_map(move |summary| {
        summary.policies.iter().map(move |of| {
            let policy = short_label(&of.policy);
            let name = if one {
                policy.to_owned()
            } else {
                format!("{}: {policy}", summary.title)
            };
            (name, of)
        })
    })
}

/// The names of all domains but the total, and the joules of each in each setup under each policy.
fn domains(summaries: &[SetupSummary]) -> (Vec<String>, Vec<(String, Vec<f64>)>) {
    let mut names: Vec<String> = each(summaries)
        .flat_map(|(_, of)| of.domains.keys().cloned().collect::<Vec<_>>())
        .filter(|name| name != "total")
        .collect();
    names.sort();
    names.dedup();
    let joules = |of: &PolicyFigures| {
        let of_each = names.iter().map(|name| of.domains.get(name).copied().unwrap_or(0.0));
        of_each.collect()
    };
    let rows = each(summaries)
        .filter(|(_, of)| !of.domains.is_empty())
        .map(|(name, of)| (name, joules(of)))
        .collect();
    (names, rows)
}

/// The frames without the detector against which changes are drawn: the figure's name, the words of title and axis, and the
/// states.
const CHANGES: [(&str, [&str; 2], &[FrameState]); 3] = [
    (
        "clips-ap50-change",
        [
            "Change of accuracy clip by clip, by frames in E or P",
            "Frames in E or P, %",
        ],
        &[FrameState::E, FrameState::P],
    ),
    (
        "clips-ap50-change-e",
        [
            "Change of accuracy clip by clip, by frames in E",
            "Frames in E, %",
        ],
        &[FrameState::E],
    ),
    (
        "clips-ap50-change-p",
        [
            "Change of accuracy clip by clip, by frames in P",
            "Frames in P, %",
        ],
        &[FrameState::P],
    ),
];

/// The share of frames (percent) and change of AP@50 (points) of every clip, by setup and policy.
fn changes(setups: &[SetupRuns], states: &[FrameState]) -> Vec<Series> {
    let mut series: Vec<Series> = Vec::new();
    for of in setups {
        let baseline = of.runs.iter().filter(|run| run.policy == BASELINE);
        let baseline: HashMap<&str, f64> =
            baseline.filter_map(|run| Some((run.clip.as_str(), run.ap50?))).collect();
        for run in of.runs.iter().filter(|run| run.policy != BASELINE) {
            let (Some(own), Some(before)) = (run.ap50, baseline.get(run.clip.as_str())) else {
                continue;
            };
            let policy = short_label(&run.policy);
            let name = if setups.len() == 1 {
                policy.to_owned()
            } else {
                format!("{}: {policy}", of.setup.title())
            };
            let frames: u64 = states.iter().map(|state| run.states.get(*state)).sum();
            let share = frames as f64 / run.states.frames().max(1) as f64;
            let at = (share * 100.0, (own - before) * 100.0);
            match series.iter_mut().find(|(other, _)| *other == name) {
                Some((_, points)) => points.push(at),
                None => series.push((name, vec![at])),
            }
        }
    }
    series
}

/// Draws a marker per clip, across the share that `name` describes.
fn clips(series: &[Series], name: &str) -> Result<String, PlotError> {
    let all = || series.iter().flat_map(|(_, points)| points);
    let across = range(all().map(|at| at.0), 0.05);
    let signed = |value: &f64| format!("{value:+.0}").replace('-', "−");
    let change = Axis {
        name: "Change of AP@50, percentage points",
        range: range(all().map(|at| at.1).chain([0.0]), 0.06),
        label: &signed,
    };
    let shares = Axis {
        name,
        range: across.clone(),
        label: &|percent| format!("{percent:.0}"),
    };
    chart(shares, change, &names(series), |plane| {
        let ends = [(across.start, 0.0), (across.end, 0.0)];
        plane.draw_series(LineSeries::new(ends, SOFT_INK))?;
        for (index, (name, points)) in series.iter().enumerate() {
            let color = color_of(index, name).mix(0.6);
            mark(plane, points, index, color.filled())?;
        }
        Ok(())
    })
}
