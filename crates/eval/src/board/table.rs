//! Makes the tables of each setup, and formats all tables for a terminal.

use super::across::AcrossSetups;
use super::run::{FRAMES, JUDGED_BY, SetupRuns};
use super::summary::{Changes, PolicyFigures, SetupSummary, summarise_all};
use crate::spec::{short_label, split_label};
use crate::summary::Difference;
use crate::text::{Column, counted, fitted, one_decimal, or_dash, signed, three_decimals, wrapped};
use albireo_core::policy::FrameState;
use std::collections::BTreeMap;

/// A table with its title, for the terminal and the page.
pub(super) struct JoinedTable {
    pub title: String,
    pub columns: Vec<Column>,
    pub notes: Vec<String>,
}

/// Formats all tables of the setups, at most `width` characters wide.
pub fn render(setups: &[SetupRuns], width: usize) -> String {
    let summaries = summarise_all(setups);
    let mut rendered = String::new();
    for table in tables(setups, &summaries) {
        if !rendered.is_empty() {
            rendered.push('\n');
        }
        rendered.push_str(&wrapped(&table.title, width));
        rendered.push('\n');
        let between = table.columns.len().saturating_sub(1);
        let wide = table.columns.iter().map(Column::width).sum::<usize>() + 2 * between;
        let gap = if wide > width { " " } else { "  " };
        rendered.push_str(&fitted(&table.columns, gap, width));
        for note in &table.notes {
            rendered.push_str(&wrapped(note, width));
            rendered.push('\n');
        }
    }
    rendered
}

/// Makes all tables: those of each setup, those across setups, and a list of those that have no rows.
pub(super) fn tables(setups: &[SetupRuns], summaries: &[SetupSummary]) -> Vec<JoinedTable> {
    let mut tables = Vec::new();
    let mut own = OwnTables::default();
    for (setup, summary) in setups.iter().zip(summaries) {
        let sweep = sweep(summary);
        let domains = domains(summary);
        own.is_swept |= sweep.is_some();
        own.has_domains |= domains.is_some();
        tables.push(figures(setup, summary));
        tables.extend(differences(summary));
        tables.extend(sweep);
        tables.extend(domains);
    }
    let across = AcrossSetups::new(setups, summaries);
    let missing = without_rows(setups, summaries, own, &across);
    tables.extend(across.detectors);
    tables.extend(across.modes);
    tables.extend(across.savings);
    tables.extend(missing);
    tables
}

/// The tables of single setups that have rows.
#[derive(Clone, Copy, Default)]
struct OwnTables {
    is_swept: bool,
    has_domains: bool,
}

/// Names each table or figure of the paper that has no rows, and what it needs; `None` if all have rows.
fn without_rows(
    setups: &[SetupRuns],
    summaries: &[SetupSummary],
    own: OwnTables,
    across: &AcrossSetups,
) -> Option<JoinedTable> {
    let runs = || setups.iter().flat_map(|setup| &setup.runs);
    let policies = || summaries.iter().flat_map(|summary| &summary.policies);
    let changes = || policies().filter_map(|policy| policy.change.as_ref());
    let has_edp = policies().any(|policy| policy.edp.is_some() && policy.ap50.is_some());
    let is_tested = |change: Option<Difference>| change.is_some_and(|change| change.p.is_some());
    let has_empty = |policy: &PolicyFigures| {
        let [empty, ..] = policy.states;
        policy.change.is_some() && empty.is_some_and(|share| share > 0.0)
    };
    let needs = [
        (
            own.is_swept,
            "sweep: several settings of one policy, --sweep u=3e-4,5e-4,7e-4,1e-3,3e-3",
        ),
        (
            has_edp,
            "AP@50 against EDP: runs with a meter and ground truth",
        ),
        (
            own.has_domains,
            "energy by domain: a meter that tells domains apart",
        ),
        (
            changes().any(|change| change.ap50.is_some()),
            "change of AP@50 clip by clip: another policy beside vanilla, and ground truth",
        ),
        (
            policies().any(has_empty),
            "the same against frames in E: an empty-scene screen ([screen] model), or a pause",
        ),
        (
            changes().any(|change| is_tested(change.ap50) || is_tested(change.joules)),
            "paired tests: another policy beside vanilla, on two clips or more",
        ),
        (
            runs().any(|run| !run.traces.is_empty()),
            "power over a clip: runs of `albireo eval board` with a meter",
        ),
        (
            across.detectors.is_some(),
            "detectors, machines, and their frame states side by side: a file of another detector or machine",
        ),
        (
            across.modes.is_some(),
            "power modes side by side: a file of another power mode",
        ),
        (
            across.savings.is_some(),
            "whether savings multiply: a file of another precision, power mode or detector on the same machine",
        ),
    ];
    let mut notes = Vec::new();
    for (is_there, what) in needs {
        if !is_there {
            notes.push(format!("{what}."));
        }
    }
    if notes.is_empty() {
        return None;
    }
    Some(JoinedTable {
        title: "No rows, and what they need".to_owned(),
        columns: Vec::new(),
        notes,
    })
}

