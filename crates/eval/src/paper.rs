//! The paper's main table, recomputed from published per-clip results.

use crate::published::{PublishedRow, VANILLA};
use crate::statistics::{mean, quantile};
use crate::summary::Difference;
use serde::Serialize;
use std::collections::HashMap;

/// Clips with more of state E than this are those the paper calls the large losses.
const MOSTLY_EMPTY: f64 = 0.40;

/// Four ways to an energy-delay product of many clips, in J·ms/frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Products {
    /// Mean energy times mean frame time.
    pub of_means: f64,
    /// The same of the means rounded to a tenth, as the paper's main table has it.
    pub of_rounded_means: f64,
    /// Mean over clips of energy × duration ÷ frames, the paper's own definition.
    pub by_definition: f64,
    /// Mean over clips of energy × mean frame time.
    pub by_frame_time: f64,
}

/// One system of a file, means over its clips.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SystemRow {
    /// Name of the system.
    pub system: String,
    /// Number of clips.
    pub clips: usize,
    /// Mean AP@50.
    pub ap50: f64,
    /// Mean mAP@50:95.
    pub map: f64,
    /// Mean joules per clip.
    pub energy_j: f64,
    /// Mean milliseconds per frame.
    pub frame_time_ms: f64,
    /// Energy-delay products.
    pub edp: Products,
    /// Mean share of skipped frames.
    pub skip_rate: f64,
    /// Share of skipped frames over all frames.
    pub skip_rate_pooled: f64,
    /// Mean share of each state: E, P, E+I, I, AI.
    pub states: [f64; 5],
    /// Share of AI over all detector frames.
    pub ai_of_detector_frames: f64,
    /// Largest share of P in a clip.
    pub largest_predicted_share: f64,
    /// Against Vanilla; `None` for Vanilla itself, or without it.
    pub against_vanilla: Option<AgainstVanilla>,
}

/// A system against Vanilla on the same clips.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AgainstVanilla {
    /// AP@50.
    pub ap50: Difference,
    /// mAP@50:95.
    pub map: Difference,
    /// Joules.
    pub energy: Difference,
    /// Change of mean energy, as a share of Vanilla's.
    pub energy_change: f64,
    /// Change of mean frame time, as a share of Vanilla's.
    pub frame_time_change: f64,
    /// Change of each energy-delay product, as a share of Vanilla's.
    pub edp_change: Products,
    /// Clips with the same or a better AP@50.
    pub clips_keeping_ap50: usize,
    /// Median loss of AP@50 on the others.
    pub median_loss: Option<f64>,
    /// Clips that take less energy.
    pub clips_with_less_energy: usize,
    /// Clips with more than 40 % of state E.
    pub mostly_empty_clips: usize,
    /// Mean change of AP@50 on these.
    pub ap50_mostly_empty: Option<f64>,
    /// Mean change of AP@50 on all others.
    pub ap50_others: Option<f64>,
}

/// The table of one file: Vanilla first, then the other systems in order of their first rows.
pub fn table(rows: &[PublishedRow]) -> Vec<SystemRow> {
    let mut order: Vec<&str> = Vec::new();
    for row in rows {
        if !order.contains(&row.system.as_str()) {
            order.push(&row.system);
        }
    }
    order.sort_by_key(|system| *system != VANILLA);
    let of = |system: &str| -> Vec<&PublishedRow> {
        rows.iter().filter(|row| row.system == system).collect()
    };
    let vanilla = of(VANILLA);
    let vanilla_row = system_row(VANILLA, &vanilla);
    order
        .into_iter()
        .map(|system| {
            let own = of(system);
            let mut row = system_row(system, &own);
            if system != VANILLA {
                row.against_vanilla = compare(&own, &row, &vanilla, &vanilla_row);
            }
            row
        })
        .collect()
}

