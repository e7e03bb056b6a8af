//! Draws the figures of a report as SVG.

use crate::result::ClipResult;
use crate::spec::{BASELINE, short_label, split_label};
use crate::summary::PolicySummary;
use albireo_core::policy::FrameState;
use plotters::chart::SeriesAnno;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::collections::HashMap;
use std::ops::Range;

/// A figure of the report.
pub(super) struct Plot {
    /// The name of its file, without extension.
    pub name: &'static str,
    /// The heading: what the figure shows.
    pub title: &'static str,
    /// The caption: how to read the figure.
    pub caption: &'static str,
    /// The SVG document.
    pub svg: String,
}

/// The error of drawing.
pub(super) type PlotError = DrawingAreaErrorKind<std::io::Error>;

/// Width and height of a chart, in CSS pixels.
const SIZE: (u32, u32) = (720, 430);

const FONT: &str = "sans-serif";
const INK: RGBColor = RGBColor(0x22, 0x28, 0x31);
const SOFT_INK: RGBColor = RGBColor(0x5c, 0x65, 0x70);
const GRID: RGBColor = RGBColor(0xe8, 0xeb, 0xef);
/// The Pareto frontier.
const BAND: RGBColor = RGBColor(0xcd, 0xd2, 0xd9);

/// Colours that colour-blind people can distinguish (Okabe and Ito, 2008), without yellow, which is faint on white; then a violet,
/// a brown and three of P. Tol's "muted" colours.
const PALETTE: [RGBColor; 11] = [
    RGBColor(0x00, 0x72, 0xb2),
    RGBColor(0xd5, 0x5e, 0x00),
    RGBColor(0x00, 0x9e, 0x73),
    RGBColor(0xcc, 0x79, 0xa7),
    RGBColor(0xe6, 0x9f, 0x00),
    RGBColor(0x56, 0xb4, 0xe9),
    RGBColor(0x78, 0x5e, 0xf0),
    RGBColor(0x6b, 0x42, 0x26),
    RGBColor(0x88, 0x22, 0x55),
    RGBColor(0x99, 0x99, 0x33),
    RGBColor(0x11, 0x77, 0x33),
];

/// Fill and text colour of a frame state: cool if the detector is skipped, warm if it runs.
const fn state_colors(state: FrameState) -> (RGBColor, RGBColor) {
    match state {
        FrameState::E => (RGBColor(0x8f, 0xbc, 0xdb), INK),
        FrameState::P => (RGBColor(0x26, 0x70, 0xb0), WHITE),
        FrameState::EI => (RGBColor(0xfd, 0xd0, 0x8b), INK),
        FrameState::I => (RGBColor(0xf1, 0x8c, 0x46), INK),
        FrameState::AI => (RGBColor(0xbe, 0x3e, 0x2c), WHITE),
    }
}

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
    if changes.iter().any(|changes| !changes.is_empty()) {
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

type Plane<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Draws a chart with the skip rate in percent on the x axis; `draw` adds the series.
fn chart(
    [x, y]: [Range<f64>; 2],
    y_name: &str,
    y_label: &dyn Fn(&f64) -> String,
    draw: impl FnOnce(&mut Plane<'_>) -> Result<(), PlotError>,
) -> Result<String, PlotError> {
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        let mut plane = ChartBuilder::on(&root)
            .margin(12)
            .x_label_area_size(42)
            .y_label_area_size(56)
            .build_cartesian_2d(x, y)?;
        plane
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID)
            .axis_style(SOFT_INK)
            .label_style((FONT, 14).into_font().color(&SOFT_INK))
            .axis_desc_style((FONT, 15).into_font().color(&INK))
            .x_desc("Frames without the detector, %")
            .x_label_formatter(&|percent| format!("{percent:.0}"))
            .y_desc(y_name)
            .y_label_formatter(y_label)
            .draw()?;
        draw(&mut plane)?;
        plane
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerLeft)
            .label_font((FONT, 14).into_font().color(&INK))
            .background_style(WHITE.mix(0.8))
            .border_style(GRID)
            .draw()?;
        root.present()?;
    }
    Ok(svg)
}

