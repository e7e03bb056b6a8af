//! Variables that must stand before libraries are loaded. A process cannot safely change its own once it has threads, so
//! the program starts itself once more in its own place.

use std::os::unix::process::CommandExt;
use std::process::Command;

/// A variable that is wanted, and its value.
pub(super) type Variable = (&'static str, &'static str);

/// ONNX Runtime's builds for Linux keep a data base of what is run under the user's cache folder and can send it to the
/// vendor. That is set up as soon as the library's environment is made, so that its call for turning telemetry off comes
/// too late; only this is in time (seen in version 1.31.1).
pub(super) const NO_TELEMETRY: Variable = ("ORT_DISABLE_TELEMETRY", "1");

/// glibc gives threads heaps of their own, up to eight for each processor, and keeps in each what once held pictures. The
/// threads that decode come and go, so a busy node's memory grew by a megabyte a minute; with two heaps it stayed
/// (benches/README.md).
pub(super) const FEW_HEAPS: Variable = ("MALLOC_ARENA_MAX", "2");

/// Goes on with these variables: in a new program in this process's place, or at once where each is set to anything already.
pub(super) fn start_with(wanted: &[Variable]) {
    let missing: Vec<_> = wanted
        .iter()
        .filter(|(name, _)| std::env::var_os(name).is_none())
        .copied()
        .collect();
    if missing.is_empty() {
        return;
    }
    let mut arguments = std::env::args_os();
    let name = arguments.next().unwrap_or_else(|| "albireo".into());
    let error = match std::env::current_exe() {
        Ok(program) => Command::new(program)
            .arg0(name)
            .args(arguments)
            .envs(missing.iter().copied())
            .exec(),
        Err(error) => error,
    };
    let set: Vec<_> = missing
        .iter()
        .map(|(name, value)| format!("{name}={value}"))
        .collect();
    eprintln!(
        "albireo: it goes on without {} ({error})",
        set.join(" and ")
    );
}
