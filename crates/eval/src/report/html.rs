//! `report.html`: tables and figures in one page that loads nothing.

use super::Report;
use super::plot::Figure;
use super::worst;
use crate::conclusion::conclusion;
use crate::result::{ClipResult, Provenance};
use crate::spec::BASELINE;
use crate::summary::{Difference, EnergySummary, PolicySummary};
use crate::table::{p_value, short};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use std::collections::{BTreeSet, HashMap};

const STYLE: &str = include_str!("report.css");
const SCRIPT: &str = include_str!("report.js");

/// The page. `figures` come with their SVG documents.
pub(super) fn render(report: &Report, figures: &[(Figure, String)]) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { "Albireo evaluation: " (report.title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                main {
                    header {
                        p.kicker { "Albireo evaluation" }
                        h1 { (report.title) }
                        (concluded(&report.policies))
                    }
                    @for (figure, svg) in figures {
                        section {
                            h2 { (figure.title) }
                            figure.plot {
                                (PreEscaped(svg))
                                figcaption { (figure.caption) }
                            }
                        }
                    }
                    (worst::frames(&report.clips))
                    (policies(&report.policies))
                    (classes(&report.policies))
                    (clips(&report.clips))
                    section {
                        h2 { "How it was judged" }
                        (settings(report))
                    }
                    footer {
                        p {
                            "Made by albireo " (env!("CARGO_PKG_VERSION")) ". The same figures are in "
                            code { "summary.csv" } " and " code { "report.json" } "."
                        }
                    }
                }
                script { (PreEscaped(SCRIPT)) }
            }
        }
    };
    page.into_string()
}

/// The conclusion, before anything else.
fn concluded(summaries: &[PolicySummary]) -> Markup {
    html! {
        div.conclusion {
            @for sentence in conclusion(summaries) { p { (minus_signs(&sentence)) } }
        }
    }
}

/// With proper minus signs before digits; hyphens of names stay.
fn minus_signs(text: &str) -> String {
    let mut signed = String::with_capacity(text.len());
    let mut before = ' ';
    let mut rest = text.chars().peekable();
    while let Some(letter) = rest.next() {
        let sign = letter == '-' && before == ' ' && rest.peek().is_some_and(char::is_ascii_digit);
        signed.push(if sign { '−' } else { letter });
        before = letter;
    }
    signed
}

fn settings(report: &Report) -> Markup {
    let lines = report.data.lines();
    html! {
        dl {
            @for (name, value) in &report.settings {
                dt { (name) }
                dd { (value) }
            }
        }
        @if !lines.is_empty() {
            details.note {
                summary {
                    "About the data: " (lines.len()) " remark" @if lines.len() != 1 { "s" }
                }
                ul {
                    @for line in &lines { li { (line) } }
                }
            }
        }
    }
}

/// A figure that may not exist, as a cell with `digits` after the point.
fn cell(value: Option<f64>, digits: usize) -> Markup {
    html! {
        @match value {
            Some(value) => td { (minus(&format!("{value:.digits$}"))) },
            None => (no_figure()),
        }
    }
}

fn no_figure() -> Markup {
    html! { td.none { "–" } }
}

/// With a proper minus sign.
fn minus(text: &str) -> String {
    text.replace('-', "−")
}

/// A change in percentage points with its confidence interval as a tooltip.
fn change(difference: Option<Difference>) -> Markup {
    let Some(difference) = difference else {
        return no_figure();
    };
    let class = if difference.mean < 0.0 {
        "worse"
    } else {
        "better"
    };
    let hint = difference.t.map(|t| {
        format!(
            "95 % confidence interval {:+.2} to {:+.2} pp",
            t.lower * 100.0,
            t.upper * 100.0
        )
    });
    let text = minus(&format!("{:+.2}", difference.mean * 100.0));
    html! { td class=(class) title=[hint] { (text) } }
}

