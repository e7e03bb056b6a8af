//! Formats the table of a run for a terminal, and its columns for the HTML report.

use crate::result::Provenance;
use crate::spec::{BASELINE, short_label};
use crate::summary::{Difference, NEWCOMERS, PolicySummary, Pooled};
use crate::text::{
    Column, counted, fitted, one_decimal, or_dash, three_decimals, two_decimals, wrapped,
};
use albireo_core::policy::FrameState;

/// Formats the tables of a run, at most `width` characters wide: the figures with one line per policy, and those below
/// them.
pub fn render(summaries: &[PolicySummary], width: usize) -> String {
    let mut text = figures(summaries, width);
    for (title, columns) in below(summaries) {
        text.push('\n');
        text.push_str(&wrapped(&title, width));
        text.push('\n');
        text.push_str(&fitted(&columns, "  ", width));
    }
    text
}

/// Formats the table of the figures. Columns with a rank that do not fit are left out, and a note names them; others
/// that do not fit follow below.
fn figures(summaries: &[PolicySummary], width: usize) -> String {
    let mut columns = ranked(summaries);
    let mut left_out = Vec::new();
    let with_gap = |ranked: &RankedColumn| ranked.column.width() + 1;
    while columns.iter().map(with_gap).sum::<usize>() > width + 1 {
        // Of equal ranks the last.
        let can_go = (1..columns.len()).filter(|&index| columns[index].rank > 0);
        let Some(index) = can_go.max_by_key(|&index| (columns[index].rank, index)) else {
            break;
        };
        let gone = columns.remove(index);
        left_out.push(gone.column.heads.join(" "));
    }
    let kept: Vec<Column> = columns.into_iter().map(|ranked| ranked.column).collect();
    let mut text = fitted(&kept, " ", width);
    let mut notes = notes(summaries);
    if !left_out.is_empty() {
        let names: Vec<_> = left_out.iter().map(|name| name.trim()).collect();
        notes.push(format!(
            "Left out for width: {}; the files of --out have them.",
            names.join(", ")
        ));
    }
    for note in notes {
        text.push_str(&wrapped(&note, width));
        text.push('\n');
    }
    text
}

/// Returns the tables below the figures, each with its title: the differences to the baseline, and the pooled figures.
pub(crate) fn below(summaries: &[PolicySummary]) -> Vec<(String, Vec<Column>)> {
    differences(summaries).into_iter().chain(pooled(summaries)).collect()
}

/// Returns the table of the figures over all frames; `None` for one clip, and without ground truth.
fn pooled(summaries: &[PolicySummary]) -> Option<(String, Vec<Column>)> {
    let first = summaries.first()?;
    let known = first.pooled?;
    let column = |head: &str, cell: &dyn Fn(Pooled) -> String| {
        let cells = summaries.iter().map(|summary| or_dash(summary.pooled.map(cell))).collect();
        Column::new([head, ""], cells)
    };
    let names = summaries
        .iter()
        .map(|summary| short_label(&summary.policy).to_owned())
        .collect();
    let mut columns = vec![
        Column::new(["policy", ""], names),
        column("skip %", &|pooled| percent(pooled.skip_rate)),
        column("AP@50", &|pooled| format!("{:.3}", pooled.ap50)),
        column("mAP", &|pooled| format!("{:.3}", pooled.map)),
    ];
    let mut title = format!(
        "Pooled: the {} clips as one, boxes as a node publishes them; {} frames, {} boxes of the ground truth",
        first.clips, first.frames, known.truths
    );
    if known.objects > 0 {
        title.push_str(&format!(", {} objects", known.objects));
        columns.push(column("new, frames", &|pooled| {
            two_decimals(pooled.delay_frames)
        }));
        columns.push(column("never", &|pooled| pooled.never_found.to_string()));
    }
    Some((title, columns))
}

/// Returns the tables of the differences to the baseline, each with its title: of the boxes that a node publishes, then
/// of all boxes. A table without a figure is left out.
fn differences(summaries: &[PolicySummary]) -> Vec<(String, Vec<Column>)> {
    let others: Vec<&PolicySummary> =
        summaries.iter().filter(|summary| summary.policy != BASELINE).collect();
    let Some(first) = others.first() else {
        return Vec::new();
    };
    let column = |head: &str, cell: &dyn Fn(&PolicySummary) -> String| {
        Column::new(
            [head, ""],
            others.iter().map(|summary| cell(summary)).collect(),
        )
    };
    let policy = || column("policy", &|summary| short_label(&summary.policy).to_owned());
    let points = |difference: Option<Difference>| {
        or_dash(difference.map(|found| found.scaled(100.0).text(1)))
    };
    let p = |difference: Option<Difference>| or_dash(difference.map(Difference::p_text));
    let as_published = vec![
        policy(),
        column("AP@50", &|summary| points(summary.ap50_change)),
        column("p", &|summary| p(summary.ap50_change)),
        column("mAP", &|summary| points(summary.map_change)),
        column("p", &|summary| p(summary.map_change)),
        column("new, frames", &|summary| {
            or_dash(summary.newcomers_change.map(|found| found.text(2)))
        }),
    ];
    let all_boxes = vec![
        policy(),
        column("AP@50", &|summary| points(summary.ap50_all_change)),
        column("p", &|summary| p(summary.ap50_all_change)),
        column("mAP", &|summary| points(summary.map_all_change)),
        column("p", &|summary| p(summary.map_all_change)),
    ];
    let how = format!(
        "points with 95 % intervals and p (paired t, {})",
        counted(first.clips, "clip")
    );
    let both = [
        (
            format!("Differences to vanilla, boxes as a node publishes them; {how}"),
            as_published,
        ),
        (
            format!("Differences to vanilla, all boxes, however faint; {how}"),
            all_boxes,
        ),
    ];
    let mut tables = Vec::new();
    for (title, mut columns) in both {
        columns.retain(|column| column.cells.iter().any(|cell| cell != "-"));
        if columns.len() > 1 {
            tables.push((title, columns));
        }
    }
    tables
}

