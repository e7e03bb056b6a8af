//! A comparison as files: `compare.json`, `runs.csv` and `compare.txt`.

use super::run::{Comparison, Run};
use super::summary::{Figure, Summary};
use super::verdict::verdicts;
use crate::text::csv;
use std::path::{Path, PathBuf};

/// A file that cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write {}: {reason}", path.display())]
pub struct WriteError {
    /// The file.
    pub path: PathBuf,
    /// Why not.
    pub reason: String,
}

/// Writes everything into `folder`, which is made if it is not there: `compare.json` with every run's clip
/// report and the summary, `runs.csv` with a row per run, and `compare.txt` with what was printed.
///
/// # Errors
/// [`WriteError`] with the first file that cannot be written.
pub fn write(
    folder: &Path,
    comparison: &Comparison,
    summary: &Summary,
    text: &str,
) -> Result<(), WriteError> {
    let failed = |path: &Path, reason: String| WriteError {
        path: path.to_owned(),
        reason,
    };
    std::fs::create_dir_all(folder).map_err(|error| failed(folder, error.to_string()))?;
    let path = folder.join("compare.json");
    let verdicts = verdicts(comparison, summary);
    let json = serde_json::json!({
        "v": 1, "comparison": comparison, "summary": summary, "verdicts": verdicts
    });
    let json =
        serde_json::to_vec_pretty(&json).map_err(|error| failed(&path, error.to_string()))?;
    let csv_path = folder.join("runs.csv");
    let rows: Vec<_> = (comparison.runs.iter())
        .map(|run| row(comparison, run))
        .collect();
    let csv = csv(&rows).map_err(|error| failed(&csv_path, error.to_string()))?;
    let files = [
        (path, json),
        (csv_path, csv),
        (folder.join("compare.txt"), text.as_bytes().to_vec()),
    ];
    for (path, bytes) in files {
        std::fs::write(&path, bytes).map_err(|error| failed(&path, error.to_string()))?;
    }
    Ok(())
}

/// Names and cells of a run; a figure that does not exist is an empty cell, never a zero.
fn row(comparison: &Comparison, run: &Run) -> Vec<(&'static str, String)> {
    let report = &run.report;
    let energy = &report.energy;
    let total = energy
        .domains
        .iter()
        .find(|domain| domain.domain == "total");
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
            (comparison.policies.get(run.variant).cloned()).unwrap_or_default(),
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
        ("power_mode", board.power_mode.unwrap_or_default()),
        ("hottest_celsius", number(board.hottest_celsius)),
        ("throttled", throttled.unwrap_or_default()),
    ]
}
