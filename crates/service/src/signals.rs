//! Handles Ctrl-C, SIGTERM and SIGHUP.

use crate::logging;
use procfs::process::Process;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::low_level::{exit, signal_name};
use std::time::{Duration, Instant};
use std::{io, thread};
use tokio_util::sync::CancellationToken;

/// Signals this soon after the first are the same request: `timeout` signals its child, then the whole group.
const ONE_REQUEST: Duration = Duration::from_secs(1);

/// Returns a token that the first Ctrl-C, SIGTERM or SIGHUP (a closed terminal) cancels. A second signal, at least a
/// second later, ends the program at once, with exit code 130. That leaves out what the C library does at an exit: threads
/// may still use other libraries.
///
/// # Errors
/// An I/O error if the signal handlers cannot be installed.
pub fn shutdown() -> io::Result<CancellationToken> {
    handle_signals(None)
}

/// Like [`shutdown`], but the program also ends, with exit code 1, if it still runs `limit` after the first signal.
///
/// # Errors
/// An I/O error if the signal handlers cannot be installed.
pub fn shutdown_within(limit: Duration) -> io::Result<CancellationToken> {
    handle_signals(Some(limit))
}

fn handle_signals(limit: Option<Duration>) -> io::Result<CancellationToken> {
    let token = CancellationToken::new();
    let cancelled = token.clone();
    let failed = |error: io::Error| {
        io::Error::other(format!("the signal handlers cannot be installed: {error}"))
    };
    let mut wanted = vec![SIGTERM, SIGINT];
    if !ignores_hangup() {
        wanted.push(SIGHUP);
    }
    let mut signals = Signals::new(wanted).map_err(failed)?;
    // In a separate thread: a signal is handled even if all workers of the program are blocked.
    thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || {
            let mut first: Option<Instant> = None;
            for signal in signals.forever() {
                let name = signal_name(signal).unwrap_or_default();
                match first {
                    None => {
                        first = Some(Instant::now());
                        // Before anything else, which may fail or wait.
                        cancelled.cancel();
                        if let Some(limit) = limit {
                            thread::spawn(move || {
                                thread::sleep(limit);
                                tracing::error!("not stopped within {limit:?}: exiting");
                                logging::finish();
                                exit(1);
                            });
                        }
                        tracing::info!("{name}: stopping");
                    }
                    Some(at) if at.elapsed() >= ONE_REQUEST => {
                        tracing::warn!("{name} again: exiting at once");
                        logging::finish();
                        exit(130);
                    }
                    Some(_) => {}
                }
            }
        })
        .map_err(failed)?;
    Ok(token)
}

/// True if this process was started so that it survives its terminal, as by `nohup`.
fn ignores_hangup() -> bool {
    let status = Process::myself().and_then(|process| process.status());
    // Bit n - 1 stands for signal n.
    status.is_ok_and(|status| status.sigign >> (SIGHUP - 1) & 1 == 1)
}
