//! Logs panics, one per line in the log's format, and ends the program where one only says that nobody reads on.

use std::any::Any;
use std::backtrace::{Backtrace, BacktraceStatus};
use std::panic::PanicHookInfo;
use tracing::field::display;

/// What a shell tells of a program that SIGPIPE ended.
const CLOSED_PIPE: i32 = 128 + signal_hook::consts::SIGPIPE;

/// Makes a closed pipe an end without a word: a reader such as `head` has seen enough, and that is nobody's fault. Call it
/// once, before the log is set up.
pub fn end_quietly_at_a_closed_pipe() {
    let tell = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        end_if_unread(panic);
        tell(panic);
    }));
}

/// Makes `tracing` log every panic of the process. Call it once, when the log is set up.
pub(crate) fn log_panics() {
    std::panic::set_hook(Box::new(|panic| {
        end_if_unread(panic);
        log(panic);
    }));
}

/// Ends the process if the panic is that of `println!` without a reader.
fn end_if_unread(panic: &PanicHookInfo<'_>) {
    if message(panic.payload()).starts_with("failed printing to stdout: Broken pipe") {
        signal_hook::low_level::exit(CLOSED_PIPE);
    }
}

fn log(panic: &PanicHookInfo<'_>) {
    let place = panic.location().map(ToString::to_string);
    let current = std::thread::current();
    let thread = current.name().unwrap_or("unnamed");
    let captured = Backtrace::capture();
    let backtrace = match captured.status() {
        BacktraceStatus::Captured => Some(display(captured)),
        _ => None,
    };
    let text = message(panic.payload());
    tracing::error!(place, thread, backtrace, "panic: {text}");
}

/// The message of a panic.
pub(crate) fn message(payload: &(dyn Any + Send)) -> &str {
    if let Some(text) = payload.downcast_ref::<&str>() {
        return text;
    }
    match payload.downcast_ref::<String>() {
        Some(text) => text,
        None => "no message",
    }
}
