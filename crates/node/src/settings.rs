//! Settings that are changed at run time, the policy, thresholds and the target: put in force on the board, in the order in which the
//! settings arrive, and kept over a restart.

mod file;
#[cfg(test)]
pub(crate) mod tests;
mod transaction;
mod turns;

pub(crate) use file::SettingsFile;
pub(crate) use transaction::{RefusedPause, RefusedPolicy, Transaction};
pub(crate) use turns::{MAX_MESSAGE_BYTES, Place, Setting};

use crate::state::board::{Board, CameraBoard};
use crate::state::readiness;
use albireo_core::policy::EmptyRoad;
use albireo_service::readiness::Fault;
use albireo_wire::Threshold;
use serde::de::DeserializeOwned;
use std::path::Path;
use std::sync::Arc;
use turns::Turns;

/// The settings of one node.
#[derive(Debug)]
pub(crate) struct Settings {
    /// Where they are in force.
    board: Arc<Board>,
    /// Where they are kept.
    file: Arc<SettingsFile>,
    /// The settings that arrived, in their order.
    pub(crate) turns: Turns,
}

impl Settings {
    /// Opens the settings in `directory`, or in memory without one, and puts on the board what was kept there: the policy, a
    /// threshold if the policy's still has that name and range, and a setting if its configured value was not edited
    /// since. An unreadable file is logged and tried again later.
    pub(crate) fn open(board: &Arc<Board>, directory: Option<&Path>) -> Self {
        let settings = Self {
            board: Arc::clone(board),
            file: Arc::new(SettingsFile::open(directory)),
            turns: Turns::default(),
        };
        settings.restore_policy();
        for camera in &board.cameras {
            settings.restore_threshold(camera);
        }
        settings.restore_pause();
        let target = &board.target;
        let kept = settings.file.kept(transaction::TARGET, &target.configured());
        let first = board.cameras.first().and_then(|camera| camera.configured());
        target.begin(kept, first);
        // The probe belongs to the board, which the settings hold: with the settings in it, neither would ever end.
        let file = Arc::clone(&settings.file);
        board.readiness.probe(readiness::DISK, "settings", move || {
            file.fault().map(Fault::degraded)
        });
        settings
    }

    /// Restores the policy that was switched to.
    fn restore_policy(&self) {
        let configured = self.board.configured_policy();
        let name = configured.name.to_owned();
        let Some((kept, _)) = self.file.kept::<String, _>(transaction::POLICY, &name) else {
            return;
        };
        if kept == name {
            return;
        }
        let restored = configured.named(&kept).map_err(RefusedPolicy::from);
        match restored.and_then(|policy| transaction::fits(&self.board, policy)) {
            Ok(policy) => {
                self.board.set_policy(policy);
                tracing::info!(
                    policy = kept,
                    configured = name,
                    "policy restored from the last run"
                );
            }
            Err(error) => {
                tracing::error!(policy = kept, %error, "the policy of the last run is not restored");
            }
        }
    }

    /// Restores the threshold kept for a camera, if it still fits the policy and the configuration.
    fn restore_threshold(&self, camera: &CameraBoard) {
        let Some(spec) = camera.threshold_spec() else {
            return;
        };
        let setting = transaction::of_threshold(camera.name());
        let Some((kept, source)) = self.file.kept::<Threshold, _>(&setting, &camera.configured())
        else {
            return;
        };
        if let Ok(value) = kept.value_of(&spec)
            && spec.check(value).is_ok()
        {
            camera.restore_threshold(value, source);
            tracing::info!(
                camera = camera.name(),
                name = spec.name,
                value,
                "threshold restored from the last run"
            );
        }
    }

    /// Restores the pause on an empty road.
    fn restore_pause(&self) {
        let kept = self
            .file
            .kept::<EmptyRoad, _>(transaction::SCREEN, &self.board.configured_road());
        if let Some((kept, _)) = kept
            && kept.problem().is_none()
        {
            self.board.set_empty_road(kept);
        }
    }

    /// Sets settings: they are in force at once and before any others, and kept as a whole or not at all. If they
    /// cannot be kept now, they are when the disk works again. Writes a small file.
    fn set<T>(&self, settings: impl FnOnce(&mut Transaction<'_>) -> T) -> T {
        self.file.edit(|kept| settings(&mut Transaction::new(&self.board, kept)))
    }

    /// Keeps the threshold's value while a target is held, so that a restart continues from there. Writes a small file.
    pub(crate) fn keep_place(&self) {
        if self.board.target.is_on() {
            self.set(|transaction| transaction.keep_target());
        }
    }

    /// The setting kept under `name`.
    pub(crate) fn get<T: DeserializeOwned>(&self, name: &str) -> Option<T> {
        self.file.get(name)
    }

    /// True if the settings survive a restart: they are in a file, and the last attempt to write it succeeded.
    pub(crate) fn survive_restart(&self) -> bool {
        self.file.survive_restart()
    }

    /// Writes the file if it differs from the settings.
    ///
    /// # Errors
    /// The disk's error; call it again later.
    pub(crate) fn save(&self) -> std::io::Result<()> {
        self.file.save()
    }
}
