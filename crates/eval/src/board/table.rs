//! Formats the joined tables for a terminal, and their rows for CSV.

use super::run::SetupRuns;
use super::summary::{Changes, Composition, PolicyFigures, SetupSummary, compositions, summarise};
use crate::spec::short_label;
use crate::summary::Difference;
use crate::text::{self, Column, one_decimal, or_dash, signed, three_decimals, wrapped};
use albireo_core::policy::FrameState;

/// Maximum width of the text in characters.
const WIDTH: usize = 100;

/// A table with its title, for the terminal and the page.
pub(super) struct JoinedTable {
    pub title: String,
    pub columns: Vec<Column>,
    pub notes: Vec<String>,
}

/// Formats all tables of the setups.
pub fn render(setups: &[SetupRuns]) -> String {
    let summaries: Vec<SetupSummary> = setups.iter().map(summarise).collect();
    let mut rendered = String::new();
    for table in tables(setups, &summaries) {
        if !rendered.is_empty() {
            rendered.push('\n');
        }
        rendered.push_str(&wrapped(&table.title, WIDTH));
        rendered.push('\n');
        rendered.push_str(&text::table(table.columns.iter(), "  "));
        for note in &table.notes {
            rendered.push_str(&wrapped(note, WIDTH));
            rendered.push('\n');
        }
    }
    rendered
}

/// Makes all tables: two for each setup, then those across setups.
pub(super) fn tables(setups: &[SetupRuns], summaries: &[SetupSummary]) -> Vec<JoinedTable> {
    let mut tables = Vec::new();
    for (setup, summary) in setups.iter().zip(summaries) {
        tables.push(figures(setup, summary));
        tables.extend(differences(summary));
        tables.extend(domains(summary));
    }
    if summaries.len() > 1 {
        tables.extend(across(summaries));
    }
    tables.extend(composed(&compositions(setups)));
    tables
}

/// Makes a column with a cell per row.
fn column<R>(head: &str, unit: &str, rows: &[R], cell: impl Fn(&R) -> String) -> Column {
    Column::new([head, unit], rows.iter().map(cell).collect())
}

fn named(policies: &[PolicyFigures]) -> Column {
    column("", "policy", policies, |of| {
        short_label(&of.policy).to_owned()
    })
}

fn percent(share: f64) -> String {
    format!("{:.1}", share * 100.0)
}

/// The main table of a setup.
fn figures(setup: &SetupRuns, summary: &SetupSummary) -> JoinedTable {
    let rows = &summary.policies;
    let mut columns = vec![
        named(rows),
        column("AP@50", "", rows, |of| three_decimals(of.ap50)),
        column("mAP", "", rows, |of| three_decimals(of.map)),
        column("energy", "J", rows, |of| one_decimal(of.joules)),
        column("time", "ms", rows, |of| format!("{:.1}", of.frame_ms)),
        column("EDP", "J·ms", rows, |of| {
            or_dash(of.edp.map(|edp| format!("{edp:.0}")))
        }),
        column("skip", "%", rows, |of| percent(of.skip_rate)),
    ];
    for (at, state) in FrameState::ALL.into_iter().enumerate() {
        columns.push(column(state.as_str(), "%", rows, |of| {
            percent(of.states[at])
        }));
    }
    columns.push(column("CPU", "cores", rows, |of| {
        or_dash(of.cores.map(|cores| format!("{cores:.2}")))
    }));
    columns.push(column("memory", "MB", rows, |of| {
        or_dash(of.memory_mb.map(|megabytes| format!("{megabytes:.0}")))
    }));
    columns.retain(|column| column.cells.iter().any(|cell| cell != "-"));
    let clips = rows.iter().map(|of| of.clips).max().unwrap_or_default();
    let mut notes = vec![
        "Unweighted means over the clips. EDP is mean energy times mean time of a frame, as the paper's tables have it; \
         policies.csv also has the mean over clips of energy times duration over frames."
            .to_owned(),
    ];
    if summary.energy_of.is_empty() {
        notes.push(
            "No energy: there was no meter, or its samples did not cover the runs.".to_owned(),
        );
    } else {
        notes.push(format!("Energy is {}.", summary.energy_of));
    }
    notes.extend(cautions(rows, clips));
    let pace = &setup.setup.pace;
    let judged = &setup.setup.truth;
    let how = [("frames", pace.as_str()), ("judged by", judged.as_str())]
        .into_iter()
        .filter(|(_, what)| !what.is_empty())
        .map(|(name, what)| format!("; {name} {what}"))
        .collect::<String>();
    JoinedTable {
        title: format!("{}: {clips} clips{how}", summary.title),
        columns,
        notes,
    }
}

/// What a reader has to know before believing a row.
fn cautions(rows: &[PolicyFigures], clips: usize) -> Vec<String> {
    let mut cautions = Vec::new();
    for of in rows {
        let name = short_label(&of.policy);
        if of.clips < clips {
            cautions.push(format!(
                "{name} was measured on {} of the {clips} clips only.",
                of.clips
            ));
        }
        if of.dropped > 0 {
            cautions.push(format!(
                "Under {name} {} frames were not answered, and count as frames without boxes.",
                of.dropped
            ));
        }
        if of.throttled > 0 {
            cautions.push(format!(
                "Under {name} the clocks were throttled in {} runs.",
                of.throttled
            ));
        }
    }
    cautions
}