/// The p-value, where any policy has one: a single clip has none.
fn test(difference: Option<Difference>, shown: bool) -> Markup {
    let p = difference.and_then(|difference| difference.t).map(|t| t.p);
    html! {
        @if shown && p.is_some() {
            td { (p_value(p)) }
        } @else if shown {
            (no_figure())
        }
    }
}

/// A word where figures were not measured.
fn badge(provenance: Provenance) -> Markup {
    let word = match provenance {
        Provenance::Measured => return Markup::default(),
        Provenance::Estimated => "estimated",
        Provenance::Composed => "composed",
        Provenance::Projected => "projected",
    };
    html! { " " small { (word) } }
}

/// A table that is sorted by a click on a column's head.
fn sortable(head: &Markup, rows: &Markup) -> Markup {
    html! {
        div.wide {
            table.sortable {
                thead { tr { (head) } }
                tbody { (rows) }
            }
        }
    }
}

fn policies(summaries: &[PolicySummary]) -> Markup {
    let energy = summaries.iter().find_map(|summary| summary.energy);
    let time = summaries.iter().find_map(|summary| summary.frame_time_ms);
    let before = summaries
        .iter()
        .find(|summary| summary.policy == BASELINE)
        .and_then(|summary| summary.energy);
    let told = Told::of(summaries);
    let head = html! {
        th { "Policy" } th { "Skipped %" } th { "Detector calls" }
        @if told.accuracy { th { "AP@50" } th { "Δ pp" } }
        @if told.tests { th { "p" } }
        @if told.several { th { "Clips kept" } }
        @if told.accuracy { th { "mAP" } th { "Δ pp" } th { "AP@75" } th { "F1@50" } th { "HOTA" } th { "IDF1" } th { "Precision" } th { "Recall" } }
        @if let Some((_, kind)) = time {
            th { "Frame ms" (badge(kind)) }
        }
        @if let Some(energy) = energy {
            th { "Energy J" (badge(energy.provenance)) }
            th { "EDP J·ms" (badge(energy.provenance)) }
            th { "Δ EDP %" }
        }
    };
    let rows = html! {
        @for summary in summaries {
            tr class=[(summary.policy == BASELINE).then_some("baseline")] {
                (policy_cells(summary, told))
                @if time.is_some() {
                    (cell(summary.frame_time_ms.map(|time| time.0), 2))
                }
                @if energy.is_some() {
                    (cell(summary.energy.map(|energy| energy.joules), 1))
                    (cell(summary.energy.map(|energy| energy.edp), 0))
                    (cell(edp_change(summary, before), 1))
                }
            }
        }
    };
    let first = summaries.first();
    let clips = first.map_or(0, |summary| summary.clips);
    let without = first.map_or(0, |summary| summary.clips_without_truth);
    html! {
        section {
            h2 { "Policies" }
            (sortable(&head, &rows))
            p.legend {
                "Unweighted means over " (clips) " clip" @if clips != 1 { "s" }
                @if without > 0 { "; " (without) " without ground truth are not in them" }
                ". "
                @if told.accuracy { "Δ against Vanilla, clip by clip. " }
                @if told.tests { "p: paired t-test, two-sided. " }
                @if told.several { "Clips kept: same or better AP@50. " }
                "★ no other skips as much and is as accurate. Click a column's head to sort."
            }
        }
    }
}

/// Which columns say anything.
#[derive(Clone, Copy)]
struct Told {
    accuracy: bool,
    tests: bool,
    several: bool,
}

impl Told {
    fn of(summaries: &[PolicySummary]) -> Self {
        let ap50 = |summary: &PolicySummary| summary.against_baseline.and_then(|found| found.ap50);
        let accuracy = summaries.iter().any(|summary| summary.ap50.is_some());
        Self {
            accuracy,
            tests: (summaries.iter())
                .filter_map(ap50)
                .any(|found| found.clips > 1 && found.t.is_some()),
            several: accuracy && summaries.iter().any(|summary| summary.clips > 1),
        }
    }
}

