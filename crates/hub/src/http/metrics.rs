//! Metrics for Prometheus, as text (0.0.4).

use super::HubView;
use crate::presence::PresenceState;
use albireo_wire::TargetStatus;
use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use std::fmt::Write as _;
use std::sync::atomic::Ordering;

const PLAIN: &str = "text/plain; version=0.0.4; charset=utf-8";

/// Figures of the hub
///
/// `curl http://127.0.0.1:8090/metrics`
#[utoipa::path(
    get, operation_id = "metrics", path = "/metrics", tag = "metrics",
    responses((status = 200, content_type = "text/plain", body = String))
)]
pub(super) async fn text(State(view): State<HubView>) -> Response {
    let sessions = view.sessions().await;
    ([(CONTENT_TYPE, PLAIN)], written(&view, sessions)).into_response()
}

/// The text; `sessions` where the session is open.
pub(super) fn written(view: &HubView, sessions: Option<usize>) -> String {
    let mut text = String::new();
    let mut family = |name: &str, kind: &str, help: &str, samples: &[(&str, f64)]| {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "# HELP {name} {help}\n# TYPE {name} {kind}");
        for (labels, value) in samples {
            let _ = writeln!(text, "{name}{labels} {value}");
        }
    };
    let version = format!("{{version=\"{}\"}}", env!("CARGO_PKG_VERSION"));
    family(
        "albireo_hub_build_info",
        "gauge",
        "The program that runs, always 1",
        &[(&version, 1.0)],
    );
    let ready = f64::from(u8::from(view.readiness.reasons().is_empty()));
    family(
        "albireo_hub_ready",
        "gauge",
        "Whether reports are taken and committed",
        &[("", ready)],
    );
    for figure in albireo_service::process::figures() {
        if figure.counter {
            let name = format!("{}_total", figure.name);
            family(&name, "counter", figure.help, &[("", figure.value)]);
        } else {
            family(figure.name, "gauge", figure.help, &[("", figure.value)]);
        }
    }
    let tallies = view.fleet.tallies(|node| view.desires.of(node).revision);
    let drifted = view.tuner().map_or(0, |tuner| tuner.drift().len());
    for (name, help, value) in [
        (
            "albireo_hub_nodes_behind",
            "Nodes that are heard and have not taken yet what is desired of them",
            tallies.behind,
        ),
        (
            "albireo_hub_nodes_drifted",
            "Nodes whose value was changed at the node, away from what is desired",
            drifted as u64,
        ),
        (
            "albireo_hub_twin_names",
            "Names that more than one node uses",
            tallies.twins,
        ),
        (
            "albireo_hub_outbox_waiting",
            "Clip reports that wait in the nodes' outboxes, as far as they have told",
            tallies.waiting,
        ),
        (
            "albireo_hub_sessions_limit",
            "Most Zenoh sessions of this hub, where it is its nodes' router",
            crate::run::MAX_SESSIONS,
        ),
    ] {
        family(name, "gauge", help, &[("", value as f64)]);
    }
    let states: Vec<(String, f64)> = PresenceState::ALL
        .into_iter()
        .zip(view.fleet.by_state())
        .map(|(state, nodes)| (format!("{{state=\"{}\"}}", state.as_str()), nodes as f64))
        .collect();
    let states: Vec<(&str, f64)> = states
        .iter()
        .map(|(labels, nodes)| (labels.as_str(), *nodes))
        .collect();
    family("albireo_hub_nodes", "gauge", "Nodes by state", &states);
    let targets: Vec<(String, f64)> = TargetStatus::ALL
        .into_iter()
        .zip(tallies.targets)
        .map(|(status, nodes)| {
            let labels = format!("{{status=\"{}\"}}", status.name());
            (labels, nodes as f64)
        })
        .collect();
    let targets: Vec<(&str, f64)> = targets
        .iter()
        .map(|(labels, nodes)| (labels.as_str(), *nodes))
        .collect();
    family(
        "albireo_hub_targets",
        "gauge",
        "Nodes that are heard and hold a target, by where it stands",
        &targets,
    );
    let one = view.ingest.snapshot();
    for (name, help, value) in [
        (
            "albireo_hub_batches_total",
            "Batches acknowledged",
            one.batches,
        ),
        ("albireo_hub_clips_total", "Clips written", one.clips),
        (
            "albireo_hub_reports_again_total",
            "Reports that were there already",
            one.again,
        ),
        (
            "albireo_hub_reports_set_aside_total",
            "Reports that make no sense",
            one.set_aside,
        ),
        (
            "albireo_hub_reports_missing_total",
            "Running counts of nodes found missing",
            one.missing,
        ),
        (
            "albireo_hub_reports_too_old_total",
            "Reports refused because they are older than identities are known",
            one.too_old,
        ),
        (
            "albireo_hub_count_resets_total",
            "Running counts that began anew: the state of a node was made anew, went back or was copied",
            one.resets,
        ),
        (
            "albireo_hub_clock_off_total",
            "Clips of nodes whose clock is off",
            one.clock_off,
        ),
        ("albireo_hub_commits_total", "Commits", one.commits),
        (
            "albireo_hub_frames_total",
            "Frames of the clips written",
            one.frames,
        ),
        (
            "albireo_hub_frames_skipped_total",
            "Frames of the clips written that skipped the detector",
            one.frames_skipped,
        ),
        (
            "albireo_hub_database_errors_total",
            "Transactions that failed",
            one.database_errors,
        ),
        (
            "albireo_hub_answers_lost_total",
            "Answers that could not be sent",
            one.answers_lost,
        ),
        (
            "albireo_hub_statuses_total",
            "Status messages taken",
            view.fleet.statuses(),
        ),
        (
            "albireo_hub_statuses_overrun_total",
            "Status messages that found their queue full",
            view.listen.overrun.load(Ordering::Relaxed),
        ),
        (
            "albireo_hub_statuses_unreadable_total",
            "Status messages that cannot be read",
            view.listen.unreadable.load(Ordering::Relaxed),
        ),
        (
            "albireo_hub_pulls_total",
            "Questions of nodes for what is desired",
            view.listen.pulls.load(Ordering::Relaxed),
        ),
    ] {
        family(name, "counter", help, &[("", value as f64)]);
    }
    family(
        "albireo_hub_energy_joules_total",
        "counter",
        "Energy of the clips written that have a figure, over the time that samples cover",
        &[("", one.energy_uj as f64 / 1e6)],
    );
    family(
        "albireo_hub_audit_frames_total",
        "counter",
        "Skipped frames of the clips written that the audit drew, by what became of them",
        &[
            ("{result=\"compared\"}", one.audit_frames as f64),
            ("{result=\"missed\"}", one.audit_missed as f64),
        ],
    );
    let rest = |all: u64, paired: u64| all.saturating_sub(paired) as f64;
    family(
        "albireo_hub_audit_boxes_total",
        "counter",
        "Boxes of the audited frames of the clips written, by side (detected: the detector's; shown: what had been \
         published) and by whether one of the other side is paired with it. Against the detector, not the truth",
        &[
            (
                "{side=\"detected\",result=\"paired\"}",
                one.audit_paired as f64,
            ),
            (
                "{side=\"detected\",result=\"unpaired\"}",
                rest(one.audit_detected, one.audit_paired),
            ),
            (
                "{side=\"shown\",result=\"paired\"}",
                one.audit_paired as f64,
            ),
            (
                "{side=\"shown\",result=\"unpaired\"}",
                rest(one.audit_shown, one.audit_paired),
            ),
        ],
    );
    family(
        "albireo_hub_batches_refused_total",
        "counter",
        "Batches not taken, by reason",
        &[
            ("{reason=\"busy\"}", one.refused_busy as f64),
            ("{reason=\"unavailable\"}", one.refused_unavailable as f64),
            ("{reason=\"unreadable\"}", one.refused_unreadable as f64),
        ],
    );
    family(
        "albireo_hub_acknowledged_after_p99_seconds",
        "gauge",
        "99th percentile of the time from a batch's arrival to its acknowledgement, of the last ones",
        &[("", one.acknowledged_after_p99_s)],
    );
    family(
        "albireo_hub_commit_p99_seconds",
        "gauge",
        "99th percentile of the time a transaction took, of the last ones",
        &[("", one.committed_in_p99_s)],
    );
    family(
        "albireo_hub_queue_batches",
        "gauge",
        "Batches that came and are not answered yet",
        &[("", one.queued as f64)],
    );
    family(
        "albireo_hub_queue_bytes",
        "gauge",
        "Compressed bytes of the batches that are not answered yet",
        &[("", one.queued_bytes as f64)],
    );
    family(
        "albireo_hub_sessions",
        "gauge",
        "Zenoh sessions of this hub: nodes where it is their router, else its router; absent while its own is not open",
        &sessions.map_or_else(Vec::new, |sessions| vec![("", sessions as f64)]),
    );
    text
}
