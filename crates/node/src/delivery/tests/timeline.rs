//! Virtual time: a seed decides what happens when, which messages are lost, and what fails.

use super::Output;
use albireo_service::clock::{Now, Uptime};
use rand_core::{RngCore, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::rc::Rc;
use std::time::{Duration, Instant};
use tempfile::TempDir;

pub(super) const SECOND: i64 = 1000;
pub(super) const HOUR: i64 = 3600 * SECOND;
pub(super) const DAY: i64 = 24 * HOUR;
/// Wall clock at the start: November 2026.
pub(super) const BEGIN: i64 = 1_795_000_000_000;

#[derive(Clone)]
pub(super) struct Payload<T>(pub(super) Rc<T>);

impl<T: Hash> std::fmt::Debug for Payload<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut hasher = DefaultHasher::new();
        self.0.hash(&mut hasher);
        write!(f, "{:016x}", hasher.finish())
    }
}

/// A temporary folder, in memory where the machine has such a folder.
pub(super) fn folder() -> TempDir {
    let in_memory = tempfile::tempdir_in("/dev/shm");
    in_memory.or_else(|_| tempfile::tempdir()).unwrap()
}

pub(super) struct Timeline<E> {
    random: Pcg64Mcg,
    began: Instant,
    pub(super) now_ms: i64,
    /// By the time at which they happen, then in the order in which they were planned.
    events: BTreeMap<(i64, u64), E>,
    numbers: u64,
    /// True once nothing may fail any more.
    pub(super) is_calm: bool,
    pub(super) cut_until_ms: i64,
    trace: String,
    output: Output,
}

impl<E: Clone + std::fmt::Debug> Timeline<E> {
    pub(super) fn new(seed: u64, output: Output) -> Self {
        Self {
            random: Pcg64Mcg::seed_from_u64(seed),
            began: Instant::now(),
            now_ms: 0,
            events: BTreeMap::new(),
            numbers: 0,
            is_calm: false,
            cut_until_ms: 0,
            trace: String::new(),
            output,
        }
    }

    /// Lets nothing fail any more.
    pub(super) fn calm_down(&mut self) {
        self.is_calm = true;
        self.cut_until_ms = 0;
    }

    pub(super) fn random(&mut self) -> u64 {
        self.random.next_u64()
    }

    pub(super) fn below(&mut self, most: u64) -> u64 {
        self.random() % most
    }

    pub(super) fn between(&mut self, from: i64, to: i64) -> i64 {
        from + self.below((to - from).unsigned_abs()).cast_signed()
    }

    pub(super) fn one_of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.below(all.len() as u64) as usize]
    }

    pub(super) fn chance(&mut self, of_thousand: u64) -> bool {
        self.below(1000) < of_thousand
    }

    /// Draws whether something rare goes wrong now.
    pub(super) fn unlucky(&mut self, of_thousand: u64) -> bool {
        !self.is_calm && self.chance(of_thousand)
    }

    /// A number not returned before.
    pub(super) fn number(&mut self) -> u64 {
        self.numbers += 1;
        self.numbers
    }

    pub(super) fn after(&mut self, ms: i64, event: E) {
        let number = self.number();
        self.events.insert((self.now_ms + ms, number), event);
    }

    /// Lets an event happen at some time between these, in milliseconds from now.
    pub(super) fn sometime(&mut self, from: i64, to: i64, event: E) {
        let ms = self.between(from, to);
        self.after(ms, event);
    }

    pub(super) fn next(&mut self) -> E {
        let ((at_ms, _), event) = self.events.pop_first().unwrap();
        self.now_ms = at_ms;
        self.note(&event);
        event
    }

    pub(super) fn events(&self) -> impl Iterator<Item = &E> {
        self.events.values()
    }

    /// The present on a machine whose wall clock is ahead by `clock_ms`, and that was started `boot` times.
    pub(super) fn now_of(&self, clock_ms: i64, boot: u64) -> Now {
        Now {
            at: self.began + Duration::from_millis(self.now_ms.unsigned_abs()),
            unix_ms: BEGIN + self.now_ms + clock_ms,
            uptime: Uptime {
                boot,
                s: self.now_ms.unsigned_abs() / 1000,
            },
        }
    }

    /// The present by a clock that is right.
    pub(super) fn now(&self) -> Now {
        self.now_by(0)
    }

    /// The present by a wall clock that is ahead by `clock_ms`.
    pub(super) fn now_by(&self, clock_ms: i64) -> Now {
        self.now_of(clock_ms, 0)
    }

    pub(super) fn note(&mut self, what: &impl std::fmt::Debug) {
        let line = format!("{:>9} {what:?}", self.now_ms);
        if self.output == Output::Printed {
            println!("{}", line.chars().take(200).collect::<String>());
        }
        self.trace.push_str(&line);
        self.trace.push('\n');
    }

    /// All that happened, in order, one event per line.
    pub(super) fn trace(self) -> String {
        self.trace
    }

    /// Sends over the network, which may lose, duplicate or delay the message.
    pub(super) fn send(&mut self, event: &E) {
        if self.now_ms < self.cut_until_ms || self.unlucky(60) {
            return;
        }
        let copies = if self.unlucky(60) { 2 } else { 1 };
        for _ in 0..copies {
            let most = if self.unlucky(60) { HOUR } else { 2 * SECOND };
            self.sometime(10, most, event.clone());
        }
    }
}
