//! The threshold of a camera: its value in force, and who set it.

use super::camera::CameraBoard;
use super::event::{Event, News, ThresholdEvent};
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{ThresholdSpec, published_threshold};
use albireo_wire::{SettingSource, Threshold, significant};
use std::sync::Arc;
use tokio::sync::watch;

impl CameraBoard {
    /// The threshold in force from the next frame on; `None` if the policy has none.
    pub fn threshold(&self) -> Option<f64> {
        *self.threshold.borrow()
    }

    /// The threshold in force, with its name.
    pub(crate) fn threshold_in_force(&self) -> Option<Threshold> {
        Some(Threshold::new(self.threshold_spec?.name, self.threshold()?))
    }

    /// The threshold of the configuration, or the policy's.
    pub(crate) fn configured(&self) -> Option<f64> {
        self.configured
    }

    /// Puts back a value from before a restart. Call it before anybody reads the threshold.
    pub(crate) fn restore_threshold(&self, value: f64, source: SettingSource) {
        self.threshold.send_replace(Some(value));
        *self.set_by.lock() = source;
    }

    /// Sets the threshold to a value that `spec` allows: it applies from the next frame, and is reported to subscribers.
    pub(crate) fn set_threshold(&self, spec: &ThresholdSpec, value: f64, source: SettingSource) {
        *self.set_by.lock() = source;
        let before = self.turn(spec, value);
        let camera = self.name();
        let name = spec.name;
        self.changes.log(|held_back| {
            tracing::info!(
                camera,
                name,
                ?before,
                now = value,
                held_back,
                "threshold changed"
            );
        });
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
