//! Draws the figures of a report as SVG.

use crate::chart::{
    Axis, BAND, FONT, Plane, Plot, PlotError, SOFT_INK, chart, color_of, families, mark,
    percent_label, plain_label, range, signed_label, stacked, state_parts,
};
use crate::result::ClipResult;
use crate::spec::{BASELINE, short_label, split_label};
use crate::summary::PolicySummary;
use plotters::prelude::*;
use std::collections::HashMap;
use std::ops::Range;

/// Draws the figures for which `report` has the data.
///
/// # Errors
/// [`PlotError`] when one cannot be drawn.
pub(super) fn figures(report: &super::Report) -> Result<Vec<Plot>, PlotError> {
    let families = families(report.policies.iter().map(|policy| policy.policy.as_str()));
    let mut figures = Vec::new();
    if report.policies.iter().any(|policy| policy.ap50.is_some()) {
        figures.push(Plot {
            name: "ap50-against-skip-rate",
            title: "Accuracy against skip rate",
            caption: "Mean over clips. Whiskers: 95 % confidence interval of the difference to Vanilla, paired over clips, \
                      cut at the figure's edge. Thin line: Vanilla. Grey band: the Pareto frontier; filled markers are on it.",
            svg: tradeoff(&report.policies, &families)?,
        });
    }
    figures.push(Plot {
        name: "frame-states",
        title: "Frame states",
        caption: "Mean share of frames over clips. E: screen says empty; P: predicted; E+I: screen, then detector; \
                  I: detector; AI: detector and a rescue.",
        svg: states(&report.policies)?,
    });
    let changes = changes(&report.clips, &families);
    if changes.iter().any(|of_family| !of_family.is_empty()) {
        figures.push(Plot {
            name: "clips-ap50-change-against-skip-rate",
            title: "Change of accuracy clip by clip",
            caption: "Each marker is one clip under one policy: how much AP@50 changed against Vanilla, and how many frames \
                      went without the detector.",
            svg: clips(&changes, &families)?,
        });
    }
    Ok(figures)
}

/// A policy whose boxes were judged.
struct JudgedPolicy<'a> {
    summary: &'a PolicySummary,
    percent_skipped: f64,
    ap50: f64,
}

impl JudgedPolicy<'_> {
    /// Its place in the figure.
    fn place(&self) -> (f64, f64) {
        (self.percent_skipped, self.ap50)
    }
}

/// Draws accuracy against skip rate: a marker per policy, a line per family, and the Pareto frontier.
fn tradeoff(summaries: &[PolicySummary], families: &[&str]) -> Result<String, PlotError> {
    let mut judged: Vec<JudgedPolicy<'_>> = Vec::new();
    for summary in summaries {
        if let Some(ap50) = summary.ap50 {
            let percent_skipped = summary.skip_rate * 100.0;
            judged.push(JudgedPolicy {
                summary,
                percent_skipped,
                ap50,
            });
        }
    }
    let places = |is_wanted: &dyn Fn(&PolicySummary) -> bool| {
        let mut found: Vec<&JudgedPolicy<'_>> =
            judged.iter().filter(|policy| is_wanted(policy.summary)).collect();
        found.sort_by(|a, b| a.percent_skipped.total_cmp(&b.percent_skipped));
        found.into_iter().map(JudgedPolicy::place).collect::<Vec<(f64, f64)>>()
    };
    let across = range(judged.iter().map(|policy| policy.percent_skipped), 0.09);
    let up = vertical_range(&judged);
    let low = up.start;
    let high = up.end;
    let accuracy = Axis {
        name: "AP@50",
        range: up,
        label: plain_label,
    };
    let names: Vec<_> = families.iter().copied().enumerate().collect();
    chart(Axis::skip_rate(across.clone()), accuracy, &names, |plane| {
        let frontier = places(&|summary| summary.on_skip_frontier);
        plane.draw_series(LineSeries::new(frontier, BAND.stroke_width(5)))?;
        if let Some((_, ap50)) = places(&|summary| summary.policy == BASELINE).first() {
            let ends = [(across.start, *ap50), (across.end, *ap50)];
            plane.draw_series(LineSeries::new(ends, SOFT_INK))?;
        }
        let whiskers = judged.iter().filter_map(|policy| {
            let ends = interval(policy.summary)?;
            let points = ends.map(|end| (policy.percent_skipped, end.clamp(low, high)));
            Some(PathElement::new(points.to_vec(), SOFT_INK.mix(0.5)))
        });
        plane.draw_series(whiskers)?;
        for (index, family) in families.iter().enumerate() {
            let color = color_of(index, family);
            let own = |summary: &PolicySummary| is_of_family(&summary.policy, family);
            plane.draw_series(LineSeries::new(places(&own), color))?;
            mark(plane, &places(&own), index, WHITE.filled())?;
            mark(plane, &places(&own), index, color.stroke_width(2))?;
            let best = places(&|summary| own(summary) && summary.on_skip_frontier);
            mark(plane, &best, index, color.filled())?;
        }
        settings(plane, &judged)
    })
}

