//! The table of a run for a terminal, at most [`WIDTH`] columns wide.

use crate::result::Provenance;
use crate::summary::{Difference, PolicySummary};
use crate::text::wrapped;
use std::fmt::Write;

/// Columns a table may take.
pub(crate) const WIDTH: usize = 100;

/// A column: its two header lines and its cells. Columns with a high rank give way when the table would be
/// too wide.
struct Column {
    heads: [&'static str; 2],
    cells: Vec<String>,
    rank: u8,
}

impl Column {
    fn width(&self) -> usize {
        let heads = self.heads.iter().map(|head| head.chars().count());
        let cells = self.cells.iter().map(|cell| cell.chars().count());
        heads.chain(cells).max().unwrap_or(0)
    }
}

/// The table: one line a policy, `*` marks who is on the AP@50-skip frontier.
pub fn render(summaries: &[PolicySummary]) -> String {
    let mut columns = columns(summaries);
    // A column nobody has a figure for says nothing.
    columns.retain(|column| column.cells.iter().any(|cell| cell != "-"));
    let mut left_out = Vec::new();
    while width(&columns) > WIDTH {
        let Some(index) = (1..columns.len()).max_by_key(|&index| (columns[index].rank, index))
        else {
            break;
        };
        left_out.push(columns.remove(index).heads.join(" "));
    }
    let mut text = String::new();
    for line in 0..2 {
        let cells = columns.iter().map(|column| column.heads[line]);
        write_line(&mut text, &columns, cells);
    }
    for row in 0..summaries.len() {
        let cells = columns.iter().map(|column| column.cells[row].as_str());
        write_line(&mut text, &columns, cells);
    }
    foot(&mut text, summaries, &left_out);
    text
}

fn width(columns: &[Column]) -> usize {
    columns
        .iter()
        .map(|column| column.width() + 1)
        .sum::<usize>()
        - 1
}

fn write_line<'a>(text: &mut String, columns: &[Column], cells: impl Iterator<Item = &'a str>) {
    let mut line = String::new();
    for (index, (column, cell)) in columns.iter().zip(cells).enumerate() {
        let width = column.width();
        // Writing to a string cannot fail.
        let _ = if index == 0 {
            write!(line, "{cell:<width$}")
        } else {
            write!(line, " {cell:>width$}")
        };
    }
    text.push_str(line.trim_end());
    text.push('\n');
}