/// Returns the families of `labels` in order, without repetition.
fn families<'a>(labels: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut families = Vec::new();
    for label in labels {
        let (family, _) = split_label(label);
        if !families.contains(&family) {
            families.push(family);
        }
    }
    families
}

/// Returns the colour of the `index`th family; the baseline is black.
fn color_of(index: usize, family: &str) -> RGBColor {
    if family == BASELINE {
        INK
    } else {
        PALETTE[index % PALETTE.len()]
    }
}

/// Draws the markers of the `index`th family. Families differ in shape and colour.
fn mark<'p, 'a>(
    plane: &'p mut Plane<'a>,
    points: &[(f64, f64)],
    index: usize,
    style: ShapeStyle,
) -> Result<&'p mut SeriesAnno<'a, SVGBackend<'a>>, PlotError> {
    let points = points.iter().copied();
    match index % 3 {
        0 => plane.draw_series(points.map(|at| Circle::new(at, 4, style))),
        1 => plane.draw_series(points.map(|at| TriangleMarker::new(at, 5, style))),
        _ => plane.draw_series(
            points.map(|at| EmptyElement::at(at) + Rectangle::new([(-4, -4), (4, 4)], style)),
        ),
    }
}

/// Names the `index`th family in the legend, with its marker.
fn label<'a>(series: &mut SeriesAnno<'a, SVGBackend<'a>>, index: usize, family: &str) {
    let style = color_of(index, family).filled();
    series.label(family).legend(move |(x, y)| {
        let at = (x + 10, y);
        match index % 3 {
            0 => Circle::new(at, 4, style).into_dyn(),
            1 => TriangleMarker::new(at, 5, style).into_dyn(),
            _ => Rectangle::new([(x + 6, y - 4), (x + 14, y + 4)], style).into_dyn(),
        }
    });
}

/// Draws accuracy against skip rate: a marker per policy, a line per family, and the Pareto frontier.
fn tradeoff(summaries: &[PolicySummary], families: &[&str]) -> Result<String, PlotError> {
    let judged: Vec<(&PolicySummary, (f64, f64))> = summaries
        .iter()
        .filter_map(|summary| Some((summary, (summary.skip_rate * 100.0, summary.ap50?))))
        .collect();
    let places = |wanted: &dyn Fn(&PolicySummary) -> bool| {
        let wanted = judged.iter().filter(|(summary, _)| wanted(summary));
        let mut places: Vec<(f64, f64)> = wanted.map(|(_, at)| *at).collect();
        places.sort_by(|a, b| a.0.total_cmp(&b.0));
        places
    };
    let across = range(judged.iter().map(|(_, at)| at.0), 0.09);
    let up = vertical_range(&judged);
    let (low, high) = (up.start, up.end);
    chart(
        [across.clone(), up],
        "AP@50",
        &|ap50| format!("{ap50:.3}"),
        |plane| {
            let frontier = places(&|summary| summary.on_skip_frontier);
            plane.draw_series(LineSeries::new(frontier, BAND.stroke_width(5)))?;
            if let Some((_, ap50)) = places(&|summary| summary.policy == BASELINE).first() {
                let ends = [(across.start, *ap50), (across.end, *ap50)];
                plane.draw_series(LineSeries::new(ends, SOFT_INK))?;
            }
            let whiskers = judged.iter().filter_map(|(summary, (x, _))| {
                let (from, to) = interval(summary)?;
                let ends = [from, to].map(|end| (*x, end.clamp(low, high)));
                Some(PathElement::new(ends.to_vec(), SOFT_INK.mix(0.5)))
            });
            plane.draw_series(whiskers)?;
            for (index, family) in families.iter().enumerate() {
                let color = color_of(index, family);
                let own = |summary: &PolicySummary| split_label(&summary.policy).0 == *family;
                plane.draw_series(LineSeries::new(places(&own), color))?;
                mark(plane, &places(&own), index, WHITE.filled())?;
                let series = mark(plane, &places(&own), index, color.stroke_width(2))?;
                label(series, index, family);
                let best = places(&|summary| own(summary) && summary.on_skip_frontier);
                mark(plane, &best, index, color.filled())?;
            }
            settings(plane, &judged)
        },
    )
}

