//! Sets the threshold of a camera for HTTP, Zenoh and the hub, reports it to subscribers, and keeps it over a restart.

use super::Board;
use super::camera::CameraBoard;
use super::event::{Event, News, ThresholdEvent};
use crate::state::settings::{Settings, Values};
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{InvalidThreshold, ThresholdSpec, published_threshold};
use albireo_wire::{SettingSource, Threshold, significant};
use std::error::Error;
use std::sync::Arc;
use tokio::sync::watch;

fn setting(camera: &str) -> String {
    format!("threshold/{camera}")
}

/// The value kept for a camera and its source, if it still fits the threshold and the configuration.
pub(super) fn kept(
    settings: &Settings,
    camera: &str,
    spec: &ThresholdSpec,
    configured: Option<f64>,
) -> Option<(f64, SettingSource)> {
    let (kept, source): (Threshold, _) = settings.kept(&setting(camera), &configured)?;
    let value = spec.check(kept.value_of(spec).ok()?).ok()?;
    let name = spec.name;
    tracing::info!(camera, name, value, "threshold restored from the last run");
    Some((value, source))
}

impl Board {
    /// Sets the threshold of these cameras: it applies from each one's next frame, is reported to subscribers, and is set
    /// in `kept`.
    ///
    /// # Errors
    /// The reason why the policy does not allow it; then nothing changes.
    pub(crate) fn set_thresholds(
        &self,
        cameras: &[Arc<CameraBoard>],
        threshold: Threshold,
        source: SettingSource,
        kept: &mut Values,
    ) -> Result<(), Box<dyn Error + Send + Sync>> {
        // All cameras have the node's policy.
        let spec = cameras.first().and_then(|camera| camera.threshold_spec);
        let policy = self.policy;
        let spec = spec.ok_or(InvalidThreshold::Absent { policy })?;
        let value = spec.check(threshold.value_of(&spec)?)?;
        // First, so that the controller no longer moves anything.
        self.target.turned_by_hand(source, kept);
        for camera in cameras {
            *camera.set_by.lock() = source;
            let before = camera.turn(&spec, value);
            let threshold = Threshold::new(spec.name, value);
            kept.keep(&setting(&camera.name), threshold, source, camera.configured);
            tracing::info!(camera = %camera.name, name = spec.name, ?before, now = value, "threshold changed");
        }
        Ok(())
    }
}

impl CameraBoard {
    /// The threshold in force from the next frame on; `None` if the policy has none.
    pub fn threshold(&self) -> Option<f64> {
        *self.threshold.borrow()
    }

    /// The threshold in force, with its name.
    pub(crate) fn threshold_in_force(&self) -> Option<Threshold> {
        Some(Threshold::new(self.threshold_spec?.name, self.threshold()?))
    }

    /// The source of the threshold in force.
    pub(crate) fn threshold_source(&self) -> SettingSource {
        *self.set_by.lock()
    }

    /// The threshold, for the camera's loop, which reads it before each frame.
    pub fn watch_threshold(&self) -> watch::Receiver<Option<f64>> {
        self.threshold.subscribe()
    }

    /// The equivalent of `u` in the published code, for pictures of this size, to three digits; `None` if it is the
    /// same number.
    pub(crate) fn published_threshold(&self, picture: PictureSize) -> Option<f64> {
        let in_force = self.threshold().filter(|_| self.has_sizeless_u)?;
        let published = significant(published_threshold(in_force, picture), 3);
        (published != in_force).then_some(published)
    }

    /// The news of a new threshold for subscribers.
    pub(super) fn threshold_news(&self, threshold: Threshold) -> News {
        News::Threshold(ThresholdEvent {
            camera: Arc::clone(&self.name),
            threshold,
        })
    }

    /// Moves the threshold on behalf of the node's target: it applies from the next frame, and is not kept. A value
    /// that the threshold does not allow changes nothing.
    pub(crate) fn move_threshold(&self, value: f64) {
        if let Some(spec) = self.threshold_spec.filter(|spec| spec.check(value).is_ok()) {
            let before = self.turn(&spec, value);
            tracing::debug!(camera = %self.name, name = spec.name, ?before, now = value, "threshold moved");
        }
    }

    /// Applies a value and reports it to subscribers, in the same order for both. Returns the previous value.
    fn turn(&self, spec: &ThresholdSpec, value: f64) -> Option<f64> {
        let mut before = None;
        self.threshold.send_modify(|in_force| {
            before = in_force.replace(value);
            let news = self.threshold_news(Threshold::new(spec.name, value));
            let _ = self.shared.events.send(Event::new(news));
        });
        before
    }
}
