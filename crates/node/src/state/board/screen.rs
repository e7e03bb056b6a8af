//! The pause on an empty road, of all cameras together, and what it means at each camera's rate.

use super::Board;
use super::CHANGES_PERIOD;
use super::camera::CameraBoard;
use albireo_core::policy::{EmptyRoad, PassCause};
use albireo_service::rate_limit::RateLimit;
use serde::Serialize;
use std::sync::atomic::Ordering;
use tokio::sync::watch;

static CHANGES: RateLimit = RateLimit::new(CHANGES_PERIOD);

/// Pictures of a camera without news.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, utoipa::ToSchema)]
pub(crate) struct NoNews {
    /// Why.
    pub(crate) cause: PassCause,
    /// For how long nothing has changed, seconds.
    pub(crate) for_s: f64,
}

impl Board {
    /// True if the policy takes a pause on an empty road.
    pub fn can_pause(&self) -> bool {
        self.policy().takes_pause
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
        let EmptyRoad {
            pause_s,
            after_s,
            still_s,
        } = empty_road;
        self.shared.empty_road.send_replace(empty_road);
        CHANGES.log(|held_back| {
            tracing::info!(pause_s, after_s, still_s, held_back, "pauses changed");
        });
    }
}

impl CameraBoard {
    /// The pause on an empty road, for the camera's loop, which reads it before each frame.
    pub(crate) fn watch_empty_road(&self) -> watch::Receiver<EmptyRoad> {
        self.shared.empty_road.subscribe()
    }

    /// Notes whether its pictures have no news, and says when that begins and ends.
    pub(crate) fn set_no_news(&self, now: Option<NoNews>) {
        let before = std::mem::replace(&mut *self.no_news.lock(), now);
        if before.is_some() == now.is_some() {
            return;
        }
        let camera = self.name();
        self.news_changes.log(|held_back| match now {
            Some(now) => tracing::info!(
                camera,
                cause = now.cause.as_str(),
                held_back,
                "its picture has no news: the detector looks once in screen.still_s"
            ),
            None => tracing::info!(camera, held_back, "its picture has changed"),
        });
    }

    /// Whether its pictures have no news.
    pub(crate) fn no_news(&self) -> Option<NoNews> {
        *self.no_news.lock()
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
