//! Ctrl-C and SIGTERM.

use std::io;
use std::sync::mpsc;
use std::time::{Duration, Instant};
use tokio::signal::unix::{Signal, SignalKind, signal};
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
    let (started, setup) = mpsc::channel();
    // A thread with a runtime of its own: a signal is heard although every worker of the program's is blocked.
    std::thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread()
                .enable_all()
                .build();
            let runtime = match runtime {
                Ok(runtime) => runtime,
                Err(error) => return drop(started.send(Err(error))),
            };
            runtime.block_on(async {
                let signals = async {
                    Ok((
                        signal(SignalKind::terminate())?,
                        signal(SignalKind::interrupt())?,
                    ))
                };
                match signals.await {
                    Ok((terminate, interrupt)) => {
                        let _ = started.send(Ok(()));
                        follow(terminate, interrupt, &cancelled, limit).await;
                    }
                    Err(error) => drop(started.send(Err(error))),
                }
            });
        })?;
    setup
        .recv()
        .unwrap_or_else(|_| Err(io::Error::other("the thread for signals ended")))?;
    Ok(token)
}

async fn follow(
    mut terminate: Signal,
    mut interrupt: Signal,
    token: &CancellationToken,
    limit: Option<Duration>,
) {
    let first = next(&mut terminate, &mut interrupt).await;
    tracing::info!("{first}: stopping");
    token.cancel();
    let too_long = async {
        match limit {
            Some(limit) => tokio::time::sleep(limit).await,
            None => std::future::pending().await,
        }
    };
    let first_at = Instant::now();
    let again = async {
        loop {
            let signal = next(&mut terminate, &mut interrupt).await;
            if first_at.elapsed() >= ONE_REQUEST {
                return signal;
            }
        }
    };
    tokio::select! {
        second = again => {
            tracing::warn!("{second} again: ended at once");
            std::process::exit(TWICE);
        }
        () = too_long => {
            tracing::error!("not stopped within {limit:?}: ended");
            std::process::exit(TOO_LONG);
        }
    }
}

async fn next(terminate: &mut Signal, interrupt: &mut Signal) -> &'static str {
    tokio::select! {
        _ = terminate.recv() => "SIGTERM",
        _ = interrupt.recv() => "Ctrl-C",
    }
}
