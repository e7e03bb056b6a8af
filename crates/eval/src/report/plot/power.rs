//! Power over one clip under several policies, with the states of its frames below.

use super::DrawResult;
use super::states;
use super::style::{GRID, INK, SOFT_INK, Scale, anchored, family_color, state_color};
use crate::result::Provenance;
use crate::spec::split_label;
use albireo_core::policy::FrameState;
use plotters::coord::Shift;
use plotters::prelude::{ChartBuilder, DrawingArea, DrawingBackend, LineSeries, Rectangle, Text};
use plotters::style::Color;
use plotters::style::text_anchor::HPos;
use serde::Serialize;

/// A frame in the ribbon below a power trace.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RibbonFrame {
    /// When its work ends, seconds from the start of the clip.
    pub end_s: f64,
    /// Its state.
    pub state: FrameState,
}

/// Power over one clip under one policy.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PowerTrace {
    /// Name of the clip.
    pub clip: String,
    /// Label of the policy.
    pub policy: String,
    /// Where the figures come from.
    pub provenance: Provenance,
    /// End of each interval in seconds and the mean watts in it.
    pub watts: Vec<(f64, f64)>,
    /// The frames.
    pub frames: Vec<RibbonFrame>,
}

/// Number of seconds over which power is averaged, so that single frames do not hide the course.
const WINDOW_S: f64 = 1.0;

pub(super) fn draw<B: DrawingBackend>(
    traces: &[PowerTrace],
    area: &DrawingArea<B, Shift>,
    scale: Scale,
) -> DrawResult
where
    B::ErrorType: 'static,
{
    let (width, height) = area.dim_in_pixel();
    let ribbons = scale.length(16.0 * traces.len() as f64 + 8.0);
    let (upper, lower) = area.split_vertically(height as i32 - ribbons - scale.length(30.0));
    let end = traces
        .iter()
        .filter_map(|trace| Some(trace.watts.last()?.0))
        .fold(0.0, f64::max)
        .max(1e-3);
    let smooth: Vec<Vec<(f64, f64)>> = traces.iter().map(|trace| windows(&trace.watts)).collect();
    let highest = smooth
        .iter()
        .flatten()
        .map(|point| point.1)
        .fold(1.0, f64::max);
    let left = scale.size(62.0);
    let mut chart = ChartBuilder::on(&upper)
        .margin_top(scale.size(34.0))
        .margin_right(scale.size(18.0))
        .margin_left(scale.size(6.0))
        .x_label_area_size(scale.size(40.0))
        .y_label_area_size(left - scale.size(6.0))
        .build_cartesian_2d(0.0..end, 0.0..highest * 1.1)?;
    chart
        .configure_mesh()
        .x_desc("Time, s")
        .y_desc("Power, W")
        .axis_desc_style(scale.text(12.0, INK))
        .label_style(scale.text(11.0, SOFT_INK))
        .axis_style(scale.line(0.8, SOFT_INK))
        .bold_line_style(scale.line(0.6, GRID))
        .light_line_style(plotters::style::TRANSPARENT)
        .x_label_formatter(&|value| format!("{value:.0}"))
        .y_label_formatter(&|value| format!("{value:.0}"))
        .draw()?;
    let color = |index: usize| match index {
        0 => SOFT_INK,
        index => family_color(index - 1),
    };
    let mut x = left as i32;
    for (index, (trace, smooth)) in traces.iter().zip(&smooth).enumerate() {
        let color = color(index);
        chart.draw_series(LineSeries::new(
            smooth.iter().copied(),
            scale.line(1.8, color),
        ))?;
        let style = anchored(scale.bold(11.5, color), HPos::Left);
        let label = trace.policy.split("-erd-").next().unwrap_or(&trace.policy);
        let (wide, _) = area.estimate_text_size(label, &style)?;
        area.draw(&Text::new(label.to_owned(), (x, scale.length(16.0)), style))?;
        x += wide as i32 + scale.length(18.0);
    }
    let right = width as i32 - scale.length(18.0);
    let across = |time: f64| left as i32 + (time / end * f64::from(right - left as i32)) as i32;
    for (row, trace) in traces.iter().enumerate() {
        let top = scale.length(16.0 * row as f64);
        let middle = top + scale.length(6.0);
        let style = anchored(scale.text(10.0, color(row)), HPos::Right);
        let place = (left as i32 - scale.length(6.0), middle);
        lower.draw(&Text::new(short_name(traces, trace), place, style))?;
        let mut from = 0.0;
        for frame in &trace.frames {
            let corners = [
                (across(from), top),
                (across(frame.end_s), top + scale.length(12.0)),
            ];
            from = frame.end_s;
            let fill = state_color(frame.state).filled();
            lower.draw(&Rectangle::new(corners, fill))?;
        }
    }
    let (_, foot) = lower.split_vertically(ribbons - scale.length(8.0));
    states::legend(&foot, scale, left as i32)
}

/// The policy of `trace`, or its setting where several have the same policy.
fn short_name(traces: &[PowerTrace], trace: &PowerTrace) -> String {
    let (family, setting) = split_label(&trace.policy);
    let same = traces
        .iter()
        .filter(|other| split_label(&other.policy).0 == family);
    if same.count() > 1 && !setting.is_empty() {
        setting
    } else {
        family.to_owned()
    }
}

/// Mean power over windows of [`WINDOW_S`], at their middles.
fn windows(watts: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut smooth = Vec::new();
    let (mut joules, mut begin, mut last) = (0.0, 0.0, 0.0);
    for &(end, power) in watts {
        joules += power * (end - last);
        last = end;
        if end - begin >= WINDOW_S {
            smooth.push(((begin + end) / 2.0, joules / (end - begin)));
            (joules, begin) = (0.0, end);
        }
    }
    if last > begin {
        smooth.push(((begin + last) / 2.0, joules / (last - begin)));
    }
    smooth
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smoothing_keeps_the_energy() {
        let watts: Vec<(f64, f64)> = (1..=100)
            .map(|i| (f64::from(i) * 0.05, f64::from(i % 7)))
            .collect();
        let energy: f64 = watts.iter().map(|&(_, power)| power * 0.05).sum();
        let smooth = windows(&watts);
        let mut begin = 0.0;
        let mut kept = 0.0;
        for (middle, power) in smooth {
            let end = 2.0 * middle - begin;
            kept += power * (end - begin);
            begin = end;
        }
        assert!((energy - kept).abs() < 1e-9);
    }
}
