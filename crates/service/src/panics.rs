//! Logs panics, one per line in the log's format, but not caught panics in third-party code that is known to panic on
//! bad input.

use std::any::Any;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind};

thread_local! {
    static CONTAINED: Cell<bool> = const { Cell::new(false) };
}

/// Makes `tracing` log every panic of the process. Call it once, when the log is set up.
pub(crate) fn log_panics() {
    std::panic::set_hook(Box::new(log));
}

/// Runs `work` and returns its panic instead of propagating it. Nothing is logged: the caller counts the panic and
/// reports its subject.
///
/// # Errors
/// The payload of a panic in `work`.
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
    fn a_contained_panic_is_returned_and_containment_ends() {
        let text = contain::<()>(|| panic!("row {}", 3)).unwrap_err();
        assert_eq!(message(&*text), "row 3");
        assert!(!CONTAINED.get());
        assert_eq!(contain(|| 7).unwrap(), 7);
    }
}
