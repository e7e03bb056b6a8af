//! Keeps what the hub knows of one node.

use super::fleet::NodeView;
use super::state::PresenceState;
use super::today::TodaysEnergy;
use crate::store::tables::NodeRow;
use albireo_wire::{HealthState, NodeStatus, StatusMessage};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Shortest time between two notices to a node.
const NOTIFY_EVERY: Duration = Duration::from_secs(5);

/// One run of a node's process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Run {
    pub(super) number: u32,
    started_ns: u64,
}

impl Run {
    pub(super) fn of(message: &StatusMessage) -> Self {
        Self {
            number: message.run,
            started_ns: message.started_ns,
        }
    }
}

/// One node.
#[derive(Clone, Debug, Default)]
pub(crate) struct Entry {
    pub(crate) state: PresenceState,
    pub(crate) since_ms: i64,
    pub(super) why: String,
    pub(super) heard: Option<Instant>,
    pub(crate) heard_ms: Option<i64>,
    /// True if its liveliness token disappeared, and no status was received since.
    pub(super) token_gone: bool,
    pub(super) run: Option<Run>,
    /// The run before the present one, and when its last status was received.
    other: Option<(Run, Instant)>,
    /// The reason to assume that several nodes use the name, and the end of that assumption.
    pub(super) identity: Option<(String, Instant)>,
    pub(super) seq: u64,
    pub(super) health: HealthState,
    pub(super) reasons: String,
    pub(crate) waiting: u64,
    pub(super) revision: u64,
    pub(crate) today: TodaysEnergy,
    /// The last full status.
    pub(super) status: Option<Arc<NodeStatus>>,
    pub(super) needs_full: bool,
    pub(super) notified: Option<Instant>,
}

impl Entry {
    /// Creates the entry of a node that has sent no status yet.
    pub(super) fn new(now_ms: i64) -> Self {
        Self {
            since_ms: now_ms,
            why: "no status was received yet".to_owned(),
            needs_full: true,
            ..Self::default()
        }
    }

    /// Creates the entry of a node from its row.
    pub(super) fn remembered(node: NodeRow, now: Instant) -> Self {
        let mut entry = Self::new(node.since_ms);
        entry.state = PresenceState::named(&node.state).unwrap_or(PresenceState::Silent);
        entry.why = node.why;
        entry.heard = entry.state.is_heard().then_some(now);
        entry.heard_ms = node.heard_ms;
        entry.run = node.run.map(|number| Run {
            number: u32::try_from(number).unwrap_or(0),
            started_ns: node.started_ns.map_or(0, i64::unsigned_abs),
        });
        entry.revision = node.revision.unsigned_abs();
        if let Some(text) = node.status
            && let Ok(status) = serde_json::from_str::<NodeStatus>(&text)
        {
            entry.health = status.health.state;
            entry.take_status(&status);
        }
        entry
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
    pub(super) fn another_run(&mut self, run: Run, now: Instant, silent: Duration) {
        let Some(before) = self.run.replace(run) else {
            return;
        };
        let back = self.other.as_ref().is_some_and(|(other, heard)| {
            *other == run && now.saturating_duration_since(*heard) < silent
        });
        if back {
            let what = format!(
                "two nodes have this name: runs {} and {}",
                run.number, before.number
            );
            self.identity = Some((what, now + silent.saturating_mul(2)));
        }
        self.other = Some((before, self.heard.unwrap_or(now)));
    }

    /// Stores a full status. Returns true if it differs from the previous one.
    pub(super) fn take_status(&mut self, status: &NodeStatus) -> bool {
        self.reasons = status.health.text();
        let changed = self.status.as_deref() != Some(status);
        if changed {
            self.status = Some(Arc::new(status.clone()));
        }
        changed
    }

    /// The row to write.
    pub(super) fn row(&self, name: &str) -> NodeRow {
        let run = self.run.as_ref();
        let status = self.status.as_deref();
        NodeRow {
            name: name.to_owned(),
            // Used only for a new node.
            first_seen_ms: self.since_ms,
            state: self.state.name().to_owned(),
            since_ms: self.since_ms,
            why: self.why.clone(),
            heard_ms: self.heard_ms,
            run: run.map(|run| run.number.into()),
            started_ns: run.and_then(|run| i64::try_from(run.started_ns).ok()),
            revision: i64::try_from(self.revision).unwrap_or(i64::MAX),
            status: status.and_then(|status| serde_json::to_string(status).ok()),
        }
    }

    /// The node as the HTTP interface shows it.
    pub(super) fn view(&self, name: &str) -> NodeView {
        let status = self.status.as_deref();
        NodeView {
            node: name.to_owned(),
            state: self.state,
            since_ms: self.since_ms,
            why: self.why.clone(),
            heard_ms: self.heard_ms,
            waiting: self.waiting,
            revision: self.revision,
            today: self.today,
            status: status.and_then(|status| serde_json::to_value(status).ok()),
        }
    }
}
