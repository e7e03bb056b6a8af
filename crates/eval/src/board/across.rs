//! Makes the tables across setups: detectors and machines, power modes, and whether savings multiply.

use super::run::{Differing, Setup, SetupRuns};
use super::summary::{Changes, Composition, PolicyFigures, SetupSummary, compositions};
use super::table::{JoinedTable, column, percent, percent_or_dash, whole};
use crate::spec::short_label;
use crate::summary::Difference;
use crate::text::{Column, one_decimal, or_dash, signed, three_decimals};
use std::collections::{BTreeMap, BTreeSet};

/// The tables across setups; `None` for one that has no rows.
pub(super) struct AcrossSetups {
    pub detectors: Option<JoinedTable>,
    pub modes: Option<JoinedTable>,
    pub savings: Option<JoinedTable>,
}

impl AcrossSetups {
    pub(super) fn new(setups: &[SetupRuns], summaries: &[SetupSummary]) -> Self {
        let caution = differing_settings(setups);
        let with_caution = |table: JoinedTable| JoinedTable {
            notes: table.notes.into_iter().chain(caution.clone()).collect(),
            ..table
        };
        Self {
            detectors: detectors(setups, summaries).map(with_caution),
            modes: modes(setups, summaries).map(with_caution),
            savings: composed(&compositions(setups)).map(with_caution),
        }
    }
}

/// Names the settings, beside the detector, in which the measured setups differ: their rows are then not alike in all
/// else. `None` if there are none.
fn differing_settings(setups: &[SetupRuns]) -> Option<String> {
    // The published rows have only the two settings that all have.
    let measured: Vec<&Setup> = setups
        .iter()
        .map(|runs| &runs.setup)
        .filter(|setup| setup.settings.len() > 2)
        .collect();
    let (first, others) = measured.split_first()?;
    let mut values: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for setup in others {
        for Differing { key, own, other } in first.differing_settings(setup) {
            values.entry(key).or_default().extend([own, other]);
        }
    }
    values.remove("detector.model");
    let mut named = Vec::new();
    for (key, found) in values {
        let list = Vec::from_iter(found).join(", ");
        named.push(format!("{key} ({list})"));
    }
    if named.is_empty() {
        return None;
    }
    Some(format!("The setups also differ in {}.", named.join(", ")))
}

/// A policy in a setup.
struct PolicyRow<'a> {
    setup: &'a Setup,
    figures: &'a PolicyFigures,
}

fn rows<'a>(
    setups: &'a [SetupRuns],
    summaries: &'a [SetupSummary],
) -> impl Iterator<Item = PolicyRow<'a>> {
    setups.iter().zip(summaries).flat_map(|(SetupRuns { setup, .. }, summary)| {
        let policies = summary.policies.iter();
        policies.map(move |figures| PolicyRow { setup, figures })
    })
}

fn change<'a>(row: &PolicyRow<'a>) -> Option<&'a Changes> {
    row.figures.change.as_ref()
}

