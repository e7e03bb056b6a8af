//! Builds the rows of `summary.csv`, one per clip and policy.
//!
//! The first columns are those of the summary published with the golden traces. `ap50` and `map` follow
//! the run's profile; `_decayed` and `_lastconf` are the published scoring's two definitions of confidence
//! and empty under profile `paper`, where the judged boxes are the published ones and `_all` is for all boxes of the
//! policy. A figure that does not exist is an empty cell, never a zero.

use crate::files::CsvRow;
use crate::judge::Accuracy;
use crate::result::ClipResult;
use crate::spec::BASELINE;
use std::collections::HashMap;

/// Returns the rows, each with column names and cells.
pub(super) fn rows(results: &[ClipResult]) -> Vec<CsvRow> {
    let baseline: HashMap<&str, &ClipResult> = results
        .iter()
        .filter(|result| result.policy == BASELINE)
        .map(|result| (result.clip.as_str(), result))
        .collect();
    let before = |result: &ClipResult| baseline.get(result.clip.as_str()).copied();
    results.iter().map(|result| row(result, before(result))).collect()
}

fn cell(value: Option<impl ToString>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}

/// Returns the column names and cells of a row.
fn row(result: &ClipResult, baseline: Option<&ClipResult>) -> CsvRow {
    let mut row = frame_cells(result);
    row.extend(accuracy_cells(result));
    row.extend(newcomer_cells(result));
    row.extend(change_cells(result, baseline));
    row.extend(cost_cells(result));
    row
}

/// The clip, the policy, and what it did with the frames.
fn frame_cells(result: &ClipResult) -> CsvRow {
    let truths = result.accuracy.map(|accuracy| accuracy.truths);
    let [e, p, ei, i, ai] = result.state_shares();
    vec![
        ("sequence", result.clip.clone()),
        ("camera", cell(result.camera.as_ref())),
        ("frames", result.frames.to_string()),
        ("gt_boxes", cell(truths)),
        ("policy", result.policy.clone()),
        ("skip_rate", result.skip_rate().to_string()),
        ("share_E", e.to_string()),
        ("share_P", p.to_string()),
        ("share_EI", ei.to_string()),
        ("share_I", i.to_string()),
        ("share_AI", ai.to_string()),
        ("boxes", result.boxes.to_string()),
    ]
}

type AccuracyFigure = fn(&Accuracy) -> f64;

/// How right the boxes and tracks are.
fn accuracy_cells(result: &ClipResult) -> CsvRow {
    let accuracy = result.accuracy;
    let last = result.accuracy_last_confidence;
    let all = result.accuracy_all;
    // Only the published scoring has both definitions.
    let decayed = last.and(accuracy);
    let judged =
        |accuracy: Option<Accuracy>, figure: AccuracyFigure| cell(accuracy.as_ref().map(figure));
    let tracks = result.tracking;
    let tracks_all = result.tracking_all;
    vec![
        ("ap50_decayed", judged(decayed, |a| a.ap50)),
        ("map_decayed", judged(decayed, |a| a.map)),
        ("ap50_lastconf", judged(last, |a| a.ap50)),
        ("map_lastconf", judged(last, |a| a.map)),
        ("ap50", judged(accuracy, |a| a.ap50)),
        ("map", judged(accuracy, |a| a.map)),
        ("ap75", judged(accuracy, |a| a.ap75)),
        ("f1_50_shown", judged(accuracy, |a| a.f1_50_shown)),
        ("hota", cell(tracks.map(|tracks| tracks.hota))),
        ("idf1", cell(tracks.map(|tracks| tracks.idf1))),
        ("precision", judged(accuracy, |a| a.precision)),
        ("recall", judged(accuracy, |a| a.recall)),
        ("ap50_all", judged(all, |a| a.ap50)),
        ("ap75_all", judged(all, |a| a.ap75)),
        ("map_all", judged(all, |a| a.map)),
        ("f1_50_shown_all", judged(all, |a| a.f1_50_shown)),
        ("hota_all", cell(tracks_all.map(|tracks| tracks.hota))),
        ("idf1_all", cell(tracks_all.map(|tracks| tracks.idf1))),
    ]
}

/// How late new objects are found.
fn newcomer_cells(result: &ClipResult) -> CsvRow {
    let newcomers = result.newcomers;
    let never_found = newcomers.map(|new| new.never_found);
    let delay_frames = newcomers.map(|new| new.delay_frames);
    vec![
        ("newcomers", cell(newcomers.map(|new| new.objects))),
        ("newcomers_never_found", cell(never_found)),
        ("newcomer_frames", cell(delay_frames)),
        ("newcomer_ms", cell(result.newcomer_ms())),
    ]
}

/// The change of accuracy against the baseline.
fn change_cells(result: &ClipResult, baseline: Option<&ClipResult>) -> CsvRow {
    let before = baseline.and_then(|baseline| baseline.accuracy);
    let delta = |figure: AccuracyFigure| {
        let both = result.accuracy.zip(before);
        cell(both.map(|(own, before)| figure(&own) - figure(&before)))
    };
    vec![
        ("delta_ap50", delta(|a| a.ap50)),
        ("delta_map", delta(|a| a.map)),
    ]
}

/// What the frames cost.
fn cost_cells(result: &ClipResult) -> CsvRow {
    let time = result.frame_time.map(|time| time.milliseconds);
    let source = result.frame_time.map(|time| time.provenance.as_str());
    let energy = result.energy;
    let rejected = result.rejected_detections;
    vec![
        ("detector_frames", result.detector_frames.to_string()),
        ("calls_a_second", cell(result.calls_a_second())),
        ("screen_frames", result.screen_frames.to_string()),
        ("degraded_frames", result.degraded_frames.to_string()),
        ("rejected_detections", rejected.to_string()),
        ("frame_time_ms_mean", cell(time.map(|t| t.mean))),
        ("frame_time_ms_p50", cell(time.map(|t| t.p50))),
        ("frame_time_ms_p95", cell(time.map(|t| t.p95))),
        ("frame_time_ms_p99", cell(time.map(|t| t.p99))),
        ("frame_time_source", cell(source)),
        ("projected_energy_j", cell(energy.map(|e| e.joules))),
        ("projected_duration_s", cell(energy.map(|e| e.duration_s))),
        ("projected_edp_j_ms_per_frame", cell(energy.map(|e| e.edp))),
        ("decision_us_mean", cell(result.decision_us.map(|d| d.mean))),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::summary::tests::of_states;
    use albireo_core::policy::FrameState;

    #[test]
    fn a_missing_figure_is_an_empty_cell() {
        let rows = rows(&[of_states("clip, one", "vanilla", &[FrameState::I])]);
        let cell = |name: &str| {
            let (_, cell) =
                rows[0].iter().find(|(column, _)| *column == name).expect("the column is there");
            cell.as_str()
        };
        assert_eq!(cell("sequence"), "clip, one");
        assert_eq!(cell("skip_rate"), "0");
        for name in "ap50 ap50_decayed delta_ap50 projected_energy_j gt_boxes".split(' ') {
            assert_eq!(cell(name), "", "{name}");
        }
    }
}