/// The cells that every policy has, measured time and energy or not.
fn policy_cells(summary: &PolicySummary, told: Told) -> Markup {
    let against = summary.against_baseline;
    let ap50 = against.and_then(|against| against.ap50);
    let kept = against
        .filter(|_| ap50.is_some())
        .map(|against| format!("{} of {}", against.clips_keeping_ap50, summary.clips));
    html! {
        th scope="row" {
            (short(&summary.policy))
            @if summary.on_skip_frontier {
                " " span.star title="No other skips as much and is as accurate" { "★" }
            }
        }
        (cell(Some(summary.skip_rate * 100.0), 1))
        (cell(Some(summary.detector_frames), 1))
        @if told.accuracy {
            (cell(summary.ap50, 4))
            (change(ap50))
        }
        (test(ap50, told.tests))
        @if told.several {
            td { (kept.as_deref().unwrap_or("–")) }
        }
        @if told.accuracy {
            (cell(summary.map, 4))
            (change(against.and_then(|against| against.map)))
            (cell(summary.ap75, 4))
            (cell(summary.f1_50, 4))
            (cell(summary.hota, 4))
            (cell(summary.idf1, 4))
            (cell(summary.precision, 3))
            (cell(summary.recall, 3))
        }
    }
}

/// How much of the baseline's EDP is saved or lost, percent, where both come about alike.
fn edp_change(summary: &PolicySummary, before: Option<EnergySummary>) -> Option<f64> {
    summary
        .energy
        .zip(before)
        .filter(|(own, before)| own.provenance == before.provenance)
        .map(|(own, before)| (own.edp / before.edp - 1.0) * 100.0)
        .filter(|_| summary.policy != BASELINE)
}

/// AP@50 by class, where there is more than one.
fn classes(summaries: &[PolicySummary]) -> Markup {
    let names: BTreeSet<&String> = summaries
        .iter()
        .flat_map(|summary| summary.ap50_by_class.keys())
        .collect();
    if names.len() < 2 {
        return Markup::default();
    }
    let head = html! {
        th { "Policy" }
        @for name in &names { th { (name) } }
    };
    let rows = html! {
        @for summary in summaries {
            tr {
                th scope="row" { (short(&summary.policy)) }
                @for name in &names {
                    (cell(summary.ap50_by_class.get(*name).copied(), 4))
                }
            }
        }
    };
    html! {
        section {
            h2 { "AP@50 by class" }
            (sortable(&head, &rows))
            p.legend { "Each class judged by itself; mean over the clips that show it." }
        }
    }
}

fn clips(results: &[ClipResult]) -> Markup {
    let baseline: HashMap<&str, &ClipResult> = results
        .iter()
        .filter(|result| result.policy == BASELINE)
        .map(|result| (result.clip.as_str(), result))
        .collect();
    let difference = |result: &ClipResult| {
        let before = baseline.get(result.clip.as_str())?.accuracy?;
        let own = result.accuracy.filter(|_| result.policy != BASELINE)?;
        Some((own.ap50 - before.ap50) * 100.0)
    };
    let head = html! {
        th { "Clip" } th { "Policy" } th { "Frames" } th { "Skipped %" } th { "AP@50" } th { "Δ pp" }
        th { "mAP" } th { "Boxes" } th { "Truth" }
    };
    let rows = html! {
        @for result in results {
            tr {
                th scope="row" { (result.clip) }
                td.text { (short(&result.policy)) }
                td { (result.frames) }
                (cell(Some(result.skip_rate() * 100.0), 1))
                (cell(result.accuracy.map(|accuracy| accuracy.ap50), 4))
                (cell(difference(result), 2))
                (cell(result.accuracy.map(|accuracy| accuracy.map), 4))
                td { (result.boxes) }
                (cell(result.accuracy.map(|accuracy| accuracy.truths as f64), 0))
            }
        }
    };
    html! {
        section {
            h2 { "Clips" }
            details {
                summary { "Every clip under every policy" }
                (sortable(&head, &rows))
            }
        }
    }
}