/// Makes a column with a cell per row.
pub(super) fn column<R>(head: &str, unit: &str, rows: &[R], cell: impl Fn(&R) -> String) -> Column {
    Column::new([head, unit], rows.iter().map(cell).collect())
}

fn named(policies: &[PolicyFigures]) -> Column {
    column("", "policy", policies, |row| {
        short_label(&row.policy).to_owned()
    })
}

pub(super) fn whole(value: Option<f64>) -> String {
    or_dash(value.map(|value| format!("{value:.0}")))
}

pub(super) fn percent(share: f64) -> String {
    format!("{:.1}", share * 100.0)
}

pub(super) fn percent_or_dash(share: Option<f64>) -> String {
    or_dash(share.map(percent))
}

/// The main table of a setup.
fn figures(setup: &SetupRuns, summary: &SetupSummary) -> JoinedTable {
    let rows = &summary.policies;
    let mut names = named(rows);
    for (name, is_best) in names.cells.iter_mut().zip(summary.on_frontier()) {
        if is_best && rows.len() > 1 {
            name.push('*');
        }
    }
    let is_marked = names.cells.iter().any(|name| name.ends_with('*'));
    let mut columns = vec![
        names,
        column("AP@50", "", rows, |row| three_decimals(row.ap50)),
        column("mAP", "", rows, |row| three_decimals(row.map)),
        column("energy", "J", rows, |row| one_decimal(row.joules)),
        column("time", "ms", rows, |row| one_decimal(row.frame_ms)),
        column("EDP", "J·ms", rows, |row| whole(row.edp)),
        column("skip", "%", rows, |row| percent_or_dash(row.skip_rate)),
    ];
    for (place, state) in FrameState::ALL.into_iter().enumerate() {
        columns.push(column(state.as_str(), "%", rows, |row| {
            percent_or_dash(row.states[place])
        }));
    }
    // These are not read everywhere.
    let of_system = [
        column("CPU", "cores", rows, |row| {
            or_dash(row.cores.map(|cores| format!("{cores:.2}")))
        }),
        column("GPU", "%", rows, |row| {
            whole(row.gpu_utilisation.map(|share| share * 100.0))
        }),
        column("memory", "MB", rows, |row| whole(row.memory_mb)),
    ];
    let unread: Vec<String> = of_system
        .iter()
        .filter(|column| column.cells.iter().all(|cell| cell == "-"))
        .map(|column| column.heads[0].clone())
        .collect();
    columns.extend(of_system);
    columns.retain(|column| column.cells.iter().any(|cell| cell != "-"));
    let clips = rows.iter().map(|row| row.clips).max().unwrap_or_default();
    let mut notes = vec![
        "Unweighted means over the clips. EDP is mean energy times mean time of a frame, as the paper's tables have it; \
         policies.csv also has the mean over clips of energy times duration over frames."
            .to_owned(),
    ];
    if is_marked {
        notes.push("* marks the Pareto frontier of AP@50 against EDP.".to_owned());
    }
    if !unread.is_empty() {
        notes.push(format!(
            "Not read: utilisation or use of {}.",
            unread.join(", ")
        ));
    }
    if summary.energy_of.is_empty() {
        notes.push(
            "No energy: there was no meter, or its samples did not cover the runs.".to_owned(),
        );
    } else {
        notes.push(format!("Energy is {}.", summary.energy_of));
    }
    notes.extend(cautions(rows, clips));
    let settings = &setup.setup.settings;
    let mut title = format!("{}: {}", summary.title, counted(clips, "clip"));
    for name in [FRAMES, JUDGED_BY] {
        if let Some(value) = settings.get(name) {
            title.push_str(&format!("; {name} {value}"));
        }
    }
    JoinedTable {
        title,
        columns,
        notes,
    }
}

