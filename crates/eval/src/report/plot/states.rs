//! Five-state bars: how each policy's frames were answered.

use super::DrawResult;
use super::style::{GRID, INK, SOFT_INK, Scale, anchored, state_color};
use crate::summary::PolicySummary;
use albireo_core::policy::FrameState;
use plotters::coord::Shift;
use plotters::prelude::{DrawingArea, DrawingBackend, PathElement, Rectangle, Text};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{Color, RGBColor};

/// One policy's bar.
pub(crate) struct Bar {
    label: String,
    shares: [f64; 5],
}

/// The bars of `summaries`, in their order.
pub(crate) fn bars(summaries: &[PolicySummary]) -> Vec<Bar> {
    summaries
        .iter()
        .map(|summary| Bar {
            label: summary
                .policy
                .split_once("-erd-")
                .map_or(summary.policy.as_str(), |(start, _)| start)
                .to_owned(),
            shares: summary.states,
        })
        .collect()
}

pub(super) fn draw<B: DrawingBackend>(
    bars: &[Bar],
    area: &DrawingArea<B, Shift>,
    scale: Scale,
) -> DrawResult
where
    B::ErrorType: 'static,
{
    let (width, height) = area.dim_in_pixel();
    let label_style = anchored(scale.text(11.5, INK), HPos::Right);
    let mut widest = 0;
    for bar in bars {
        widest = widest.max(area.estimate_text_size(&bar.label, &label_style)?.0);
    }
    let left = scale.length(14.0) + widest as i32 + scale.length(8.0);
    let right = width as i32 - scale.length(22.0);
    let (top, bottom) = (scale.length(32.0), height as i32 - scale.length(30.0));
    let across = |share: f64| left + (share * f64::from(right - left)).round() as i32;
    for tick in 0..=5 {
        let share = f64::from(tick) / 5.0;
        let x = across(share);
        let line = PathElement::new(vec![(x, top), (x, bottom)], scale.line(0.6, GRID));
        area.draw(&line)?;
        let style = scale
            .text(11.0, SOFT_INK)
            .pos(Pos::new(HPos::Center, VPos::Top));
        let label = format!("{:.0} %", share * 100.0);
        area.draw(&Text::new(label, (x, bottom + scale.length(7.0)), style))?;
    }
    let pitch = f64::from(bottom - top) / bars.len().max(1) as f64;
    for (row, bar) in bars.iter().enumerate() {
        let middle = top + ((row as f64 + 0.5) * pitch).round() as i32;
        let half = (pitch * 0.36).round() as i32;
        let place = (left - scale.length(8.0), middle);
        area.draw(&Text::new(bar.label.clone(), place, label_style.clone()))?;
        let mut from = 0.0;
        for (state, share) in FrameState::ALL.into_iter().zip(bar.shares) {
            let (start, end) = (across(from), across(from + share));
            from += share;
            if end <= start {
                continue;
            }
            let corners = [(start, middle - half), (end, middle + half)];
            area.draw(&Rectangle::new(corners, state_color(state).filled()))?;
            if share >= 0.045 {
                let style = scale
                    .text(10.0, ink_on(state))
                    .pos(Pos::new(HPos::Center, VPos::Center));
                let text = format!("{:.0}", share * 100.0);
                area.draw(&Text::new(text, ((start + end) / 2, middle), style))?;
            }
        }
    }
    legend(area, scale, left)
}

/// Text that can be read on a state's colour.
fn ink_on(state: FrameState) -> RGBColor {
    match state {
        FrameState::P | FrameState::AI => RGBColor(255, 255, 255),
        FrameState::E | FrameState::EI | FrameState::I => INK,
    }
}

/// The states' colours along the top.
pub(super) fn legend<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    scale: Scale,
    left: i32,
) -> DrawResult
where
    B::ErrorType: 'static,
{
    let mut x = left;
    let y = scale.length(16.0);
    let half = scale.length(5.0);
    for state in FrameState::ALL {
        let corners = [(x, y - half), (x + 2 * half, y + half)];
        area.draw(&Rectangle::new(corners, state_color(state).filled()))?;
        x += 2 * half + scale.length(5.0);
        let style = anchored(scale.text(11.5, INK), HPos::Left);
        let (width, _) = area.estimate_text_size(state.as_str(), &style)?;
        area.draw(&Text::new(state.as_str(), (x, y), style))?;
        x += width as i32 + scale.length(16.0);
    }
    Ok(())
}
