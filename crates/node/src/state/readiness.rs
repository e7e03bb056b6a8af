//! The parts of a node's readiness, and the effect of their faults.
//!
//! | part | not ready | degraded |
//! | --- | --- | --- |
//! | `detector` | it is starting, its session is being rebuilt, or its GPU is lost | |
//! | `screen` | | its session is being rebuilt: the detector is called instead |
//! | `cameras` | they are not subscribed yet | no frame has arrived from one for a while, its source has failed, or its frames are slow, broken or dropped |
//! | `power` | | the meter cannot be read, or returns no samples |
//! | `position` | | the receiver gives none, or a position cannot be used |
//! | `outbox` | | reports are lost, or do not survive a power loss although a state directory is set |
//! | `zenoh` | the local session is not open, or closed | another node has the same name |
//! | `uplink` | | the session to the hub is not open, or no hub acknowledges the reports that are due |
//! | `hooks` | | a hook's address cannot be reached or refuses a post |
//! | `mqtt` | | the broker cannot be reached or refuses the node |
//! | `certificates` | | one ends within a week, has ended, is not valid yet, or cannot be read |
//! | `record` | | recordings cannot be written, or frames are missing in them |
//! | `disk` | | reports or settings in the state directory cannot be written, or were damaged |
//! | `tasks` | a camera's loop has failed and does not run | a task failed and runs again, or a non-essential one does not run |

use crate::state::board::Board;
use albireo_power::PowerHandle;
use albireo_service::readiness::{Fault, Readiness};
use albireo_vision::detector::ModelStatus;
use albireo_wire::{EnergyQuality, HealthState, HealthStatus};
use std::sync::Arc;
use std::time::Duration;

/// The detector.
pub(crate) const DETECTOR: &str = "detector";
/// The empty-scene screen, if it is a model.
pub(crate) const SCREEN: &str = "screen";
/// The cameras; the subject is a camera's name.
pub const CAMERAS: &str = "cameras";
/// Behind a camera's name: the fault is one of the pictures that come from its source.
pub(crate) const PICTURES: &str = " (pictures)";
/// The power meter.
pub(crate) const POWER: &str = "power";
/// Where the node is.
pub(crate) const POSITION: &str = "position";
/// Clip reports on their way to the hub.
pub(crate) const OUTBOX: &str = "outbox";
/// The local Zenoh session.
pub const ZENOH: &str = "zenoh";
/// Subject of [`ZENOH`]: the session was open, and is closed permanently.
pub(crate) const ZENOH_SESSION: &str = "session";
/// The Zenoh session to the hub.
pub(crate) const UPLINK: &str = "uplink";
/// The hooks; the subject is a hook's address, without secrets.
pub(crate) const HOOKS: &str = "hooks";
/// The MQTT broker.
pub(crate) const MQTT: &str = "mqtt";
/// The certificates of the sessions.
pub(crate) const CERTIFICATES: &str = albireo_service::identity::PART;
/// The recordings.
pub(crate) const RECORDER: &str = "record";
/// The state directory.
pub(crate) const DISK: &str = "disk";
/// The tasks; the subject is a task's name.
pub(crate) const TASKS: &str = albireo_service::supervise::PART;

/// The time limit for a meter's first sample.
const FIRST_SAMPLE: Duration = Duration::from_secs(15);

/// All parts, in the order of the metrics.
pub(crate) const PARTS: [&str; 14] = [
    DETECTOR,
    SCREEN,
    CAMERAS,
    POWER,
    POSITION,
    OUTBOX,
    ZENOH,
    UPLINK,
    HOOKS,
    MQTT,
    CERTIFICATES,
    RECORDER,
    DISK,
    TASKS,
];

/// What the service manager gets to know.
pub(crate) struct ManagerState {
    /// The node's health.
    pub health: HealthStatus,
    /// Why the service manager should restart the node, if it should.
    pub stuck: Option<String>,
}

/// The state for the service manager. A fault of the node itself (not an unreachable router) that has lasted for
/// `stuck_after_s` seconds counts as stuck, so that the service manager restarts the node; the loss of this process's
/// GPU does so at once. A detector that `builds_engine` is not stuck.
pub(crate) fn service_state(
    readiness: &Readiness,
    detector: &ModelStatus,
    stuck_after_s: f64,
    builds_engine: bool,
) -> ManagerState {
    let health = readiness.health();
    let lost = match detector {
        ModelStatus::Lost { reason, .. } => Some(format!("{DETECTOR}: {reason}")),
        _ => None,
    };
    // The detector starts once the session is open: until then, the session is the cause. TensorRT may need a quarter of an
    // hour for an engine, and would begin again after a restart.
    let waits_for_session = health
        .faults
        .iter()
        .any(|fault| fault.part == ZENOH && fault.subject.is_empty());
    let may_take_long = *detector == ModelStatus::Starting && (builds_engine || waits_for_session);
    let lasting = health.faults.iter().find(|fault| {
        let own = match fault.part {
            DETECTOR => !may_take_long,
            TASKS => true,
            ZENOH => fault.subject == ZENOH_SESSION,
            _ => false,
        };
        own && fault.fault.effect == HealthState::NotReady && fault.since_s >= stuck_after_s
    });
    let lasting = lasting.map(|fault| format!("{}: {}", fault.part, fault.fault.reason));
    ManagerState {
        health: health.status(),
        stuck: lost.or(lasting),
    }
}

/// The fault of the node if the detector has this status: without the detector there are only predictions.
pub(crate) fn of_detector(status: &ModelStatus) -> Option<Fault> {
    match status {
        ModelStatus::Starting => Some(Fault::not_ready("the session is being built")),
        _ => status.fault().map(|reason| Fault::not_ready(format!("degraded: {reason}"))),
    }
}

