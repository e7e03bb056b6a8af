//! The pictures that wait for a run: cameras take turns, and a run takes one picture of each camera at most.

use super::Answer;
use crate::detector::{CameraSlot, InferenceError};
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::time::Instant;

/// A picture that waits for its run.
pub(super) struct Request<I, T> {
    /// Whose it is; `None` for one that runs only when no camera waits.
    pub(super) camera: Option<CameraSlot>,
    pub(super) picture: I,
    pub(super) requested_at: Instant,
    pub(super) reply: oneshot::Sender<Result<Answer<T>, InferenceError>>,
}

/// The requests that wait, in the order in which they came.
pub(super) struct Queue<I, T> {
    waiting: Vec<Request<I, T>>,
    /// Cameras that have ever asked: a batch cannot have more pictures.
    cameras: BTreeSet<CameraSlot>,
    last_served: Option<CameraSlot>,
    /// The most pictures of a run.
    batch_size: usize,
    /// How long a picture waits for those of other cameras, from being asked.
    batch_wait: Duration,
}

impl<I, T> Queue<I, T> {
    pub(super) fn new(batch_size: usize, batch_wait: Duration) -> Self {
        Self {
            waiting: Vec::new(),
            cameras: BTreeSet::new(),
            last_served: None,
            batch_size: batch_size.max(1),
            batch_wait,
        }
    }

    pub(super) fn push(&mut self, request: Request<I, T>) {
        self.cameras.extend(request.camera);
        self.waiting.push(request);
    }

    /// How many pictures of cameras wait.
    pub(super) fn waiting(&self) -> usize {
        self.of_cameras().count()
    }

    fn of_cameras(&self) -> impl Iterator<Item = &Request<I, T>> {
        (self.waiting.iter()).filter(|request| request.camera.is_some())
    }

    /// Drops the requests whose requester gave up; says how many of them were cameras'.
    pub(super) fn drop_cancelled(&mut self) -> usize {
        let before = self.waiting();
        self.waiting.retain(|request| !request.reply.is_closed());
        before - self.waiting()
    }

    /// When the next run may begin: as soon as its pictures are there, or when the first of them has waited for others
    /// long enough. `None` when nothing waits.
    pub(super) fn begins_at(&self) -> Option<Instant> {
        let Some(first) = self.of_cameras().map(|request| request.requested_at).min() else {
            return self.waiting.first().map(|request| request.requested_at);
        };
        let waiting: BTreeSet<_> = self.of_cameras().map(|request| request.camera).collect();
        if waiting.len() >= self.batch_size.min(self.cameras.len()) {
            Some(first)
        } else {
            Some(first + self.batch_wait)
        }
    }

    /// The pictures of the next run: of the next cameras round the circle, else one that is no camera's.
    pub(super) fn take_batch(&mut self) -> Vec<Request<I, T>> {
        let mut batch: Vec<Request<I, T>> = Vec::new();
        while batch.len() < self.batch_size {
            let last = self.last_served;
            let next = (self.waiting.iter().enumerate())
                .filter(|(_, request)| request.camera.is_some())
                .filter(|(_, request)| batch.iter().all(|other| other.camera != request.camera))
                .min_by_key(|(_, request)| (request.camera <= last, request.camera));
            let Some((place, _)) = next else { break };
            let request = self.waiting.remove(place);
            self.last_served = request.camera;
            batch.push(request);
        }
        if batch.is_empty() && !self.waiting.is_empty() {
            batch.push(self.waiting.remove(0));
        }
        batch
    }

    /// All that wait.
    pub(super) fn take_all(&mut self) -> Vec<Request<I, T>> {
        std::mem::take(&mut self.waiting)
    }
}
