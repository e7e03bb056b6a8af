//! Renders `report.html`: tables and figures on one page that loads no other file.

use super::Report;
use super::conclusion::conclusion;
use super::table::{below, columns, notes};
use super::worst;
use crate::chart::Plot;
use crate::result::ClipResult;
use crate::spec::{BASELINE, short_label};
use crate::summary::PolicySummary;
use crate::text::{Column, counted, or_dash};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use std::collections::{BTreeSet, HashMap};

/// The name of the setting that says by what clips were judged.
const JUDGED: &str = "Judged";

const STYLE: &str = include_str!("report.css");
const SCRIPT: &str = include_str!("report.js");

/// Renders the page.
pub(super) fn render(report: &Report, plots: &[Plot]) -> String {
    let content = html! {
        main {
            header {
                p.kicker { "Albireo evaluation" }
                h1 { (report.title) }
                (concluded(report))
            }
            (figures(plots))
            (worst::frames(&report.clips, truth(report)))
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
    };
    document(&format!("Albireo evaluation: {}", report.title), &content)
}

/// Renders a page that loads no other file.
pub(crate) fn document(title: &str, content: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body { (content) }
        }
    };
    page.into_string()
}

/// Renders each figure in a section of its own.
pub(crate) fn figures(plots: &[Plot]) -> Markup {
    html! {
        @for plot in plots {
            section {
                h2 { (plot.title) }
                figure.plot {
                    (PreEscaped(&plot.svg))
                    figcaption { (plot.caption) }
                }
            }
        }
    }
}

/// How the clips were judged, if somebody noted it.
fn judged(report: &Report) -> Option<&str> {
    report
        .settings
        .iter()
        .find(|(name, _)| name == JUDGED)
        .map(|(_, how)| how.as_str())
}

/// Names the boxes by which the clips were judged.
fn truth(report: &Report) -> &'static str {
    match judged(report) {
        Some(how) if how.contains("its own output") => "the detector's own boxes",
        _ => "ground truth",
    }
}

/// Renders what comes first: how the clips were judged, then the conclusion.
fn concluded(report: &Report) -> Markup {
    html! {
        div.conclusion {
            @if let Some(how) = judged(report) { p { "Judged " (how) "." } }
            @for sentence in conclusion(&report.policies) { p { (sentence.replace(" -", " −")) } }
        }
    }
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
                    "About the data: " (counted(lines.len(), "remark"))
                }
                ul {
                    @for line in &lines { li { (line) } }
                }
            }
        }
    }
}

/// Renders a cell of a table; `-` is a figure that does not exist.
fn cell(text: &str) -> Markup {
    html! {
        @if text == "-" {
            td.none { "–" }
        } @else if text.starts_with(char::is_alphabetic) {
            td.text { (text) }
        } @else {
            td { (text.replace('-', "−")) }
        }
    }
}

/// Renders a table that a click on a column's heading sorts; the first column names the rows.
fn sortable(columns: &[Column]) -> Markup {
    let Some((names, others)) = columns.split_first() else {
        return Markup::default();
    };
    html! {
        div.wide {
            table.sortable {
                thead { tr { @for column in columns { th { (column.heads.join(" ").trim()) } } } }
                tbody {
                    @for (row, name) in names.cells.iter().enumerate() {
                        tr class=[name.starts_with(BASELINE).then_some("baseline")] {
                            th scope="row" { (name) }
                            @for column in others { (cell(&column.cells[row])) }
                        }
                    }
                }
            }
        }
    }
}

fn policies(summaries: &[PolicySummary]) -> Markup {
    html! {
        section {
            h2 { "Policies" }
            (sortable(&columns(summaries)))
            p.legend { (notes(summaries).join(" ")) " Click a column's head to sort." }
            @for (title, columns) in below(summaries) {
                h3 { (title) }
                (sortable(&columns))
            }
        }
    }
}

/// Renders AP@50 by class, if there is more than one.
fn classes(summaries: &[PolicySummary]) -> Markup {
    let names: BTreeSet<&String> =
        summaries.iter().flat_map(|summary| summary.ap50_by_class.keys()).collect();
    if names.len() < 2 {
        return Markup::default();
    }
    let policies = summaries
        .iter()
        .map(|summary| short_label(&summary.policy))
        .map(str::to_owned)
        .collect();
    let mut columns = vec![Column::new(["Policy", ""], policies)];
    for name in names {
        let ap50 = |summary: &PolicySummary| figure(summary.ap50_by_class.get(name).copied(), 4);
        let cells = summaries.iter().map(ap50).collect();
        columns.push(Column::new([name, ""], cells));
    }
    html! {
        section {
            h2 { "AP@50 by class" }
            (sortable(&columns))
            p.legend { "Each class is judged separately; mean over the clips that show it." }
        }
    }
}

/// Formats a figure with this many decimals, or as `-` if it does not exist.
fn figure(value: Option<f64>, digits: usize) -> String {
    or_dash(value.map(|value| format!("{value:.digits$}")))
}

fn clips(results: &[ClipResult]) -> Markup {
    let baseline: HashMap<&str, &ClipResult> = results
        .iter()
        .filter(|result| result.policy == BASELINE)
        .map(|result| (result.clip.as_str(), result))
        .collect();
    let difference = |result: &ClipResult| {
        if result.policy == BASELINE {
            return None;
        }
        let before = baseline.get(result.clip.as_str())?.accuracy?;
        let own = result.accuracy?;
        Some((own.ap50 - before.ap50) * 100.0)
    };
    let column = |head: &str, cell: &dyn Fn(&ClipResult) -> String| {
        Column::new([head, ""], results.iter().map(cell).collect())
    };
    let columns = [
        column("Clip", &|result| result.clip.clone()),
        column("Policy", &|result| short_label(&result.policy).to_owned()),
        column("Frames", &|result| result.frames.to_string()),
        column("Skipped %", &|result| {
            figure(Some(result.skip_rate() * 100.0), 1)
        }),
        column("AP@50", &|result| {
            figure(result.accuracy.map(|found| found.ap50), 4)
        }),
        column("Δ pp", &|result| figure(difference(result), 2)),
        column("mAP", &|result| {
            figure(result.accuracy.map(|found| found.map), 4)
        }),
        column("Boxes", &|result| result.boxes.to_string()),
        column("Truth", &|result| {
            figure(result.accuracy.map(|found| found.truths as f64), 0)
        }),
    ];
    html! {
        section {
            h2 { "Clips" }
            details {
                summary { "Every clip under every policy" }
                (sortable(&columns))
            }
        }
    }
}
