//! Writes the Prometheus metrics.

mod cameras;

use super::RouteState;
use crate::outbox::OutboxCounts;
use crate::recorder::RecordingStatus;
use crate::state::board::{Board, provider};
use crate::state::readiness::PARTS;
use albireo_service::metrics::MetricsPage;
use albireo_wire::TargetStatus;
use axum::extract::State;
use std::sync::atomic::Ordering;

fn flag(on: bool) -> f64 {
    f64::from(u8::from(on))
}

/// Metrics for Prometheus
///
/// `curl http://127.0.0.1:8080/metrics`
#[utoipa::path(get, operation_id = "metrics", path = "/metrics", tag = "metrics", responses((status = 200, body = String, content_type = "text/plain")))]
pub(super) async fn text(State(shared): State<RouteState>) -> MetricsPage {
    let mut page = MetricsPage::default();
    let board = &shared.board;
    page.process();
    page.certificates(&board.certificates);
    page.counter(
        "albireo_shown_pictures_decoded_total",
        "Pictures decoded for display",
        shared.decoded.load(Ordering::Relaxed) as f64,
    );
    node(&mut page, board);
    detector(&mut page, board);
    cameras::cameras(&mut page, board);
    target(&mut page, board);
    outbox(&mut page, &shared.outbox.counts());
    recordings(&mut page, &shared.recorder.status());
    forwarded(&mut page, board);
    power(&mut page, board);
    page
}

/// What was forwarded to hooks and an MQTT broker.
fn forwarded(page: &mut MetricsPage, board: &Board) {
    let places = board.forwarded();
    page.counters(
        "albireo_forwarded_total",
        "Messages to hooks and the MQTT broker: sent (acknowledged), failed (attempts, repeated later), dropped",
        places.iter().flat_map(|place| {
            let counts = [
                ("sent", place.sent),
                ("failed", place.failed),
                ("dropped", place.dropped),
            ];
            counts.map(|(outcome, count)| {
                ([("to", place.to.as_str()), ("outcome", outcome)], count as f64)
            })
        }),
    );
}

/// The build, and the state of the node's parts.
fn node(page: &mut MetricsPage, board: &Board) {
    let status = board.detector_status();
    let health = board.readiness.health();
    let version = ("version", env!("CARGO_PKG_VERSION"));
    page.gauges(
        "albireo_build_info",
        "The program that runs, always 1",
        [([version, ("node", board.node.as_str())], 1.0)],
    );
    page.gauge(
        "albireo_uptime_seconds",
        "Time since the node started",
        board.uptime().as_secs_f64(),
    );
    page.gauge(
        "albireo_ready",
        "Whether the node works as configured",
        flag(health.is_ready()),
    );
    let wanted = board.providers.first();
    let runs = provider(&status);
    let fell_back = match (wanted, runs) {
        (Some(wanted), Some(runs)) => wanted.as_str() != runs,
        _ => false,
    };
    page.gauge(
        "albireo_detector_fallback",
        "Whether the detector runs on another execution provider than the first configured one",
        flag(fell_back),
    );
    let labels = [
        ("model", board.model.as_str()),
        ("provider", runs.unwrap_or("none")),
        ("policy", board.policy().name),
    ];
    page.gauges(
        "albireo_detector_info",
        "The detector's model and the execution provider that actually runs it, always 1",
        [(labels, 1.0)],
    );
    page.gauges(
        "albireo_part_working",
        "Whether a part works: 1, or 0 when /readyz has a reason for it",
        PARTS.map(|part| {
            let works = health.faults.iter().all(|fault| fault.part != part);
            ([("part", part)], flag(works))
        }),
    );
    let failures = board.tasks.lock().clone();
    page.counters(
        "albireo_task_failures_total",
        "Times a task of the node panicked, failed or ended before the shutdown",
        failures.iter().map(|(task, count)| ([("task", &**task)], *count as f64)),
    );
}

/// The counts of the detector and of the empty-scene screen.
fn detector(page: &mut MetricsPage, board: &Board) {
    let counts = board.model_counts();
    let head = board.reading.get().map(|reading| reading.meter.read()).unwrap_or_default();
    page.counter(
        "albireo_detector_batches_total",
        "Completed runs of the model: fewer than completed pictures where cameras share a run",
        counts.detector.batches as f64,
    );
    page.gauge(
        "albireo_detector_queue",
        "Pictures that wait for the detector",
        counts.detector.waiting as f64,
    );
    let dropped = [
        ("impossible", head.rejected),
        ("outside", head.outside),
        ("unknown_class", head.unknown_class),
        ("over_limit", head.over_limit),
        ("other_class", head.other_class),
    ];
    page.counters(
        "albireo_detector_boxes_dropped_total",
        "Boxes in the model's output that were not reported, by reason",
        dropped.map(|(reason, count)| ([("reason", reason)], count as f64)),
    );
    for (prefix, what, counts) in [
        ("detector", "detector", &counts.detector),
        ("screen", "empty-scene screen", &counts.screen),
    ] {
        let runs = [
            ("completed", counts.completed),
            ("timed_out", counts.timed_out),
            ("failed", counts.failed),
            ("panicked", counts.panicked),
            ("refused", counts.refused),
            ("cancelled", counts.cancelled),
        ];
        let rebuilds = [
            ("completed", counts.rebuilds),
            ("failed", counts.rebuilds_failed),
        ];
        page.counters(
            &format!("albireo_{prefix}_runs_total"),
            &format!("Pictures given to the {what}, by outcome"),
            runs.map(|(outcome, count)| ([("outcome", outcome)], count as f64)),
        );
        page.counters(
            &format!("albireo_{prefix}_rebuilds_total"),
            &format!("Sessions of the {what} rebuilt after a failure, by outcome"),
            rebuilds.map(|(outcome, count)| ([("outcome", outcome)], count as f64)),
        );
    }
}