/// What a reader has to know before believing a row.
fn cautions(rows: &[PolicyFigures], clips: usize) -> Vec<String> {
    let mut cautions = Vec::new();
    if let Some(sparse) = rows.iter().find(|row| row.unlabelled > 0) {
        let all = sparse.frames + sparse.dropped;
        cautions.push(format!(
            "Accuracy is that of {} of {all} frames: nobody labelled the others, which count for everything else.",
            all.saturating_sub(sparse.unlabelled)
        ));
    }
    for row in rows {
        let name = short_label(&row.policy);
        if row.clips < clips {
            cautions.push(format!(
                "{name} was measured on {} of the {clips} clips only.",
                row.clips
            ));
        }
        if row.dropped > 0 {
            cautions.push(format!(
                "Under {name} {} frames were not answered, and count as frames without boxes.",
                row.dropped
            ));
        }
        if row.throttled > 0 {
            cautions.push(format!(
                "Under {name} the clocks were throttled in {}.",
                counted(row.throttled, "run")
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
        .filter_map(|row| Some((row, row.change.as_ref()?)))
        .collect();
    if rows.is_empty() {
        return None;
    }
    let figure = |found: Option<Difference>| or_dash(found.map(|found| found.text(1)));
    let p = |found: Option<Difference>| or_dash(found.map(Difference::p_text));
    let mean = |found: Option<Difference>| or_dash(found.map(|found| signed(found.mean, 1)));
    let mut columns = vec![
        column("", "policy", &rows, |(row, _)| {
            short_label(&row.policy).to_owned()
        }),
        column("AP@50", "points", &rows, |(_, change)| figure(change.ap50)),
        column("", "p", &rows, |(_, change)| p(change.ap50)),
        column("mAP", "points", &rows, |(_, change)| mean(change.map)),
        column("energy", "%", &rows, |(_, change)| figure(change.joules)),
        column("", "p", &rows, |(_, change)| p(change.joules)),
        column("time", "%", &rows, |(_, change)| mean(change.frame_ms)),
        column("EDP", "%", &rows, |(_, change)| {
            or_dash(change.edp.map(|edp| signed(edp, 1)))
        }),
    ];
    columns.retain(|column| column.cells.iter().any(|cell| cell != "-"));
    let clips = rows.iter().filter_map(|(_, change)| Some(change.ap50?.clips)).max();
    let notes = rows.iter().filter_map(|(row, change)| sentence(row, change)).collect();
    let with_truth = match clips {
        Some(clips) => format!(", {} with ground truth", counted(clips, "clip")),
        None => String::new(),
    };
    Some(JoinedTable {
        title: format!("Differences to vanilla with 95 % intervals and p (paired t{with_truth})"),
        columns,
        notes,
    })
}

/// `albireo: less energy on 89 % of the clips; AP@50 as good or better on 144 of 200 clips, median drop of the others
/// 1.7 points.`
fn sentence(row: &PolicyFigures, change: &Changes) -> Option<String> {
    let mut parts = Vec::new();
    if let Some(share) = change.clips_that_save {
        parts.push(format!(
            "less energy on {:.0} % of the clips",
            share * 100.0
        ));
    }
    if let Some(clips) = &change.clips {
        let drop = match clips.median_drop {
            Some(drop) => format!(", median drop of the others {drop:.1} points"),
            None => String::new(),
        };
        parts.push(format!(
            "AP@50 as good or better on {} of {} clips{drop}",
            clips.as_good, clips.all
        ));
    }
    if parts.is_empty() {
        return None;
    }
    let policy = short_label(&row.policy);
    Some(format!("{policy}: {}.", parts.join("; ")))
}

/// The settings of each policy of which several were measured, in order; none if there is no such policy.
fn sweep(summary: &SetupSummary) -> Option<JoinedTable> {
    struct SweptRow<'a> {
        name: String,
        value: f64,
        figures: &'a PolicyFigures,
    }
    let mut families: BTreeMap<&str, Vec<SweptRow<'_>>> = BTreeMap::new();
    for figures in &summary.policies {
        let (family, setting) = split_label(&figures.policy);
        if let Ok(value) = setting.trim_start_matches("u = ").parse() {
            families.entry(family).or_default().push(SweptRow {
                name: format!("{family} {setting}"),
                value,
                figures,
            });
        }
    }
    let mut rows: Vec<SweptRow<'_>> = Vec::new();
    for mut settings in families.into_values().filter(|settings| settings.len() > 1) {
        settings.sort_by(|a, b| a.value.total_cmp(&b.value));
        rows.extend(settings);
    }
    if rows.is_empty() {
        return None;
    }
    let change = |row: &SweptRow<'_>, figure: fn(&Changes) -> Option<f64>| {
        let change = row.figures.change.as_ref().and_then(figure);
        or_dash(change.map(|value| signed(value, 1)))
    };
    let mut columns = vec![
        column("", "policy", &rows, |row| row.name.clone()),
        column("skip", "%", &rows, |row| {
            percent_or_dash(row.figures.skip_rate)
        }),
        column("calls", "a clip", &rows, |row| {
            one_decimal(Some(row.figures.detector_calls))
        }),
        column("AP@50", "", &rows, |row| three_decimals(row.figures.ap50)),
        column("change", "points", &rows, |row| {
            change(row, |change| Some(change.ap50?.mean))
        }),
        column("energy", "J", &rows, |row| one_decimal(row.figures.joules)),
        column("change", "%", &rows, |row| {
            change(row, |change| Some(change.joules?.mean))
        }),
        column("EDP", "J·ms", &rows, |row| whole(row.figures.edp)),
        column("change", "%", &rows, |row| change(row, |change| change.edp)),
    ];
    columns.retain(|column| column.cells.iter().any(|cell| cell != "-"));
    Some(JoinedTable {
        title: format!("Sweep: {}", summary.title),
        columns,
        notes: Vec::new(),
    })
}

/// Energy by domain; none if the machine has fewer than two domains.
fn domains(summary: &SetupSummary) -> Option<JoinedTable> {
    let rows = &summary.policies;
    let mut names: Vec<&String> = rows.iter().flat_map(|row| row.domains.keys()).collect();
    names.sort();
    names.dedup();
    // A single one says no more than the total.
    if names.iter().filter(|name| *name != &"total").count() < 2 {
        return None;
    }
    let mut columns = vec![named(rows)];
    for name in names {
        columns.push(column(name, "J", rows, |row| {
            one_decimal(row.domains.get(name).copied())
        }));
    }
    Some(JoinedTable {
        title: format!("Energy by domain: {}", summary.title),
        columns,
        notes: Vec::new(),
    })
}