/// True if a policy's label is of `family`.
fn is_of_family(label: &str, family: &str) -> bool {
    let (own, _) = split_label(label);
    own == family
}

/// Returns the 95 % interval of a policy's AP@50.
fn interval(summary: &PolicySummary) -> Option<[f64; 2]> {
    let ap50 = summary.ap50?;
    let change = summary.ap50_change?;
    let ends = change.interval?;
    Some(ends.map(|end| ap50 - change.mean + end))
}

/// Returns the vertical range: all points, and as much of the intervals as leaves the points distinguishable. The
/// interval over two clips can be wider than the whole range of accuracies.
fn vertical_range(judged: &[JudgedPolicy<'_>]) -> Range<f64> {
    let points = range(judged.iter().map(|policy| policy.ap50), 0.0);
    let room = (points.end - points.start).max(0.02);
    let ends = judged.iter().flat_map(|policy| {
        let [low, high] = interval(policy.summary).unwrap_or([policy.ap50; 2]);
        [low.max(points.start - room), high.min(points.end + room)]
    });
    let all = range(ends, 0.08);
    all.start.max(0.0)..all.end.min(1.0 + 0.04 * (1.0 - points.start))
}

/// Writes each setting beside its marker, where there is still room.
fn settings(plane: &mut Plane<'_>, judged: &[JudgedPolicy<'_>]) -> Result<(), PlotError> {
    let style = (FONT, 13).into_font().color(&SOFT_INK);
    let mut taken: Vec<(i32, i32)> =
        judged.iter().map(|policy| plane.backend_coord(&policy.place())).collect();
    for policy in judged {
        let (_, setting) = split_label(&policy.summary.policy);
        let (x, y) = plane.backend_coord(&policy.place());
        let width = 6 * setting.len() as i32;
        let middle = |(right, down): (i32, i32)| (x + right + width / 2, y + down + 6);
        let is_free = |offset: &(i32, i32)| {
            let (middle_x, middle_y) = middle(*offset);
            let apart = |(other_x, other_y): &(i32, i32)| {
                (other_x - middle_x).abs() > width / 2 + 6 || (other_y - middle_y).abs() > 10
            };
            taken.iter().all(apart)
        };
        let offsets = [(8, -17), (8, 6), (-8 - width, -17), (-8 - width, 6)];
        if let Some(offset) = offsets.into_iter().find(is_free) {
            taken.push(middle(offset));
            let text = EmptyElement::at(policy.place()) + Text::new(setting, offset, style.clone());
            plane.draw_series([text])?;
        }
    }
    Ok(())
}

/// Draws a bar per policy with the shares of its frame states.
fn states(summaries: &[PolicySummary]) -> Result<String, PlotError> {
    let row = |summary: &PolicySummary| {
        let label = short_label(&summary.policy).to_owned();
        (label, summary.states.to_vec())
    };
    let rows: Vec<_> = summaries.iter().map(row).collect();
    stacked(&rows, &state_parts(), percent_label)
}

/// Returns skip rate (percent) and change of AP@50 (percentage points) of every clip with ground truth, by family.
fn changes(results: &[ClipResult], families: &[&str]) -> Vec<Vec<(f64, f64)>> {
    let ap50 = |result: &ClipResult| result.accuracy.map(|accuracy| accuracy.ap50);
    let (of_baseline, others): (Vec<_>, Vec<_>) =
        results.iter().partition(|result| result.policy == BASELINE);
    let baselines: HashMap<&str, f64> = of_baseline
        .into_iter()
        .filter_map(|result| Some((result.clip.as_str(), ap50(result)?)))
        .collect();
    let change = |result: &&ClipResult| {
        let before = baselines.get(result.clip.as_str())?;
        Some((result.skip_rate() * 100.0, (ap50(result)? - before) * 100.0))
    };
    let of = |family: &&str| {
        let own = others.iter().filter(|result| is_of_family(&result.policy, family));
        own.filter_map(change).collect()
    };
    families.iter().map(of).collect()
}

/// Draws the change of AP@50 against the skip rate, with a marker per clip.
fn clips(changes: &[Vec<(f64, f64)>], families: &[&str]) -> Result<String, PlotError> {
    let all = || changes.iter().flatten();
    let across = range(all().map(|(percent_skipped, _)| *percent_skipped), 0.05);
    let up = range(all().map(|(_, points)| *points).chain([0.0]), 0.06);
    let change = Axis {
        name: "Change of AP@50, percentage points",
        range: up,
        label: signed_label,
    };
    let is_shown = |index: &usize| !changes[*index].is_empty();
    let shown: Vec<usize> = (0..families.len()).filter(is_shown).collect();
    let names: Vec<_> = shown.iter().map(|index| (*index, families[*index])).collect();
    chart(Axis::skip_rate(across.clone()), change, &names, |plane| {
        let ends = [(across.start, 0.0), (across.end, 0.0)];
        plane.draw_series(LineSeries::new(ends, SOFT_INK))?;
        for index in shown {
            let color = color_of(index, families[index]).mix(0.6);
            mark(plane, &changes[index], index, color.filled())?;
        }
        Ok(())
    })
}