/// Returns the 95 % interval of a policy's AP@50.
fn interval(summary: &PolicySummary) -> Option<(f64, f64)> {
    let ap50 = summary.ap50?;
    let change = summary.ap50_change?;
    let [from, to] = change.interval?;
    Some((ap50 - change.mean + from, ap50 - change.mean + to))
}

/// Returns the vertical range: all points, and as much of the intervals as leaves the points distinguishable. The
/// interval over two clips can be wider than the whole range of accuracies.
fn vertical_range(judged: &[(&PolicySummary, (f64, f64))]) -> Range<f64> {
    let points = range(judged.iter().map(|(_, at)| at.1), 0.0);
    let room = (points.end - points.start).max(0.02);
    let ends = judged.iter().flat_map(|(summary, (_, ap50))| {
        let (low, high) = interval(summary).unwrap_or((*ap50, *ap50));
        [low.max(points.start - room), high.min(points.end + room)]
    });
    let all = range(ends, 0.08);
    all.start.max(0.0)..all.end.min(1.0 + 0.04 * (1.0 - points.start))
}

/// Writes each setting beside its marker, where there is still room.
fn settings(
    plane: &mut Plane<'_>,
    judged: &[(&PolicySummary, (f64, f64))],
) -> Result<(), PlotError> {
    let style = (FONT, 13).into_font().color(&SOFT_INK);
    let mut taken: Vec<(i32, i32)> = judged.iter().map(|(_, at)| plane.backend_coord(at)).collect();
    for (summary, at) in judged {
        let (_, setting) = split_label(&summary.policy);
        let (x, y) = plane.backend_coord(at);
        let width = 6 * setting.len() as i32;
        let is_free = |offset: &(i32, i32)| {
            let middle = (x + offset.0 + width / 2, y + offset.1 + 6);
            let apart = |(other_x, other_y): &(i32, i32)| {
                (other_x - middle.0).abs() > width / 2 + 6 || (other_y - middle.1).abs() > 10
            };
            taken.iter().all(apart)
        };
        let offsets = [(8, -17), (8, 6), (-8 - width, -17), (-8 - width, 6)];
        if let Some(offset) = offsets.into_iter().find(is_free) {
            taken.push((x + offset.0 + width / 2, y + offset.1 + 6));
            let text = EmptyElement::at(*at) + Text::new(setting, offset, style.clone());
            plane.draw_series([text])?;
        }
    }
    Ok(())
}

/// Draws a bar per policy with the shares of its frame states.
fn states(summaries: &[PolicySummary]) -> Result<String, PlotError> {
    let rows = summaries.len();
    let size = (SIZE.0, 70 + 26 * rows.clamp(1, 60) as u32);
    let widest = summaries.iter().map(|summary| short_label(&summary.policy).len()).max();
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE)?;
        let mut plane = ChartBuilder::on(&root)
            .margin(12)
            .margin_top(32)
            .margin_right(28)
            .x_label_area_size(24)
            .y_label_area_size(20 + 7 * widest.unwrap_or(0) as u32)
            .build_cartesian_2d(0.0..1.0, 0.0..rows as f64)?;
        plane
            .configure_mesh()
            .disable_y_mesh()
            .disable_y_axis()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID)
            .axis_style(SOFT_INK)
            .label_style((FONT, 14).into_font().color(&SOFT_INK))
            .x_labels(6)
            .x_label_formatter(&|share| format!("{:.0} %", share * 100.0))
            .draw()?;
        let text = |size: i32, ink: RGBColor, h: HPos| {
            let style = (FONT, size).into_font().color(&ink);
            style.pos(Pos::new(h, VPos::Center))
        };
        for (row, summary) in summaries.iter().enumerate() {
            let middle = (rows - row) as f64 - 0.5;
            let (x, y) = plane.backend_coord(&(0.0, middle));
            let name = short_label(&summary.policy).to_owned();
            root.draw(&Text::new(name, (x - 8, y), text(14, INK, HPos::Right)))?;
            let mut from = 0.0;
            for (state, share) in FrameState::ALL.into_iter().zip(summary.states) {
                let (fill, ink) = state_colors(state);
                let corners = [(from, middle - 0.36), (from + share, middle + 0.36)];
                plane.draw_series([Rectangle::new(corners, fill.filled())])?;
                if share >= 0.045 {
                    let place = (from + share / 2.0, middle);
                    let percent = format!("{:.0}", share * 100.0);
                    plane.draw_series([Text::new(percent, place, text(12, ink, HPos::Center))])?;
                }
                from += share;
            }
        }
        let left = plane.backend_coord(&(0.0, 0.0)).0;
        for (at, state) in (0..).zip(FrameState::ALL) {
            let x = left + 60 * at;
            root.draw(&Rectangle::new(
                [(x, 12), (x + 10, 22)],
                state_colors(state).0.filled(),
            ))?;
            root.draw(&Text::new(
                state.as_str(),
                (x + 15, 17),
                text(14, INK, HPos::Left),
            ))?;
        }
        root.present()?;
    }
    Ok(svg)
}

