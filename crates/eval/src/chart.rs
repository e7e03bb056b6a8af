//! Draws charts as SVG: a plane with series, and stacked bars.

use crate::spec::{BASELINE, split_label};
use albireo_core::policy::FrameState;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::ops::Range;

/// A figure of the report.
pub(crate) struct Plot {
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
pub(crate) type PlotError = DrawingAreaErrorKind<std::io::Error>;

/// Width and height of a chart, in CSS pixels.
pub(crate) const SIZE: (u32, u32) = (720, 430);

pub(crate) const FONT: &str = "sans-serif";
pub(crate) const INK: RGBColor = RGBColor(0x22, 0x28, 0x31);
pub(crate) const SOFT_INK: RGBColor = RGBColor(0x5c, 0x65, 0x70);
pub(crate) const GRID: RGBColor = RGBColor(0xe8, 0xeb, 0xef);
/// The Pareto frontier.
pub(crate) const BAND: RGBColor = RGBColor(0xcd, 0xd2, 0xd9);

/// Colours that colour-blind people can distinguish (Okabe and Ito, 2008), without yellow, which is faint on white;
/// then a violet, a brown and three of P. Tol's "muted" colours.
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
pub(crate) const fn state_colors(state: FrameState) -> (RGBColor, RGBColor) {
    match state {
        FrameState::E => (RGBColor(0x8f, 0xbc, 0xdb), INK),
        FrameState::P => (RGBColor(0x26, 0x70, 0xb0), WHITE),
        FrameState::EI => (RGBColor(0xfd, 0xd0, 0x8b), INK),
        FrameState::I => (RGBColor(0xf1, 0x8c, 0x46), INK),
        FrameState::AI => (RGBColor(0xbe, 0x3e, 0x2c), WHITE),
    }
}

pub(crate) type Plane<'a> =
    ChartContext<'a, SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// The text of a value with this many decimals.
pub(crate) type AxisLabel = fn(f64, usize) -> String;

/// The label of a value without a sign of its own.
pub(crate) fn plain_label(value: f64, decimals: usize) -> String {
    format!("{value:.decimals$}")
}

/// The label of a change.
pub(crate) fn signed_label(value: f64, decimals: usize) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    format!("{value:+.decimals$}").replace('-', "−")
}

/// The most labels of an axis.
const MOST_LABELS: usize = 11;

/// The decimals at which the labels of an axis differ: plotters draws at most `most` of them, 1, 2 or 5 times a power
/// of ten apart.
fn decimals(range: &Range<f64>, most: usize) -> usize {
    let least = (range.end - range.start) / most as f64;
    let unit = 10_f64.powf(least.log10().floor());
    let steps = [unit, 2.0 * unit, 5.0 * unit];
    let step = steps.into_iter().find(|step| *step >= least).unwrap_or(10.0 * unit);
    // A power of ten may be a little below itself.
    let power = (step * 1.000_001).log10().floor();
    let decimals = -power;
    decimals.clamp(0.0, 9.0) as usize
}

/// An axis of a chart: its name, its range, and the text of a value.
pub(crate) struct Axis<'a> {
    pub name: &'a str,
    pub range: Range<f64>,
    pub label: AxisLabel,
}

impl Axis<'_> {
    /// The axis of the skip rate in percent.
    pub(crate) fn skip_rate(range: Range<f64>) -> Self {
        Self {
            name: "Frames without the detector, %",
            range,
            label: plain_label,
        }
    }
}

/// The height of a line of the legend, pixels.
const LEGEND_LINE: i32 = 20;

/// The width of a marker and the gaps beside it, pixels, and where in it the name begins.
const LEGEND_MARKER: i32 = 26;
const LEGEND_NAME: i32 = 10;

/// The width of a letter of the legend, pixels.
const LEGEND_LETTER: i32 = 8;

/// The lines of a legend above a chart, where no data are.
struct Legend {
    /// The places of the markers.
    places: Vec<(i32, i32)>,
    /// The height of all lines.
    height: i32,
}

impl Legend {
    fn new(names: &[(usize, &str)]) -> Self {
        let left = 24;
        let (chart_width, _) = SIZE;
        let right = chart_width as i32 - 12;
        let mut x = left;
        let mut y = 12 + LEGEND_LINE / 2;
        let mut places = Vec::new();
        for (_, name) in names {
            let width = LEGEND_MARKER + LEGEND_LETTER * name.chars().count() as i32;
            if x + width > right && x > left {
                x = left;
                y += LEGEND_LINE;
            }
            places.push((x, y));
            x += width;
        }
        let height = if names.is_empty() {
            0
        } else {
            y + LEGEND_LINE / 2
        };
        Self { places, height }
    }
}

