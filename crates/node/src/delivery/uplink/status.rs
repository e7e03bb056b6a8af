//! When a status is due, and what it says.

use super::DesiredKeeper;
use crate::delivery::outbox::Outbox;
use crate::state::board::Board;
use albireo_service::clock::unix_nanoseconds;
use albireo_wire::{
    CameraState, CameraStatus, NodeStatus, SignOfLife, Standing, StatusMessage, VERSION, run_number,
};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// A camera from which no frame came for this time is stale.
const STALE: Duration = Duration::from_secs(10);

/// Full statuses are not sent faster than this, whatever changes.
const LEAST_PAUSE: Duration = Duration::from_secs(1);

/// Decides when to tell what.
pub(super) struct StatusTeller {
    labels: BTreeMap<String, String>,
    started_ns: u64,
    seq: u64,
    told: Option<NodeStatus>,
    /// The generation that was told last: a sign of life says that it holds.
    told_generation: Option<u64>,
    told_at: Option<Instant>,
    full_due: bool,
}

impl StatusTeller {
    pub(super) fn new(labels: BTreeMap<String, String>) -> Self {
        Self {
            labels,
            started_ns: unix_nanoseconds(),
            seq: 0,
            told: None,
            told_generation: None,
            told_at: None,
            full_due: true,
        }
    }

    /// The next status is a full one, and soon.
    pub(super) fn full_is_due(&mut self) {
        self.full_due = true;
    }

    /// The payload of a message, if one is due: in full at a change, a short one every `period`; a sign of life where
    /// `signs_of_life` are read and nothing but numbers has changed.
    ///
    /// # Errors
    /// None that can happen: a status can always be written.
    pub(super) fn due(
        &mut self,
        period: Duration,
        signs_of_life: bool,
        board: &Board,
        outbox: &Outbox,
        desired: &DesiredKeeper,
    ) -> Result<Option<Vec<u8>>, serde_json::Error> {
        let since = self.told_at.map(|at| at.elapsed());
        if since.is_some_and(|since| since < LEAST_PAUSE) {
            return Ok(None);
        }
        let status = self.status(board, outbox, desired);
        let changed = !self.told.as_ref().is_some_and(|told| same(told, &status));
        if !changed && !self.full_due && since.is_some_and(|since| since < period) {
            return Ok(None);
        }
        let generation = desired.generation_in_force();
        let waiting = status.outbox.waiting;
        let short =
            signs_of_life && !changed && !self.full_due && self.told_generation == Some(generation);
        let seq = self.seq;
        self.seq += 1;
        self.told_generation = Some(generation);
        self.told_at = Some(Instant::now());
        if short {
            let (instance, machine) = (outbox.instance(), outbox.machine());
            let run = run_number(&instance, machine.as_deref(), self.started_ns);
            return SignOfLife { run, seq, waiting }.to_payload().map(Some);
        }
        let message = StatusMessage {
            v: VERSION,
            instance: outbox.instance(),
            machine: outbox.machine(),
            started_ns: self.started_ns,
            seq,
            t_ns: unix_nanoseconds(),
            health: status.health.state,
            waiting,
            generation,
            full: (changed || self.full_due).then(|| Box::new(status.clone())),
        };
        self.told = Some(status);
        self.full_due = false;
        serde_json::to_vec(&message).map(Some)
    }

    fn status(&self, board: &Board, outbox: &Outbox, desired: &DesiredKeeper) -> NodeStatus {
        let cameras = board.cameras().iter().map(|camera| {
            let state = match camera.snapshot().last_frame_age {
                None => CameraState::NeverSeen,
                Some(age) if age > STALE => CameraState::Stale,
                Some(_) => CameraState::Live,
            };
            CameraStatus {
                name: camera.name().to_owned(),
                state,
                knob: camera.knob_value(),
                knob_source: camera.knob_source(),
            }
        });
        let power = board.power();
        let target = board.target().report();
        NodeStatus {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            labels: self.labels.clone(),
            cameras: cameras.collect(),
            policy: board.policy().to_owned(),
            model: board.detector_facts().model.clone(),
            provider: crate::api::http::provider(&board.detector_status()).map(str::to_owned),
            power_source: power.source,
            power_quality: power.quality,
            health: board.readiness().health().status(),
            outbox: outbox.counts().status(),
            refused: desired.refused(),
            target: target.status(),
            target_off: target.off,
            takes_targets: true,
        }
    }
}

/// Whether nothing changed that a full status is worth: what moves by itself is not.
fn same(told: &NodeStatus, now: &NodeStatus) -> bool {
    let mut now = now.clone();
    now.outbox.waiting = told.outbox.waiting;
    if let (Some(now_held), Some(told_held)) = (&mut now.target, &told.target)
        && now_held.target == told_held.target
    {
        now_held.actual = told_held.actual;
        // Between these it goes to and fro.
        let underway = [Standing::Moving, Standing::Held].map(Some);
        if underway.contains(&now_held.standing) && underway.contains(&told_held.standing) {
            now_held.standing = told_held.standing;
        }
        for (now, told) in now.cameras.iter_mut().zip(&told.cameras) {
            now.knob = told.knob;
        }
    }
    *told == now
}
