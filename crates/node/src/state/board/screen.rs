//! The pause on an empty road, of all cameras together, and what it means at each camera's rate.

use super::Board;
use super::camera::CameraBoard;
use albireo_core::policy::EmptyRoad;
use std::sync::atomic::Ordering;
use tokio::sync::watch;

impl Board {
    /// True if the policy takes a pause on an empty road.
    pub fn can_pause(&self) -> bool {
        self.can_pause
    }

    /// The configured pause on an empty road.
    pub(crate) fn configured_road(&self) -> EmptyRoad {
        self.configured_road
    }

    /// The pause in force from each camera's next frame on.
    pub(crate) fn empty_road(&self) -> EmptyRoad {
        *self.shared.empty_road.borrow()
    }

    /// Puts a pause in force.
    pub(crate) fn set_empty_road(&self, empty_road: EmptyRoad) {
        let EmptyRoad { pause_s, after_s } = empty_road;
        self.shared.empty_road.send_replace(empty_road);
        tracing::info!(pause_s, after_s, "pause on an empty road changed");
    }
}

impl CameraBoard {
    /// The pause on an empty road, for the camera's loop, which reads it before each frame.
    pub(crate) fn watch_empty_road(&self) -> watch::Receiver<EmptyRoad> {
        self.shared.empty_road.subscribe()
    }

    /// Notes the measured frames per second.
    pub(crate) fn set_rate(&self, rate: Option<f64>) {
        let bits = rate.unwrap_or_default().to_bits();
        self.rate.store(bits, Ordering::Relaxed);
    }

    /// The measured frames per second; `None` before the second frame.
    pub(crate) fn rate(&self) -> Option<f64> {
        let rate = f64::from_bits(self.rate.load(Ordering::Relaxed));
        (rate > 0.0).then_some(rate)
    }
}
