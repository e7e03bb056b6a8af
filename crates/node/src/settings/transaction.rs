//! Settings that are set together: put in force, and noted to be kept.

use super::file::KeptValues;
use crate::state::board::{Board, CameraBoard, NodePolicy};
use albireo_core::policy::{
    CannotRewind, EmptyRoad, InvalidThreshold, PolicyConfigError, no_pause,
};
use albireo_core::target::{Target, TargetError};
use albireo_wire::{Pauses, SettingSource, Threshold};
use serde::Serialize;
use std::error::Error;
use std::slice::from_ref;
use std::sync::Arc;

/// The name of the policy among the kept settings.
pub(super) const POLICY: &str = "policy";

/// The name of the target among the kept settings.
pub(super) const TARGET: &str = "target";

/// The name of the pause on an empty road among the kept settings.
pub(super) const SCREEN: &str = "screen";

/// The name of a camera's threshold among the kept settings.
pub(super) fn of_threshold(camera: &str) -> String {
    format!("threshold/{camera}")
}

/// The reason why a pause on an empty road is refused.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RefusedPause {
    /// A number is out of range.
    #[error("`{0}` {1}")]
    OutOfRange(&'static str, String),
    /// It names none.
    #[error("it names no pause: `pause_s`, `after_s` or `still_s`, in seconds")]
    Nothing,
    /// The policy takes no pause.
    #[error("{}", no_pause(.0))]
    NoPause(&'static str),
}

/// The reason why the policy is not switched.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RefusedPolicy {
    /// There is none of this name, or a setting of it is invalid.
    #[error(transparent)]
    Invalid(#[from] PolicyConfigError),
    /// It cannot answer at once, as a camera should.
    #[error("camera `{camera}` answers at once: {reason}")]
    Waits {
        /// The camera.
        camera: String,
        /// The reason.
        reason: CannotRewind,
    },
}

/// Returns the policy if all cameras can follow it.
pub(super) fn fits(board: &Board, policy: NodePolicy) -> Result<NodePolicy, RefusedPolicy> {
    let answering_at_once = board.cameras.iter().find(|camera| camera.answers_at_once);
    match answering_at_once {
        Some(camera) if !policy.can_rewind => Err(RefusedPolicy::Waits {
            camera: camera.name().to_owned(),
            reason: CannotRewind {
                policy: policy.name,
            },
        }),
        _ => Ok(policy),
    }
}

/// Settings that are being set: they are kept together, or not at all.
pub(crate) struct Transaction<'a> {
    board: &'a Board,
    kept: &'a mut KeptValues,
    /// The names of the settings that were set.
    names: Vec<String>,
}

impl<'a> Transaction<'a> {
    pub(super) fn new(board: &'a Board, kept: &'a mut KeptValues) -> Self {
        Self {
            board,
            kept,
            names: Vec::new(),
        }
    }

    /// Sets the threshold of these cameras: it applies from each one's next frame. Somebody who sets it ends the target.
    ///
    /// # Errors
    /// The reason why the policy does not allow it; then nothing changes.
    pub(crate) fn thresholds(
        &mut self,
        cameras: &[Arc<CameraBoard>],
        threshold: Threshold,
        source: SettingSource,
    ) -> Result<(), Box<dyn Error + Send + Sync>> {
        let policy = self.board.policy().name;
        // All cameras have the node's policy.
        let spec = cameras
            .first()
            .and_then(|camera| camera.threshold_spec())
            .ok_or(InvalidThreshold::Absent { policy })?;
        let value = spec.check(threshold.value_of(&spec)?)?;
        // First, so that the controller no longer moves anything.
        if self.board.target.threshold_was_set(source) {
            self.keep_target();
        }
        for camera in cameras {
            camera.set_threshold(&spec, value, source);
            let name = of_threshold(camera.name());
            let threshold = Threshold::new(spec.name, value);
            self.keep_value(&name, threshold, source, camera.configured());
        }
        Ok(())
    }

    /// Switches the policy of all cameras: each follows at its next frame, with the threshold that is configured for the new
    /// policy. A target is held from there, if the new policy has a threshold for it.
    ///
    /// # Errors
    /// [`RefusedPolicy`]; then nothing changes.
    pub(crate) fn policy(&mut self, name: &str) -> Result<(), RefusedPolicy> {
        let before = self.board.policy();
        if before.name == name {
            return Ok(());
        }
        let policy = fits(self.board, before.named(name)?)?;
        let holds_target = self.board.target.is_on();
        self.board.switch_policy(policy);
        let configured = self.board.configured_policy().name;
        self.keep_value(POLICY, name, SettingSource::Local, configured);
        // What was once set under this policy is not to come back after a restart.
        for camera in &self.board.cameras {
            if let Some(threshold) = camera.threshold_in_force() {
                let setting = of_threshold(camera.name());
                let source = camera.threshold_source();
                self.keep_value(&setting, threshold, source, camera.configured());
            }
        }
        if holds_target {
            self.keep_target();
        }
        Ok(())
    }

    /// Holds `target` from now on, or none: the thresholds then keep their values.
    ///
    /// # Errors
    /// [`TargetError`] if it cannot be held; then nothing changes.
    pub(crate) fn target(
        &mut self,
        target: Option<Target>,
        source: SettingSource,
    ) -> Result<(), TargetError> {
        let ends = self.board.target.is_on() && target.is_none();
        self.board.set_target(target, source)?;
        self.keep_target();
        if ends {
            for camera in &self.board.cameras {
                if let Some(threshold) = camera.threshold_in_force() {
                    // Cannot fail: it is in force.
                    let _ = self.thresholds(from_ref(camera), threshold, source);
                }
            }
        }
        Ok(())
    }

    /// Changes the pauses of all cameras.
    ///
    /// # Errors
    /// [`RefusedPause`]; then nothing changes.
    pub(crate) fn pauses(&mut self, new: Pauses) -> Result<(), RefusedPause> {
        if new == Pauses::default() {
            return Err(RefusedPause::Nothing);
        }
        let before = self.board.empty_road();
        let empty_road = EmptyRoad {
            pause_s: new.pause_s.unwrap_or(before.pause_s),
            after_s: new.after_s.unwrap_or(before.after_s),
            still_s: new.still_s.unwrap_or(before.still_s),
        };
        if let Some((name, reason)) = empty_road.problem() {
            return Err(RefusedPause::OutOfRange(name, reason));
        }
        if empty_road.pause_s > 0.0 && !self.board.can_pause() {
            return Err(RefusedPause::NoPause(self.board.policy().name));
        }
        self.board.set_empty_road(empty_road);
        let configured = self.board.configured_road();
        self.keep_value(SCREEN, empty_road, SettingSource::Local, configured);
        Ok(())
    }

    /// Keeps the target as it is, with its threshold.
    pub(super) fn keep_target(&mut self) {
        let target = &self.board.target;
        let (kept, source) = target.kept();
        self.keep_value(TARGET, kept, source, target.configured());
    }

    /// The names of the settings that were set.
    pub(super) fn names(&mut self) -> Vec<String> {
        std::mem::take(&mut self.names)
    }

    /// Keeps a value that was set instead of a configured one.
    fn keep_value(
        &mut self,
        name: &str,
        value: impl Serialize,
        source: SettingSource,
        configured: impl Serialize,
    ) {
        self.names.push(name.to_owned());
        self.kept.keep(name, value, source, configured);
    }

    /// Keeps another setting, which is in force elsewhere.
    pub(crate) fn keep(&mut self, name: &str, setting: &impl Serialize) {
        self.kept.set(name, setting);
    }
}
