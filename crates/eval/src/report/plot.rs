//! Draws the figures of a report as SVG.

mod axes;

use crate::result::ClipResult;
use crate::spec::{BASELINE, split_label};
use crate::summary::PolicySummary;
use albireo_core::policy::FrameState;
use axes::{Axes, INK, SOFT_INK, document, line, range, steps, text, width_of};
use maud::{Markup, html};
use std::collections::HashMap;

/// A figure.
pub(super) struct Figure {
    /// The name of its file, without extension.
    pub name: &'static str,
    /// What it shows, as a heading.
    pub title: &'static str,
    /// How to read it.
    pub caption: String,
    /// The SVG document.
    pub svg: String,
}

/// Width and height of a chart, in CSS pixels.
const SIZE: (f64, f64) = (720.0, 430.0);

/// Colours that the colour-blind can tell apart (Okabe and Ito, 2008), without yellow, which is faint on white, and with a
/// brown.
const PALETTE: [&str; 8] = [
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#785ef0", "#6b4226",
];

/// Fill and ink of a frame state: cool where the detector rests, warm where it runs.
const fn state_colors(state: FrameState) -> (&'static str, &'static str) {
    match state {
        FrameState::E => ("#8fbcdb", INK),
        FrameState::P => ("#2670b0", "#fff"),
        FrameState::EI => ("#fdd08b", INK),
        FrameState::I => ("#f18c46", INK),
        FrameState::AI => ("#be3e2c", "#fff"),
    }
}

/// The figures that `report` has the data for.
pub(super) fn figures(report: &super::Report) -> Vec<Figure> {
    let mut figures = Vec::new();
    let points = points(&report.policies);
    if !points.is_empty() {
        figures.push(Figure {
            name: "ap50-against-skip-rate",
            title: "Accuracy against skip rate",
            caption: "Mean over clips. Whiskers: 95 % confidence interval of the difference to Vanilla, paired over clips, \
                      cut at the figure's edge. Thin line: Vanilla. Grey band: the Pareto frontier; filled markers are on it."
                .to_owned(),
            svg: tradeoff(&points),
        });
    }
    figures.push(Figure {
        name: "frame-states",
        title: "Frame states",
        caption: "Mean share of frames over clips. E: screen says empty; P: predicted; E+I: screen, then detector; \
                  I: detector; AI: detector and a rescue."
            .to_owned(),
        svg: states(&report.policies),
    });
    let changes = changes(&report.clips);
    if !changes.is_empty() {
        figures.push(Figure {
            name: "clips-ap50-change-against-skip-rate",
            title: "Change of accuracy clip by clip",
            caption: "Each marker is one clip under one policy: how much AP@50 changed against Vanilla, and how many frames \
                      went without the detector."
                .to_owned(),
            svg: clips(&changes),
        });
    }
    figures
}

/// One policy in the plane of skip rate and accuracy.
struct Point {
    /// What it belongs to: a family shares colour and marker.
    family: String,
    /// Its setting, written beside it.
    setting: String,
    /// Skip rate in percent, and AP@50.
    at: (f64, f64),
    /// Confidence interval of AP@50.
    interval: Option<(f64, f64)>,
    on_frontier: bool,
    baseline: bool,
}

fn points(summaries: &[PolicySummary]) -> Vec<Point> {
    let point = |summary: &PolicySummary| {
        let (family, setting) = split_label(&summary.policy);
        let ap50 = summary.ap50?;
        let t = summary.ap50_change.and_then(|change| change.t);
        Some(Point {
            family: family.to_owned(),
            setting,
            at: (summary.skip_rate * 100.0, ap50),
            interval: t.map(|t| (ap50 - t.mean + t.lower, ap50 - t.mean + t.upper)),
            on_frontier: summary.on_skip_frontier,
            baseline: summary.policy == BASELINE,
        })
    };
    summaries.iter().filter_map(point).collect()
}

/// Name, marker and colour of each family, in the order of the policies; the baseline is black.
struct Families<'a>(Vec<(&'a str, usize, &'static str)>);

impl<'a> Families<'a> {
    fn new(names: impl Iterator<Item = &'a str>) -> Self {
        let (mut families, mut looks) = (
            Vec::<(&str, usize, &str)>::new(),
            (0..).zip(PALETTE.into_iter().cycle()),
        );
        for name in names {
            if families.iter().all(|(known, ..)| *known != name) {
                let look = if name == BASELINE { None } else { looks.next() };
                let (index, color) = look.unwrap_or((0, INK));
                families.push((name, index, color));
            }
        }
        Self(families)
    }

    fn look(&self, family: &str) -> (usize, &'static str) {
        let known = self.0.iter().find(|(name, ..)| *name == family);
        known.map_or((0, INK), |&(_, index, color)| (index, color))
    }

    /// Markers with names along the top, in as many lines as they need, and the height these take.
    fn legend(&self) -> (Markup, f64) {
        let (mut x, mut y) = (62.0, 16.0);
        let mut entries = Vec::new();
        for &(name, index, color) in &self.0 {
            let width = 9.0 + width_of(name, 11.5);
            if x > 62.0 && x + width > SIZE.0 - 8.0 {
                (x, y) = (62.0, y + 17.0);
            }
            entries.push(html! {
                (marker((x, y), index, color, true, ""))
                (text((x + 9.0, y), "start", 11.5, INK, name))
            });
            x += width + 18.0;
        }
        (html! { @for entry in &entries { (entry) } }, y + 18.0)
    }
}