fn system_row(system: &str, rows: &[&PublishedRow]) -> SystemRow {
    let over = |figure: &dyn Fn(&PublishedRow) -> f64| {
        mean(rows.iter().map(|row| figure(row))).unwrap_or(f64::NAN)
    };
    let sum = |figure: &dyn Fn(&PublishedRow) -> usize| {
        rows.iter().map(|row| figure(row)).sum::<usize>() as f64
    };
    let energy_j = over(&|row| row.energy_j);
    let frame_time_ms = over(&|row| row.frame_time_ms);
    let tenth = |value: f64| (value * 10.0).round() / 10.0;
    SystemRow {
        system: system.to_owned(),
        clips: rows.len(),
        ap50: over(&|row| row.ap50),
        map: over(&|row| row.map),
        energy_j,
        frame_time_ms,
        edp: Products {
            of_means: energy_j * frame_time_ms,
            of_rounded_means: tenth(energy_j) * tenth(frame_time_ms),
            by_definition: over(&|row| row.energy_j * row.wall_s * 1e3 / row.frames() as f64),
            by_frame_time: over(&|row| row.energy_j * row.frame_time_ms),
        },
        skip_rate: over(&|row| row.states.skip_rate(0)),
        skip_rate_pooled: sum(&|row| row.states.e + row.states.p) / sum(&PublishedRow::frames),
        states: std::array::from_fn(|state| over(&|row| row.states.shares()[state])),
        ai_of_detector_frames: sum(&|row| row.states.ai) / sum(&|row| row.detector_frames),
        largest_predicted_share: rows
            .iter()
            .map(|row| row.states.shares()[1])
            .fold(0.0, f64::max),
        against_vanilla: None,
    }
}

fn compare(
    own: &[&PublishedRow],
    row: &SystemRow,
    vanilla: &[&PublishedRow],
    before: &SystemRow,
) -> Option<AgainstVanilla> {
    let by_clip: HashMap<&str, &PublishedRow> = vanilla
        .iter()
        .map(|row| (row.sequence.as_str(), *row))
        .collect();
    let pairs: Vec<(&PublishedRow, &PublishedRow)> = own
        .iter()
        .filter_map(|row| Some((*row, *by_clip.get(row.sequence.as_str())?)))
        .collect();
    let differences = |figure: fn(&PublishedRow) -> f64| -> Vec<f64> {
        let pairs = pairs.iter();
        pairs
            .map(|(own, other)| figure(own) - figure(other))
            .collect()
    };
    let ap50 = differences(|row| row.ap50);
    let energy = differences(|row| row.energy_j);
    let mut losses: Vec<f64> = ap50
        .iter()
        .filter(|&&difference| difference < 0.0)
        .map(|difference| -difference)
        .collect();
    losses.sort_by(f64::total_cmp);
    let empty = |(row, _): &(&PublishedRow, &PublishedRow)| row.states.shares()[0] > MOSTLY_EMPTY;
    let ap50_where = |wanted: bool| {
        let chosen = pairs.iter().zip(&ap50);
        mean(
            chosen
                .filter(|(pair, _)| empty(pair) == wanted)
                .map(|(_, difference)| *difference),
        )
    };
    let change = |own: f64, before: f64| own / before - 1.0;
    Some(AgainstVanilla {
        ap50: Difference::of(&ap50)?,
        map: Difference::of(&differences(|row| row.map))?,
        energy: Difference::of(&energy)?,
        energy_change: change(row.energy_j, before.energy_j),
        frame_time_change: change(row.frame_time_ms, before.frame_time_ms),
        edp_change: Products {
            of_means: change(row.edp.of_means, before.edp.of_means),
            of_rounded_means: change(row.edp.of_rounded_means, before.edp.of_rounded_means),
            by_definition: change(row.edp.by_definition, before.edp.by_definition),
            by_frame_time: change(row.edp.by_frame_time, before.edp.by_frame_time),
        },
        clips_keeping_ap50: ap50.iter().filter(|&&difference| difference >= 0.0).count(),
        median_loss: quantile(&losses, 0.5),
        clips_with_less_energy: energy
            .iter()
            .filter(|&&difference| difference < 0.0)
            .count(),
        mostly_empty_clips: pairs.iter().filter(|pair| empty(pair)).count(),
        ap50_mostly_empty: ap50_where(true),
        ap50_others: ap50_where(false),
    })
}
