//! What each camera does: frames by state, whether they come, what was seen, what it cost, how long it took.

use super::Snapshots;
use super::family::Page;
use crate::state::board::{Board, CameraSnapshot};
use crate::state::readiness::CAMERAS;
use albireo_core::policy::{CallCause, FrameState};
use std::fmt;

/// Writes the families of the cameras.
pub(super) fn cameras(page: &mut Page<'_>, board: &Board, cameras: &Snapshots<'_>) -> fmt::Result {
    frames(page, cameras)?;
    let health = board.readiness().health();
    let silent = |name: &str| {
        (health.faults.iter()).any(|fault| fault.part == CAMERAS && fault.subject == name)
    };
    page.gauges(
        "camera_state",
        "Whether frames come from a camera: 1 for the state it is in (live, stale, never_seen), 0 for the others",
        cameras.iter().flat_map(|(camera, snapshot)| {
            let now = match snapshot.last_frame_age {
                None => "never_seen",
                Some(_) if silent(camera.name()) => "stale",
                Some(_) => "live",
            };
            ["live", "stale", "never_seen"].map(|state| {
                let labels = vec![("camera", camera.name()), ("state", state)];
                (labels, f64::from(u8::from(state == now)))
            })
        }),
    )?;
    page.gauges(
        "last_frame_age_seconds",
        "Time since the newest frame",
        cameras.iter().filter_map(|(camera, snapshot)| {
            let age = snapshot.last_frame_age?.as_secs_f64();
            Some((vec![("camera", camera.name())], age))
        }),
    )?;
    page.counters(
        "boxes",
        "Boxes reported, by class and by how each is known (detected, predicted, followed, rescued)",
        cameras.iter().flat_map(|(camera, snapshot)| {
            snapshot.boxes.iter().map(|((class, source), count)| {
                let camera = ("camera", camera.name());
                let labels = vec![camera, ("class", &**class), ("source", *source)];
                (labels, *count as f64)
            })
        }),
    )?;
    page.gauges(
        "threshold",
        "Threshold in force, under the policy's name for it",
        cameras.iter().filter_map(|(camera, _)| {
            let labels = vec![("camera", camera.name()), ("knob", camera.knob()?.name)];
            Some((labels, camera.threshold()?))
        }),
    )?;
    page.gauges(
        "tau_max",
        "Largest uncertainty of the newest frame; absent where it had no objects",
        cameras.iter().filter_map(|(camera, snapshot)| {
            let tau = snapshot.latest.as_ref()?.tau_max?;
            Some((vec![("camera", camera.name())], tau))
        }),
    )?;
    page.histograms(
        "frame_latency_seconds",
        "Time from reception to publication of a frame, by frame state",
        cameras.iter().flat_map(|(camera, _)| {
            FrameState::ALL.map(|state| {
                let labels = vec![("camera", camera.name()), ("state", state.as_str())];
                (labels, camera.total_latency(state))
            })
        }),
    )?;
    page.histograms(
        "detector_latency_seconds",
        "Time the detector took, over the frames where it ran",
        (cameras.iter())
            .map(|(camera, _)| (vec![("camera", camera.name())], camera.detector_latency())),
    )
}

/// A counter of each camera: name, help, and its value.
type CameraCounter = (&'static str, &'static str, fn(&CameraSnapshot) -> f64);

const COUNTERS: [CameraCounter; 8] = [
    (
        "screen_overruled",
        "Frames that the detector ran on although the empty-scene screen said empty, too often in a row",
        |camera| camera.calls.get(CallCause::EmptyLimit) as f64,
    ),
    (
        "frames_skipped",
        "Frames that skipped the detector: state E or P and not degraded",
        |camera| camera.states.skipped(camera.degraded_frames) as f64,
    ),
    (
        "frames_degraded",
        "Frames answered from prediction because the detector was not available: state P, and not skipped",
        |camera| camera.degraded_frames as f64,
    ),
    ("clips", "Clips ended", |camera| camera.clips as f64),
    (
        "camera_shared_memory_frames",
        "Frames that came in memory which their sender on this machine shares, and were read in place",
        |camera| camera.shared_frames as f64,
    ),
    (
        "messages_unpublished",
        "Messages about a camera (answers, counters, clip reports) that were not published, as Zenoh took them too slowly \
         or not at all",
        |camera| camera.unpublished as f64,
    ),
    (
        "looks",
        "Frames of which a small grey picture was decoded, to follow boxes by optical flow in it",
        |camera| camera.looks as f64,
    ),
    (
        "camera_energy_joules",
        "Energy of the clips that ended, each camera's share by the time the detector ran for it, over the time that \
         samples cover; `power_info` says whether it is measured or estimated",
        |camera| camera.clip_joules,
    ),
];

fn frames(page: &mut Page<'_>, cameras: &Snapshots<'_>) -> fmt::Result {
    page.counters(
        "frames",
        "Frames processed, by frame state",
        cameras.iter().flat_map(|(camera, snapshot)| {
            FrameState::ALL.map(|state| {
                let labels = vec![("camera", camera.name()), ("state", state.as_str())];
                (labels, snapshot.states.get(state) as f64)
            })
        }),
    )?;
    page.counters(
        "detector_calls",
        "Frames that the detector was called for, by cause, whether or not it was available",
        cameras.iter().flat_map(|(camera, snapshot)| {
            // A cause that this policy does not have would be a row of zeros for ever.
            let some = snapshot.calls.by_cause().filter(|(_, count)| *count > 0);
            some.map(|(cause, count)| {
                let labels = vec![("camera", camera.name()), ("cause", cause.as_str())];
                (labels, count as f64)
            })
        }),
    )?;
    page.counters(
        "frames_dropped",
        "Frames not processed, by kind",
        cameras.iter().flat_map(|(camera, snapshot)| {
            (snapshot.dropped.by_kind()).map(|(kind, count)| {
                (
                    vec![("camera", camera.name()), ("kind", kind)],
                    count as f64,
                )
            })
        }),
    )?;
    for (name, help, value) in COUNTERS {
        let samples = (cameras.iter())
            .map(|(camera, snapshot)| (vec![("camera", camera.name())], value(snapshot)));
        page.counters(name, help, samples)?;
    }
    Ok(())
}
