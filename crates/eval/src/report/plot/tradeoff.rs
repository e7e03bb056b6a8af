//! Accuracy against what it costs: one marker a policy, families joined, the frontier behind.

use super::DrawResult;
use super::style::{
    FRONTIER, GRID, INK, SOFT_INK, Scale, anchored, family_color, marker, range, ring,
};
use plotters::coord::Shift;
use plotters::prelude::{
    ChartBuilder, DrawingArea, DrawingBackend, LineSeries, PathElement, Text, TextStyle,
};
use plotters::style::text_anchor::HPos;
use plotters::style::{Color, RGBColor};

/// One policy.
pub struct Point {
    /// What it belongs to: a family shares colour and marker.
    pub family: String,
    /// Its setting, written beside it.
    pub setting: String,
    /// Cost or skip rate.
    pub x: f64,
    /// Accuracy.
    pub y: f64,
    /// Confidence interval of `y`.
    pub interval: Option<(f64, f64)>,
    /// Whether nobody beats it.
    pub on_frontier: bool,
    /// Whether it is what the others are compared with.
    pub baseline: bool,
}

/// The figure.
pub(crate) struct Tradeoff {
    /// Name and unit of the horizontal axis.
    pub x_label: String,
    /// Name and unit of the vertical axis.
    pub y_label: String,
    /// The policies.
    pub points: Vec<Point>,
}

/// With more families than this, the setting of a family that has but one is not written: the legend names it.
const CROWDED: usize = 4;

/// A rectangle in the backend's steps: left, top, right, bottom.
type Place = (i32, i32, i32, i32);

impl Tradeoff {
    /// Families in order of their first points.
    fn families(&self) -> Vec<&str> {
        let mut families: Vec<&str> = Vec::new();
        for point in &self.points {
            if !families.contains(&point.family.as_str()) {
                families.push(&point.family);
            }
        }
        families
    }

    pub(super) fn draw<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
        scale: Scale,
    ) -> DrawResult
    where
        B::ErrorType: 'static,
    {
        let families = self.families();
        let color = |family: &str| {
            let index = families
                .iter()
                .position(|other| *other == family)
                .unwrap_or(0);
            let baseline = self.points.iter().any(|p| p.family == family && p.baseline);
            if baseline {
                (index, INK)
            } else {
                (index, family_color(index.saturating_sub(1)))
            }
        };
        let (x0, x1) = range(self.points.iter().map(|point| point.x), 0.09);
        let (y0, y1) = self.heights();
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
            .x_desc(self.x_label.as_str())
            .y_desc(self.y_label.as_str())
            .axis_desc_style(scale.text(12.0, INK))
            .label_style(scale.text(11.0, SOFT_INK))
            .axis_style(scale.line(0.8, SOFT_INK))
            .bold_line_style(scale.line(0.6, GRID))
            .light_line_style(plotters::style::TRANSPARENT)
            .x_labels(8)
            .y_labels(8)
            .x_label_formatter(&|value| {
                if x1 > 1000.0 {
                    format!("{value:.0}")
                } else {
                    trim(*value)
                }
            })
            .y_label_formatter(&|value| {
                let text = format!("{value:.3}");
                text.trim_end_matches('0').trim_end_matches('.').to_owned()
            })
            .draw()?;
        self.draw_frontier(&mut |path| {
            chart.draw_series(LineSeries::new(path, scale.line(5.0, FRONTIER)))?;
            Ok(())
        })?;
        if let Some(baseline) = self.points.iter().find(|point| point.baseline) {
            let level = vec![(x0, baseline.y), (x1, baseline.y)];
            let style = SOFT_INK.mix(0.5).stroke_width(scale.size(1.0));
            chart.draw_series([PathElement::new(level, style)])?;
        }
        for family in &families {
            let mut path: Vec<(f64, f64)> = self
                .points
                .iter()
                .filter(|point| point.family == *family)
                .map(|point| (point.x, point.y))
                .collect();
            path.sort_by(|a, b| a.0.total_cmp(&b.0));
            chart.draw_series(LineSeries::new(path, scale.line(1.2, color(family).1)))?;
        }
        for point in &self.points {
            if let Some((low, high)) = point.interval {
                let style = color(&point.family)
                    .1
                    .mix(0.45)
                    .stroke_width(scale.size(1.0));
                let (low, high) = (low.clamp(y0, y1), high.clamp(y0, y1));
                chart.draw_series([PathElement::new(
                    vec![(point.x, low), (point.x, high)],
                    style,
                )])?;
            }
        }
        let places: Vec<(i32, i32)> = self
            .points
            .iter()
            .map(|point| chart.backend_coord(&(point.x, point.y)))
            .collect();
        for (point, &at) in self.points.iter().zip(&places) {
            let (index, color) = color(&point.family);
            if point.baseline {
                // So that it shows below a policy that does the same.
                ring(area, scale, at, color)?;
            }
            marker(area, scale, at, index, color, point.on_frontier)?;
        }
        self.draw_settings(area, scale, &places, &|family| color(family).1)?;
        legend.draw(area, scale, &families, &color)
    }

    /// The vertical axis: all points, and of the intervals as much as leaves the points apart. Two clips can have an
    /// interval that is wider than every accuracy there is.
    fn heights(&self) -> (f64, f64) {
        let of = |values: &mut dyn Iterator<Item = f64>| {
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
                (low.min(value), high.max(value))
            })
        };
        let (lowest, highest) = of(&mut self.points.iter().map(|point| point.y));
        let room = (highest - lowest).max(0.02);
        let ends = self.points.iter().flat_map(|point| {
            let (low, high) = point.interval.unwrap_or((point.y, point.y));
            [low.max(lowest - room), high.min(highest + room)]
        });
        let (low, high) = range(ends, 0.08);
        // Of a share of 1 there is no more than all.
        let is_share = lowest >= 0.0 && highest <= 1.0;
        if is_share {
            (low.max(0.0), high.min(1.0 + 0.04 * (1.0 - lowest)))
        } else {
            (low, high)
        }
    }

    fn draw_frontier(&self, line: &mut dyn FnMut(Vec<(f64, f64)>) -> DrawResult) -> DrawResult {
        let mut path: Vec<(f64, f64)> = self
            .points
            .iter()
            .filter(|point| point.on_frontier)
            .map(|point| (point.x, point.y))
            .collect();
        path.sort_by(|a, b| a.0.total_cmp(&b.0));
        if path.len() > 1 { line(path) } else { Ok(()) }
    }

    /// Writes each setting beside its marker, at the first side where nothing is yet.
    fn draw_settings<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
        scale: Scale,
        places: &[(i32, i32)],
        color: &dyn Fn(&str) -> RGBColor,
    ) -> DrawResult
    where
        B::ErrorType: 'static,
    {
        let reach = scale.length(7.0);
        let mut taken: Vec<Place> = places
            .iter()
            .map(|&(x, y)| (x - reach, y - reach, x + reach, y + reach))
            .collect();
        let (width, height) = area.dim_in_pixel();
        let crowded = self.families().len() > CROWDED;
        for (point, &(x, y)) in self.points.iter().zip(places) {
            let alone = || {
                let family = self.points.iter().filter(|p| p.family == point.family);
                family.count() == 1
            };
            if point.setting.is_empty() || crowded && alone() {
                continue;
            }
            let style = scale.text(10.5, color(&point.family));
            let (w, h) = area.estimate_text_size(&point.setting, &style)?;
            let (w, h) = (w as i32, h as i32);
            let gap = scale.length(8.0);
            let candidates = [
                (x + gap, y - gap - h / 2),
                (x + gap, y + gap - h / 2),
                (x - gap - w, y - gap - h / 2),
                (x - gap - w, y + gap - h / 2),
                (x + gap, y - h / 2),
                (x - gap - w, y - h / 2),
                (x - w / 2, y - gap - h),
                (x - w / 2, y + gap),
                (x + gap, y - 2 * gap - h / 2),
                (x + gap, y + 2 * gap - h / 2),
                (x - gap - w, y - 2 * gap - h / 2),
                (x - gap - w, y + 2 * gap - h / 2),
            ];
            let fits = |&(left, top): &(i32, i32)| {
                left >= 0
                    && top >= 0
                    && left + w <= width as i32
                    && top + h <= height as i32
                    && taken
                        .iter()
                        .all(|&(l, t, r, b)| left >= r || left + w <= l || top >= b || top + h <= t)
            };
            let &(left, top) = candidates
                .iter()
                .find(|place| fits(place))
                .unwrap_or(&candidates[0]);
            taken.push((left, top, left + w, top + h));
            let style = anchored(style, HPos::Left);
            area.draw(&Text::new(
                point.setting.as_str(),
                (left, top + h / 2),
                style,
            ))?;
        }
        Ok(())
    }
}

