//! Writes the metrics of each camera: frames, boxes, latency, energy and audit.

use super::flag;
use crate::state::board::{Board, CameraBoard, CameraSnapshot};
use crate::state::readiness::CAMERAS;
use albireo_core::policy::{FrameState, PassCause};
use albireo_service::metrics::MetricsPage;
use albireo_wire::{AuditRate, AuditReport};

/// The metric families of the cameras.
pub(super) fn cameras(page: &mut MetricsPage, board: &Board) {
    let cameras: Vec<ShownCamera<'_>> = board
        .cameras
        .iter()
        .map(|camera| ShownCamera {
            label: ("camera", camera.name()),
            board: camera,
            snapshot: camera.snapshot(),
        })
        .collect();
    frames(page, &cameras);
    newest(page, board, &cameras);
    audit(page, &cameras);
}

/// A camera, as all metrics of one page show it.
struct ShownCamera<'a> {
    label: (&'static str, &'a str),
    board: &'a CameraBoard,
    snapshot: CameraSnapshot,
}

/// A counter of each camera: name, help and value.
type CameraCounter = (&'static str, &'static str, fn(&CameraSnapshot) -> f64);

const COUNTERS: [CameraCounter; 9] = [
    (
        "albireo_frames_arrived_total",
        "Frames that a camera sent, also those that max_rate leaves out",
        |camera| camera.arrived.frames as f64,
    ),
    (
        "albireo_frames_broken_total",
        "Frames that a camera sent and that show damage: from a complaint of the decoder to the next whole key frame. \
         They are answered by prediction",
        |camera| camera.arrived.broken as f64,
    ),
    (
        "albireo_decoder_complaints_total",
        "Complaints of the decoder about a camera's pictures",
        |camera| camera.arrived.complaints as f64,
    ),
    (
        "albireo_files_passed_over_total",
        "Video files of a camera's source that could not be played, as after a power cut",
        |camera| camera.arrived.passed_over as f64,
    ),
    (
        "albireo_frames_skipped_total",
        "Frames that skipped the detector: state E or P and not degraded",
        |camera| camera.states.skipped(camera.degraded_frames) as f64,
    ),
    (
        "albireo_frames_degraded_total",
        "Frames answered from prediction because the detector was not available: state P, and not skipped",
        |camera| camera.degraded_frames as f64,
    ),
    ("albireo_clips_total", "Clips ended", |camera| {
        camera.clips as f64
    }),
    (
        "albireo_messages_unpublished_total",
        "Messages about a camera (answers, counters, clip reports) that were not published because Zenoh accepted \
         them too slowly or not at all",
        |camera| camera.unpublished as f64,
    ),
    (
        "albireo_camera_energy_joules_total",
        "Energy of the clips that ended, each camera's share by the time the detector ran for it, over the time that \
         samples cover; `power_info` says whether it is measured or estimated",
        |camera| camera.clip_joules,
    ),
];

