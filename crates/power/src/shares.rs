//! Whose energy it is when several cameras use one node: the node's energy is measured once and divided.
//!
//! The rule: every second of the node's life is divided between its users by the time the detector ran for
//! each in that second, a run for several pictures evenly between them; a second without detector time, by the
//! frames each sent; a second without either, as the second before. The shares of a second add up to one, so
//! the clips of all users together never count a joule twice.
//!
//! A user *aside* (the audit, which works for no frame) takes of a second what the detector worked for it of that
//! second's time, and the others divide the rest.
//!
//! A second that somebody has asked about is settled and never divided again: detector time that becomes known
//! later counts in the next. So do the pieces of a second that a clip's end cuts in two.

use super::series::seconds_between;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;
use tokio::time::Instant;

/// Length of one piece.
const PIECE: Duration = Duration::from_secs(1);

/// What one user did in a piece.
#[derive(Clone, Copy, Debug, Default)]
struct Work {
    detector_s: f64,
    frames: f64,
}

/// A piece of the node's life, from one power sample to another; the last is still open.
#[derive(Debug)]
struct Piece {
    from: Instant,
    /// The node's joules up to its start.
    joules: f64,
    /// Its end and the node's joules up to there.
    end: Option<(Instant, f64)>,
    work: Vec<Work>,
    settled: Option<Settled>,
}

/// A piece that is not divided again.
#[derive(Debug)]
struct Settled {
    /// The joules of each user up to the piece's start.
    before: Vec<f64>,
    /// The share of each in it.
    shares: Vec<f64>,
}

/// The division of the node's energy.
#[derive(Debug)]
pub(super) struct Shares {
    users: BTreeMap<String, usize>,
    /// Whether each user stands aside.
    aside: Vec<bool>,
    /// Oldest first; never empty.
    pieces: VecDeque<Piece>,
    /// The joules of each user up to the first piece that is not settled.
    given: Vec<f64>,
    /// The shares of the last settled piece in which something was done.
    shares: Vec<f64>,
}

impl Shares {
    /// Of a node that begins now.
    pub(super) fn new(now: Instant) -> Self {
        Self {
            users: BTreeMap::new(),
            aside: Vec::new(),
            pieces: VecDeque::from([Piece::open(now, 0.0)]),
            given: Vec::new(),
            shares: Vec::new(),
        }
    }

    /// The number of the user `name`; asked for twice, it is the same user.
    pub(super) fn user(&mut self, name: &str) -> usize {
        self.number_of(name, false)
    }

    /// The number of the user `name` that stands aside. Its name must be no other user's.
    pub(super) fn user_aside(&mut self, name: &str) -> usize {
        self.number_of(name, true)
    }

    fn number_of(&mut self, name: &str, aside: bool) -> usize {
        let next = self.users.len();
        let number = *self.users.entry(name.to_owned()).or_insert(next);
        if number == next {
            self.aside.push(aside);
        }
        number
    }

    /// Notes a frame of `user`.
    pub(super) fn frame(&mut self, user: usize, at: Instant) {
        let first = self.first_unsettled();
        let piece = self
            .pieces
            .iter_mut()
            .skip(first)
            .find(|piece| piece.end.is_none_or(|(end, _)| at < end));
        if let Some(piece) = piece {
            piece.work(user).frames += 1.0;
        }
    }

    /// Notes that `user` used `used` of the detector's run from `start` to `end`. What falls on settled time is
    /// counted in the first that is not.
    pub(super) fn detector(&mut self, user: usize, start: Instant, end: Instant, used: Duration) {
        let (length, used) = (seconds_between(start, end), used.as_secs_f64());
        let mut left = used;
        let first = self.first_unsettled();
        for piece in self.pieces.iter_mut().skip(first) {
            let part = match piece.end {
                Some((until, _)) if until < end && length > 0.0 => {
                    let done = seconds_between(start, until) / length * used;
                    (done - (used - left)).clamp(0.0, left)
                }
                _ => left,
            };
            if part > 0.0 {
                piece.work(user).detector_s += part;
            }
            left -= part;
            if left <= 0.0 {
                return;
            }
        }
    }

    /// The node has used `joules` up to the sample at `at`.
    pub(super) fn sampled(&mut self, at: Instant, joules: f64) {
        if self
            .pieces
            .back()
            .is_some_and(|open| at.saturating_duration_since(open.from) >= PIECE)
        {
            self.cut(at, joules);
        }
    }

    /// Ends the open piece at a sample, and begins the next.
    fn cut(&mut self, at: Instant, joules: f64) {
        if let Some(open) = self.pieces.back_mut()
            && at > open.from
        {
            open.end = Some((at, joules));
            self.pieces.push_back(Piece::open(at, joules));
        }
    }

