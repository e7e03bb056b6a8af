//! Writes a comparison to files: `compare.json`, `runs.csv` and `compare.txt`.

use super::run::{Comparison, Run};
use super::summary::{Figure, Summary};
use super::verdict::verdicts;
use crate::error::EvalError;
use crate::files::{self, CsvRow};
use albireo_wire::Percentiles;
use std::path::Path;

/// Writes all files into `folder`, which is created if needed: `compare.json` with every run's clip report and the
/// summary, `runs.csv` with a row per run, and `compare.txt` with the printed text.
///
/// # Errors
/// [`EvalError`] with the first file that cannot be written.
pub fn write(
    folder: &Path,
    comparison: &Comparison,
    summary: &Summary,
    text: &str,
) -> Result<(), EvalError> {
    let verdicts = verdicts(comparison, summary);
    let json = serde_json::json!({
        "v": 1, "comparison": comparison, "summary": summary, "verdicts": verdicts
    });
    files::write_json(&folder.join("compare.json"), &json)?;
    let rows: Vec<_> = comparison.runs.iter().map(|run| row(comparison, run)).collect();
    files::write_csv(&folder.join("runs.csv"), &rows)?;
    files::write(&folder.join("compare.txt"), text)
}

/// Returns the column names and cells of a run; a figure that does not exist is an empty cell, never a zero.
fn row(comparison: &Comparison, run: &Run) -> CsvRow {
    let report = &run.report;
    let energy = &report.energy;
    let total = energy.domains.iter().find(|domain| domain.domain == "total");
    let board = report.board.clone().unwrap_or_default();
    let figure = |figure: Figure| or_empty(figure.of(run));
    let threshold = report.threshold.as_ref().map(|threshold| threshold.value);
    let frame_ms = &report.total_latency_ms;
    let detector_ms = &report.detector_latency_ms;
    vec![
        ("round", (run.round + 1).to_string()),
        (
            "policy",
            comparison.policies.get(run.variant).cloned().unwrap_or_default(),
        ),
        ("u", or_empty(threshold)),
        ("frames", report.frames.to_string()),
        ("dropped", figure(Figure::Dropped)),
        ("duration_s", report.duration_s.to_string()),
        ("skip_rate", figure(Figure::SkipRate)),
        ("detector_calls", figure(Figure::DetectorCalls)),
        ("energy_j", figure(Figure::Joules)),
        ("energy_quality", energy.quality.as_str().to_owned()),
        ("energy_source", energy.source.clone()),
        ("energy_coverage", energy.coverage.to_string()),
        ("mean_watts", or_empty(total.map(|total| total.mean_watts))),
        (
            "peak_watts",
            or_empty(total.and_then(|total| total.peak_watts)),
        ),
        ("edp_j_ms_per_frame", figure(Figure::Edp)),
        ("cpu_s", figure(Figure::CpuSeconds)),
        ("meter_share_of_core", run.meter_share_of_core.to_string()),
        ("frame_ms_mean", figure(Figure::FrameMilliseconds)),
        ("frame_ms_p95", if_any(frame_ms, frame_ms.p95)),
        ("detector_ms_mean", if_any(detector_ms, detector_ms.mean)),
        ("ap50", figure(Figure::Ap50)),
        ("precision", figure(Figure::Precision)),
        ("recall", figure(Figure::Recall)),
        ("truth_ap50", figure(Figure::TruthAp50)),
        ("truth_precision", figure(Figure::TruthPrecision)),
        ("truth_recall", figure(Figure::TruthRecall)),
        ("power_mode", board.power_mode.unwrap_or_default()),
        ("hottest_celsius", or_empty(board.hottest_celsius)),
        ("throttled", or_empty(board.throttled)),
    ]
}

fn or_empty(value: Option<impl ToString>) -> String {
    match value {
        Some(value) => value.to_string(),
        None => String::new(),
    }
}

/// The cell of a figure of `durations`. If there are none, every figure is a zero that means nothing.
fn if_any(durations: &Percentiles, figure: f64) -> String {
    if durations.count == 0 {
        return String::new();
    }
    figure.to_string()
}

#[cfg(test)]
mod tests {
    use super::super::summary::tests::{comparison, run};
    use super::*;

    /// The cell of a run in this column.
    fn cell(played: &Run, column: &str) -> String {
        let (_, text) = row(&comparison(&["albireo"], Vec::new()), played)
            .into_iter()
            .find(|(name, _)| *name == column)
            .unwrap();
        text
    }

    #[test]
    fn a_duration_is_shown_if_there_is_one() {
        let mut played = run(0, 0, 40, None);
        played.report.total_latency_ms = Percentiles {
            count: 100,
            p95: 31.5,
            ..Percentiles::default()
        };
        played.report.detector_latency_ms = Percentiles {
            count: 60,
            mean: 20.0,
            ..Percentiles::default()
        };
        assert_eq!(cell(&played, "frame_ms_p95"), "31.5");
        assert_eq!(cell(&played, "detector_ms_mean"), "20");
    }

    #[test]
    fn a_duration_without_a_frame_or_a_detector_call_is_an_empty_cell() {
        let mut played = run(0, 0, 40, None);
        played.report.total_latency_ms = Percentiles::default();
        played.report.detector_latency_ms = Percentiles::default();
        assert_eq!(cell(&played, "frame_ms_p95"), "");
        assert_eq!(cell(&played, "detector_ms_mean"), "");
    }

    #[test]
    fn a_mean_or_a_share_of_no_frame_is_an_empty_cell() {
        let mut played = run(0, 0, 0, None);
        assert_eq!(cell(&played, "frame_ms_mean"), "12.5");
        assert_eq!(cell(&played, "skip_rate"), "1");
        played.frame_ms = None;
        played.report.frames = 0;
        played.report.skip_rate = 0.0;
        assert_eq!(cell(&played, "frame_ms_mean"), "");
        assert_eq!(cell(&played, "skip_rate"), "");
    }
}
