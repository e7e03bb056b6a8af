//! `summary.csv`: one row per clip and policy.
//!
//! The first columns are those of the summary published with the golden traces. `ap50` and `map` follow
//! the run's profile; `_decayed` and `_lastconf` are the published scoring's two definitions of confidence
//! and empty under profile `paper`. A figure that does not exist is an empty cell, never a zero.

use crate::result::ClipResult;
use crate::spec::BASELINE;
use std::collections::HashMap;

const HEADER: [&str; 41] = [
    "sequence",
    "camera",
    "frames",
    "gt_boxes",
    "policy",
    "skip_rate",
    "share_E",
    "share_P",
    "share_EI",
    "share_I",
    "share_AI",
    "boxes",
    "ap50_decayed",
    "map_decayed",
    "ap50_lastconf",
    "map_lastconf",
    "ap50",
    "map",
    "ap75",
    "f1_50",
    "f1_50_shown",
    "hota",
    "idf1",
    "precision",
    "recall",
    "delta_ap50",
    "delta_map",
    "detector_frames",
    "screen_frames",
    "degraded_frames",
    "rejected_detections",
    "frame_time_ms_mean",
    "frame_time_ms_p50",
    "frame_time_ms_p95",
    "frame_time_ms_p99",
    "frame_time_source",
    "energy_j",
    "duration_s",
    "edp_j_ms_per_frame",
    "energy_source",
    "decision_us_mean",
];

/// The table as bytes.
pub(super) fn render(results: &[ClipResult]) -> Result<Vec<u8>, String> {
    let baseline: HashMap<&str, &ClipResult> = results
        .iter()
        .filter(|result| result.policy == BASELINE)
        .map(|result| (result.clip.as_str(), result))
        .collect();
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer
        .write_record(HEADER)
        .map_err(|error| error.to_string())?;
    for result in results {
        let row = row(result, baseline.get(result.clip.as_str()).copied());
        writer
            .write_record(row)
            .map_err(|error| error.to_string())?;
    }
    writer.into_inner().map_err(|error| error.to_string())
}

fn cell(value: Option<impl ToString>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}

fn row(result: &ClipResult, baseline: Option<&ClipResult>) -> [String; 41] {
    let accuracy = result.accuracy;
    let last = result.accuracy_last_confidence;
    // Under the published scoring, and only there, both definitions exist.
    let decayed = last.and(accuracy);
    let before = baseline.and_then(|baseline| baseline.accuracy);
    let delta = |of: fn(&crate::average_precision::Accuracy) -> f64| {
        Some(of(accuracy.as_ref()?) - of(before.as_ref()?))
    };
    let time = result.frame_time.map(|time| time.milliseconds);
    let energy = result.energy;
    let [e, p, ei, i, ai] = result.states.shares();
    [
        result.clip.clone(),
        cell(result.camera.as_ref()),
        result.frames.to_string(),
        cell(accuracy.map(|a| a.truths)),
        result.policy.clone(),
        result.skip_rate().to_string(),
        e.to_string(),
        p.to_string(),
        ei.to_string(),
        i.to_string(),
        ai.to_string(),
        result.boxes.to_string(),
        cell(decayed.map(|a| a.ap50)),
        cell(decayed.map(|a| a.map)),
        cell(last.map(|a| a.ap50)),
        cell(last.map(|a| a.map)),
        cell(accuracy.map(|a| a.ap50)),
        cell(accuracy.map(|a| a.map)),
        cell(accuracy.map(|a| a.ap75)),
        cell(accuracy.map(|a| a.f1_50)),
        cell(accuracy.map(|a| a.f1_50_shown)),
        cell(result.tracking.map(|tracking| tracking.hota)),
        cell(result.tracking.map(|tracking| tracking.idf1)),
        cell(accuracy.map(|a| a.precision)),
        cell(accuracy.map(|a| a.recall)),
        cell(delta(|a| a.ap50)),
        cell(delta(|a| a.map)),
        result.detector_frames.to_string(),
        result.screen_frames.to_string(),
        result.degraded_frames.to_string(),
        result.rejected_detections.to_string(),
        cell(time.map(|t| t.mean)),
        cell(time.map(|t| t.p50)),
        cell(time.map(|t| t.p95)),
        cell(time.map(|t| t.p99)),
        cell(result.frame_time.map(|t| t.provenance.as_str())),
        cell(energy.map(|e| e.joules)),
        cell(energy.map(|e| e.duration_s)),
        cell(energy.map(|e| e.edp)),
        cell(energy.map(|e| e.provenance.as_str())),
        cell(result.decision_us.map(|d| d.mean)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::replay::Replay;
    use albireo_core::policy::FrameState;

    #[test]
    fn a_figure_that_does_not_exist_is_an_empty_cell() {
        let replay = Replay {
            frames: Vec::new(),
            boxes: Vec::new(),
            boxes_last_confidence: None,
            rejected_detections: 0,
            trace: None,
        };
        let mut result = ClipResult::from_replay("clip, one", "vanilla", &replay);
        result.frames = 1;
        result.states.count(FrameState::I);
        let bytes = render(&[result]).expect("it can be written");
        let mut reader = csv::Reader::from_reader(&bytes[..]);
        let headers = reader.headers().expect("a header").clone();
        let record = reader.records().next().expect("a row").expect("readable");
        let cell = |name: &str| {
            let index = headers.iter().position(|header| header == name);
            &record[index.expect("the column is there")]
        };
        assert_eq!(cell("sequence"), "clip, one");
        assert_eq!(cell("skip_rate"), "0");
        for name in ["ap50", "ap50_decayed", "delta_ap50", "energy_j", "gt_boxes"] {
            assert_eq!(cell(name), "", "{name}");
        }
    }
}
