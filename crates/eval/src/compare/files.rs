//! A comparison as files: `compare.json`, `runs.csv` and `compare.txt`.

use super::run::{Comparison, Run};
use super::summary::{Figure, Summary};
use super::verdict::verdicts;
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
/// report and the summary, `runs.csv` with a row a run, and `compare.txt` with what was printed.
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
    let csv = csv(comparison).map_err(|error| failed(&csv_path, error.to_string()))?;
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

const HEADER: [&str; 26] = [
    "round",
    "policy",
    "u",
    "frames",
    "dropped",
    "duration_s",
    "skip_rate",
    "detector_calls",
    "energy_j",
    "energy_quality",
    "energy_source",
    "energy_coverage",
    "mean_watts",
    "peak_watts",
    "edp_j_ms_per_frame",
    "cpu_s",
    "meter_share_of_core",
    "frame_ms_mean",
    "frame_ms_p95",
    "detector_ms_mean",
    "ap50",
    "precision",
    "recall",
    "power_mode",
    "hottest_celsius",
    "throttled",
];

fn csv(comparison: &Comparison) -> Result<Vec<u8>, Box<dyn std::error::Error + Send + Sync>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(HEADER)?;
    for run in &comparison.runs {
        writer.write_record(row(comparison, run))?;
    }
    Ok(writer.into_inner().map_err(|error| error.to_string())?)
}

/// A figure that does not exist is an empty cell, never a zero.
fn row(comparison: &Comparison, run: &Run) -> [String; 26] {
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
    [
        (run.round + 1).to_string(),
        comparison
            .policies
            .get(run.variant)
            .cloned()
            .unwrap_or_default(),
        number(report.threshold.map(|threshold| threshold.value)),
        report.frames.to_string(),
        figure(Figure::Dropped),
        report.duration_s.to_string(),
        figure(Figure::SkipRate),
        figure(Figure::DetectorCalls),
        figure(Figure::Joules),
        quality.as_str().unwrap_or_default().to_owned(),
        energy.source.clone(),
        energy.coverage.to_string(),
        number(total.map(|total| total.mean_watts)),
        number(total.and_then(|total| total.peak_watts)),
        figure(Figure::Edp),
        figure(Figure::CpuSeconds),
        run.meter_share_of_core.to_string(),
        figure(Figure::FrameMilliseconds),
        report.total_latency_ms.p95.to_string(),
        report.detector_latency_ms.mean.to_string(),
        figure(Figure::Ap50),
        figure(Figure::Precision),
        figure(Figure::Recall),
        board.power_mode.unwrap_or_default(),
        number(board.hottest_celsius),
        board
            .throttled
            .map_or_else(String::new, |held| held.to_string()),
    ]
}
