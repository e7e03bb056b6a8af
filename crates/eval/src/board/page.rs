//! Renders `join.html`: all tables and figures on one page that loads no other file and prints well.

use super::run::SetupRuns;
use super::summary::SetupSummary;
use super::table::{JoinedTable, tables};
use crate::chart::Plot;
use crate::report::{document, figures};
use crate::text::Column;
use maud::{Markup, html};

/// Renders the page.
pub(super) fn render(setups: &[SetupRuns], summaries: &[SetupSummary], plots: &[Plot]) -> String {
    let setup_titles: Vec<&str> = summaries.iter().map(|summary| summary.title.as_str()).collect();
    let title = setup_titles.join("; ");
    let content = html! {
        main {
            header {
                p.kicker { "Albireo, measured on the machine" }
                h1 { (title) }
            }
            @for found in tables(setups, summaries) { (table(&found)) }
            (figures(plots))
            footer {
                p {
                    "Made by albireo " (env!("CARGO_PKG_VERSION")) ". The same figures are in " code { "policies.csv" }
                    ", each run's in " code { "clips.csv" } ", the power over the first clips in " code { "power.csv" }
                    ", and the settings of the measurement in " code { "settings.csv" } "."
                }
            }
        }
    };
    document(&format!("Albireo, measured: {title}"), &content)
}

fn table(found: &JoinedTable) -> Markup {
    let Some((names, others)) = found.columns.split_first() else {
        return html! {
            section {
                h2 { (found.title) }
                ul.legend { @for note in &found.notes { li { (note) } } }
            }
        };
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