    /// Settles all pieces that begin before `moment`, which the newest sample (its time, and the node's joules
    /// up to it) need not have reached.
    pub(super) fn settle(&mut self, moment: Instant, newest: (Instant, f64)) {
        if self.pieces.back().is_some_and(|open| open.from < moment) {
            self.cut(newest.0, newest.1);
        }
        let first = self.first_unsettled();
        let users = self.users.len();
        self.given.resize(users, 0.0);
        for piece in self.pieces.iter_mut().skip(first) {
            let Some((end, joules)) = piece.end else {
                break;
            };
            if piece.from >= moment {
                break;
            }
            if let Some(shares) = piece.shares(&self.aside) {
                self.shares = shares;
            }
            let shares = piece.with_aside(or_equal(&self.shares, &self.aside), &self.aside, end);
            let before = self.given.clone();
            for (given, share) in self.given.iter_mut().zip(&shares) {
                *given += share * (joules - piece.joules);
            }
            piece.settled = Some(Settled { before, shares });
        }
    }

    /// The joules of `user` at `moment`, when the node had used `joules`. What is not settled yet is divided as
    /// it stands.
    pub(super) fn at(&self, user: usize, moment: Instant, joules: f64) -> f64 {
        let after = self.pieces.partition_point(|piece| piece.from <= moment);
        let of = |list: &[f64]| list.get(user).copied().unwrap_or(0.0);
        match self.pieces.get(after.saturating_sub(1)) {
            Some(Piece {
                settled: Some(settled),
                joules: start,
                ..
            }) => of(&settled.before) + of(&settled.shares) * (joules - start),
            Some(piece) => {
                let shares = piece
                    .shares(&self.aside)
                    .unwrap_or_else(|| or_equal(&self.shares, &self.aside));
                let until = piece.end.map_or(moment, |(end, _)| end);
                let shares = piece.with_aside(shares, &self.aside, until);
                of(&self.given) + of(&shares) * (joules - piece.joules)
            }
            None => 0.0,
        }
    }

    /// Forgets the pieces that ended before `moment`; they must be settled.
    pub(super) fn forget(&mut self, moment: Instant) {
        while self.pieces.front().is_some_and(|piece| {
            piece.settled.is_some() && piece.end.is_some_and(|(end, _)| end <= moment)
        }) {
            self.pieces.pop_front();
        }
    }

    fn first_unsettled(&self) -> usize {
        self.pieces.partition_point(|piece| piece.settled.is_some())
    }

    #[cfg(test)]
    pub(super) fn pieces(&self) -> usize {
        self.pieces.len()
    }
}

impl Piece {
    fn open(from: Instant, joules: f64) -> Self {
        Self {
            from,
            joules,
            end: None,
            work: Vec::new(),
            settled: None,
        }
    }

    fn work(&mut self, user: usize) -> &mut Work {
        if self.work.len() <= user {
            self.work.resize(user + 1, Work::default());
        }
        &mut self.work[user]
    }

    /// The share of each user that does not stand aside; `None` in a piece in which none of them did anything.
    fn shares(&self, aside: &[bool]) -> Option<Vec<f64>> {
        let by = |of: fn(&Work) -> f64| {
            let work = |user: usize| self.work.get(user).map_or(0.0, of);
            let mut shares: Vec<f64> = (aside.iter().enumerate())
                .map(|(user, aside)| if *aside { 0.0 } else { work(user) })
                .collect();
            let sum: f64 = shares.iter().sum();
            shares.iter_mut().for_each(|share| *share /= sum);
            (sum > 0.0).then_some(shares)
        };
        by(|work| work.detector_s).or_else(|| by(|work| work.frames))
    }

    /// `shares` less what those aside take of a piece that ends at `end`, and their own.
    fn with_aside(&self, mut shares: Vec<f64>, aside: &[bool], end: Instant) -> Vec<f64> {
        let length = seconds_between(self.from, end);
        let of_time = |user: usize| {
            let worked = self.work.get(user).map_or(0.0, |work| work.detector_s);
            if worked > 0.0 && length > 0.0 {
                (worked / length).min(1.0)
            } else {
                0.0
            }
        };
        let taken: Vec<f64> = (aside.iter().enumerate())
            .map(|(user, aside)| if *aside { of_time(user) } else { 0.0 })
            .collect();
        let all: f64 = taken.iter().sum();
        if all > 0.0 {
            let most = all.min(1.0);
            for (share, taken) in shares.iter_mut().zip(taken) {
                *share = *share * (1.0 - most) + taken * most / all;
            }
        }
        shares
    }
}

/// `shares`, or equal parts where there are none yet, of the users that do not stand aside.
fn or_equal(shares: &[f64], aside: &[bool]) -> Vec<f64> {
    if shares.is_empty() {
        let others = aside.iter().filter(|aside| !**aside).count().max(1);
        let equal = |aside: &bool| if *aside { 0.0 } else { 1.0 / others as f64 };
        return aside.iter().map(equal).collect();
    }
    let mut shares = shares.to_vec();
    shares.resize(aside.len().max(shares.len()), 0.0);
    shares
}

#[cfg(test)]
mod tests;
