//! ONNX Runtime's own telemetry is off before its library is loaded.
//!
//! Its builds for Linux keep a data base of what is run under the user's cache folder and can send it to the vendor. That is
//! set up as soon as the library's environment is made, so that its call for turning telemetry off comes too late; only a
//! variable is in time (`ORT_DISABLE_TELEMETRY`, seen in version 1.31.1). A process cannot safely change its own variables
//! once it has threads, so the program starts itself once more in its own place.

use std::os::unix::process::CommandExt;
use std::process::Command;

const VARIABLE: &str = "ORT_DISABLE_TELEMETRY";

/// Goes on with telemetry off: in a new program in this process's place, or at once where the variable is set to anything
/// already.
pub(super) fn turn_off() {
    if std::env::var_os(VARIABLE).is_some() {
        return;
    }
    let mut arguments = std::env::args_os();
    let name = arguments.next().unwrap_or_else(|| "albireo".into());
    let error = match std::env::current_exe() {
        Ok(program) => Command::new(program)
            .arg0(name)
            .args(arguments)
            .env(VARIABLE, "1")
            .exec(),
        Err(error) => error,
    };
    eprintln!("albireo: ONNX Runtime's telemetry is not turned off ({error}): set {VARIABLE}=1");
}