/// A number without zeros at its end.
fn trim(value: f64) -> String {
    let text = format!("{value:.1}");
    text.strip_suffix(".0").map_or(text.clone(), str::to_owned)
}

/// Markers with names along the top, in as many lines as they need.
pub(super) struct Legend {
    /// Where each marker is.
    places: Vec<(i32, i32)>,
    height: u32,
}

impl Legend {
    /// The legend of `families` in `area`.
    pub(super) fn new<B: DrawingBackend>(
        area: &DrawingArea<B, Shift>,
        scale: Scale,
        families: &[&str],
    ) -> DrawResult<Self>
    where
        B::ErrorType: 'static,
    {
        let left = scale.length(62.0);
        let right = area.dim_in_pixel().0 as i32 - scale.length(8.0);
        let (mut x, mut y) = (left, scale.length(16.0));
        let mut places = Vec::new();
        for family in families {
            let (width, _) = area.estimate_text_size(family, &Self::style(scale))?;
            let width = scale.length(9.0) + width as i32;
            if x > left && x + width > right {
                x = left;
                y += scale.length(17.0);
            }
            places.push((x, y));
            x += width + scale.length(18.0);
        }
        let height = scale.size(18.0) + u32::try_from(y).unwrap_or_default();
        Ok(Self { places, height })
    }

    /// What it takes of the top.
    pub(super) const fn height(&self) -> u32 {
        self.height
    }

    fn style(scale: Scale) -> TextStyle<'static> {
        anchored(scale.text(11.5, INK), HPos::Left)
    }

    /// Draws it; `color` gives a family's marker and colour.
    pub(super) fn draw<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
        scale: Scale,
        families: &[&str],
        color: &dyn Fn(&str) -> (usize, RGBColor),
    ) -> DrawResult
    where
        B::ErrorType: 'static,
    {
        for (family, &(x, y)) in families.iter().zip(&self.places) {
            let (index, color) = color(family);
            marker(area, scale, (x, y), index, color, true)?;
            let at = (x + scale.length(9.0), y);
            area.draw(&Text::new((*family).to_owned(), at, Self::style(scale)))?;
        }
        Ok(())
    }
}
