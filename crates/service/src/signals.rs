//! Ctrl-C and SIGTERM.

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::time::{Duration, Instant};
use std::{io, process, thread};
use tokio_util::sync::CancellationToken;

/// What to say when the signals cannot be listened to.
pub const CONTEXT: &str = "signals cannot be listened to";

/// Signals that come this soon after the first are the same request: `timeout` signals its child, then the whole group.
const ONE_REQUEST: Duration = Duration::from_secs(1);

/// Exit code after a second signal.
const TWICE: i32 = 130;

/// Exit code when stopping took too long.
const TOO_LONG: i32 = 1;

/// A token that is cancelled by the first Ctrl-C or SIGTERM. A second one, a second later or more, ends the program at
/// once, with exit code 130.
///
/// # Errors
/// When the signals cannot be listened to.
pub fn shutdown() -> io::Result<CancellationToken> {
    listen(None)
}

/// As [`shutdown`]; the program also ends, with exit code 1, when it still runs `limit` after the first signal.
///
/// # Errors
/// As there.
pub fn shutdown_within(limit: Duration) -> io::Result<CancellationToken> {
    listen(Some(limit))
}

fn listen(limit: Option<Duration>) -> io::Result<CancellationToken> {
    let token = CancellationToken::new();
    let cancelled = token.clone();
    let mut signals = Signals::new([SIGTERM, SIGINT])?;
    // A thread of its own: a signal is heard although every worker of the program's is blocked.
    thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || {
            let mut first: Option<Instant> = None;
            for signal in signals.forever() {
                let name = if signal == SIGTERM {
                    "SIGTERM"
                } else {
                    "Ctrl-C"
                };
                match first {
                    None => {
                        first = Some(Instant::now());
                        tracing::info!("{name}: stopping");
                        cancelled.cancel();
                        if let Some(limit) = limit {
                            end_after(limit);
                        }
                    }
                    Some(at) if at.elapsed() >= ONE_REQUEST => {
                        tracing::warn!("{name} again: ended at once");
                        process::exit(TWICE);
                    }
                    Some(_) => {}
                }
            }
        })?;
    Ok(token)
}

fn end_after(limit: Duration) {
    thread::spawn(move || {
        thread::sleep(limit);
        tracing::error!("not stopped within {limit:?}: ended");
        process::exit(TOO_LONG);
    });
}