/// The target, its measured value and its status; nothing without a target.
fn target(page: &mut MetricsPage, board: &Board) {
    let report = board.target.report();
    let target = report.target;
    let state = if target.is_some() { report.state } else { None };
    let label = || target.iter().map(|target| [("target", target.name())]);
    page.gauges(
        "albireo_target",
        "The target held instead of a fixed threshold, in its own unit; absent without a target",
        label().zip(target.map(|target| target.value())),
    );
    page.gauges(
        "albireo_target_actual",
        "The measured value of the target; for recall, the lower end of its interval. Absent before the first measurement",
        label().zip(state.and_then(|state| state.actual)),
    );
    page.gauges(
        "albireo_target_status",
        "Whether the target is met, and if not, why: 1 for the current status, 0 for the others",
        state.iter().flat_map(|state| {
            TargetStatus::ALL
                .map(|status| ([("status", status.name())], flag(status == state.status)))
        }),
    );
    page.counters(
        "albireo_target_unmet_total",
        "Times since the target was set that it became impossible to meet within the threshold's range",
        state.map(|state| ([], state.unmet as f64)),
    );
    page.counters(
        "albireo_target_unmet_seconds_total",
        "Time since the target was set during which it could not be met within the threshold's range",
        state.map(|state| ([], state.unmet_s)),
    );
}

/// The counts of the outbox.
fn outbox(page: &mut MetricsPage, counts: &OutboxCounts) {
    page.gauge(
        "albireo_outbox_waiting",
        "Clip reports that no hub has acknowledged",
        counts.status.waiting as f64,
    );
    page.counter(
        "albireo_outbox_kept_total",
        "Clip reports added to the outbox",
        counts.kept as f64,
    );
    page.counter(
        "albireo_outbox_acknowledged_total",
        "Clip reports that a hub has acknowledged",
        counts.acknowledged as f64,
    );
    page.counter(
        "albireo_outbox_lost_total",
        "Clip reports lost because the outbox was full or its disk was broken",
        counts.status.lost as f64,
    );
    page.counter(
        "albireo_outbox_undeliverable_total",
        "Clip reports that a hub refused for good, or that cannot be sent; the log has the reasons",
        counts.status.undeliverable as f64,
    );
    page.counter(
        "albireo_outbox_disk_failures_total",
        "Times the state directory failed",
        counts.disk_failures as f64,
    );
}

/// Recordings; nothing without a folder for them.
fn recordings(page: &mut MetricsPage, status: &RecordingStatus) {
    if status.folder.is_none() {
        return;
    }
    page.gauge(
        "albireo_recordings",
        "Recordings in the folder record.folder",
        status.files as f64,
    );
    page.gauge(
        "albireo_recordings_bytes",
        "Bytes of these recordings",
        status.bytes as f64,
    );
    page.counter(
        "albireo_recording_events_total",
        "Events since the start that began or prolonged a recording",
        status.events as f64,
    );
    let frames = [
        ("written", status.written_frames),
        ("audited", status.audited_frames),
        ("dropped", status.dropped_frames),
        ("failed", status.failed_frames),
    ];
    page.counters(
        "albireo_recording_frames_total",
        "Frames for recordings: written, audited (with what the detector found), dropped (the disk or the processor is too slow), failed \
         (the disk or the picture is at fault)",
        frames.map(|(outcome, count)| ([("outcome", outcome)], count as f64)),
    );
}

/// Power and energy.
fn power(page: &mut MetricsPage, board: &Board) {
    let power = board.power();
    let source = ("source", power.source.as_str());
    let quality = power.quality.as_str();
    page.gauges(
        "albireo_power_info",
        "Whether power is measured or estimated now, or unavailable: always 1",
        [([source, ("quality", quality)], 1.0)],
    );
    page.gauges(
        "albireo_power_watts",
        "Power now; `power_info` says whether it is measured or estimated",
        power.watts.iter().map(|now| ([("domain", &*now.domain), source], now.watts)),
    );
    page.counters(
        "albireo_energy_joules_total",
        "Energy since the node started, over the time that samples cover; `power_info` says whether it is measured or \
         estimated",
        power.joules.iter().map(|(domain, joules)| ([("domain", domain.as_str()), source], *joules)),
    );
    page.counters(
        "albireo_energy_covered_seconds_total",
        "Time that samples of power cover since the node started: `energy_joules` divided by it is the mean power",
        power.covered_s.iter()
            .map(|(domain, seconds)| ([("domain", domain.as_str()), source], *seconds)),
    );
    page.gauges(
        "albireo_temperature_celsius",
        "The machine's hottest sensor",
        power
            .hottest
            .iter()
            .map(|(sensor, celsius)| ([("sensor", sensor.as_str())], *celsius)),
    );
    page.counters(
        "albireo_power_failed_reads_total",
        "Times the power source could not be read",
        [([source], power.failed_reads as f64)],
    );
    page.counters(
        "albireo_power_meter_cpu_seconds_total",
        "CPU time spent on reading the power source",
        [([source], power.meter_cpu.as_secs_f64())],
    );
}