/// The differences to the baseline; none if only it was measured.
fn differences(summary: &SetupSummary) -> Option<JoinedTable> {
    let rows: Vec<(&PolicyFigures, &Changes)> = summary
        .policies
        .iter()
        .filter_map(|of| Some((of, of.change.as_ref()?)))
        .collect();
    let figure = |found: Option<Difference>| or_dash(found.map(|found| found.text(1)));
    let p = |found: Option<Difference>| or_dash(found.map(Difference::p_text));
    let mut columns = vec![
        column("", "policy", &rows, |(of, _)| {
            short_label(&of.policy).to_owned()
        }),
        column("AP@50", "points", &rows, |(_, change)| figure(change.ap50)),
        column("mAP", "points", &rows, |(_, change)| figure(change.map)),
        column("energy", "%", &rows, |(_, change)| figure(change.joules)),
        column("", "p", &rows, |(_, change)| p(change.joules)),
        column("time", "%", &rows, |(_, change)| {
            or_dash(change.frame_ms.map(|found| signed(found.mean, 1)))
        }),
        column("EDP", "%", &rows, |(_, change)| {
            or_dash(change.edp.map(|edp| signed(edp, 1)))
        }),
    ];
    columns.retain(|column| column.cells.iter().any(|cell| cell != "-"));
    let clips = rows.iter().filter_map(|(_, change)| Some(change.ap50?.clips)).max();
    let notes = rows.iter().flat_map(|(of, change)| sentences(of, change)).collect();
    (!rows.is_empty()).then(|| JoinedTable {
        title: format!(
            "Differences to vanilla with 95 % intervals and p of the energy (paired t{})",
            clips.map_or_else(String::new, |clips| format!(
                ", {clips} clips with ground truth"
            ))
        ),
        columns,
        notes,
    })
}

/// `albireo: less energy on 89 % of the clips; AP@50 as good or better on 144 of 200 clips, median drop of the others 1.7 points.`
fn sentences(of: &PolicyFigures, change: &Changes) -> Option<String> {
    let mut parts = Vec::new();
    if let Some(share) = change.clips_that_save {
        parts.push(format!(
            "less energy on {:.0} % of the clips",
            share * 100.0
        ));
    }
    if let Some(clips) = &change.clips {
        let drop = clips.median_drop.map_or_else(String::new, |drop| {
            format!(", median drop of the others {drop:.1} points")
        });
        parts.push(format!(
            "AP@50 as good or better on {} of {} clips{drop}",
            clips.as_good, clips.all
        ));
    }
    (!parts.is_empty()).then(|| format!("{}: {}.", short_label(&of.policy), parts.join("; ")))
}

/// Energy by domain; none if the machine has no domains.
fn domains(summary: &SetupSummary) -> Option<JoinedTable> {
    let rows = &summary.policies;
    let mut names: Vec<&String> = rows.iter().flat_map(|of| of.domains.keys()).collect();
    names.sort();
    names.dedup();
    let mut columns = vec![named(rows)];
    columns.extend(names.iter().map(|name| {
        column(name, "J", rows, |of| {
            one_decimal(of.domains.get(*name).copied())
        })
    }));
    (columns.len() > 2).then(|| JoinedTable {
        title: format!("Energy by domain: {}", summary.title),
        columns,
        notes: Vec::new(),
    })
}

/// One row for each setup and policy.
fn across(summaries: &[SetupSummary]) -> Option<JoinedTable> {
    let rows: Vec<(&str, &PolicyFigures, &Changes)> = summaries
        .iter()
        .flat_map(|summary| {
            let policies = summary.policies.iter();
            policies.filter_map(|of| Some((summary.title.as_str(), of, of.change.as_ref()?)))
        })
        .collect();
    let mean = |found: Option<Difference>| or_dash(found.map(|found| signed(found.mean, 1)));
    let mut columns = vec![
        column("", "setup", &rows, |row| row.0.to_owned()),
        column("", "policy", &rows, |row| {
            short_label(&row.1.policy).to_owned()
        }),
        column("clips", "", &rows, |row| row.1.clips.to_string()),
        column("skip", "%", &rows, |row| percent(row.1.skip_rate)),
        column("AP@50", "points", &rows, |row| mean(row.2.ap50)),
        column("energy", "%", &rows, |row| mean(row.2.joules)),
        column("time", "%", &rows, |row| mean(row.2.frame_ms)),
        column("EDP", "%", &rows, |row| {
            or_dash(row.2.edp.map(|edp| signed(edp, 1)))
        }),
    ];
    columns.retain(|column| column.cells.iter().any(|cell| cell != "-"));
    (!rows.is_empty()).then(|| JoinedTable {
        title: "Across setups: changes against vanilla of the same setup".to_owned(),
        columns,
        notes: Vec::new(),
    })
}