/// The figures of each row, and their changes against vanilla of the same setup.
fn figures(rows: &[PolicyRow<'_>]) -> Vec<Column> {
    let mean = |found: Option<Difference>| or_dash(found.map(|found| signed(found.mean, 1)));
    vec![
        column("", "policy", rows, |row| {
            short_label(&row.figures.policy).to_owned()
        }),
        column("AP@50", "", rows, |row| three_decimals(row.figures.ap50)),
        column("change", "points", rows, |row| {
            mean(change(row).and_then(|change| change.ap50))
        }),
        column("energy", "J", rows, |row| one_decimal(row.figures.joules)),
        column("change", "%", rows, |row| {
            mean(change(row).and_then(|change| change.joules))
        }),
        column("time", "ms", rows, |row| one_decimal(row.figures.frame_ms)),
        column("EDP", "J·ms", rows, |row| whole(row.figures.edp)),
        column("change", "%", rows, |row| {
            let edp = change(row).and_then(|change| change.edp);
            or_dash(edp.map(|edp| signed(edp, 1)))
        }),
        column("skip", "%", rows, |row| {
            percent_or_dash(row.figures.skip_rate)
        }),
    ]
}

fn without_empty(mut columns: Vec<Column>) -> Vec<Column> {
    columns.retain(|column| column.cells.iter().any(|cell| !matches!(cell.as_str(), "-" | "")));
    columns
}

/// A row for each detector and machine under each policy; none with only one of them.
fn detectors(setups: &[SetupRuns], summaries: &[SetupSummary]) -> Option<JoinedTable> {
    let mut different = BTreeSet::new();
    for SetupRuns { setup, .. } in setups {
        different.insert((&setup.detector, &setup.machine));
    }
    if different.len() < 2 {
        return None;
    }
    let rows: Vec<PolicyRow<'_>> = rows(setups, summaries).collect();
    let mut columns = vec![
        column("", "detector", &rows, |row| row.setup.detector.clone()),
        column("", "machine", &rows, |row| row.setup.machine.clone()),
    ];
    let detail = |row: &PolicyRow<'_>| {
        let PolicyRow { setup, .. } = row;
        format!("{} {}", setup.precision, setup.power_mode).trim().to_owned()
    };
    let details: BTreeSet<String> = rows.iter().map(detail).collect();
    if details.len() > 1 {
        columns.push(column("", "setup", &rows, detail));
    }
    columns.extend(figures(&rows));
    Some(JoinedTable {
        title: "Detectors and machines side by side; changes against vanilla of the same setup"
            .to_owned(),
        columns: without_empty(columns),
        notes: Vec::new(),
    })
}

/// A row for each policy in each power mode of a detector on a machine; none without two modes of one.
fn modes(setups: &[SetupRuns], summaries: &[SetupSummary]) -> Option<JoinedTable> {
    let has_another = |own: &Setup| {
        setups.iter().any(|SetupRuns { setup: other, .. }| {
            own.detector == other.detector
                && own.precision == other.precision
                && own.machine == other.machine
                && own.power_mode != other.power_mode
        })
    };
    let mut rows: Vec<PolicyRow<'_>> =
        rows(setups, summaries).filter(|row| has_another(row.setup)).collect();
    if rows.is_empty() {
        return None;
    }
    // The modes of a policy are beside each other; the sort is stable, so they stay in the order of the files.
    let key = |row: &PolicyRow<'_>| {
        let PolicyRow { setup, figures } = row;
        let of_machine = [&setup.machine, &setup.detector, &setup.precision].map(String::clone);
        let place = summaries
            .iter()
            .flat_map(|summary| &summary.policies)
            .position(|other| other.policy == figures.policy);
        (of_machine, place)
    };
    rows.sort_by_cached_key(key);
    let mut columns = vec![
        column("", "detector", &rows, |row| {
            format!("{} {}", row.setup.detector, row.setup.precision)
        }),
        column("", "power mode", &rows, |row| row.setup.power_mode.clone()),
    ];
    columns.extend(figures(&rows));
    Some(JoinedTable {
        title: "Power modes side by side; changes against vanilla of the same mode".to_owned(),
        columns: without_empty(columns),
        notes: Vec::new(),
    })
}

/// Whether savings multiply; none without two setups of one machine.
fn composed(rows: &[Composition]) -> Option<JoinedTable> {
    if rows.is_empty() {
        return None;
    }
    let columns = vec![
        column("", "setups", rows, |row| row.setups.clone()),
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
    Some(JoinedTable {
        title: "Do savings multiply? Energy saved by skipping in the first setup, by the second setup without skipping, and \
                by both"
            .to_owned(),
        columns,
        notes: vec![
            "product: 1 − (1 − skipping)(1 − setup). factor: energy of both over what the product says, geometric mean over \
             the clips with its 95 % interval: 1 if they multiply; a wide interval around 1 shows neither."
                .to_owned(),
        ],
    })
}
