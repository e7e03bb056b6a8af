//! Writes a comparison to files: `compare.json`, `runs.csv` and `compare.txt`.

use super::run::{Comparison, Run};
use super::summary::{Figure, Summary};
use super::verdict::verdicts;
use crate::error::EvalError;
use crate::files;
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
    let runs = comparison.runs.iter();
    let rows: Vec<_> = runs.map(|run| row(comparison, run)).collect();
    files::write_csv(&folder.join("runs.csv"), &rows)?;
    files::write(&folder.join("compare.txt"), text)
}

/// Returns the column names and cells of a run; a figure that does not exist is an empty cell, never a zero.
fn row(comparison: &Comparison, run: &Run) -> Vec<(&'static str, String)> {
    let report = &run.report;
    let energy = &report.energy;
    let total = energy.domains.iter().find(|domain| domain.domain == "total");
    let board = report.board.clone().unwrap_or_default();
    let number = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
    let figure = |figure: Figure| number(figure.of(run));
    let quality = serde_json::to_value(energy.quality).unwrap_or_default();
    let threshold = report.threshold.as_ref().map(|threshold| threshold.value);
    let throttled = board.throttled.map(|throttled| throttled.to_string());
    vec![
        ("round", (run.round + 1).to_string()),
        (
            "policy",
            comparison.policies.get(run.variant).cloned().unwrap_or_default(),
        ),
        ("u", number(threshold)),
        ("frames", report.frames.to_string()),
        ("dropped", figure(Figure::Dropped)),
        ("duration_s", report.duration_s.to_string()),
        ("skip_rate", figure(Figure::SkipRate)),
        ("detector_calls", figure(Figure::DetectorCalls)),
        ("energy_j", figure(Figure::Joules)),
        (
            "energy_quality",
            quality.as_str().unwrap_or_default().to_owned(),
        ),
        ("energy_source", energy.source.clone()),
        ("energy_coverage", energy.coverage.to_string()),
        ("mean_watts", number(total.map(|total| total.mean_watts))),
        (
            "peak_watts",
            number(total.and_then(|total| total.peak_watts)),
        ),
        ("edp_j_ms_per_frame", figure(Figure::Edp)),
        ("cpu_s", figure(Figure::CpuSeconds)),
        ("meter_share_of_core", run.meter_share_of_core.to_string()),
        ("frame_ms_mean", figure(Figure::FrameMilliseconds)),
        ("frame_ms_p95", report.total_latency_ms.p95.to_string()),
        (
            "detector_ms_mean",
            report.detector_latency_ms.mean.to_string(),
        ),
        ("ap50", figure(Figure::Ap50)),
        ("precision", figure(Figure::Precision)),
        ("recall", figure(Figure::Recall)),
        ("truth_ap50", figure(Figure::TruthAp50)),
        ("truth_precision", figure(Figure::TruthPrecision)),
        ("truth_recall", figure(Figure::TruthRecall)),
        ("power_mode", board.power_mode.unwrap_or_default()),
        ("hottest_celsius", number(board.hottest_celsius)),
        ("throttled", throttled.unwrap_or_default()),
    ]
}
