//! Decides when a status is due, and writes it.

use super::desired::known;
use crate::outbox::Outbox;
use crate::settings::Settings;
use crate::state::board::{Board, provider};
use albireo_service::clock::Now;
use albireo_wire::{
    CameraState, CameraStatus, Desired, Heartbeat, NodeStatus, RefusedRevision, StatusMessage,
    TargetStatus, VERSION,
};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// A camera without a frame for this long is stale.
const STALE: Duration = Duration::from_secs(10);

/// Seconds between two heartbeats.
const HEARTBEAT_S: u32 = 30;

/// The most seconds between two heartbeats that a hub may ask for.
const LONGEST_HEARTBEAT_S: u32 = 600;

/// The shortest time between two messages, even if more changes in between.
const LEAST_PAUSE: Duration = Duration::from_secs(1);

/// Decides when which status is due.
pub(in crate::delivery) struct StatusSender {
    labels: BTreeMap<String, String>,
    run: u32,
    started_ns: u64,
    seq: u64,
    /// The last full status sent, without figures; `None` if the next must be full.
    last: Option<NodeStatus>,
    sent_at: Option<Instant>,
    /// Seconds between two heartbeats.
    heartbeat_s: u32,
}

impl StatusSender {
    /// `run` is a random number.
    pub(in crate::delivery) fn new(labels: BTreeMap<String, String>, run: u32, now: Now) -> Self {
        Self {
            labels,
            run,
            started_ns: nanoseconds(now),
            seq: 0,
            last: None,
            sent_at: None,
            heartbeat_s: HEARTBEAT_S,
        }
    }

    /// Makes the next status a full one, and due soon.
    pub(in crate::delivery) fn full_is_due(&mut self) {
        self.last = None;
    }

    /// Follows an answer of the hub.
    pub(in crate::delivery) fn follow(&mut self, desired: &Desired) {
        let wanted_s = desired.heartbeat_s.unwrap_or(HEARTBEAT_S);
        self.heartbeat_s = wanted_s.clamp(HEARTBEAT_S, LONGEST_HEARTBEAT_S);
        if desired.send_full_status {
            self.full_is_due();
        }
    }

    /// Returns the payload of a message, if one is due: a full status after a change, and at intervals a heartbeat if
    /// only numbers have changed.
    pub(in crate::delivery) fn due(
        &mut self,
        now: Now,
        board: &Board,
        settings: &Settings,
        outbox: &Outbox,
    ) -> Option<Vec<u8>> {
        let since = self.sent_at.map(|at| now.at.saturating_duration_since(at));
        if since.is_some_and(|since| since < LEAST_PAUSE) {
            return None;
        }
        let known = known(settings);
        let status = self.status(board, outbox, known.refused);
        let lasting = without_figures(status.clone());
        let changed = self.last.as_ref() != Some(&lasting);
        if !changed && since.is_some_and(|since| since.as_secs() < self.heartbeat_s.into()) {
            return None;
        }
        let waiting = status.outbox.waiting;
        let run = self.run;
        let seq = self.seq;
        self.seq += 1;
        self.sent_at = Some(now.at);
        if !changed {
            return Heartbeat { run, seq, waiting }.to_payload().ok();
        }
        let message = StatusMessage {
            v: VERSION,
            run,
            started_ns: self.started_ns,
            seq,
            t_ns: nanoseconds(now),
            health: status.health.state,
            waiting,
            revision: known.in_force,
            full: Some(Box::new(status)),
        };
        self.last = Some(lasting);
        // A status can always be serialised.
        serde_json::to_vec(&message).ok()
    }

    fn status(
        &self,
        board: &Board,
        outbox: &Outbox,
        refused: Option<RefusedRevision>,
    ) -> NodeStatus {
        let cameras = board.cameras.iter().map(|camera| {
            let state = match camera.snapshot().last_frame_age() {
                None => CameraState::NeverSeen,
                Some(age) if age > STALE => CameraState::Stale,
                Some(_) => CameraState::Live,
            };
            CameraStatus {
                name: camera.name().to_owned(),
                state,
                threshold: camera.threshold_in_force(),
                threshold_source: camera.threshold_source(),
            }
        });
        let power = board.power();
        let target = board.target.report();
        NodeStatus {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            labels: self.labels.clone(),
            cameras: cameras.collect(),
            policy: board.policy().name.to_owned(),
            model: board.model.clone(),
            provider: provider(&board.detector_status()).map(str::to_owned),
            power_source: power.source,
            power_quality: power.quality,
            health: board.readiness.health().status(),
            outbox: outbox.counts().status,
            refused,
            target: target.status(),
            target_off: target.off,
            certificates: board.certificates.status(),
        }
    }
}

/// The wall clock, nanoseconds since the Unix epoch.
fn nanoseconds(now: Now) -> u64 {
    now.unix_ms.unsigned_abs() * 1_000_000
}

/// A status without the figures that always change: they alone are no reason to send it.
fn without_figures(mut status: NodeStatus) -> NodeStatus {
    status.outbox.waiting = 0;
    if let Some(target) = &mut status.target {
        target.actual = None;
        // The status alternates between these.
        if target.status == Some(TargetStatus::Moving) {
            target.status = Some(TargetStatus::Held);
        }
        for camera in &mut status.cameras {
            camera.threshold = None;
        }
    }
    status
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::tests::{config, prepared};

    #[test]
    fn a_hub_makes_heartbeats_rarer_within_limits() {
        let node = prepared(&config(None, "albireo"));
        let mut now = Now::system();
        let mut sender = StatusSender::new(BTreeMap::new(), 1, now);
        let due = |sender: &mut StatusSender, now| {
            sender.due(now, &node.board, &node.settings, &node.outbox)
        };
        for (wanted_s, pause) in [
            (None, 30),
            (Some(1), 30),
            (Some(120), 120),
            (Some(900), 600),
        ] {
            let mut desired = Desired::nothing();
            desired.heartbeat_s = wanted_s;
            due(&mut sender, now).unwrap();
            sender.follow(&desired);
            now.at += Duration::from_secs(pause - 1);
            assert_eq!(due(&mut sender, now), None, "{wanted_s:?}");
            now.at += Duration::from_secs(1);
        }
        due(&mut sender, now).unwrap();
    }
}
