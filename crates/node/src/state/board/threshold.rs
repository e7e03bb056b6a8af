//! The threshold of a camera: its value in force, and who set it.

use super::camera::CameraBoard;
use super::event::{Event, News, ThresholdEvent};
use super::policy::NodePolicy;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{ThresholdSpec, published_threshold};
use albireo_wire::{SettingSource, Threshold, significant};
use std::sync::Arc;

/// The policy of a camera with the value of its threshold: they change together, so that no value is taken for that of another
/// policy.
#[derive(Clone, Debug)]
pub(crate) struct InForce {
    /// The policy.
    pub(crate) policy: Arc<NodePolicy>,
    /// The value of its threshold, if it has one.
    pub(crate) threshold: Option<f64>,
}

impl InForce {
    /// The threshold with its name.
    pub(super) fn named(&self) -> Option<Threshold> {
        Some(Threshold::new(self.policy.spec?.name, self.threshold?))
    }
}

impl CameraBoard {
    /// The name, range and default of the policy's threshold; `None` if it has none.
    pub fn threshold_spec(&self) -> Option<ThresholdSpec> {
        self.in_force.borrow().policy.spec
    }

    /// The threshold in force from the next frame on; `None` if the policy has none.
    pub fn threshold(&self) -> Option<f64> {
        self.in_force.borrow().threshold
    }

    /// The threshold in force, with its name.
    pub(crate) fn threshold_in_force(&self) -> Option<Threshold> {
        self.in_force.borrow().named()
    }

    /// The threshold of the configuration, or the policy's.
    pub(crate) fn configured(&self) -> Option<f64> {
        self.configured_under(&self.in_force.borrow().policy)
    }

    /// Puts back a value from before a restart. Call it before anybody reads the threshold.
    pub(crate) fn restore_threshold(&self, value: f64, source: SettingSource) {
        self.in_force.send_modify(|in_force| in_force.threshold = Some(value));
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
                before,
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

    /// The equivalent of `u` in the published code, for pictures of this size, to three digits; `None` if it is the
    /// same number.
    pub(crate) fn published_threshold(&self, picture: PictureSize) -> Option<f64> {
        let in_force = self.in_force.borrow();
        if !in_force.policy.has_sizeless_u() {
            return None;
        }
        let value = in_force.threshold?;
        let published = significant(published_threshold(value, picture), 3);
        (published != value).then_some(published)
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
        let Some(spec) = self.threshold_spec() else {
            return;
        };
        if spec.check(value).is_ok() {
            let before = self.turn(&spec, value);
            tracing::debug!(camera = %self.name, name = spec.name, before, now = value, "threshold moved");
        }
    }

    /// Applies a value and reports it to subscribers, in the same order for both. Returns the previous value.
    fn turn(&self, spec: &ThresholdSpec, value: f64) -> Option<f64> {
        let mut before = None;
        self.in_force.send_modify(|in_force| {
            before = in_force.threshold.replace(value);
            self.announce(Threshold::new(spec.name, value));
        });
        before
    }

    /// Reports a threshold to subscribers.
    pub(super) fn announce(&self, threshold: Threshold) {
        let _ = self.shared.events.send(Event::new(self.threshold_news(threshold)));
    }
}