/// The frames by state, and their latency.
fn frames(page: &mut MetricsPage, cameras: &[ShownCamera<'_>]) {
    page.counters(
        "albireo_frames_total",
        "Frames processed, by frame state",
        cameras.iter().flat_map(|camera| {
            FrameState::ALL.map(|state| {
                let labels = [camera.label, ("state", state.as_str())];
                (labels, camera.snapshot.states.get(state) as f64)
            })
        }),
    );
    page.counters(
        "albireo_detector_calls_total",
        "Frames for which the detector was called, by cause, whether or not it was available",
        cameras.iter().flat_map(|camera| {
            // A cause that the policy never has would stay a row of zeros.
            camera
                .snapshot
                .calls
                .by_cause()
                .filter(|(_, count)| *count > 0)
                .map(|(cause, count)| ([camera.label, ("cause", cause.as_str())], count as f64))
        }),
    );
    page.counters(
        "albireo_frames_dropped_total",
        "Frames not processed, by kind",
        cameras.iter().flat_map(|camera| {
            let dropped = camera.snapshot.dropped.by_kind();
            dropped.map(|(kind, count)| ([camera.label, ("kind", kind)], count as f64))
        }),
    );
    page.counters(
        "albireo_frames_passed_total",
        "Frames that a pause passed over, by cause: the road was empty, the picture has not changed, or is dark as well",
        cameras.iter().flat_map(|camera| {
            PassCause::ALL
                .into_iter()
                .zip(camera.snapshot.passed)
                .filter(|(_, count)| *count > 0)
                .map(|(cause, count)| ([camera.label, ("cause", cause.as_str())], count as f64))
        }),
    );
    for (name, help, value) in COUNTERS {
        page.counters(
            name,
            help,
            cameras.iter().map(|camera| ([camera.label], value(&camera.snapshot))),
        );
    }
    page.histograms(
        "albireo_frame_latency_seconds",
        "Time from reception to publication of a frame, by frame state",
        cameras.iter().flat_map(|camera| {
            FrameState::ALL
                .into_iter()
                .zip(&camera.snapshot.total_latency)
                .map(|(state, times)| ([camera.label, ("state", state.as_str())], *times))
        }),
    );
    page.histograms(
        "albireo_detector_latency_seconds",
        "Time the detector took, over the frames where it ran",
        cameras.iter().map(|camera| ([camera.label], camera.snapshot.detector_latency)),
    );
}

/// The arrival of frames, and the figures of the newest.
fn newest(page: &mut MetricsPage, board: &Board, cameras: &[ShownCamera<'_>]) {
    let health = board.readiness.health();
    let silent = |name: &str| {
        health.faults.iter().any(|fault| fault.part == CAMERAS && fault.subject == name)
    };
    page.gauges(
        "albireo_camera_state",
        "Whether frames come from a camera: 1 for the state it is in (live, stale, never_seen, unusable), 0 for the others",
        cameras.iter().flat_map(|camera| {
            let now = if camera.snapshot.unusable().is_some() {
                "unusable"
            } else if camera.snapshot.last_frame_age().is_none() {
                "never_seen"
            } else if silent(camera.board.name()) {
                "stale"
            } else {
                "live"
            };
            ["live", "stale", "never_seen", "unusable"]
                .map(|state| ([camera.label, ("state", state)], flag(state == now)))
        }),
    );
    page.gauges(
        "albireo_last_frame_age_seconds",
        "Time since the newest frame",
        cameras.iter().filter_map(|camera| {
            let age = camera.snapshot.last_frame_age()?;
            Some(([camera.label], age.as_secs_f64()))
        }),
    );
    page.gauges(
        "albireo_camera_no_news_seconds",
        "Time for which a camera's picture has not changed, by cause (unchanged, dark); absent while it changes",
        cameras.iter().filter_map(|camera| {
            let now = camera.board.no_news()?;
            Some(([camera.label, ("cause", now.cause.as_str())], now.for_s))
        }),
    );
    page.gauges(
        "albireo_camera_frame_rate",
        "Frames per second that a camera sends, over the last 10 s",
        cameras
            .iter()
            .filter_map(|camera| Some(([camera.label], camera.snapshot.rate?))),
    );
    page.gauges(
        "albireo_camera_max_rate",
        "Frames per second that the node takes at most, max_rate",
        cameras
            .iter()
            .filter_map(|camera| Some(([camera.label], camera.board.max_rate?))),
    );
    page.counters(
        "albireo_boxes_total",
        "Boxes reported, by class and source (detected, predicted, followed, rescued)",
        cameras.iter().flat_map(|camera| {
            camera.snapshot.boxes.iter().map(|((class, source), count)| {
                let labels = [camera.label, ("class", &**class), ("source", *source)];
                (labels, *count as f64)
            })
        }),
    );
    page.gauges(
        "albireo_threshold",
        "Threshold in force, under the policy's name for it",
        cameras.iter().filter_map(|camera| {
            let name = camera.board.threshold_spec()?.name;
            Some(([camera.label, ("name", name)], camera.board.threshold()?))
        }),
    );
    page.gauges(
        "albireo_tau_max",
        "Largest uncertainty of the newest frame; absent where it had no objects",
        cameras
            .iter()
            .filter_map(|camera| Some(([camera.label], camera.snapshot.latest.as_ref()?.tau_max?))),
    );
}

/// The audit's results: sums over cameras and nodes, and rates of each camera.
fn audit(page: &mut MetricsPage, cameras: &[ShownCamera<'_>]) {
    let audited = || {
        cameras
            .iter()
            .filter_map(|camera| Some((camera.label, camera.snapshot.audit.as_ref()?)))
    };
    page.counters(
        "albireo_audit_frames_total",
        "Skipped frames drawn for the audit, by result: compared, or missed because the detector had no time",
        audited().flat_map(|(label, audit)| {
            [("compared", audit.sums.frames), ("missed", audit.sums.missed)]
                .map(|(result, count)| ([label, ("result", result)], count as f64))
        }),
    );
    page.counters(
        "albireo_audit_boxes_total",
        "Boxes of audited frames by side (detected: the detector's; shown: the published ones) and by result: paired \
         with one of the other side, or unpaired. Compared with the detector, not with ground truth",
        audited().flat_map(|(label, AuditReport { sums, .. })| {
            let results = [
                ("detected", "paired", sums.paired),
                ("detected", "unpaired", sums.detected.saturating_sub(sums.paired)),
                ("shown", "paired", sums.paired),
                ("shown", "unpaired", sums.shown.saturating_sub(sums.paired)),
            ];
            results.map(|(side, result, count)| {
                ([label, ("side", side), ("result", result)], count as f64)
            })
        }),
    );
    let ends = |label, rate: Option<AuditRate>| {
        rate.into_iter().flat_map(move |rate| {
            let ends = [("rate", rate.rate), ("low", rate.low), ("high", rate.high)];
            ends.map(|(end, value)| ([label, ("end", end)], value))
        })
    };
    let under_policy = || {
        cameras
            .iter()
            .filter_map(|camera| Some((camera.label, camera.snapshot.policy_audit.as_ref()?)))
    };
    page.gauges(
        "albireo_audit_recall",
        "Share of the detector's boxes on audited frames that had been shown, since the policy began, with the ends of its \
         interval at 95 %, missed frames included",
        under_policy().flat_map(|(label, audit)| ends(label, audit.sums.recall())),
    );
    page.gauges(
        "albireo_audit_precision",
        "Share of the shown boxes on audited frames that the detector confirms, since the policy began, with the ends of its \
         interval at 95 %, missed frames included; low where a policy shows objects that the detector misses",
        under_policy().flat_map(|(label, audit)| ends(label, audit.sums.precision())),
    );
}
