//! Fitting an energy model to published per-clip results, and how far it misses on clips left out.
//!
//! Least squares without a constant: energy and processing time of a clip as so much for each detector
//! frame, predicted frame and call of the screen; a cost that comes out below zero is set to zero and the
//! others are fitted again. Processing time is the mean frame time times the frames. The published runs
//! process frames back to back, so what a board takes while it waits for the next frame cannot be seen in
//! them; `idle_power_w` stays open.

use crate::energy_model::{Costs, EnergyModel, LeftOutError};
use crate::published::{PublishedRow, VANILLA};
use crate::statistics::mean;
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeSet;

/// Parts into which the clips are split to see how far a fit misses.
const FOLDS: usize = 10;

/// Costs cannot be told from these rows.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FitError {
    /// There are too few clips, or they are all alike.
    #[error(
        "the rows do not tell the costs of detector, prediction and screen apart: they need Vanilla and a \
         system that skips, on at least {FOLDS} clips"
    )]
    Undetermined,
}

/// Fits a model on all `rows` and tests it on clips left out.
///
/// # Errors
/// [`FitError`] when the rows do not determine the costs.
pub fn fit(
    rows: &[PublishedRow],
    board: &str,
    detector: &str,
    source: &str,
) -> Result<EnergyModel, FitError> {
    let all: Vec<&PublishedRow> = rows.iter().collect();
    let (energy_j, time_ms) = fit_costs(&all)?;
    Ok(EnergyModel {
        board: board.to_owned(),
        detector: detector.to_owned(),
        source: source.to_owned(),
        energy_j,
        time_ms,
        idle_power_w: None,
        left_out: Some(left_out(rows)?),
    })
}

/// Detector frames, predicted frames, calls of the screen.
fn work(row: &PublishedRow) -> [f64; 3] {
    [
        row.detector_frames as f64,
        row.states.p as f64,
        (row.states.e + row.states.ei) as f64,
    ]
}

fn fit_costs(rows: &[&PublishedRow]) -> Result<(Costs, Costs), FitError> {
    let energy: Vec<f64> = rows.iter().map(|row| row.energy_j).collect();
    let time: Vec<f64> = rows
        .iter()
        .map(|row| row.frame_time_ms * row.frames() as f64)
        .collect();
    Ok((least_squares(rows, &energy)?, least_squares(rows, &time)?))
}

fn least_squares(rows: &[&PublishedRow], totals: &[f64]) -> Result<Costs, FitError> {
    let totals = DVector::from_column_slice(totals);
    let mut free = vec![0, 1, 2];
    let [detector, predicted, screen] = loop {
        let matrix = DMatrix::from_fn(rows.len(), free.len(), |row, column| {
            work(rows[row])[free[column]]
        });
        let decomposition = matrix.svd(true, true);
        let largest = decomposition.singular_values.max();
        if rows.len() <= free.len() || decomposition.rank(largest * 1e-9) < free.len() {
            return Err(FitError::Undetermined);
        }
        let solution = decomposition
            .solve(&totals, largest * 1e-9)
            .map_err(|_| FitError::Undetermined)?;
        let mut costs = [0.0; 3];
        for (column, &kind) in free.iter().enumerate() {
            costs[kind] = solution[column];
        }
        let lowest = (0..3).min_by(|&a, &b| costs[a].total_cmp(&costs[b]));
        match lowest {
            Some(kind) if costs[kind] < 0.0 => free.retain(|&other| other != kind),
            _ => break costs,
        }
    };
    Ok(Costs {
        detector,
        predicted,
        screen,
        // The published runs never look.
        look: 0.0,
    })
}

