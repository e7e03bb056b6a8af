//! Ctrl-C and SIGTERM.

use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;

/// What to say when the signals cannot be listened to.
pub const CONTEXT: &str = "signals cannot be listened to";

/// A token that is cancelled by the first Ctrl-C or SIGTERM. A second one ends the program at once, with
/// exit code 130, for whoever does not want to wait.
///
/// # Errors
/// When the signals cannot be listened to.
pub fn shutdown() -> std::io::Result<CancellationToken> {
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let token = CancellationToken::new();
    let cancelled = token.clone();
    tokio::spawn(async move {
        let mut asked = false;
        loop {
            let name = tokio::select! {
                _ = terminate.recv() => "SIGTERM",
                _ = interrupt.recv() => "Ctrl-C",
            };
            if asked {
                std::process::exit(130);
            }
            asked = true;
            tracing::info!("{name}: stopping");
            cancelled.cancel();
        }
    });
    Ok(token)
}
