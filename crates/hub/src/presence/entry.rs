//! Keeps what the hub knows of one node.

use super::node::NodeView;
use albireo_wire::HealthState;
use std::time::{Duration, Instant};

/// Shortest time between two notices to a node.
const NOTIFY_EVERY: Duration = Duration::from_secs(5);

/// One node.
#[derive(Clone, Debug, Default)]
pub(crate) struct Entry {
    pub(crate) node: NodeView,
    pub(super) heard: Option<Instant>,
    /// True if its liveliness token disappeared, and no status was received since.
    pub(super) token_gone: bool,
    /// The number of the present run of its process; `None` until its first status.
    pub(super) run: Option<u32>,
    /// The run before the present one, and when its last status was received.
    other: Option<(u32, Instant)>,
    /// The reason to assume that several nodes use the name, and the end of that assumption.
    pub(super) identity: Option<(String, Instant)>,
    pub(super) seq: u64,
    pub(super) health: HealthState,
    pub(super) needs_full: bool,
    pub(super) notified: Option<Instant>,
}

impl Entry {
    /// Creates the entry of a node that has sent no status yet.
    pub(super) fn new(name: &str, now_ms: i64) -> Self {
        Self {
            node: NodeView {
                node: name.to_owned(),
                since_ms: now_ms,
                why: "no status was received yet".to_owned(),
                ..NodeView::default()
            },
            needs_full: true,
            ..Self::default()
        }
    }

    /// Creates the entry of a node that was read from the database.
    pub(super) fn remembered(node: NodeView, now: Instant) -> Self {
        let status = node.status.as_ref();
        Self {
            heard: node.state.is_heard().then_some(now),
            health: status.map_or(HealthState::Ready, |status| status.health.state),
            needs_full: true,
            node,
            ..Self::default()
        }
    }

    /// Returns true if the node should be asked for a full status now: it is missing, and the last notice is not
    /// recent.
    pub(super) fn ask_for_all(&mut self, now: Instant) -> bool {
        let due = |notified: Instant| now.saturating_duration_since(notified) >= NOTIFY_EVERY;
        let notice = self.needs_full && self.notified.is_none_or(due);
        if notice {
            self.notified = Some(now);
        }
        notice
    }

    /// Notes a run that differs from the present one. A new run is a restart; a run that comes back after another one
    /// means that two nodes have this name.
    pub(super) fn another_run(&mut self, run: u32, now: Instant, silent: Duration) {
        let Some(before) = self.run.replace(run) else {
            return;
        };
        let back = self.other.is_some_and(|(other, heard)| {
            other == run && now.saturating_duration_since(heard) < silent
        });
        if back {
            let what = format!("two nodes have this name: runs {run} and {before}");
            self.identity = Some((what, now + silent.saturating_mul(2)));
        }
        self.other = Some((before, self.heard.unwrap_or(now)));
    }
}
