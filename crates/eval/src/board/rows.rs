//! Lists the figures of runs and policies as rows for CSV.

use super::run::{ClipRun, Setup, SetupRuns};
use super::summary::{PolicyFigures, SetupSummary};
use crate::files::CsvRow;
use crate::summary::Difference;

fn number(value: Option<f64>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

/// Returns a row per run; a figure that does not exist is an empty cell, never a zero.
pub(super) fn rows_of_clips(setups: &[SetupRuns]) -> Vec<CsvRow> {
    let mut rows = Vec::new();
    for SetupRuns { setup, runs } in setups {
        let title = setup.title_among(setups);
        rows.extend(runs.iter().map(|run| row_of_clip(&title, setup, run)));
    }
    rows
}

fn row_of_clip(title: &str, setup: &Setup, run: &ClipRun) -> CsvRow {
    let domain = |name: &str| number(run.domains.get(name).copied());
    vec![
        ("setup", title.to_owned()),
        ("detector", setup.detector.clone()),
        ("precision", setup.precision.clone()),
        ("power_mode", setup.power_mode.clone()),
        ("machine", setup.machine.clone()),
        ("clip", run.clip.clone()),
        ("policy", run.policy.clone()),
        ("frames", run.frames.to_string()),
        ("dropped", run.dropped.to_string()),
        ("unlabelled", run.unlabelled.to_string()),
        ("e", run.states.e.to_string()),
        ("p", run.states.p.to_string()),
        ("ei", run.states.ei.to_string()),
        ("i", run.states.i.to_string()),
        ("ai", run.states.ai.to_string()),
        ("degraded", run.degraded.to_string()),
        ("detector_calls", run.detector_calls.to_string()),
        ("skip_rate", number(run.skip_rate())),
        ("duration_s", run.duration_s.to_string()),
        ("frame_ms", number(run.frame_ms)),
        ("ap50", number(run.ap50)),
        ("map", number(run.map)),
        ("energy_j", number(run.joules)),
        ("energy_estimated", run.estimated.to_string()),
        ("energy_gpu_j", domain("gpu")),
        ("energy_cpu_j", domain("cpu")),
        ("energy_io_mem_j", domain("io_mem")),
        ("edp_j_ms_per_frame", number(run.edp())),
        ("cpu_s", number(run.cpu_s)),
        ("gpu_utilisation", number(run.gpu_utilisation)),
        ("memory_mb", number(run.memory_mb)),
        ("throttled", run.throttled.to_string()),
    ]
}

/// Returns a row for each setting under which a setup was measured.
pub(super) fn rows_of_settings(setups: &[SetupRuns]) -> Vec<CsvRow> {
    let mut rows = Vec::new();
    for SetupRuns { setup, .. } in setups {
        let title = setup.title_among(setups);
        for (key, value) in &setup.settings {
            rows.push(vec![
                ("setup", title.clone()),
                ("key", key.clone()),
                ("value", value.clone()),
            ]);
        }
    }
    rows
}

/// Returns a row for each entry of a power trace.
pub(super) fn rows_of_power(setups: &[SetupRuns]) -> Vec<CsvRow> {
    let mut rows = Vec::new();
    for SetupRuns { setup, runs } in setups {
        let title = setup.title_among(setups);
        for run in runs {
            for (domain, trace) in &run.traces {
                for [seconds, watts] in trace {
                    rows.push(vec![
                        ("setup", title.clone()),
                        ("clip", run.clip.clone()),
                        ("policy", run.policy.clone()),
                        ("domain", domain.clone()),
                        ("seconds", seconds.to_string()),
                        ("watts", watts.to_string()),
                    ]);
                }
            }
        }
    }
    rows
}

/// Returns a row per setup and policy.
pub(super) fn rows_of_policies(summaries: &[SetupSummary]) -> Vec<CsvRow> {
    let mut rows = Vec::new();
    for summary in summaries {
        rows.extend(summary.policies.iter().map(|figures| row_of_policy(&summary.title, figures)));
    }
    rows
}

fn row_of_policy(setup: &str, figures: &PolicyFigures) -> CsvRow {
    let change = figures.change.as_ref();
    let mean = |found: Option<Difference>| number(found.map(|found| found.mean));
    let p = |found: Option<Difference>| number(found.and_then(|found| found.p));
    vec![
        ("setup", setup.to_owned()),
        ("policy", figures.policy.clone()),
        ("clips", figures.clips.to_string()),
        ("frames", figures.frames.to_string()),
        ("unlabelled", figures.unlabelled.to_string()),
        ("ap50", number(figures.ap50)),
        ("map", number(figures.map)),
        ("energy_j", number(figures.joules)),
        ("frame_ms", number(figures.frame_ms)),
        ("edp_of_means", number(figures.edp)),
        ("edp_mean_of_clips", number(figures.edp_of_clips)),
        ("skip_rate", number(figures.skip_rate)),
        ("detector_calls", figures.detector_calls.to_string()),
        ("cpu_cores", number(figures.cores)),
        ("gpu_utilisation", number(figures.gpu_utilisation)),
        ("memory_mb", number(figures.memory_mb)),
        (
            "ap50_change_points",
            mean(change.and_then(|change| change.ap50)),
        ),
        ("ap50_change_p", p(change.and_then(|change| change.ap50))),
        (
            "map_change_points",
            mean(change.and_then(|change| change.map)),
        ),
        ("map_change_p", p(change.and_then(|change| change.map))),
        (
            "energy_change_percent",
            mean(change.and_then(|change| change.joules)),
        ),
        (
            "energy_change_p",
            p(change.and_then(|change| change.joules)),
        ),
        (
            "frame_ms_change_percent",
            mean(change.and_then(|change| change.frame_ms)),
        ),
        (
            "edp_change_percent",
            number(change.and_then(|change| change.edp)),
        ),
        (
            "clips_that_save",
            number(change.and_then(|change| change.clips_that_save)),
        ),
    ]
}
