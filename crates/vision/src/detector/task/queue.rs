//! The pictures that wait: at most one a camera, served in turn, one by one or in batches.

use crate::detector::CameraSlot;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Bound::{Excluded, Unbounded};
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, oneshot};
use tokio::time::Instant;

/// A picture that waits for its run.
pub(super) struct Job<I, A> {
    pub(super) picture: I,
    pub(super) asked: Instant,
    pub(super) reply: oneshot::Sender<A>,
    /// The place it takes in the queue, given back when its run starts; none outside of the queue.
    pub(super) places: Option<[OwnedSemaphorePermit; 2]>,
}

/// How pictures of several cameras share a run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Batching {
    /// The most pictures of a run.
    pub(super) size: usize,
    /// How long a picture waits for others, from being asked.
    pub(super) wait: Duration,
}

/// Pictures of type `I` that wait for an answer of type `A`.
pub(super) struct Queue<I, A> {
    batching: Batching,
    waiting: BTreeMap<CameraSlot, Job<I, A>>,
    /// Cameras that have ever asked: a batch cannot have more pictures.
    cameras: BTreeSet<CameraSlot>,
    last_served: Option<CameraSlot>,
}

impl<I, A> Queue<I, A> {
    pub(super) fn new(batching: Batching) -> Self {
        Self {
            batching,
            waiting: BTreeMap::new(),
            cameras: BTreeSet::new(),
            last_served: None,
        }
    }

    /// How many pictures wait.
    pub(super) fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// Puts a picture into its camera's place.
    pub(super) fn push(&mut self, camera: CameraSlot, job: Job<I, A>) {
        self.waiting.insert(camera, job);
        self.cameras.insert(camera);
    }

    /// Drops the pictures whose askers have gone; says how many.
    pub(super) fn forget_the_gone(&mut self) -> usize {
        let before = self.waiting.len();
        self.waiting.retain(|_, job| !job.reply.is_closed());
        before - self.waiting.len()
    }

    /// When the next run may begin: as soon as its pictures are there, or when the first of them has waited for
    /// others long enough. `None` without any.
    pub(super) fn batch_complete_at(&self) -> Option<Instant> {
        let first = self.waiting.values().map(|job| job.asked).min()?;
        let full = self.batching.size.min(self.cameras.len());
        if self.waiting.len() >= full {
            Some(first)
        } else {
            Some(first + self.batching.wait)
        }
    }

    /// The pictures of the next run.
    pub(super) fn take_batch(&mut self) -> Vec<Job<I, A>> {
        let size = self.batching.size;
        std::iter::from_fn(|| self.take_next()).take(size).collect()
    }

    /// All that wait.
    pub(super) fn take_all(&mut self) -> Vec<Job<I, A>> {
        std::mem::take(&mut self.waiting).into_values().collect()
    }

    /// The picture of the next camera round the circle.
    fn take_next(&mut self) -> Option<Job<I, A>> {
        let camera = self
            .last_served
            .and_then(|last| self.waiting.range((Excluded(last), Unbounded)).next())
            .or_else(|| self.waiting.iter().next())
            .map(|(&camera, _)| camera)?;
        self.last_served = Some(camera);
        self.waiting.remove(&camera)
    }
}
