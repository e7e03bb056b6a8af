//! The pictures that wait for a run: askers take turns, and a run takes at most one picture of each, all of one size.

use super::{Answer, Asker, Coming, RunError};
use albireo_core::geometry::PictureSize;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::time::Instant;

/// The numbers of pictures that a run may have, ascending: 1, 2, 4 and so on, and the largest. A library that adapts to each
/// number that it meets has met all of them once the model has been run with each.
pub(crate) fn batch_sizes(largest: usize) -> impl DoubleEndedIterator<Item = usize> {
    let largest = largest.max(1);
    // As many powers of 2 are below it.
    let below = largest.next_power_of_two().trailing_zeros();
    (0..below).map(|power| 1 << power).chain([largest])
}

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
    /// All that have ever asked.
    askers: BTreeMap<Asker, Rhythm>,
    last_served: Option<Asker>,
    /// The maximum number of pictures in a run.
    batch_size: usize,
    /// The longest time that a picture waits for pictures of other askers, from its request.
    batch_wait: Duration,
    /// The pictures that are announced, waiting or not.
    pub(super) coming: Coming,
    /// The duration of the last run. Waiting longer for another picture would be slower than a run of its own.
    last_run: Duration,
}

/// When an asker asks: by it a picture waits for those that are not announced yet but likely to come.
#[derive(Clone, Copy, Debug)]
struct Rhythm {
    /// The size of its latest picture.
    size: PictureSize,
    asked_at: Instant,
    /// The usual time between two requests; `None` after the first.
    gap: Option<Duration>,
    /// How far the times are from it, on average.
    deviation: Duration,
}

impl Rhythm {
    fn new(size: PictureSize, asked_at: Instant) -> Self {
        Self {
            size,
            asked_at,
            gap: None,
            deviation: Duration::ZERO,
        }
    }

    /// Smooths as the round-trip times of TCP are (RFC 6298).
    fn asked(&mut self, size: PictureSize, now: Instant) {
        let latest = now.saturating_duration_since(self.asked_at);
        match self.gap {
            None => {
                self.gap = Some(latest);
                self.deviation = latest / 2;
            }
            Some(gap) => {
                self.deviation = (3 * self.deviation + latest.abs_diff(gap)) / 4;
                self.gap = Some((7 * gap + latest) / 8);
            }
        }
        self.size = size;
        self.asked_at = now;
    }

    /// The time until which a picture of `first` waits for the next one of this asker: until it is late, but no longer than
    /// `longest`. `None` if it is not expected so soon, or asks at no regular times.
    fn waited_for_until(&self, first: Instant, longest: Duration) -> Option<Instant> {
        let expected = self.asked_at + self.gap?;
        let limit = first + longest;
        if expected > limit || self.deviation > longest {
            return None;
        }
        let late = expected + 4 * self.deviation;
        Some(late.min(limit))
    }
}

impl<I, T> Queue<I, T> {
    pub(super) fn new(batch_size: usize, batch_wait: Duration, coming: Coming) -> Self {
        Self {
            waiting: Vec::new(),
            askers: BTreeMap::new(),
            last_served: None,
            batch_size: batch_size.max(1),
            batch_wait,
            coming,
            last_run: Duration::ZERO,
        }
    }

    pub(super) fn push(&mut self, request: Request<I, T>) {
        if let Some(asker) = request.asker {
            match self.askers.get_mut(&asker) {
                Some(rhythm) => rhythm.asked(request.size, request.requested_at),
                None => {
                    let rhythm = Rhythm::new(request.size, request.requested_at);
                    self.askers.insert(asker, rhythm);
                }
            }
        }
        self.waiting.push(request);
    }

    /// Takes note of how long a run took.
    pub(super) fn ran(&mut self, took: Duration) {
        self.last_run = took;
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

    /// The time at which the next run may begin: at once, or when no picture of another asker is announced or likely to come
    /// that could share it. `None` if nothing waits.
    pub(super) fn begins_at(&self) -> Option<Instant> {
        let Some(next) = self.next(|_| true) else {
            return self.waiting.first().map(|request| request.requested_at);
        };
        let size = self.waiting[next].size;
        let first = self
            .of_askers()
            .filter(|request| request.size == size)
            .map(|request| request.requested_at)
            .min()?;
        let waiting = self.askers_of(size);
        if waiting.len() >= self.batch_size {
            return Some(first);
        }
        let longest = self.batch_wait.min(self.last_run);
        let announced = self.coming.askers_of(size);
        if announced.iter().any(|asker| !waiting.contains(asker)) {
            return Some(first + longest);
        }
        let mut begins_at = first;
        for (asker, rhythm) in &self.askers {
            let could_share = rhythm.size == size && !waiting.contains(asker);
            if could_share && let Some(until) = rhythm.waited_for_until(first, longest) {
                begins_at = begins_at.max(until);
            }
        }
        Some(begins_at)
    }

    /// Those who wait with pictures of `size`.
    fn askers_of(&self, size: PictureSize) -> BTreeSet<Asker> {
        self.of_askers()
            .filter(|request| request.size == size)
            .filter_map(|request| request.asker)
            .collect()
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

    /// The number of pictures in the next run: as many askers as wait with pictures of the size that is next, rounded down
    /// to one of the [`batch_sizes`].
    fn next_size(&self) -> usize {
        let Some(next) = self.next(|_| true) else {
            return 1;
        };
        let waiting = self.askers_of(self.waiting[next].size).len();
        batch_sizes(self.batch_size).rev().find(|size| *size <= waiting).unwrap_or(1)
    }

    /// Takes the pictures of the next run: that of the next asker in round-robin order and those of others that have its
    /// size, else one of nobody.
    pub(super) fn take_batch(&mut self) -> Vec<Request<I, T>> {
        let mut batch: Vec<Request<I, T>> = Vec::new();
        // An asker that is passed over, because its picture has another size, is the next in turn.
        let mut all_in_turn = true;
        let most = self.next_size();
        while batch.len() < most {
            let is_new =
                |request: &Request<I, T>| batch.iter().all(|other| other.asker != request.asker);
            let in_turn = self.next(is_new);
            let fitting = self.next(|request| {
                is_new(request) && batch.first().is_none_or(|first| first.size == request.size)
            });
            let Some(place) = fitting else { break };
            if fitting != in_turn {
                all_in_turn = false;
            }
            let request = self.waiting.remove(place);
            if all_in_turn {
                self.last_served = request.asker;
            }
            batch.push(request);
        }
        for asker in batch.iter().filter_map(|request| request.asker) {
            self.coming.begins(asker);
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
