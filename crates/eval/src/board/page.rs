//! Renders `join.html`: all tables and figures on one page that loads no other file and prints well.

use super::run::SetupRuns;
use super::summary::SetupSummary;
use super::table::{JoinedTable, tables};
use crate::chart::Plot;
use crate::report::STYLE;
use crate::text::Column;
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// Renders the page.
pub(super) fn render(setups: &[SetupRuns], summaries: &[SetupSummary], figures: &[Plot]) -> String {
    let titles: Vec<&str> = summaries.iter().map(|summary| summary.title.as_str()).collect();
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { "Albireo, measured: " (titles.join("; ")) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                main {
                    header {
                        p.kicker { "Albireo, measured on the machine" }
                        h1 { (titles.join("; ")) }
                    }
                    @for found in tables(setups, summaries) { (table(&found)) }
                    @for figure in figures {
                        section {
                            h2 { (figure.title) }
                            figure.plot {
                                (PreEscaped(&figure.svg))
                                figcaption { (figure.caption) }
                            }
                        }
                    }
                    footer {
                        p {
                            "Made by albireo " (env!("CARGO_PKG_VERSION")) ". The same figures are in " code { "policies.csv" }
                            ", each run's in " code { "clips.csv" } "."
                        }
                    }
                }
            }
        }
    };
    page.into_string()
}

fn table(found: &JoinedTable) -> Markup {
    let Some((names, others)) = found.columns.split_first() else {
        return Markup::default();
    };
    let head = |column: &Column| column.heads.join(" ").trim().to_owned();
    html! {
        section {
            h2 { (found.title) }
            div.wide {
                table {
                    thead { tr { th { (head(names)) } @for column in others { th { (head(column)) } } } }
                    tbody {
                        @for (row, name) in names.cells.iter().enumerate() {
                            tr {
                                th scope="row" { (name) }
                                @for column in others { td { (column.cells[row].replace(" -", " −")) } }
                            }
                        }
                    }
                }
            }
            @if !found.notes.is_empty() { p.legend { (found.notes.join(" ")) } }
        }
    }
}
