//! Logs panics, one per line in the log's format, and ends the program where one only says that nothing can be printed.

use std::any::Any;
use std::backtrace::{Backtrace, BacktraceStatus};
use std::io::Write as _;
use std::panic::PanicHookInfo;
use tracing::field::display;

/// What a shell tells of a program that SIGPIPE ended.
const CLOSED_PIPE: i32 = 128 + signal_hook::consts::SIGPIPE;

/// The reason why a stream cannot be written whose reader is gone.
const NO_READER: &str = "Broken pipe";

/// Makes `println!` end the program where standard output cannot be written: without a word at a closed pipe, because a
/// reader such as `head` has seen enough and that is nobody's fault, and else, as on a full disk, with one line. Call it
/// once, before the log is set up.
pub fn end_if_nothing_can_be_printed() {
    let tell = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        end_if_unprinted(panic);
        tell(panic);
    }));
}

/// Makes `tracing` log every panic of the process. Call it once, when the log is set up.
pub(crate) fn log_panics() {
    std::panic::set_hook(Box::new(|panic| {
        end_if_unprinted(panic);
        log(panic);
    }));
}

/// Ends the process if the panic is that of `println!` or `eprintln!`.
fn end_if_unprinted(panic: &PanicHookInfo<'_>) {
    let text = message(panic.payload());
    for stream in ["stdout", "stderr"] {
        let words = format!("failed printing to {stream}: ");
        if let Some(reason) = text.strip_prefix(&words) {
            signal_hook::low_level::exit(say_unprinted(stream, reason));
        }
    }
}

/// Says why `stream` cannot be written, unless its reader is gone. Returns the exit code.
pub fn say_unprinted(stream: &str, reason: &str) -> i32 {
    if reason.starts_with(NO_READER) {
        return CLOSED_PIPE;
    }
    // `eprintln!` would panic again if that is the stream.
    let _ = writeln!(
        std::io::stderr(),
        "albireo: {stream} cannot be written: {reason}"
    );
    1
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
