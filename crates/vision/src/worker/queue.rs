//! The pictures that wait for a run: askers take turns, and a run takes at most one picture of each.

use super::{Answer, Asker, RunError};
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::time::Instant;

/// A picture that waits for its run.
pub(super) struct Request<I, T> {
    /// Who asked; `None` for a picture that runs only when no asker waits.
    pub(super) asker: Option<Asker>,
    pub(super) picture: I,
    pub(super) requested_at: Instant,
    pub(super) reply: oneshot::Sender<Result<Answer<T>, RunError>>,
}

/// The waiting requests, in order of arrival.
pub(super) struct Queue<I, T> {
    waiting: Vec<Request<I, T>>,
    /// All that have ever asked: a batch cannot have more pictures.
    askers: BTreeSet<Asker>,
    last_served: Option<Asker>,
    /// The maximum number of pictures in a run.
    batch_size: usize,
    /// The longest time that a picture waits for pictures of other askers, from its request.
    batch_wait: Duration,
}

impl<I, T> Queue<I, T> {
    pub(super) fn new(batch_size: usize, batch_wait: Duration) -> Self {
        Self {
            waiting: Vec::new(),
            askers: BTreeSet::new(),
            last_served: None,
            batch_size: batch_size.max(1),
            batch_wait,
        }
    }

    pub(super) fn push(&mut self, request: Request<I, T>) {
        self.askers.extend(request.asker);
        self.waiting.push(request);
    }

    /// The number of waiting pictures of askers.
    pub(super) fn waiting(&self) -> usize {
        self.of_askers().count()
    }

    fn of_askers(&self) -> impl Iterator<Item = &Request<I, T>> {
        self.waiting.iter().filter(|request| request.asker.is_some())
    }

    /// Drops the requests whose requester gave up; returns how many of them came from askers.
    pub(super) fn drop_cancelled(&mut self) -> usize {
        let before = self.waiting();
        self.waiting.retain(|request| !request.reply.is_closed());
        before - self.waiting()
    }

    /// The time at which the next run may begin: as soon as its pictures are there, or once the first of them has
    /// waited long enough for others. `None` if nothing waits.
    pub(super) fn begins_at(&self) -> Option<Instant> {
        let Some(first) = self.of_askers().map(|request| request.requested_at).min() else {
            return self.waiting.first().map(|request| request.requested_at);
        };
        let waiting: BTreeSet<_> = self.of_askers().map(|request| request.asker).collect();
        if waiting.len() >= self.batch_size.min(self.askers.len()) {
            Some(first)
        } else {
            Some(first + self.batch_wait)
        }
    }

    /// Takes the pictures of the next run: those of the next askers in round-robin order, else one of nobody.
    pub(super) fn take_batch(&mut self) -> Vec<Request<I, T>> {
        let mut batch: Vec<Request<I, T>> = Vec::new();
        while batch.len() < self.batch_size {
            let last = self.last_served;
            let next = self
                .waiting
                .iter()
                .enumerate()
                .filter(|(_, request)| request.asker.is_some())
                .filter(|(_, request)| batch.iter().all(|other| other.asker != request.asker))
                .min_by_key(|(_, request)| (request.asker <= last, request.asker));
            let Some((place, _)) = next else { break };
            let request = self.waiting.remove(place);
            self.last_served = request.asker;
            batch.push(request);
        }
        if batch.is_empty() && !self.waiting.is_empty() {
            batch.push(self.waiting.remove(0));
        }
        batch
    }

    /// Takes all waiting requests.
    pub(super) fn take_all(&mut self) -> Vec<Request<I, T>> {
        std::mem::take(&mut self.waiting)
    }
}
