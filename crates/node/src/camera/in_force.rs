//! Applies what is in force to a camera's loop, before a frame: the policy, its threshold, and the pause on an empty road.

use super::Camera;
use crate::state::board::{NoNews, NodePolicy};
use std::sync::Arc;
use tokio::time::Instant;

impl Camera {
    /// Shows on the board that the camera's pictures have no news, with the pause in seconds at the measured rate.
    pub(super) fn show_no_news(&self) {
        let rate = self.rate.rate().unwrap_or(1.0);
        let no_news = self.decider.policy.no_news().map(|(cause, frames)| {
            let seconds = f64::from(frames) / rate;
            NoNews {
                cause,
                for_s: (10.0 * seconds).round() / 10.0,
            }
        });
        self.parts.board.set_no_news(no_news);
    }

    /// Applies the pause on an empty road, in frames of the measured rate, from this frame on, and shows the rate. Says once
    /// what the pause means: it may be shorter than two frames.
    pub(super) fn apply_pause(&mut self) {
        if self.empty_road.has_changed().unwrap_or(false) {
            self.empty_road.mark_unchanged();
            self.pause_is_told = false;
        }
        let empty_road = *self.empty_road.borrow();
        let rate = self.rate.rate();
        let frames = empty_road.frames(rate);
        self.decider.policy.set_pause(frames);
        self.parts.board.set_rate(rate);
        if !self.pause_is_told && empty_road.pause_s > 0.0 && self.rate.is_settled() {
            self.pause_is_told = true;
            self.tell_pause(empty_road.pause_s, frames.every, rate.unwrap_or_default());
        }
    }

    /// Says what the pause means at the camera's rate.
    fn tell_pause(&self, pause_s: f64, every: u32, rate: f64) {
        let camera = self.parts.board.name();
        match every {
            0 | 1 => tracing::warn!(
                camera,
                pause_s,
                frames_per_second = format!("{rate:.1}"),
                "the pause on an empty road is shorter than two frames and does nothing: set screen.pause_s to {:.2} or more",
                2.0 / rate
            ),
            every => tracing::info!(
                camera,
                pause_s,
                frames_per_second = format!("{rate:.1}"),
                "on an empty road, one frame in {every} is looked at"
            ),
        }
    }

    /// Makes the prediction of a pending frame its final answer.
    pub(super) fn conclude_pending(&mut self) {
        if let Some(given_up) = self.decider.give_up(&mut self.outcome) {
            self.conclude(&given_up);
        }
    }

    /// Applies a switched policy and a changed threshold from this frame on, which arrived at `arrival`.
    pub(super) fn take_in_force(&mut self, arrival: Instant) {
        if !self.in_force.has_changed().unwrap_or(false) {
            return;
        }
        let in_force = self.in_force.borrow_and_update().clone();
        if !Arc::ptr_eq(&in_force.policy, &self.policy) {
            self.switch(in_force.policy, arrival);
        }
        let Some(value) = in_force.threshold else {
            return;
        };
        if let Err(error) = self.decider.policy.set_threshold(value) {
            tracing::error!(camera = self.parts.board.name(), %error, "the policy rejected a threshold");
        }
    }

    /// Follows another policy, which begins as at the start of a stream: what was seen and counted under the one before stays
    /// with that one's clip.
    fn switch(&mut self, policy: Arc<NodePolicy>, arrival: Instant) {
        self.conclude_pending();
        let camera = self.parts.board.name();
        match self.parts.policy(&policy.config) {
            Ok(made) => self.decider.policy = made,
            // The node's own policies were built before they came into force; only a program's own ones can fail here.
            Err(error) => {
                tracing::error!(camera, policy = policy.name, %error, "the camera keeps its policy");
                return;
            }
        }
        self.policy = policy;
        self.first_index = None;
        if let Some(settled) = &mut self.settled {
            settled.end_stream();
        }
        self.audit.give_up();
        self.count_unreported();
        let name = self.decider.policy.policy().name();
        self.parts.hand_over(self.tracker.switch(name, arrival));
        self.parts.board.policy_begins();
        let camera = self.parts.board.name();
        tracing::info!(camera, policy = name, "follows another policy");
    }
}
