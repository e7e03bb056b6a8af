//! Sets environment variables that libraries read when they are loaded. A process with threads cannot safely change its
//! own environment, so the program replaces itself with a new process.

use std::os::unix::process::CommandExt;
use std::process::Command;

/// The name and value of a variable.
pub(super) type Variable = (&'static str, &'static str);

/// ONNX Runtime's builds for Linux keep a database of runs in the user's cache folder and can send it to the vendor.
/// The library sets this up when it creates its environment, so its own call to disable telemetry comes too late; only
/// this variable is in time (seen in version 1.31.1).
pub(super) const NO_TELEMETRY: Variable = ("ORT_DISABLE_TELEMETRY", "1");

/// glibc gives threads separate heaps, up to eight per processor, and keeps memory that once held pictures in each. The
/// decoding threads come and go, so a busy node's memory grew by a megabyte per minute; with two heaps it stayed
/// constant (benches/README.md).
pub(super) const FEW_HEAPS: Variable = ("MALLOC_ARENA_MAX", "2");

/// Replaces this process with one that has these variables. Returns if all of them have a value already, or after an
/// error, which it writes to standard error.
pub(super) fn start_with(wanted: &[Variable]) {
    let is_missing = |(name, _): &&Variable| std::env::var_os(name).is_none();
    let missing: Vec<Variable> = wanted.iter().filter(is_missing).copied().collect();
    if missing.is_empty() {
        return;
    }
    let mut arguments = std::env::args_os();
    let name = arguments.next().unwrap_or_else(|| "albireo".into());
    let error = match std::env::current_exe() {
        Ok(program) => {
            Command::new(program).arg0(name).args(arguments).envs(missing.clone()).exec()
        }
        Err(error) => error,
    };
    eprintln!("albireo: continuing without {missing:?} ({error})");
}
