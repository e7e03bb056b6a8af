//! Lists the figures of runs and policies as rows for CSV.

use super::run::SetupRuns;
use super::summary::SetupSummary;
use crate::summary::Difference;

type Cells = Vec<(&'static str, String)>;

fn number(value: Option<f64>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

/// Returns a row per run; a figure that does not exist is an empty cell, never a zero.
pub(super) fn rows_of_clips(setups: &[SetupRuns]) -> Vec<Cells> {
    let runs = setups.iter().flat_map(|of| of.runs.iter().map(move |run| (&of.setup, run)));
    runs.map(|(setup, run)| {
        let domain = |name: &str| number(run.domains.get(name).copied());
        vec![
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
            ("skip_rate", run.skip_rate().to_string()),
            ("duration_s", run.duration_s.to_string()),
            ("frame_ms", run.frame_ms.to_string()),
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
    })
    .collect()
}

/// Returns a row for each setting under which a setup was measured.
pub(super) fn rows_of_settings(setups: &[SetupRuns]) -> Vec<Cells> {
    let rows_of = |of: &SetupRuns| -> Vec<Cells> {
        let title = of.setup.title();
        let settings = of.setup.settings.iter();
        settings
            .map(|(key, value)| {
                vec![
                    ("setup", title.clone()),
                    ("key", key.clone()),
                    ("value", value.clone()),
                ]
            })
            .collect()
    };
    setups.iter().flat_map(rows_of).collect()
}

/// Returns a row for each entry of a power trace.
pub(super) fn rows_of_power(setups: &[SetupRuns]) -> Vec<Cells> {
    let runs = setups.iter().flat_map(|of| of.runs.iter().map(move |run| (&of.setup, run)));
    let traces = runs.flat_map(|(setup, run)| {
        run.traces.iter().map(move |(domain, trace)| (setup, run, domain, trace))
    });
    traces
        .flat_map(|(setup, run, domain, trace)| {
            trace.iter().map(move |[seconds, watts]| {
                vec![
                    ("setup", setup.title()),
                    ("clip", run.clip.clone()),
                    ("policy", run.policy.clone()),
                    ("domain", domain.clone()),
                    ("seconds", seconds.to_string()),
                    ("watts", watts.to_string()),
                ]
            })
        })
        .collect()
}

/// Returns a row per setup and policy.
pub(super) fn rows_of_policies(summaries: &[SetupSummary]) -> Vec<Cells> {
    let policies = summaries
        .iter()
        .flat_map(|summary| summary.policies.iter().map(move |of| (&summary.title, of)));
    policies
        .map(|(title, of)| {
            let change = of.change.as_ref();
            let mean = |found: Option<Difference>| number(found.map(|found| found.mean));
            let p = |found: Option<Difference>| number(found.and_then(|found| found.p));
            vec![
                ("setup", title.clone()),
                ("policy", of.policy.clone()),
                ("clips", of.clips.to_string()),
                ("frames", of.frames.to_string()),
                ("unlabelled", of.unlabelled.to_string()),
                ("ap50", number(of.ap50)),
                ("map", number(of.map)),
                ("energy_j", number(of.joules)),
                ("frame_ms", of.frame_ms.to_string()),
                ("edp_of_means", number(of.edp)),
                ("edp_mean_of_clips", number(of.edp_of_clips)),
                ("skip_rate", of.skip_rate.to_string()),
                ("detector_calls", of.detector_calls.to_string()),
                ("cpu_cores", number(of.cores)),
                ("gpu_utilisation", number(of.gpu_utilisation)),
                ("memory_mb", number(of.memory_mb)),
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
        })
        .collect()
}
