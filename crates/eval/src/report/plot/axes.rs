//! Axes, lines and text of a chart in SVG.

use maud::{Markup, PreEscaped, html};

/// Colour of text.
pub(super) const INK: &str = "#222831";
/// Colour of axes and their labels.
pub(super) const SOFT_INK: &str = "#5c6570";
/// Colour of grid lines.
pub(super) const GRID: &str = "#e8ebef";

/// A chart's plane: across is the skip rate in percent.
pub(super) struct Axes {
    size: (f64, f64),
    x: (f64, f64),
    y: (f64, f64),
    top: f64,
}

const LEFT: f64 = 60.0;
const RIGHT: f64 = 18.0;
const BOTTOM: f64 = 48.0;

impl Axes {
    /// The plane of `x` and `y` in a picture of `size`, below `top`.
    pub(super) const fn new(size: (f64, f64), top: f64, x: (f64, f64), y: (f64, f64)) -> Self {
        Self { size, x, y, top }
    }

    /// Where a value is drawn.
    pub(super) fn at(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let share = |value: f64, (low, high): (f64, f64)| (value - low) / (high - low);
        let (right, bottom) = (self.size.0 - RIGHT, self.size.1 - BOTTOM);
        (
            LEFT + share(x, self.x) * (right - LEFT),
            bottom - share(y, self.y) * (bottom - self.top),
        )
    }

    /// A line through values.
    pub(super) fn line(&self, values: &[(f64, f64)], width: f64, color: &str) -> Markup {
        let points: Vec<_> = values.iter().map(|&value| self.at(value)).collect();
        line(&points, width, color)
    }

    /// A thin line across at height `y`.
    pub(super) fn across(&self, y: f64) -> Markup {
        self.line(&[(self.x.0, y), (self.x.1, y)], 1.0, SOFT_INK)
    }

    /// The chart as an SVG document.
    pub(super) fn document(
        &self,
        y_name: &str,
        y_label: impl Fn(f64) -> String,
        drawn: &Markup,
    ) -> String {
        let (left, bottom) = self.at((self.x.0, self.y.0));
        let (right, top) = self.at((self.x.1, self.y.1));
        let (center, middle) = (f64::midpoint(left, right), f64::midpoint(top, bottom));
        let turned = format!("rotate(-90 13 {})", steps(middle));
        document(
            self.size,
            &html! {
                @for tick in ticks(self.x) {
                    @let x = self.at((tick, self.y.0)).0;
                    (line(&[(x, top), (x, bottom)], 0.6, GRID))
                    (text((x, bottom + 13.0), "middle", 11.0, SOFT_INK, &format!("{tick:.0}")))
                }
                @for tick in ticks(self.y) {
                    @let y = self.at((self.x.0, tick)).1;
                    (line(&[(left, y), (right, y)], 0.6, GRID))
                    (text((left - 6.0, y), "end", 11.0, SOFT_INK, &y_label(tick)))
                }
                (line(&[(left, top), (left, bottom), (right, bottom)], 0.8, SOFT_INK))
                (text((center, self.size.1 - 12.0), "middle", 12.0, INK, "Frames without the detector, %"))
                g transform=(turned) { (text((13.0, middle), "middle", 12.0, INK, y_name)) }
                (drawn)
            },
        )
    }
}

/// At most nine round values within a range: multiples of 1, 2 or 5 times a power of ten.
fn ticks((low, high): (f64, f64)) -> Vec<f64> {
    let rough = (high - low) / 8.0;
    let power = 10_f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .map(|round| round * power)
        .into_iter()
        .find(|step| *step >= rough);
    let step = step.unwrap_or(rough);
    let first = (low / step).ceil() as i64;
    let last = (high / step).floor() as i64;
    (first..=last).map(|number| number as f64 * step).collect()
}

/// A range around `values` with that share of air, and never empty.
pub(super) fn range(values: impl Iterator<Item = f64>, air: f64) -> (f64, f64) {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    if !(low.is_finite() && high.is_finite()) {
        return (0.0, 1.0);
    }
    let span = (high - low).max(high.abs() * 1e-3).max(1e-6);
    (low - air * span, high + air * span)
}

/// A coordinate as it is written: a tenth of a pixel is exact enough.
pub(super) fn steps(value: f64) -> String {
    format!("{value:.1}")
}

/// Points as SVG writes them.
pub(super) fn path(points: impl Iterator<Item = (f64, f64)>) -> String {
    let points: Vec<_> = points.map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    points.join(" ")
}

/// A line through points.
pub(super) fn line(points: &[(f64, f64)], width: f64, color: &str) -> Markup {
    html! {
        polyline points=(path(points.iter().copied())) fill="none" stroke=(color) stroke-width=(width) {}
    }
}

/// Text with its `anchor` (`start`, `middle` or `end`) and its middle at that place.
pub(super) fn text((x, y): (f64, f64), anchor: &str, size: f64, color: &str, text: &str) -> Markup {
    html! {
        text x=(steps(x)) y=(steps(y)) text-anchor=(anchor) dominant-baseline="central" font-size=(size) fill=(color) { (text) }
    }
}

/// About how wide text is in a sans-serif font; the viewer's own font decides.
pub(super) fn width_of(text: &str, size: f64) -> f64 {
    text.chars().count() as f64 * size * 0.56
}

/// A picture of that size as an SVG document, on white.
pub(super) fn document((width, height): (f64, f64), drawn: &Markup) -> String {
    let document = html! {
        svg xmlns="http://www.w3.org/2000/svg" width=(width) height=(height) viewBox=(format!("0 0 {width} {height}"))
            font-family="system-ui, sans-serif" {
            rect width="100%" height="100%" fill="#fff" {}
            (drawn)
        }
    };
    let PreEscaped(text) = document;
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_a_few_round_numbers_within_the_range() {
        let ten = [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0];
        assert_eq!(ticks((-6.0, 72.6)), ten);
        for (low, high) in [(0.0, 1.0), (0.7312, 0.7331), (-43.0, 12.0), (0.0, 1e-6)] {
            let ticks = ticks((low, high));
            assert!((2..=9).contains(&ticks.len()), "{low} to {high}: {ticks:?}");
            assert!(ticks.iter().all(|tick| (low..=high).contains(tick)));
        }
    }

    #[test]
    fn a_range_is_never_empty() {
        assert_eq!(range([].into_iter(), 0.1), (0.0, 1.0));
        let (low, high) = range([0.5].into_iter(), 0.1);
        assert!(low < 0.5 && 0.5 < high);
    }
}