/// Draws a chart with a legend of the families at `names`, by index, above it; `draw` adds the series.
pub(crate) fn chart(
    x: Axis<'_>,
    y: Axis<'_>,
    names: &[(usize, &str)],
    draw: impl FnOnce(&mut Plane<'_>) -> Result<(), PlotError>,
) -> Result<String, PlotError> {
    let legend = Legend::new(names);
    let (width, height) = SIZE;
    let size = (width, height + legend.height as u32);
    let x_decimals = decimals(&x.range, MOST_LABELS);
    let y_decimals = decimals(&y.range, MOST_LABELS);
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE)?;
        let mut plane = ChartBuilder::on(&root)
            .margin(12)
            .margin_top(12 + legend.height)
            .x_label_area_size(42)
            .y_label_area_size(56)
            .build_cartesian_2d(x.range, y.range)?;
        plane
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID)
            .axis_style(SOFT_INK)
            .label_style((FONT, 14).into_font().color(&SOFT_INK))
            .axis_desc_style((FONT, 15).into_font().color(&INK))
            .x_desc(x.name)
            .x_label_formatter(&|value| (x.label)(*value, x_decimals))
            .x_labels(MOST_LABELS)
            .y_desc(y.name)
            .y_label_formatter(&|value| (y.label)(*value, y_decimals))
            .y_labels(MOST_LABELS)
            .draw()?;
        draw(&mut plane)?;
        let text = (FONT, 14).into_font().color(&INK).pos(Pos::new(HPos::Left, VPos::Center));
        for ((index, name), (x, y)) in names.iter().zip(legend.places) {
            root.draw(&marker((x, y), *index, color_of(*index, name).filled()))?;
            root.draw(&Text::new(
                (*name).to_owned(),
                (x + LEGEND_NAME, y),
                text.clone(),
            ))?;
        }
        root.present()?;
    }
    Ok(svg)
}

/// Returns the families of `labels` in order, without repetition.
pub(crate) fn families<'a>(labels: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
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
pub(crate) fn color_of(index: usize, family: &str) -> RGBColor {
    if family == BASELINE {
        INK
    } else {
        PALETTE[index % PALETTE.len()]
    }
}

/// The marker of the `index`th family. Families differ in shape and colour.
fn marker<'a>(
    (x, y): (i32, i32),
    index: usize,
    style: ShapeStyle,
) -> DynElement<'a, SVGBackend<'a>, (i32, i32)> {
    match index % 3 {
        0 => Circle::new((x, y), 4, style).into_dyn(),
        1 => TriangleMarker::new((x, y), 5, style).into_dyn(),
        _ => Rectangle::new([(x - 4, y - 4), (x + 4, y + 4)], style).into_dyn(),
    }
}

/// Draws the markers of the `index`th family.
pub(crate) fn mark(
    plane: &mut Plane<'_>,
    points: &[(f64, f64)],
    index: usize,
    style: ShapeStyle,
) -> Result<(), PlotError> {
    let points = points.iter().copied();
    let drawn = match index % 3 {
        0 => plane.draw_series(points.map(|at| Circle::new(at, 4, style))),
        1 => plane.draw_series(points.map(|at| TriangleMarker::new(at, 5, style))),
        _ => plane.draw_series(
            points.map(|at| EmptyElement::at(at) + Rectangle::new([(-4, -4), (4, 4)], style)),
        ),
    };
    drawn.map(drop)
}

/// A part of stacked bars.
pub(crate) struct BarPart<'a> {
    pub name: &'a str,
    pub fill: RGBColor,
    /// The colour of text on it.
    pub ink: RGBColor,
}

/// The parts of bars of frame states.
pub(crate) fn state_parts() -> [BarPart<'static>; 5] {
    FrameState::ALL.map(|state| {
        let (fill, ink) = state_colors(state);
        BarPart {
            name: state.as_str(),
            fill,
            ink,
        }
    })
}

/// The most labels below bars.
const BAR_LABELS: usize = 6;

/// The label of a share in percent.
pub(crate) fn percent_label(share: f64, decimals: usize) -> String {
    // Of a hundred.
    let decimals = decimals.saturating_sub(2);
    format!("{:.decimals$} %", share * 100.0)
}

