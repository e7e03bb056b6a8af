//! The pictures that wait for a run: askers take turns, and a run takes at most one picture of each, all of one size.

use super::{Answer, Asker, RunError};
use albireo_core::geometry::PictureSize;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::time::Instant;

/// A picture that waits for its run.
pub(super) struct Request<I, T> {
    /// Who asked; `None` for a picture that runs only when no asker waits.
    pub(super) asker: Option<Asker>,
    pub(super) picture: I,
    pub(super) size: PictureSize,
    pub(super) requested_at: Instant,
    pub(super) reply: oneshot::Sender<Result<Answer<T>, RunError>>,
}

/// The waiting requests, in order of arrival.
pub(super) struct Queue<I, T> {
    waiting: Vec<Request<I, T>>,
    /// All that have ever asked, with the size of their latest picture: a batch cannot have more pictures than there are
    /// askers of its size.
    askers: BTreeMap<Asker, PictureSize>,
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
            askers: BTreeMap::new(),
            last_served: None,
            batch_size: batch_size.max(1),
            batch_wait,
        }
    }

    pub(super) fn push(&mut self, request: Request<I, T>) {
        self.askers.extend(request.asker.map(|asker| (asker, request.size)));
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
        let Some(next) = self.next(|_| true) else {
            return self.waiting.first().map(|request| request.requested_at);
        };
        let size = self.waiting[next].size;
        let of_size = || self.of_askers().filter(|request| request.size == size);
        let first = of_size().map(|request| request.requested_at).min()?;
        let waiting: BTreeSet<_> = of_size().map(|request| request.asker).collect();
        let could_wait = self.askers.values().filter(|latest| **latest == size).count();
        if waiting.len() >= self.batch_size.min(could_wait) {
            Some(first)
        } else {
            Some(first + self.batch_wait)
        }
    }

    /// The place of the request whose asker is next in turn, among those that `fit`.
    fn next(&self, fits: impl Fn(&Request<I, T>) -> bool) -> Option<usize> {
        let last = self.last_served;
        self.waiting
            .iter()
            .enumerate()
            .filter(|(_, request)| request.asker.is_some() && fits(request))
            .min_by_key(|(_, request)| (request.asker <= last, request.asker))
            .map(|(place, _)| place)
    }

    /// Takes the pictures of the next run: that of the next asker in round-robin order and those of others that have its
    /// size, else one of nobody.
    pub(super) fn take_batch(&mut self) -> Vec<Request<I, T>> {
        let mut batch: Vec<Request<I, T>> = Vec::new();
        // An asker that is passed over, because its picture has another size, is the next in turn.
        let mut all_in_turn = true;
        while batch.len() < self.batch_size {
            let is_new =
                |request: &Request<I, T>| batch.iter().all(|other| other.asker != request.asker);
            let in_turn = self.next(is_new);
            let fitting = self.next(|request| {
                is_new(request) && batch.first().is_none_or(|first| first.size == request.size)
            });
            let Some(place) = fitting else { break };
            all_in_turn &= in_turn == fitting;
            let request = self.waiting.remove(place);
            if all_in_turn {
                self.last_served = request.asker;
            }
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
