//! Logs panics, one line each in the log's own format, and none where code of others is known to panic on bad input and
//! the panic is caught.

use std::any::Any;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind};

thread_local! {
    static CONTAINED: Cell<bool> = const { Cell::new(false) };
}

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
    let place = panic.location().map(ToString::to_string);
    let thread = std::thread::current();
    let thread = thread.name().unwrap_or("unnamed");
    let text = message(panic.payload());
    let backtrace = std::backtrace::Backtrace::capture();
    if backtrace.status() == std::backtrace::BacktraceStatus::Captured {
        tracing::error!(place, thread, %backtrace, "panic: {text}");
    } else {
        tracing::error!(place, thread, "panic: {text}");
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
}
