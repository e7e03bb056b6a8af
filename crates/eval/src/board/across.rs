//! Makes the tables across setups: detectors and machines, power modes, and whether savings multiply.

use super::run::SetupRuns;
use super::summary::{Changes, Composition, PolicyFigures, SetupSummary, compositions};
use super::table::{JoinedTable, column, percent, whole};
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

/// Names the settings, beside the detector, in which the measured setups differ: their rows are then not alike in all else.
fn differing_settings(setups: &[SetupRuns]) -> Option<String> {
    // The published rows tell no settings.
    let measured = || setups.iter().map(|of| &of.setup).filter(|of| of.settings.len() > 2);
    let first = measured().next()?;
    let mut values: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for other in measured() {
        for (key, own, others) in first.differing_settings(other) {
            values.entry(key).or_default().extend([own, others]);
        }
    }
    values.remove("detector.model");
    let named: Vec<String> = values
        .into_iter()
        .map(|(key, values)| {
            let values: Vec<&str> = values.into_iter().collect();
            format!("{key} ({})", values.join(", "))
        })
        .collect();
    (!named.is_empty()).then(|| format!("The setups also differ in {}.", named.join(", ")))
}

/// A policy in a setup.
type PolicyRow<'a> = (&'a SetupRuns, &'a PolicyFigures);

fn rows<'a>(
    setups: &'a [SetupRuns],
    summaries: &'a [SetupSummary],
) -> impl Iterator<Item = PolicyRow<'a>> {
    let both = setups.iter().zip(summaries);
    both.flat_map(|(setup, summary)| summary.policies.iter().map(move |of| (setup, of)))
}

fn change<'a>(row: &PolicyRow<'a>) -> Option<&'a Changes> {
    row.1.change.as_ref()
}

/// The figures of each row, and their changes against vanilla of the same setup.
fn figures(rows: &[PolicyRow<'_>]) -> Vec<Column> {
    let mean = |found: Option<Difference>| or_dash(found.map(|found| signed(found.mean, 1)));
    vec![
        column("", "policy", rows, |row| {
            short_label(&row.1.policy).to_owned()
        }),
        column("AP@50", "", rows, |row| three_decimals(row.1.ap50)),
        column("change", "points", rows, |row| {
            mean(change(row).and_then(|of| of.ap50))
        }),
        column("energy", "J", rows, |row| one_decimal(row.1.joules)),
        column("change", "%", rows, |row| {
            mean(change(row).and_then(|of| of.joules))
        }),
        column("time", "ms", rows, |row| format!("{:.1}", row.1.frame_ms)),
        column("EDP", "J·ms", rows, |row| whole(row.1.edp)),
        column("change", "%", rows, |row| {
            or_dash(change(row).and_then(|of| of.edp).map(|edp| signed(edp, 1)))
        }),
        column("skip", "%", rows, |row| percent(row.1.skip_rate)),
    ]
}

fn without_empty(mut columns: Vec<Column>) -> Vec<Column> {
    columns.retain(|column| column.cells.iter().any(|cell| !matches!(cell.as_str(), "-" | "")));
    columns
}

/// A row for each detector and machine under each policy; none with only one of them.
fn detectors(setups: &[SetupRuns], summaries: &[SetupSummary]) -> Option<JoinedTable> {
    let machine = |of: &SetupRuns| (of.setup.detector.clone(), of.setup.machine.clone());
    let different: BTreeSet<_> = setups.iter().map(machine).collect();
    let rows: Vec<PolicyRow<'_>> = rows(setups, summaries).collect();
    let mut columns = vec![
        column("", "detector", &rows, |row| row.0.setup.detector.clone()),
        column("", "machine", &rows, |row| row.0.setup.machine.clone()),
    ];
    let detail = |row: &PolicyRow<'_>| {
        let setup = &row.0.setup;
        format!("{} {}", setup.precision, setup.power_mode).trim().to_owned()
    };
    let details: BTreeSet<String> = rows.iter().map(detail).collect();
    if details.len() > 1 {
        columns.push(column("", "setup", &rows, detail));
    }
    columns.extend(figures(&rows));
    (different.len() > 1).then(|| JoinedTable {
        title: "Detectors and machines side by side; changes against vanilla of the same setup"
            .to_owned(),
        columns: without_empty(columns),
        notes: Vec::new(),
    })
}

/// A row for each policy in each power mode of a detector on a machine; none without two modes of one.
fn modes(setups: &[SetupRuns], summaries: &[SetupSummary]) -> Option<JoinedTable> {
    let has_another = |of: &SetupRuns| {
        setups.iter().any(|other| {
            let [own, other] = [&of.setup, &other.setup];
            let [a, b] = [own, other].map(|of| (&of.detector, &of.precision, &of.machine));
            a == b && own.power_mode != other.power_mode
        })
    };
    let mut rows: Vec<PolicyRow<'_>> =
        rows(setups, summaries).filter(|(setup, _)| has_another(setup)).collect();
    // The modes of a policy are beside each other; the sort is stable, so they stay in the order of the files.
    let key = |row: &PolicyRow<'_>| {
        let setup = &row.0.setup;
        let of_machine = [&setup.machine, &setup.detector, &setup.precision].map(String::clone);
        let policies = summaries.iter().flat_map(|summary| &summary.policies);
        let place = policies.into_iter().position(|of| of.policy == row.1.policy);
        (of_machine, place)
    };
    rows.sort_by_cached_key(key);
    let mut columns = vec![
        column("", "detector", &rows, |row| {
            format!("{} {}", row.0.setup.detector, row.0.setup.precision)
        }),
        column("", "power mode", &rows, |row| {
            row.0.setup.power_mode.clone()
        }),
    ];
    columns.extend(figures(&rows));
    (!rows.is_empty()).then(|| JoinedTable {
        title: "Power modes side by side; changes against vanilla of the same mode".to_owned(),
        columns: without_empty(columns),
        notes: Vec::new(),
    })
}

/// Whether savings multiply; none without two setups of one machine.
fn composed(rows: &[Composition]) -> Option<JoinedTable> {
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
    (!rows.is_empty()).then(|| JoinedTable {
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