/// Returns the columns for which at least one policy has a figure. The first one names the policies, with `*` for those
/// on the Pareto frontier of AP@50 and skip rate.
pub(crate) fn columns(summaries: &[PolicySummary]) -> Vec<Column> {
    ranked(summaries).into_iter().map(|ranked| ranked.column).collect()
}

/// A column, and its rank: if the table is too wide, those of the highest rank are left out first, and those of rank 0
/// never.
struct RankedColumn {
    rank: u8,
    column: Column,
}

/// Returns the same columns with ranks.
fn ranked(summaries: &[PolicySummary]) -> Vec<RankedColumn> {
    let column =
        |heads: [&str; 2], rank: u8, cell: &dyn Fn(&PolicySummary) -> String| RankedColumn {
            rank,
            column: Column::new(heads, summaries.iter().map(cell).collect()),
        };
    let mut columns = vec![
        column(["", "policy"], 0, &|summary| {
            let star = if summary.on_skip_frontier { "*" } else { "" };
            format!("{}{star}", short_label(&summary.policy))
        }),
        column(["skip", "%"], 0, &|summary| percent(summary.skip_rate)),
    ];
    for (place, state) in FrameState::ALL.into_iter().enumerate() {
        columns.push(column([state.as_str(), "%"], 0, &|summary| {
            percent(summary.states[place])
        }));
    }
    columns.extend([
        column(["AP@50", ""], 0, &|summary| three_decimals(summary.ap50)),
        column(["mAP", ""], 0, &|summary| three_decimals(summary.map)),
        column(["AP@75", ""], 1, &|summary| three_decimals(summary.ap75)),
        column(["F1@50", ">=.3"], 1, &|summary| {
            three_decimals(summary.f1_50_shown)
        }),
        column(["new", "frames"], 0, &|summary| {
            two_decimals(summary.newcomers.map(|new| new.frames))
        }),
        column(["new", "ms"], 0, &|summary| {
            let ms = summary.newcomers.and_then(|new| new.ms);
            or_dash(ms.map(|ms| format!("{ms:.0}")))
        }),
        column(["never", "%"], 0, &|summary| {
            one_decimal(summary.newcomers.map(|new| 100.0 * new.never_found))
        }),
        column(["calls", "/s"], 2, &|summary| {
            one_decimal(summary.calls_a_second)
        }),
        column(["AP@50", "all"], 2, &|summary| {
            three_decimals(summary.ap50_all)
        }),
        column(["mAP", "all"], 3, &|summary| {
            three_decimals(summary.map_all)
        }),
        column(["HOTA", ">=.3"], 3, &|summary| three_decimals(summary.hota)),
        column(["IDF1", ">=.3"], 4, &|summary| three_decimals(summary.idf1)),
        column(["time", "ms"], 4, &|summary| {
            or_dash(summary.frame_time_ms.map(marked_time))
        }),
        column(["energy", "J"], 3, &|summary| {
            or_dash(summary.energy.map(|energy| format!("{:.0}p", energy.joules)))
        }),
        column(["EDP", "J·ms"], 4, &|summary| {
            or_dash(summary.energy.map(|energy| format!("{:.0}p", energy.edp)))
        }),
    ]);
    columns.retain(|ranked| ranked.column.cells.iter().any(|cell| cell != "-"));
    columns
}

/// Formats a time with the mark of its origin, which [`notes`] explains: `12.3c`.
fn marked_time((time, origin): (f64, Provenance)) -> String {
    let mark = match origin {
        Provenance::Composed => "c",
        Provenance::Projected => "p",
    };
    format!("{time:.1}{mark}")
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
        "Unweighted means over {}. * no other skips as much and is as accurate.",
        counted(clips, "clip")
    )];
    if without > 0 {
        let are = if without == 1 { "is" } else { "are" };
        notes.push(format!(
            "{} without ground truth {are} not in the means.",
            counted(without, "clip")
        ));
    }
    if summaries.iter().any(|summary| summary.ap50_all.is_some()) {
        notes.push(
            "Boxes are judged as a node publishes them; all: every box of the policy, however faint.".to_owned(),
        );
    }
    if summaries.iter().any(|summary| summary.newcomers.is_some()) {
        notes.push(NEWCOMERS.to_owned());
    }
    let times = || summaries.iter().filter_map(|summary| summary.frame_time_ms);
    let has_energy = summaries.iter().any(|summary| summary.energy.is_some());
    if has_energy || times().any(|(_, kind)| kind == Provenance::Projected) {
        notes.push("p: projected from an energy model, not measured.".to_owned());
    }
    if times().any(|(_, kind)| kind == Provenance::Composed) {
        notes.push("c: composed of the times measured for each step on each frame.".to_owned());
    }
    notes
}
