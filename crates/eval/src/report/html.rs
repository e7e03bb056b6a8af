//! `report.html`: tables and figures in one page that loads nothing.

use super::Report;
use super::plot::Figure;
use super::worst;
use crate::conclusion::conclusion;
use crate::result::ClipResult;
use crate::spec::BASELINE;
use crate::summary::PolicySummary;
use crate::table::{columns, notes, short};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use std::collections::{BTreeSet, HashMap};

const STYLE: &str = include_str!("report.css");
const SCRIPT: &str = include_str!("report.js");

/// The page.
pub(super) fn render(report: &Report, figures: &[Figure]) -> String {
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
                    @for figure in figures {
                        section {
                            h2 { (figure.title) }
                            figure.plot {
                                (PreEscaped(&figure.svg))
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
    text_cell(&value.map_or("-".to_owned(), |value| format!("{value:.digits$}")))
}

/// A cell of the table, `-` for a figure that does not exist.
fn text_cell(text: &str) -> Markup {
    html! {
        @if text == "-" { td.none { "–" } } @else { td { (text.replace('-', "−")) } }
    }
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
    let columns = columns(summaries);
    let (names, figures) = columns.split_at(1.min(columns.len()));
    let head = html! {
        @for column in &columns { th { (column.heads.join(" ").trim()) } }
    };
    let rows = html! {
        @for (row, summary) in summaries.iter().enumerate() {
            tr class=[(summary.policy == BASELINE).then_some("baseline")] {
                @for column in names { th scope="row" { (column.cells[row]) } }
                @for column in figures { (text_cell(&column.cells[row])) }
            }
        }
    };
    html! {
        section {
            h2 { "Policies" }
            (sortable(&head, &rows))
            p.legend { (notes(summaries).join(" ")) " Click a column's head to sort." }
        }
    }
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
