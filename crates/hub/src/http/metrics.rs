//! Serves metrics for Prometheus.

use crate::hub::Hub;
use crate::presence::NodeView;
use crate::tuning::DesiredSettings;
use albireo_service::clock::unix_milliseconds;
use albireo_service::metrics::MetricsPage;
use albireo_wire::TargetStatus;
use axum::extract::State;

const DAY_S: i64 = 86_400;

/// Metrics of the hub
///
/// `curl http://127.0.0.1:8090/metrics`
#[utoipa::path(
    get, operation_id = "metrics", path = "/metrics", tag = "metrics",
    responses((status = 200, content_type = "text/plain", body = String))
)]
pub(super) async fn text(State(hub): State<Hub>) -> MetricsPage {
    page(&hub).await
}

/// All metrics.
pub(super) async fn page(hub: &Hub) -> MetricsPage {
    let mut page = MetricsPage::default();
    page.gauges(
        "albireo_hub_build_info",
        "The running program, always 1",
        [([("version", env!("CARGO_PKG_VERSION"))], 1.0)],
    );
    page.gauge(
        "albireo_hub_ready",
        "Whether reports are accepted and committed",
        f64::from(u8::from(hub.readiness.health().is_ready())),
    );
    page.process();
    page.certificates(&hub.certificates);
    presence(&mut page, hub);
    ingest(&mut page, hub);
    let sessions = match hub.session.get() {
        Some(session) => Some(session.info().transports().await.count() as f64),
        None => None,
    };
    page.gauge(
        "albireo_hub_sessions",
        "Zenoh sessions with this hub: one per node if the hub is their router, else the one with its router; absent until \
         the hub has opened its session",
        sessions,
    );
    page.gauge(
        "albireo_hub_sessions_limit",
        "Most Zenoh sessions of this hub, where it is its nodes' router",
        crate::answers::MAX_SESSIONS as f64,
    );
    page
}

/// What the nodes of the fleet add up to.
#[derive(Default)]
struct FleetCounts {
    /// Nodes out of reach that are always expected.
    missing: u32,
    /// Nodes in reach without their desired setting.
    behind: u32,
    /// Reports that wait in outboxes.
    waiting: u64,
    /// Nodes with a certificate that ends within seven days.
    within_7_days: u32,
    /// Nodes with a certificate that ends within thirty days.
    within_30_days: u32,
    /// Nodes in reach that hold a target, in the order of [`TargetStatus::ALL`].
    targets: [u32; TargetStatus::ALL.len()],
}

impl FleetCounts {
    /// Adds a node at the time `now_s`.
    fn add(&mut self, node: &NodeView, desired: &DesiredSettings, now_s: i64) {
        // Any node may claim any number.
        self.waiting = self.waiting.saturating_add(node.waiting);
        let certificates = node.status.iter().flat_map(|status| &status.certificates);
        if let Some(first_s) = certificates.map(|one| one.until_s).min() {
            let left_s = first_s.saturating_sub(now_s);
            self.within_7_days += u32::from(left_s < 7 * DAY_S);
            self.within_30_days += u32::from(left_s < 30 * DAY_S);
        }
        if !node.is_reachable() {
            let expected = node.labels().get("expected");
            self.missing += u32::from(expected.is_some_and(|when| when == "always"));
            return;
        }
        if let Some(desired) = desired.get(&node.node)
            && node.revision < desired.given.revision
        {
            self.behind += 1;
        }
        if let Some(target) = node.status.as_ref().and_then(|status| status.target) {
            let status = target.status.unwrap_or(TargetStatus::Measuring);
            self.targets[status as usize] += 1;
        }
    }
}

fn count_fleet(hub: &Hub) -> FleetCounts {
    let mut counts = FleetCounts::default();
    let now_s = unix_milliseconds().div_euclid(1000);
    hub.fleet.each(|node| counts.add(node, &hub.desired, now_s));
    counts
}

