//! Clip by clip: the change of AP@50 against the skip rate.

use super::DrawResult;
use super::style::{GRID, INK, SOFT_INK, Scale, family_color, range};
use super::tradeoff::Legend;
use crate::result::ClipResult;
use crate::spec::{BASELINE, split_label};
use plotters::coord::Shift;
use plotters::prelude::{ChartBuilder, Circle, DrawingArea, DrawingBackend, PathElement};
use plotters::style::Color;
use std::collections::HashMap;

/// The clips of one family of policies.
pub(crate) struct Cloud {
    /// Name of the family.
    pub family: String,
    /// Skip rate in percent and change of AP@50 in percentage points, one a clip and policy.
    pub points: Vec<(f64, f64)>,
}

/// All clips that have ground truth, by family.
pub(crate) fn clouds(results: &[ClipResult]) -> Vec<Cloud> {
    let baseline: HashMap<&str, f64> = results
        .iter()
        .filter(|result| result.policy == BASELINE)
        .filter_map(|result| Some((result.clip.as_str(), result.accuracy?.ap50)))
        .collect();
    let mut clouds: Vec<Cloud> = Vec::new();
    for result in results {
        if result.policy == BASELINE {
            continue;
        }
        let (family, _) = split_label(&result.policy);
        let index = clouds
            .iter()
            .position(|cloud| cloud.family == family)
            .unwrap_or_else(|| {
                clouds.push(Cloud {
                    family: family.to_owned(),
                    points: Vec::new(),
                });
                clouds.len() - 1
            });
        if let (Some(accuracy), Some(before)) =
            (result.accuracy, baseline.get(result.clip.as_str()))
        {
            let skip = result.skip_rate() * 100.0;
            let change = (accuracy.ap50 - before) * 100.0;
            clouds[index].points.push((skip, change));
        }
    }
    clouds
}

pub(super) fn draw<B: DrawingBackend>(
    clouds: &[Cloud],
    area: &DrawingArea<B, Shift>,
    scale: Scale,
) -> DrawResult
where
    B::ErrorType: 'static,
{
    let all = || clouds.iter().flat_map(|cloud| cloud.points.iter());
    let (x0, x1) = range(all().map(|point| point.0), 0.05);
    let (y0, y1) = range(all().map(|point| point.1).chain([0.0]), 0.06);
    let families: Vec<&str> = clouds.iter().map(|cloud| cloud.family.as_str()).collect();
    let legend = Legend::new(area, scale, &families)?;
    let mut chart = ChartBuilder::on(area)
        .margin_top(legend.height())
        .margin_right(scale.size(18.0))
        .margin_bottom(scale.size(6.0))
        .margin_left(scale.size(6.0))
        .x_label_area_size(scale.size(42.0))
        .y_label_area_size(scale.size(54.0))
        .build_cartesian_2d(x0..x1, y0..y1)?;
    chart
        .configure_mesh()
        .x_desc("Frames without the detector, %")
        .y_desc("Change of AP@50, percentage points")
        .axis_desc_style(scale.text(12.0, INK))
        .label_style(scale.text(11.0, SOFT_INK))
        .axis_style(scale.line(0.8, SOFT_INK))
        .bold_line_style(scale.line(0.6, GRID))
        .light_line_style(plotters::style::TRANSPARENT)
        .x_labels(8)
        .y_labels(8)
        .x_label_formatter(&|value| format!("{value:.0}"))
        .y_label_formatter(&|value| format!("{value:+.0}").replace('-', "−").replace("+0", "0"))
        .draw()?;
    chart.draw_series([PathElement::new(
        vec![(x0, 0.0), (x1, 0.0)],
        scale.line(1.2, SOFT_INK),
    )])?;
    for (index, cloud) in clouds.iter().enumerate() {
        let color = family_color(index);
        for &point in &cloud.points {
            let at = chart.backend_coord(&point);
            area.draw(&Circle::new(
                at,
                scale.length(3.6),
                color.mix(0.55).filled(),
            ))?;
        }
    }
    legend.draw(area, scale, &families, &|family| {
        let index = families
            .iter()
            .position(|other| *other == family)
            .unwrap_or(0);
        (0, family_color(index))
    })
}