/// The fault of the node if the screen has this status: without the screen the detector is called.
pub(crate) fn of_screen(status: &ModelStatus) -> Option<Fault> {
    of_detector(status).map(|fault| Fault::degraded(fault.reason))
}

/// A camera without a frame for this long makes the node degraded.
const CAMERA_SILENCE: Duration = Duration::from_secs(30);

/// Adds probes for frames from every camera without a source; a source reports its own faults.
pub(crate) fn check_cameras(board: &Board) {
    let start = tokio::time::Instant::now();
    for camera in &board.cameras {
        let name = camera.name().to_owned();
        let camera = Arc::clone(camera);
        if camera.source.is_some() {
            // The source itself reports whether it works, under the camera's name.
            board.readiness.probe(CAMERAS, format!("{name}{PICTURES}"), move || {
                let now = camera.snapshot();
                now.unusable().or_else(|| now.flow_fault()).map(Fault::degraded)
            });
            continue;
        }
        board.readiness.probe(CAMERAS, name, move || {
            let limit = CAMERA_SILENCE;
            let now = camera.snapshot();
            if let Some(reason) = now.unusable() {
                return Some(Fault::degraded(reason));
            }
            let age = now.last_frame_age();
            if age.unwrap_or_else(|| start.elapsed()) > limit {
                let reason = match age {
                    Some(_) => format!("no frame for more than {} s", limit.as_secs()),
                    None => "no frame has arrived since the start".to_owned(),
                };
                return Some(Fault::degraded(reason));
            }
            now.flow_fault().map(Fault::degraded)
        });
    }
}

/// Adds a probe for samples from the power meter.
pub(crate) fn check_power(board: &Board, power: &PowerHandle) {
    let power = power.clone();
    let begun = tokio::time::Instant::now();
    board.readiness.probe(POWER, "", move || {
        let now = power.snapshot();
        let silent = now.meter_quality != EnergyQuality::Unavailable
            && begun.elapsed() > FIRST_SAMPLE
            && now.quality == EnergyQuality::Unavailable;
        silent.then(|| Fault::degraded(format!("{} returns no samples", now.source)))
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_vision::detector::ExecutionProvider;

    const BUILDS_ENGINE: bool = true;
    const NO_ENGINE: bool = false;

    #[tokio::test(start_paused = true)]
    async fn only_lasting_faults_of_the_node_itself_are_stuck() {
        let readiness = Readiness::default();
        let limit = Duration::from_secs(60);
        let limit_s = limit.as_secs_f64();
        let state = |status: &ModelStatus| service_state(&readiness, status, limit_s, NO_ENGINE);
        let stuck = |status: &ModelStatus| state(status).stuck.unwrap_or_default();
        let starting = ModelStatus::Starting;
        let failed = ModelStatus::Degraded {
            reason: "the run does not come back".to_owned(),
            provider: ExecutionProvider::Cpu,
        };
        let detector = readiness.part(DETECTOR);
        detector.not_ready("it is broken");
        assert_eq!(state(&starting).health.state, HealthState::NotReady);
        tokio::time::advance(Duration::from_secs(59)).await;
        assert_eq!(stuck(&starting), "");
        tokio::time::advance(Duration::from_secs(1)).await;
        assert_eq!(stuck(&starting), "detector: it is broken");
        // TensorRT's engine takes as long as it takes.
        tokio::time::advance(100 * limit).await;
        let building = service_state(&readiness, &starting, limit_s, BUILDS_ENGINE);
        assert_eq!(building.stuck, None);
        let broken = service_state(&readiness, &failed, limit_s, BUILDS_ENGINE);
        assert_eq!(broken.stuck.as_deref(), Some("detector: it is broken"));

        // A node that waits for its router has not got as far as its detector.
        let zenoh = readiness.part(ZENOH);
        zenoh.not_ready("the router is away");
        tokio::time::advance(limit).await;
        assert_eq!(stuck(&starting), "");
        assert_eq!(stuck(&failed), "detector: it is broken");

        // The session was opened, the detector is being built, and the session closes permanently.
        zenoh.works();
        let session = readiness.part_of(ZENOH, ZENOH_SESSION);
        session.not_ready("it is closed");
        assert_eq!(stuck(&starting), "detector: it is broken");
        detector.degraded("does not matter");
        assert_eq!(stuck(&failed), "");
        tokio::time::advance(limit).await;
        assert_eq!(stuck(&failed), "zenoh: it is closed");

        session.works();
        readiness.part(UPLINK).degraded("the hub is away");
        tokio::time::advance(limit).await;
        let state = state(&failed);
        assert_eq!(state.health.state, HealthState::Degraded);
        assert_eq!(state.stuck, None);
        let reasons = state.health.text();
        assert!(reasons.contains("uplink: the hub is away"), "{reasons}");
    }

    #[test]
    fn a_lost_gpu_calls_for_a_restart_at_once() {
        let lost = ModelStatus::Lost {
            reason: "the GPU is lost to this process".to_owned(),
            provider: ExecutionProvider::Cuda,
        };
        let state = service_state(&Readiness::default(), &lost, 900.0, BUILDS_ENGINE);
        let stuck = state.stuck.unwrap();
        assert!(stuck.starts_with("detector: the GPU is lost"), "{stuck}");
        let fault = of_detector(&lost).unwrap();
        assert_eq!(fault.effect, HealthState::NotReady);
        assert!(fault.reason.contains("the GPU is lost"), "{fault:?}");
    }
}
