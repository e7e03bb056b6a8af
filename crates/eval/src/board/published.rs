//! Reads the per-clip results that accompany the paper: `results/BOARD/SYSTEM/DETECTOR/summary.csv` of its repository.

use super::run::{ClipRun, FRAMES, JUDGED_BY, Setup, SetupRuns};
use crate::error::EvalError;
use crate::spec::BASELINE;
use albireo_wire::FrameStates;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

/// The columns that are read of a row.
#[derive(Deserialize)]
struct PublishedRow {
    sequence: String,
    system: String,
    ap_50: Option<f64>,
    ap_50_95: Option<f64>,
    infer_count: u64,
    erd_empty_count: u64,
    predict_count: u64,
    erd_infer_count: u64,
    augmented_infer_count: u64,
    pure_infer_count: u64,
    wall_duration_s: f64,
    avg_frame_time_ms: f64,
    energy_j: Option<f64>,
    energy_gpu_j: Option<f64>,
    energy_cpu_j: Option<f64>,
    energy_io_j: Option<f64>,
}

/// Parses the rows of `path`. Board and detector are the names of the folders that contain the file.
///
/// # Errors
/// When the header or a row is not of that form.
pub(super) fn parse(path: &Path, text: &str) -> Result<SetupRuns, EvalError> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let mut runs = Vec::new();
    for (number, row) in (2..).zip(reader.deserialize()) {
        let row: PublishedRow = row.map_err(|error| {
            let what = format!(
                "{error}; a summary.csv of the paper's results has the columns sequence, system, ap_50, infer_count, energy_j, …"
            );
            EvalError::line(path, number, what)
        })?;
        runs.push(run(row));
    }
    let folder = |above: usize| {
        let name = path.ancestors().nth(above).and_then(Path::file_name);
        name.map_or_else(String::new, |name| name.to_string_lossy().into_owned())
    };
    let setup = Setup {
        detector: folder(1),
        precision: "as published".to_owned(),
        power_mode: String::new(),
        machine: folder(3),
        settings: [(FRAMES, "unpaced"), (JUDGED_BY, "BDD100K MOT")]
            .map(|(key, value)| (key.to_owned(), value.to_owned()))
            .into(),
    };
    Ok(SetupRuns { setup, runs })
}

fn run(row: PublishedRow) -> ClipRun {
    let states = FrameStates {
        e: row.erd_empty_count,
        p: row.predict_count,
        ei: row.erd_infer_count,
        i: row.pure_infer_count,
        ai: row.augmented_infer_count,
    };
    let policy = match row.system.as_str() {
        "Vanilla" => BASELINE.to_owned(),
        "Adaptive" => "albireo".to_owned(),
        other => other.to_lowercase(),
    };
    let mut domains = BTreeMap::new();
    for (name, joules) in [
        ("gpu", row.energy_gpu_j),
        ("cpu", row.energy_cpu_j),
        ("io_mem", row.energy_io_j),
    ] {
        if let Some(joules) = joules {
            domains.insert(name.to_owned(), joules);
        }
    }
    ClipRun {
        clip: row.sequence,
        policy,
        content: String::new(),
        frames: states.frames(),
        dropped: 0,
        unlabelled: 0,
        states,
        degraded: 0,
        detector_calls: row.infer_count,
        duration_s: row.wall_duration_s,
        frame_ms: Some(row.avg_frame_time_ms),
        ap50: row.ap_50,
        map: row.ap_50_95,
        joules: row.energy_j,
        domains,
        estimated: false,
        energy_of: "the board".to_owned(),
        cpu_s: None,
        gpu_utilisation: None,
        memory_mb: None,
        traces: BTreeMap::new(),
        throttled: false,
    }
}