/// Returns skip rate (percent) and change of AP@50 (percentage points) of every clip with ground truth, by family.
fn changes(results: &[ClipResult], families: &[&str]) -> Vec<Vec<(f64, f64)>> {
    let ap50 = |result: &ClipResult| result.accuracy.map(|accuracy| accuracy.ap50);
    let (baselines, others): (Vec<_>, Vec<_>) =
        results.iter().partition(|result| result.policy == BASELINE);
    let baselines: HashMap<&str, f64> = baselines
        .into_iter()
        .filter_map(|result| Some((result.clip.as_str(), ap50(result)?)))
        .collect();
    let change = |result: &&ClipResult| {
        let before = baselines.get(result.clip.as_str())?;
        Some((result.skip_rate() * 100.0, (ap50(result)? - before) * 100.0))
    };
    let of = |family: &&str| {
        let own = others.iter().filter(|result| split_label(&result.policy).0 == *family);
        own.filter_map(change).collect()
    };
    families.iter().map(of).collect()
}

/// Draws the change of AP@50 against the skip rate, with a marker per clip.
fn clips(changes: &[Vec<(f64, f64)>], families: &[&str]) -> Result<String, PlotError> {
    let all = || changes.iter().flatten();
    let across = range(all().map(|change| change.0), 0.05);
    let up = range(all().map(|change| change.1).chain([0.0]), 0.06);
    let signed = |value: &f64| {
        if *value == 0.0 {
            "0".to_owned()
        } else {
            format!("{value:+.0}").replace('-', "−")
        }
    };
    let name = "Change of AP@50, percentage points";
    chart([across.clone(), up], name, &signed, |plane| {
        let ends = [(across.start, 0.0), (across.end, 0.0)];
        plane.draw_series(LineSeries::new(ends, SOFT_INK))?;
        let of_families = families.iter().zip(changes).enumerate();
        for (index, (family, changes)) in of_families.filter(|(_, (_, some))| !some.is_empty()) {
            let color = color_of(index, family).mix(0.6);
            let series = mark(plane, changes, index, color.filled())?;
            label(series, index, family);
        }
        Ok(())
    })
}

/// Returns a range around `values`, extended by this share on both sides; it is never empty.
fn range(values: impl Iterator<Item = f64>, margin: f64) -> Range<f64> {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    if !(low.is_finite() && high.is_finite()) {
        return 0.0..1.0;
    }
    let span = (high - low).max(high.abs() * 1e-3).max(1e-6);
    low - margin * span..high + margin * span
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_is_never_empty() {
        assert_eq!(range([].into_iter(), 0.1), 0.0..1.0);
        let range = range([0.5].into_iter(), 0.1);
        assert!(range.start < 0.5 && 0.5 < range.end);
    }
}