/// The marker of the `index`th family: filled, or white with a coloured edge.
fn marker((x, y): (f64, f64), index: usize, color: &str, filled: bool, title: &str) -> Markup {
    let corners: &[(f64, f64)] = match index % 4 {
        0 => &[],
        1 => &[(-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)],
        2 => &[(0.0, -1.2), (1.1, 0.8), (-1.1, 0.8)],
        _ => &[(0.0, -1.2), (1.2, 0.0), (0.0, 1.2), (-1.2, 0.0)],
    };
    let fill = if filled { color } else { "#fff" };
    html! {
        g fill=(fill) stroke=(color) stroke-width="1.6" {
            @if !title.is_empty() { title { (title) } }
            @if corners.is_empty() {
                circle cx=(steps(x)) cy=(steps(y)) r="4" {}
            } @else {
                polygon points=(axes::path(corners.iter().map(|(dx, dy)| (x + 4.0 * dx, y + 4.0 * dy)))) {}
            }
        }
    }
}

/// Accuracy against skip rate: one marker per policy, families joined, the frontier behind.
fn tradeoff(points: &[Point]) -> String {
    let families = Families::new(points.iter().map(|point| point.family.as_str()));
    let (legend, top) = families.legend();
    let (low, high) = heights(points);
    let axes = Axes::new(
        SIZE,
        top,
        range(points.iter().map(|point| point.at.0), 0.09),
        (low, high),
    );
    let joined = |wanted: &dyn Fn(&Point) -> bool, width: f64, color: &str| {
        let mut path: Vec<_> = points
            .iter()
            .filter(|point| wanted(point))
            .map(|point| point.at)
            .collect();
        path.sort_by(|a, b| a.0.total_cmp(&b.0));
        axes.line(&path, width, color)
    };
    let looks: Vec<_> = points
        .iter()
        .map(|point| families.look(&point.family))
        .collect();
    let drawn = html! {
        (joined(&|point| point.on_frontier, 5.0, "#cdd2d9"))
        @if let Some(baseline) = points.iter().find(|point| point.baseline) {
            (axes.across(baseline.at.1))
        }
        @for (family, _, color) in &families.0 {
            (joined(&|point| point.family == *family, 1.2, color))
        }
        @for (point, (_, color)) in points.iter().zip(&looks) {
            @if let Some((from, to)) = point.interval {
                g opacity=".5" {
                    (axes.line(&[(point.at.0, from.clamp(low, high)), (point.at.0, to.clamp(low, high))], 1.0, color))
                }
            }
        }
        @for (point, &(index, color)) in points.iter().zip(&looks) {
            @if point.baseline {
                // It must show below a policy that does the same.
                circle cx=(steps(axes.at(point.at).0)) cy=(steps(axes.at(point.at).1)) r="7" fill="#fff" stroke=(color) {}
            }
            (marker(axes.at(point.at), index, color, point.on_frontier, &format!("{} {}", point.family, point.setting)))
        }
        (settings(points, &axes, &looks))
        (legend)
    };
    axes.document("AP@50", |value| format!("{value:.3}"), &drawn)
}

/// The vertical range: all points, and of the intervals as much as leaves the points apart. Two clips can have an
/// interval that is wider than every accuracy there is.
fn heights(points: &[Point]) -> (f64, f64) {
    let (lowest, highest) = range(points.iter().map(|point| point.at.1), 0.0);
    let room = (highest - lowest).max(0.02);
    let ends = points.iter().flat_map(|point| {
        let (low, high) = point.interval.unwrap_or((point.at.1, point.at.1));
        [low.max(lowest - room), high.min(highest + room)]
    });
    let (low, high) = range(ends, 0.08);
    (low.max(0.0), high.min(1.0 + 0.04 * (1.0 - lowest)))
}

/// Each setting beside its marker, at the first side where nothing is yet; where there is none, the marker's title says it.
fn settings(points: &[Point], axes: &Axes, looks: &[(usize, &str)]) -> Markup {
    let places: Vec<(f64, f64)> = points.iter().map(|point| axes.at(point.at)).collect();
    let mut taken: Vec<[f64; 4]> = places
        .iter()
        .map(|&(x, y)| [x - 6.0, y - 6.0, x + 6.0, y + 6.0])
        .collect();
    let mut written = Vec::new();
    for ((point, &(x, y)), (_, color)) in points.iter().zip(&places).zip(looks) {
        let width = width_of(&point.setting, 10.5);
        let sides = [
            (x + 8.0, y - 10.0),
            (x + 8.0, y + 10.0),
            (x - 8.0 - width, y - 10.0),
            (x - 8.0 - width, y + 10.0),
        ];
        let free = |&&(left, middle): &&(f64, f64)| {
            left >= 0.0
                && left + width <= SIZE.0
                && taken.iter().all(|[l, t, r, b]| {
                    left >= *r || left + width <= *l || middle - 6.0 >= *b || middle + 6.0 <= *t
                })
        };
        if let Some(&(left, middle)) = sides.iter().find(free) {
            taken.push([left, middle - 6.0, left + width, middle + 6.0]);
            written.push(text((left, middle), "start", 10.5, color, &point.setting));
        }
    }
    html! { @for setting in &written { (setting) } }
}