fn columns(summaries: &[PolicySummary]) -> Vec<Column> {
    let column = |heads, rank, cell: &dyn Fn(&PolicySummary) -> String| Column {
        heads,
        cells: summaries.iter().map(cell).collect(),
        rank,
    };
    let against = |summary: &PolicySummary| summary.against_baseline;
    let change = |difference: Option<Difference>| {
        difference.map_or("-".to_owned(), |difference| {
            format!("{:+.1}", difference.mean * 100.0)
        })
    };
    let ap50 = |summary: &PolicySummary| against(summary).and_then(|against| against.ap50);
    let mut columns = vec![
        column(["", "policy"], 0, &|s| {
            format!(
                "{}{}",
                short(&s.policy),
                if s.on_skip_frontier { "*" } else { "" }
            )
        }),
        column(["skip", "%"], 0, &|s| percent(s.skip_rate)),
    ];
    let names = [
        ["E", "%"],
        ["P", "%"],
        ["E+I", "%"],
        ["I", "%"],
        ["AI", "%"],
    ];
    for (state, heads) in names.into_iter().enumerate() {
        columns.push(column(heads, 0, &|s| percent(s.states[state])));
    }
    columns.extend([
        column(["AP@50", ""], 0, &|s| three(s.ap50)),
        column(["Δ", "pp"], 0, &|s| change(ap50(s))),
        column(["p", "t"], 3, &|s| {
            p_value(ap50(s).and_then(|d| d.t).map(|t| t.p))
        }),
        column(["kept", "clips"], 1, &|s| {
            against(s)
                .filter(|against| against.ap50.is_some())
                .map_or("-".to_owned(), |against| {
                    format!("{}/{}", against.clips_keeping_ap50, s.clips)
                })
        }),
        column(["mAP", ""], 0, &|s| three(s.map)),
        column(["Δ", "pp"], 2, &|s| change(against(s).and_then(|a| a.map))),
        column(["AP@75", ""], 2, &|s| three(s.ap75)),
        column(["F1@50", ""], 5, &|s| three(s.f1_50)),
        column(["F1@50", ">=.3"], 1, &|s| three(s.f1_50_shown)),
        column(["HOTA", ">=.3"], 2, &|s| three(s.hota)),
        column(["IDF1", ">=.3"], 4, &|s| three(s.idf1)),
        column(["prec.", ""], 6, &|s| three(s.precision)),
        column(["recall", ""], 6, &|s| three(s.recall)),
        column(["time", "ms"], 4, &|s| {
            s.frame_time_ms.map_or("-".to_owned(), |(time, kind)| {
                format!("{time:.1}{}", mark(kind))
            })
        }),
        column(["energy", "J"], 3, &|s| {
            s.energy.map_or("-".to_owned(), |energy| {
                format!("{:.0}{}", energy.joules, mark(energy.provenance))
            })
        }),
        column(["EDP", "J·ms"], 4, &|s| {
            s.energy.map_or("-".to_owned(), |energy| {
                format!("{:.0}{}", energy.edp, mark(energy.provenance))
            })
        }),
    ]);
    columns
}

/// Marks figures that no meter showed.
fn mark(provenance: Provenance) -> &'static str {
    match provenance {
        Provenance::Measured => "",
        Provenance::Estimated => "e",
        Provenance::Composed => "c",
        Provenance::Projected => "p",
    }
}

/// The label without the part that all policies of a run share.
pub(super) fn short(label: &str) -> &str {
    label.split_once("-erd-").map_or(label, |(start, _)| start)
}

fn percent(share: f64) -> String {
    format!("{:.1}", share * 100.0)
}

fn three(value: Option<f64>) -> String {
    value.map_or("-".to_owned(), |value| format!("{value:.3}"))
}

/// A p-value in at most five characters.
pub(super) fn p_value(p: Option<f64>) -> String {
    match p {
        None => "-".to_owned(),
        Some(p) if p < 0.001 => "<.001".to_owned(),
        Some(p) => format!("{p:.3}").trim_start_matches('0').to_owned(),
    }
}

fn foot(text: &mut String, summaries: &[PolicySummary], left_out: &[String]) {
    let first = summaries.first();
    let clips = first.map_or(0, |summary| summary.clips);
    let without = first.map_or(0, |summary| summary.clips_without_truth);
    let mut notes = vec![format!(
        "Unweighted means over {clips} clip{}; Δ and p (paired t) against vanilla, clip by clip. \
         * no other skips as much and is as accurate.",
        if clips == 1 { "" } else { "s" }
    )];
    match without {
        0 => {}
        1 => notes.push("1 clip has no ground truth and is not in the means.".to_owned()),
        _ => notes.push(format!(
            "{without} clips have no ground truth and are not in the means."
        )),
    }
    let kinds: Vec<Provenance> = summaries
        .iter()
        .flat_map(|s| [s.energy.map(|e| e.provenance), s.frame_time_ms.map(|t| t.1)])
        .flatten()
        .collect();
    if kinds.contains(&Provenance::Projected) {
        notes.push("p: projected from an energy model, not measured.".to_owned());
    }
    if kinds.contains(&Provenance::Estimated) {
        notes.push("e: estimated by a meter that does not see everything.".to_owned());
    }
    if kinds.contains(&Provenance::Composed) {
        notes.push("c: composed of the times measured for each step on each frame.".to_owned());
    }
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
}