/// Leaves out every tenth clip, fits on the others and projects the ones left out; ten times.
fn left_out(rows: &[PublishedRow]) -> Result<LeftOutError, FitError> {
    let clips: BTreeSet<&str> = rows.iter().map(|row| row.sequence.as_str()).collect();
    if clips.len() < FOLDS {
        return Err(FitError::Undetermined);
    }
    let (mut energy_errors, mut time_errors) = (Vec::new(), Vec::new());
    // Measured and projected, each Vanilla's and the others'.
    let mut sums = [[0.0; 2]; 2];
    for fold in 0..FOLDS {
        let apart: BTreeSet<&str> = clips.iter().copied().skip(fold).step_by(FOLDS).collect();
        let (test, train): (Vec<&PublishedRow>, Vec<&PublishedRow>) = rows
            .iter()
            .partition(|row| apart.contains(row.sequence.as_str()));
        let (energy, time) = fit_costs(&train)?;
        for row in test {
            let projected = energy.total(work(row));
            energy_errors.push((projected / row.energy_j - 1.0).abs());
            let projected_time = time.total(work(row)) / row.frames() as f64;
            time_errors.push((projected_time / row.frame_time_ms - 1.0).abs());
            let system = usize::from(row.system != VANILLA);
            sums[0][system] += row.energy_j;
            sums[1][system] += projected;
        }
    }
    let counts = [true, false].map(|vanilla| {
        let rows = rows.iter();
        rows.filter(|row| (row.system == VANILLA) == vanilla)
            .count() as f64
    });
    let saving = |sums: [f64; 2]| 100.0 * (1.0 - (sums[1] / counts[1]) / (sums[0] / counts[0]));
    if counts.contains(&0.0) {
        return Err(FitError::Undetermined);
    }
    Ok(LeftOutError {
        folds: FOLDS,
        energy_percent: 100.0 * mean(energy_errors).unwrap_or(f64::NAN),
        frame_time_percent: 100.0 * mean(time_errors).unwrap_or(f64::NAN),
        saving_measured_percent: saving(sums[0]),
        saving_projected_percent: saving(sums[1]),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::result::StateCounts;

    /// Clips whose energy and time follow known costs exactly.
    fn rows(clips: usize) -> Vec<PublishedRow> {
        let row = |clip: usize, skips: bool| {
            let (e, p, ei) = if skips {
                (clip % 7, 10 + clip % 11, clip % 3)
            } else {
                (0, 0, 0)
            };
            let states = StateCounts {
                e,
                p,
                ei,
                i: 100 - e - p - ei,
                ai: 0,
            };
            let detector_frames = states.ei + states.i;
            let work = [detector_frames as f64, p as f64, (e + ei) as f64];
            let total = |costs: [f64; 3]| -> f64 {
                work.iter().zip(costs).map(|(work, cost)| work * cost).sum()
            };
            PublishedRow {
                sequence: format!("clip-{clip}"),
                system: if skips { "Adaptive" } else { VANILLA }.to_owned(),
                ap50: 0.5,
                map: 0.4,
                states,
                detector_frames,
                wall_s: 1.0,
                frame_time_ms: total([50.0, 4.0, 40.0]) / 100.0,
                energy_j: total([4.0, 0.1, 1.5]),
            }
        };
        (0..clips)
            .flat_map(|clip| [row(clip, false), row(clip, true)])
            .collect()
    }

    #[test]
    fn known_costs_are_found_again_and_nothing_is_missed_on_clips_left_out() {
        let model = fit(&rows(30), "board", "detector", "made up").expect("it is determined");
        for (found, known) in [
            (model.energy_j.detector, 4.0),
            (model.energy_j.predicted, 0.1),
            (model.energy_j.screen, 1.5),
            (model.time_ms.detector, 50.0),
            (model.time_ms.predicted, 4.0),
            (model.time_ms.screen, 40.0),
        ] {
            assert!((found - known).abs() < 1e-6, "{found} is not {known}");
        }
        let error = model.left_out.expect("it was tested");
        assert!(error.energy_percent < 1e-6);
        assert!((error.saving_measured_percent - error.saving_projected_percent).abs() < 1e-6);
    }

    #[test]
    fn a_cost_is_never_below_zero() {
        let mut rows = rows(30);
        for row in &mut rows {
            // Predicting seems to give energy back.
            row.energy_j -= 2.0 * row.states.p as f64;
        }
        let model = fit(&rows, "board", "detector", "made up").expect("it is determined");
        assert_eq!(model.energy_j.predicted, 0.0);
        assert!(model.energy_j.detector > 0.0);
    }

    #[test]
    fn rows_that_do_not_tell_the_costs_apart_are_refused() {
        let vanilla: Vec<PublishedRow> = rows(30)
            .into_iter()
            .filter(|row| row.system == VANILLA)
            .collect();
        let error = fit(&vanilla, "board", "detector", "made up");
        assert_eq!(error, Err(FitError::Undetermined));
        let error = fit(&rows(5), "board", "detector", "made up");
        assert_eq!(error, Err(FitError::Undetermined));
    }
}