/// One bar per policy: how its frames were answered.
fn states(summaries: &[PolicySummary]) -> String {
    let label = |summary: &PolicySummary| {
        let base = summary.policy.split_once("-erd-");
        base.map_or(summary.policy.clone(), |(base, _)| base.to_owned())
    };
    let rows = summaries.len().min(60) as f64;
    let (width, height) = (SIZE.0, 70.0 + 26.0 * rows);
    let widest = summaries
        .iter()
        .map(|summary| width_of(&label(summary), 11.5))
        .fold(0.0, f64::max);
    let (left, right, top, bottom) = (22.0 + widest, width - 22.0, 32.0, height - 30.0);
    let across = |share: f64| left + share * (right - left);
    let pitch = (bottom - top) / (summaries.len().max(1)) as f64;
    let bar = |row: usize, summary: &PolicySummary| {
        let middle = top + (row as f64 + 0.5) * pitch;
        let mut from = 0.0;
        let shares = FrameState::ALL.into_iter().zip(summary.states).map(|(state, share)| {
            let (start, end) = (across(from), across(from + share));
            from += share;
            let (fill, ink) = state_colors(state);
            html! {
                rect x=(steps(start)) y=(steps(middle - 0.36 * pitch)) width=(steps(end - start)) height=(steps(0.72 * pitch)) fill=(fill) {}
                @if share >= 0.045 {
                    (text((f64::midpoint(start, end), middle), "middle", 10.0, ink, &format!("{:.0}", share * 100.0)))
                }
            }
        });
        html! {
            (text((left - 8.0, middle), "end", 11.5, INK, &label(summary)))
            @for share in shares { (share) }
        }
    };
    let mut x = left;
    let legend = FrameState::ALL.map(|state| {
        let at = x;
        x += 31.0 + width_of(state.as_str(), 11.5);
        html! {
            rect x=(steps(at)) y="11" width="10" height="10" fill=(state_colors(state).0) {}
            (text((at + 15.0, 16.0), "start", 11.5, INK, state.as_str()))
        }
    });
    document(
        (width, height),
        &html! {
            @for tick in 0..=5 {
                @let share = f64::from(tick) / 5.0;
                (line(&[(across(share), top), (across(share), bottom)], 0.6, axes::GRID))
                (text((across(share), bottom + 13.0), "middle", 11.0, SOFT_INK, &format!("{:.0} %", share * 100.0)))
            }
            @for (row, summary) in summaries.iter().enumerate() { (bar(row, summary)) }
            @for entry in &legend { (entry) }
        },
    )
}

/// Skip rate in percent and change of AP@50 in percentage points of every clip with ground truth, by family.
fn changes(results: &[ClipResult]) -> Vec<(&str, Vec<(f64, f64)>)> {
    let ap50 = |result: &ClipResult| result.accuracy.map(|accuracy| accuracy.ap50);
    let baselines: HashMap<&str, f64> = results
        .iter()
        .filter(|result| result.policy == BASELINE)
        .filter_map(|result| Some((result.clip.as_str(), ap50(result)?)))
        .collect();
    let mut changes: Vec<(&str, Vec<(f64, f64)>)> = Vec::new();
    for result in results.iter().filter(|result| result.policy != BASELINE) {
        if let (Some(ap50), Some(before)) = (ap50(result), baselines.get(result.clip.as_str())) {
            let (family, _) = split_label(&result.policy);
            let change = (result.skip_rate() * 100.0, (ap50 - before) * 100.0);
            match changes.iter_mut().find(|(known, _)| *known == family) {
                Some((_, changes)) => changes.push(change),
                None => changes.push((family, vec![change])),
            }
        }
    }
    changes
}

/// Clip by clip: the change of AP@50 against the skip rate.
fn clips(changes: &[(&str, Vec<(f64, f64)>)]) -> String {
    let families = Families::new(changes.iter().map(|(family, _)| *family));
    let (legend, top) = families.legend();
    let all = || changes.iter().flat_map(|(_, changes)| changes);
    let x = range(all().map(|change| change.0), 0.05);
    let axes = Axes::new(
        SIZE,
        top,
        x,
        range(all().map(|change| change.1).chain([0.0]), 0.06),
    );
    let drawn = html! {
        (axes.across(0.0))
        @for (family, changes) in changes {
            @let (index, color) = families.look(family);
            g opacity=".6" {
                @for &change in changes { (marker(axes.at(change), index, color, true, "")) }
            }
        }
        (legend)
    };
    let signed = |value: f64| {
        if value == 0.0 {
            "0".to_owned()
        } else {
            format!("{value:+.0}").replace('-', "−")
        }
    };
    axes.document("Change of AP@50, percentage points", signed, &drawn)
}