/// Draws a bar per row, stacked of `parts`. `label` formats a value; a part too short for its text has none.
pub(crate) fn stacked(
    rows: &[(String, Vec<f64>)],
    parts: &[BarPart<'_>],
    label: AxisLabel,
) -> Result<String, PlotError> {
    let count = rows.len();
    let (width, _) = SIZE;
    let size = (width, 70 + 26 * count.clamp(1, 60) as u32);
    let widest = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    let mut longest = 0.0_f64;
    for (_, values) in rows {
        longest = longest.max(values.iter().sum());
    }
    if longest <= 0.0 {
        // Bars without a length, too, need an axis that has one.
        longest = 1.0;
    }
    let decimals = decimals(&(0.0..longest), BAR_LABELS);
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE)?;
        let mut plane = ChartBuilder::on(&root)
            .margin(12)
            .margin_top(32)
            .margin_right(28)
            .x_label_area_size(24)
            .y_label_area_size(20 + 7 * widest as u32)
            .build_cartesian_2d(0.0..longest, 0.0..count as f64)?;
        plane
            .configure_mesh()
            .disable_y_mesh()
            .disable_y_axis()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID)
            .axis_style(SOFT_INK)
            .label_style((FONT, 14).into_font().color(&SOFT_INK))
            .x_labels(BAR_LABELS)
            .x_label_formatter(&|value| label(*value, decimals))
            .draw()?;
        let text = |size: i32, ink: RGBColor, h: HPos| {
            (FONT, size).into_font().color(&ink).pos(Pos::new(h, VPos::Center))
        };
        for (row, (name, values)) in rows.iter().enumerate() {
            let middle = (count - row) as f64 - 0.5;
            let (x, y) = plane.backend_coord(&(0.0, middle));
            root.draw(&Text::new(
                name.clone(),
                (x - 8, y),
                text(14, INK, HPos::Right),
            ))?;
            let mut from = 0.0;
            for (BarPart { fill, ink, .. }, value) in parts.iter().zip(values) {
                let corners = [(from, middle - 0.36), (from + value, middle + 0.36)];
                plane.draw_series([Rectangle::new(corners, fill.filled())])?;
                if *value >= 0.045 * longest {
                    let place = (from + value / 2.0, middle);
                    let words = label(*value, decimals).trim_end_matches(" %").to_owned();
                    plane.draw_series([Text::new(words, place, text(12, *ink, HPos::Center))])?;
                }
                from += value;
            }
        }
        let (mut x, _) = plane.backend_coord(&(0.0, 0.0));
        for BarPart { name, fill, .. } in parts {
            root.draw(&Rectangle::new([(x, 12), (x + 10, 22)], fill.filled()))?;
            root.draw(&Text::new(
                (*name).to_owned(),
                (x + 15, 17),
                text(14, INK, HPos::Left),
            ))?;
            x += 60_i32.max(30 + 8 * name.chars().count() as i32);
        }
        root.present()?;
    }
    Ok(svg)
}

/// Returns a range around `values`, extended by this share on both sides; it is never empty.
pub(crate) fn range(values: impl Iterator<Item = f64>, margin: f64) -> Range<f64> {
    let mut low = f64::INFINITY;
    let mut high = f64::NEG_INFINITY;
    for value in values {
        low = low.min(value);
        high = high.max(value);
    }
    if !(low.is_finite() && high.is_finite()) {
        return 0.0..1.0;
    }
    let span = (high - low).max(high.abs() * 1e-3).max(1e-6);
    low - margin * span..high + margin * span
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn a_legend_lies_above_the_chart_and_in_the_picture_whatever_the_names() {
        let long = "x".repeat(40);
        let names: Vec<_> = (0..12).map(|index| (index, long.as_str())).collect();
        let Legend { places, height } = Legend::new(&names);
        assert_eq!(places.len(), 12);
        let width = LEGEND_LETTER * 40;
        for ((x, y), (next_x, next_y)) in places.iter().zip(places.iter().skip(1)) {
            let is_left = x + LEGEND_MARKER + width <= *next_x;
            assert!(y < next_y || is_left, "{places:?}");
        }
        let (chart_width, _) = SIZE;
        for (x, y) in places {
            assert!(x + LEGEND_NAME + width < chart_width as i32, "{x}");
            assert!(y + LEGEND_LINE / 2 <= height, "{y}");
        }
    }

    #[test]
    fn a_legend_without_names_takes_no_room() {
        let empty = Legend::new(&[]);
        assert!(empty.places.is_empty());
        assert_eq!(empty.height, 0);
    }

    #[test]
    fn no_two_labels_of_an_axis_are_the_same_however_short_the_range() {
        for end in [1e-3, 0.04, 0.09, 0.3, 0.5, 1.0, 3.3, 7.0, 12.0, 50.0, 1e5] {
            let axis = || Axis {
                name: "",
                range: 0.0..end,
                label: plain_label,
            };
            let svg = chart(axis(), axis(), &[], |_| Ok(())).unwrap();
            let is_number = |line: &&str| line.trim().parse::<f64>().is_ok();
            let labels: Vec<&str> = svg.lines().filter(is_number).collect();
            let different: HashSet<&str> = labels.iter().copied().collect();
            // Both axes have each.
            assert!(different.len() > 3, "{end}: {labels:?}");
            assert_eq!(labels.len(), 2 * different.len(), "{end}: {labels:?}");
        }
    }

    #[test]
    fn labels_that_are_ten_apart_have_no_decimals() {
        assert_eq!(decimals(&(0.0..100.0), MOST_LABELS), 0);
    }

    #[test]
    fn a_range_is_never_empty() {
        assert_eq!(range([].into_iter(), 0.1), 0.0..1.0);
        let around = range([0.5].into_iter(), 0.1);
        assert!(around.start < 0.5 && 0.5 < around.end, "{around:?}");
    }
}