fn presence(page: &mut MetricsPage, hub: &Hub) {
    let counts = count_fleet(hub);
    page.gauge(
        "albireo_hub_nodes_missing",
        "Silent or offline nodes with the label expected = \"always\"",
        f64::from(counts.missing),
    );
    page.gauges(
        "albireo_hub_nodes_certificate_ending",
        "Nodes with a certificate that ends within this time, or has ended, by their last status",
        [
            ([("within", "7d")], f64::from(counts.within_7_days)),
            ([("within", "30d")], f64::from(counts.within_30_days)),
        ],
    );
    page.gauge(
        "albireo_hub_nodes_behind",
        "Online or degraded nodes that do not have their desired setting yet",
        f64::from(counts.behind),
    );
    page.gauge(
        "albireo_hub_nodes_drifted",
        "Nodes whose setting was changed at the node and differs from the desired one",
        hub.tuner().map_or(0, |tuner| tuner.drift().len()) as f64,
    );
    page.gauge(
        "albireo_hub_twin_names",
        "Names that more than one node uses",
        hub.fleet.twins() as f64,
    );
    let dropped = hub.fleet.dropped_statuses();
    page.counters(
        "albireo_hub_statuses_dropped_total",
        "Statuses that were not kept: of too many names that never sent a report, or too large for the memory of all",
        [
            ([("reason", "names")], dropped.names as f64),
            ([("reason", "memory")], dropped.memory as f64),
        ],
    );
    page.gauge(
        "albireo_hub_outbox_waiting",
        "Clip reports that wait in the nodes' outboxes, as far as they have reported",
        counts.waiting as f64,
    );
    page.gauges(
        "albireo_hub_nodes",
        "Nodes by state",
        hub.fleet
            .by_state()
            .into_iter()
            .map(|(state, nodes)| ([("state", state.name())], nodes as f64)),
    );
    page.gauges(
        "albireo_hub_targets",
        "Online or degraded nodes that hold a target, by its status",
        TargetStatus::ALL
            .into_iter()
            .zip(counts.targets)
            .map(|(status, nodes)| ([("status", status.name())], f64::from(nodes))),
    );
}

fn ingest(page: &mut MetricsPage, hub: &Hub) {
    let counts = hub.ingest.counts();
    for (name, help, count) in counts.named() {
        page.counter(name, help, count as f64);
    }
    page.counter(
        "albireo_hub_energy_joules_total",
        "Energy of the clips written that have a figure, over the time that samples cover",
        counts.energy_uj as f64 / 1e6,
    );
    page.counters(
        "albireo_hub_audit_frames_total",
        "Skipped frames of the clips written that the audit drew, by result",
        [
            ([("result", "compared")], counts.audit_frames as f64),
            ([("result", "missed")], counts.audit_missed as f64),
        ],
    );
    let paired = counts.audit_paired;
    let row = |side, result, boxes: u64| ([("side", side), ("result", result)], boxes as f64);
    page.counters(
        "albireo_hub_audit_boxes_total",
        "Boxes of the audited frames of the clips written, by side (detected: the detector's; shown: the published) and by \
         result (paired with a box of the other side, or unpaired). Against the detector, not the truth",
        [
            row("detected", "paired", paired),
            row("detected", "unpaired", counts.audit_detected.saturating_sub(paired)),
            row("shown", "paired", paired),
            row("shown", "unpaired", counts.audit_shown.saturating_sub(paired)),
        ],
    );
    let refused = |reason, batches: u64| ([("reason", reason)], batches as f64);
    page.counters(
        "albireo_hub_batches_refused_total",
        "Batches refused, by reason",
        [
            refused("busy", counts.refused_busy),
            refused("unavailable", counts.refused_unavailable),
            refused("unreadable", counts.refused_unreadable),
        ],
    );
    page.gauge(
        "albireo_hub_acknowledged_after_p99_seconds",
        "99th percentile of the time from a batch's arrival to its acknowledgement, over the most recent batches",
        hub.ingest.acknowledged_after.p99_s(),
    );
    page.gauge(
        "albireo_hub_commit_p99_seconds",
        "99th percentile of the duration of a transaction, over the most recent ones",
        hub.ingest.committed_in.p99_s(),
    );
    page.gauge(
        "albireo_hub_queue_batches",
        "Batches that were received and are not answered yet",
        hub.ingest.queued() as f64,
    );
    page.gauge(
        "albireo_hub_queue_bytes",
        "Compressed bytes of the batches that are not answered yet",
        hub.ingest.queued_bytes() as f64,
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_that_claim_to_have_any_number_of_reports_do_not_overflow_the_sum() {
        let (desired, _notices) = DesiredSettings::new();
        let mut counts = FleetCounts::default();
        for waiting in [u64::MAX, 1] {
            let node = NodeView {
                waiting,
                ..NodeView::default()
            };
            counts.add(&node, &desired, 0);
        }
        assert_eq!(counts.waiting, u64::MAX);
    }
}
