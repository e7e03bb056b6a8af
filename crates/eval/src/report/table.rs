//! Formats the table of a run for a terminal, and its columns for the HTML report.

use crate::result::Provenance;
use crate::spec::short_label;
use crate::summary::{Difference, PolicySummary};
use crate::text::{self, Column, or_dash, three_decimals, wrapped};
use albireo_core::policy::FrameState;

/// Maximum width of the table in characters.
pub(crate) const WIDTH: usize = 100;

/// Formats the table with one line per policy. Columns that do not fit are left out, and a note names them.
pub fn render(summaries: &[PolicySummary]) -> String {
    let mut columns = ranked(summaries);
    let mut left_out = Vec::new();
    let width = |(_, column): &(u8, Column)| column.width() + 1;
    while columns.iter().map(width).sum::<usize>() > WIDTH + 1 {
        let Some(index) = (1..columns.len()).max_by_key(|&index| (columns[index].0, index)) else {
            break;
        };
        left_out.push(columns.remove(index).1.heads.join(" "));
    }
    let mut text = text::table(columns.iter().map(|(_, column)| column), " ");
    let mut notes = notes(summaries);
    if !left_out.is_empty() {
        let names: Vec<_> = left_out.iter().map(|name| name.trim()).collect();
        notes.push(format!(
            "Left out for width: {}; the files of --out have them.",
            names.join(", ")
        ));
    }
    for note in notes {
        text.push_str(&wrapped(&note, WIDTH));
        text.push('\n');
    }
    text
}

/// Returns the columns for which at least one policy has a figure. The first one names the policies, with `*` for those on
/// the Pareto frontier of AP@50 and skip rate.
pub(crate) fn columns(summaries: &[PolicySummary]) -> Vec<Column> {
    let ranked = ranked(summaries).into_iter();
    ranked.map(|(_, column)| column).collect()
}

/// Returns the same columns with ranks; the highest rank is left out first if the table is too wide.
fn ranked(summaries: &[PolicySummary]) -> Vec<(u8, Column)> {
    let column = |heads: [&str; 2], rank: u8, cell: &dyn Fn(&PolicySummary) -> String| {
        let cells = summaries.iter().map(cell).collect();
        (rank, Column::new(heads, cells))
    };
    let change = |difference: Option<Difference>| {
        or_dash(difference.map(|found| format!("{:+.1}", found.mean * 100.0)))
    };
    let interval = |difference: Option<Difference>| {
        or_dash(
            difference
                .and_then(|found| found.interval)
                .map(|[from, to]| format!("[{:+.1}, {:+.1}]", from * 100.0, to * 100.0)),
        )
    };
    let mut columns = vec![
        column(["", "policy"], 0, &|s| {
            let star = if s.on_skip_frontier { "*" } else { "" };
            format!("{}{star}", short_label(&s.policy))
        }),
        column(["skip", "%"], 0, &|s| percent(s.skip_rate)),
    ];
    for (at, state) in FrameState::ALL.into_iter().enumerate() {
        columns.push(column([state.as_str(), "%"], 0, &|s| percent(s.states[at])));
    }
    columns.extend([
        column(["AP@50", ""], 0, &|s| three_decimals(s.ap50)),
        column(["AP@50", "all"], 0, &|s| three_decimals(s.ap50_all)),
        column(["Δ", "pp"], 0, &|s| change(s.ap50_change)),
        column(["95 %", "pp"], 1, &|s| interval(s.ap50_change)),
        column(["mAP", ""], 0, &|s| three_decimals(s.map)),
        column(["Δ", "pp"], 3, &|s| change(s.map_change)),
        column(["AP@75", ""], 1, &|s| three_decimals(s.ap75)),
        column(["F1@50", ">=.3"], 1, &|s| three_decimals(s.f1_50_shown)),
        column(["HOTA", ">=.3"], 2, &|s| three_decimals(s.hota)),
        column(["IDF1", ">=.3"], 4, &|s| three_decimals(s.idf1)),
        column(["time", "ms"], 4, &|s| {
            or_dash(s.frame_time_ms.map(|(time, kind)| {
                let mark = match kind {
                    Provenance::Composed => "c",
                    Provenance::Projected => "p",
                };
                format!("{time:.1}{mark}")
            }))
        }),
        column(["energy", "J"], 3, &|s| {
            or_dash(s.energy.map(|energy| format!("{:.0}p", energy.joules)))
        }),
        column(["EDP", "J·ms"], 4, &|s| {
            or_dash(s.energy.map(|energy| format!("{:.0}p", energy.edp)))
        }),
    ]);
    columns.retain(|(_, column)| column.cells.iter().any(|cell| cell != "-"));
    columns
}

fn percent(share: f64) -> String {
    format!("{:.1}", share * 100.0)
}

/// Returns notes that explain the table.
pub(crate) fn notes(summaries: &[PolicySummary]) -> Vec<String> {
    let first = summaries.first();
    let clips = first.map_or(0, |summary| summary.clips);
    let without = first.map_or(0, |summary| summary.clips_without_truth);
    let mut notes = vec![format!(
        "Unweighted means over {clips} clip{}; Δ and its 95 % interval (paired t) against vanilla, clip by clip. \
         * no other skips as much and is as accurate.",
        if clips == 1 { "" } else { "s" }
    )];
    if without > 0 {
        let (clips, are) = if without == 1 {
            ("clip", "is")
        } else {
            ("clips", "are")
        };
        notes.push(format!(
            "{without} {clips} without ground truth {are} not in the means."
        ));
    }
    if summaries.iter().any(|summary| summary.ap50_all.is_some()) {
        notes.push(
            "Boxes are judged as a node publishes them; AP@50 all: every box of the policy, however faint."
                .to_owned(),
        );
    }
    let times = || summaries.iter().filter_map(|summary| summary.frame_time_ms);
    let energy = summaries.iter().any(|summary| summary.energy.is_some());
    if energy || times().any(|(_, kind)| kind == Provenance::Projected) {
        notes.push("p: projected from an energy model, not measured.".to_owned());
    }
    if times().any(|(_, kind)| kind == Provenance::Composed) {
        notes.push("c: composed of the times measured for each step on each frame.".to_owned());
    }
    notes
}
