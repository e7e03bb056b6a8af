//! Panics in the log: one line each in the log's own format, thinned out, and none where code of others is known to
//! panic on bad input and the panic is caught.

use parking_lot::Mutex;
use std::any::Any;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, Location, PanicHookInfo, catch_unwind};
use std::time::{Duration, Instant};

/// Time between two log lines of panics at one place.
const PERIOD: Duration = Duration::from_secs(10);

/// Places that are remembered; panics at any further ones are always logged.
const MOST_PLACES: usize = 256;

thread_local! {
    static CONTAINED: Cell<bool> = const { Cell::new(false) };
}

/// When a panic at a place was logged last, and how many since were not.
static LOGGED: Mutex<BTreeMap<(String, u32), (Instant, u64)>> = Mutex::new(BTreeMap::new());

/// Has every panic of the process logged by `tracing` from now on. To be called once, when the log is set up.
pub(crate) fn log_panics() {
    std::panic::set_hook(Box::new(log));
}

/// Runs `work`, and gives what it panicked with instead of letting that go on. Nothing is logged: the caller counts
/// it and says what it was about.
///
/// # Errors
/// What `work` panicked with.
pub fn contain<T>(work: impl FnOnce() -> T) -> Result<T, Box<dyn Any + Send>> {
    let before = CONTAINED.replace(true);
    let ended = catch_unwind(AssertUnwindSafe(work));
    CONTAINED.set(before);
    ended
}

fn log(panic: &PanicHookInfo<'_>) {
    if CONTAINED.get() {
        return;
    }
    let Some(held_back) = panic.location().map_or(Some(0), admit) else {
        return;
    };
    let place = panic
        .location()
        .map(ToString::to_string)
        .unwrap_or_default();
    let thread = std::thread::current();
    let thread = thread.name().unwrap_or("unnamed");
    let text = message(panic.payload());
    let backtrace = std::backtrace::Backtrace::capture();
    if backtrace.status() == std::backtrace::BacktraceStatus::Captured {
        tracing::error!(place, thread, held_back, %backtrace, "panic: {text}");
    } else {
        tracing::error!(place, thread, held_back, "panic: {text}");
    }
}

/// Whether to log a panic at `place`: then how many before it were not logged.
fn admit(place: &Location<'_>) -> Option<u64> {
    let now = Instant::now();
    let mut places = LOGGED.lock();
    let key = (place.file().to_owned(), place.line());
    match places.get_mut(&key) {
        Some((last, held_back)) if now.duration_since(*last) < PERIOD => {
            *held_back += 1;
            None
        }
        Some((last, held_back)) => {
            *last = now;
            Some(std::mem::take(held_back))
        }
        None => {
            if places.len() < MOST_PLACES {
                places.insert(key, (now, 0));
            }
            Some(0)
        }
    }
}

/// The message of a panic.
pub fn message(payload: &(dyn Any + Send)) -> &str {
    (payload.downcast_ref::<&str>().copied())
        .or_else(|| payload.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no message")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_contained_panic_comes_back_and_the_next_one_is_not_contained() {
        let text = contain(|| panic!("row {}", 3))
            .map(|(): ()| ())
            .unwrap_err();
        assert_eq!(message(&*text), "row 3");
        assert!(!CONTAINED.get());
        assert_eq!(contain(|| 7).unwrap(), 7);
    }

    #[test]
    fn panics_at_one_place_are_told_once_a_period_and_counted() {
        let place = Location::caller();
        assert_eq!(admit(place), Some(0));
        for _ in 0..5 {
            assert_eq!(admit(place), None);
        }
        assert_eq!(LOGGED.lock()[&(place.file().to_owned(), place.line())].1, 5);
    }
}