/// Whether savings multiply; none without two setups of one machine.
fn composed(rows: &[Composition]) -> Option<JoinedTable> {
    let columns = vec![
        column("", "from", rows, |row| row.from.clone()),
        column("", "to", rows, |row| row.to.clone()),
        column("", "policy", rows, |row| {
            short_label(&row.policy).to_owned()
        }),
        column("skipping", "%", rows, |row| percent(row.skipping)),
        column("setup", "%", rows, |row| percent(row.other)),
        column("both", "%", rows, |row| percent(row.together)),
        column("product", "%", rows, |row| percent(row.expected)),
        column("factor", "", rows, |row| {
            let interval = row.interval.map(|[from, to]| format!(" [{from:.3}, {to:.3}]"));
            format!("{:.3}{}", row.factor, interval.unwrap_or_default())
        }),
        column("clips", "", rows, |row| row.clips.to_string()),
    ];
    (!rows.is_empty()).then(|| JoinedTable {
        title: "Do savings multiply? Energy saved by skipping in the first setup, by the second setup without skipping, and \
                by both"
            .to_owned(),
        columns,
        notes: vec![
            "product: 1 − (1 − skipping)(1 − setup). factor: energy of both over what the product says, geometric mean over \
             the clips; they multiply if its interval contains 1."
                .to_owned(),
        ],
    })
}

type Cells = Vec<(&'static str, String)>;

fn number(value: Option<f64>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

/// Returns a row per run; a figure that does not exist is an empty cell, never a zero.
pub(super) fn rows_of_clips(setups: &[SetupRuns]) -> Vec<Cells> {
    let runs = setups.iter().flat_map(|of| of.runs.iter().map(move |run| (&of.setup, run)));
    runs.map(|(setup, run)| {
        let domain = |name: &str| number(run.domains.get(name).copied());
        vec![
            ("detector", setup.detector.clone()),
            ("precision", setup.precision.clone()),
            ("power_mode", setup.power_mode.clone()),
            ("machine", setup.machine.clone()),
            ("clip", run.clip.clone()),
            ("policy", run.policy.clone()),
            ("frames", run.frames.to_string()),
            ("dropped", run.dropped.to_string()),
            ("e", run.states.e.to_string()),
            ("p", run.states.p.to_string()),
            ("ei", run.states.ei.to_string()),
            ("i", run.states.i.to_string()),
            ("ai", run.states.ai.to_string()),
            ("degraded", run.degraded.to_string()),
            ("detector_calls", run.detector_calls.to_string()),
            ("skip_rate", run.skip_rate().to_string()),
            ("duration_s", run.duration_s.to_string()),
            ("frame_ms", run.frame_ms.to_string()),
            ("ap50", number(run.ap50)),
            ("map", number(run.map)),
            ("energy_j", number(run.joules)),
            ("energy_estimated", run.estimated.to_string()),
            ("energy_gpu_j", domain("gpu")),
            ("energy_cpu_j", domain("cpu")),
            ("energy_io_mem_j", domain("io_mem")),
            ("edp_j_ms_per_frame", number(run.edp())),
            ("cpu_s", number(run.cpu_s)),
            ("memory_mb", number(run.memory_mb)),
            ("throttled", run.throttled.to_string()),
        ]
    })
    .collect()
}

/// Returns a row per setup and policy.
pub(super) fn rows_of_policies(summaries: &[SetupSummary]) -> Vec<Cells> {
    let policies = summaries
        .iter()
        .flat_map(|summary| summary.policies.iter().map(move |of| (&summary.title, of)));
    policies
        .map(|(title, of)| {
            let change = of.change.as_ref();
            let mean = |found: Option<Difference>| number(found.map(|found| found.mean));
            let p = |found: Option<Difference>| number(found.and_then(|found| found.p));
            vec![
                ("setup", title.clone()),
                ("policy", of.policy.clone()),
                ("clips", of.clips.to_string()),
                ("frames", of.frames.to_string()),
                ("ap50", number(of.ap50)),
                ("map", number(of.map)),
                ("energy_j", number(of.joules)),
                ("frame_ms", of.frame_ms.to_string()),
                ("edp_of_means", number(of.edp)),
                ("edp_mean_of_clips", number(of.edp_of_clips)),
                ("skip_rate", of.skip_rate.to_string()),
                ("detector_calls", of.detector_calls.to_string()),
                (
                    "ap50_change_points",
                    mean(change.and_then(|change| change.ap50)),
                ),
                ("ap50_change_p", p(change.and_then(|change| change.ap50))),
                (
                    "map_change_points",
                    mean(change.and_then(|change| change.map)),
                ),
                (
                    "energy_change_percent",
                    mean(change.and_then(|change| change.joules)),
                ),
                (
                    "energy_change_p",
                    p(change.and_then(|change| change.joules)),
                ),
                (
                    "frame_ms_change_percent",
                    mean(change.and_then(|change| change.frame_ms)),
                ),
                (
                    "edp_change_percent",
                    number(change.and_then(|change| change.edp)),
                ),
                (
                    "clips_that_save",
                    number(change.and_then(|change| change.clips_that_save)),
                ),
            ]
        })
        .collect()
}
