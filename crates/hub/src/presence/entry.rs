//! Keeps what the hub knows of one node, and judges its state.

use super::node::{NodeView, PresenceState};
use crate::store::row::beginning;
use albireo_wire::{HealthState, NodeStatus, StatusMessage};
use std::time::{Duration, Instant};

/// Most messages that overtake one on its way. The highest number before one that is further behind was a stray.
const MOST_OVERTAKING: u64 = 100;

/// The length of a status as JSON, bytes.
pub(super) fn json_bytes(status: &NodeStatus) -> usize {
    struct Length(usize);
    impl std::io::Write for Length {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0 += bytes.len();
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let mut length = Length(0);
    let _ = serde_json::to_writer(&mut length, status);
    length.0
}

/// One node.
#[derive(Clone, Debug, Default)]
pub(crate) struct NodeEntry {
    pub(crate) node: NodeView,
    pub(super) heard: Option<Instant>,
    /// True if its liveliness token disappeared, and no status was received since.
    pub(super) token_gone: bool,
    /// The number of the present run of its process; `None` until its first status.
    pub(super) run: Option<u32>,
    /// When that process started, by its own clock.
    pub(super) started_ns: u64,
    /// The run before the present one.
    before: Option<EarlierRun>,
    /// Present while several nodes seem to use the name.
    pub(super) twin: Option<Twin>,
    /// The highest number of a message of the present run.
    seq: u64,
    pub(super) health: HealthState,
    pub(super) needs_full: bool,
    /// True if a report of it was stored: it is no invented name.
    pub(super) has_reported: bool,
    /// Bytes of its full status, as JSON.
    pub(super) status_bytes: usize,
    pub(super) notified: Option<Instant>,
}

/// A run that another one replaced.
#[derive(Clone, Copy, Debug)]
struct EarlierRun {
    run: u32,
    /// When its last status was received.
    heard: Instant,
}

/// The assumption that several nodes use one name.
#[derive(Clone, Debug)]
pub(super) struct Twin {
    pub(super) why: String,
    /// When the assumption ends.
    pub(super) until: Instant,
}

impl NodeEntry {
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
        let status = node.status.as_deref();
        Self {
            heard: node.is_reachable().then_some(now),
            health: status.map_or(HealthState::Ready, |status| status.health.state),
            needs_full: true,
            has_reported: node.has_reported,
            status_bytes: status.map_or(0, json_bytes),
            node,
            ..Self::default()
        }
    }

    /// Notes the number of a message of the present run. Returns false if a later one overtook it; after a gap, a full
    /// status may be lost.
    pub(super) fn note_seq(&mut self, seq: u64) -> bool {
        if let Some(behind) = self.seq.checked_sub(seq)
            && behind < MOST_OVERTAKING
        {
            return false;
        }
        if self.seq.checked_add(1) != Some(seq) {
            self.needs_full = true;
        }
        self.seq = seq;
        true
    }

    /// Notes the message of a run that differs from the present one. A new run is a restart, also under the number of the
    /// one before; a run that comes back after another one means that two nodes have this name.
    pub(super) fn another_run(&mut self, message: &StatusMessage, now: Instant, silent: Duration) {
        let run = message.run;
        self.needs_full = true;
        self.seq = message.seq;
        self.started_ns = message.started_ns;
        let Some(last) = self.run.replace(run) else {
            return;
        };
        if last == run {
            return;
        }
        if let Some(before) = self.before
            && before.run == run
            && now.saturating_duration_since(before.heard) < silent
        {
            self.twin = Some(Twin {
                why: format!("two nodes have this name: runs {run} and {last}"),
                until: now + silent * 2,
            });
        }
        self.before = Some(EarlierRun {
            run: last,
            heard: self.heard.unwrap_or(now),
        });
    }

    /// Returns its state if its last status is that old, and the reason. Without a status the time is `None`.
    /// docs/fleet.md describes the rules.
    pub(super) fn judge(
        &self,
        heard_ago: Option<Duration>,
        silent_s: f64,
        offline_s: f64,
    ) -> (PresenceState, String) {
        let Some(ago) = heard_ago else {
            let why = "no status was received yet";
            return (PresenceState::Silent, why.to_owned());
        };
        if self.token_gone {
            let why = "its liveliness token disappeared: it stopped, or its connection broke";
            return (PresenceState::Offline, why.to_owned());
        }
        for (state, limit_s) in [
            (PresenceState::Offline, offline_s),
            (PresenceState::Silent, silent_s),
        ] {
            if ago.as_secs_f64() >= limit_s {
                return (state, format!("no status for {limit_s} s"));
            }
        }
        if let Some(twin) = &self.twin {
            return (PresenceState::Degraded, twin.why.clone());
        }
        if self.health == HealthState::Ready {
            return (PresenceState::Online, String::new());
        }
        let status = self.node.status.as_ref();
        let reasons = status.map_or_else(String::new, |status| status.health.text());
        let why = match (self.health, reasons.as_str()) {
            (HealthState::NotReady, "") => "it does not answer frames".to_owned(),
            (_, "") => "a part does not work".to_owned(),
            _ => beginning(&reasons),
        };
        (PresenceState::Degraded, why)
    }
}
