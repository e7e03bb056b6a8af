//! Reports the service's state to the service manager (systemd, `Type=notify`), and feeds its watchdog while the
//! service works. Without a manager nothing is sent.
//!
//! A service that waits for others (a router, a database) counts as started after a while, because killing it would not
//! help. The watchdog is fed by the task that checks the service's real health, on the runtime that everything else
//! runs on: hung workers, a lock that is never released, or a part that has been broken for too long all stop the
//! feeding, and the manager restarts the service.

use crate::readiness::sentence;
use albireo_wire::{HealthState, HealthStatus};
use sd_notify::NotifyState;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::time::{Instant, MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;

/// The time after which a service counts as started although it still waits for others.
const STARTED_AFTER: Duration = Duration::from_secs(30);

/// The check interval if the manager has no watchdog.
const CHECK_INTERVAL: Duration = Duration::from_secs(5);

/// The time limit for the last message to be sent.
const PARTING: Duration = Duration::from_secs(1);

/// The maximum length of a text, characters.
const LONGEST: usize = 400;

/// Reports the service's state to the service manager until `shutdown`, then that it is stopping. `read` returns the
/// health, and the fault that only a restart can repair, if there is one: the watchdog is not fed while it lasts. It is
/// called at least once per half of the watchdog's period, and must not block.
pub async fn run(
    read: impl Fn() -> (HealthStatus, Option<String>) + Send,
    shutdown: CancellationToken,
) {
    if std::env::var_os("NOTIFY_SOCKET").is_none() {
        return;
    }
    let period = sd_notify::watchdog_enabled().map(|watchdog| watchdog / 2);
    let (outgoing, queue) = sync_channel::<String>(1);
    let (ended, all_sent) = oneshot::channel::<()>();
    // A manager that does not read its socket holds up this thread and nothing else.
    let sender = std::thread::Builder::new().name("notify".to_owned()).spawn(move || {
        send_all(&queue);
        drop(ended);
    });
    if let Err(error) = sender {
        tracing::warn!(%error, "the service manager cannot be notified");
        return;
    }
    let send = |messages: &[NotifyState<'_>]| {
        let lines: Vec<String> = messages.iter().map(ToString::to_string).collect();
        outgoing.try_send(lines.join("\n")).is_ok()
    };
    watch_state(send, period, read, shutdown).await;
    drop(outgoing);
    let _ = tokio::time::timeout(PARTING, all_sent).await;
}

/// Sends messages until their sender is gone.
fn send_all(queue: &Receiver<String>) {
    let mut has_failed = false;
    for message in queue {
        match sd_notify::notify(&[NotifyState::Custom(&message)]) {
            Ok(()) => has_failed = false,
            Err(error) => {
                // The first of several failures in a row is logged.
                if !has_failed {
                    tracing::warn!(%error, "the service manager cannot be notified");
                }
                has_failed = true;
            }
        }
    }
}

async fn watch_state(
    send: impl Fn(&[NotifyState<'_>]) -> bool,
    watchdog: Option<Duration>,
    read: impl Fn() -> (HealthStatus, Option<String>),
    shutdown: CancellationToken,
) {
    let period = watchdog.unwrap_or(CHECK_INTERVAL);
    // A watchdog period of zero would spin.
    let mut ticks = interval(period.clamp(Duration::from_millis(1), CHECK_INTERVAL));
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let begun = Instant::now();
    let mut has_started = false;
    let mut was_stuck = false;
    loop {
        tokio::select! {
            biased;
            () = shutdown.cancelled() => break,
            _ = ticks.tick() => {}
        }
        let (health, stuck) = read();
        let status = status(&health, stuck.as_deref());
        let mut messages = vec![NotifyState::Status(&status)];
        let is_ready = health.state != HealthState::NotReady;
        let starts = !has_started && (is_ready || begun.elapsed() >= STARTED_AFTER);
        if starts {
            messages.push(NotifyState::Ready);
        }
        if watchdog.is_some() && stuck.is_none() {
            messages.push(NotifyState::Watchdog);
        }
        if let Some(reason) = &stuck
            && !was_stuck
        {
            tracing::error!(reason, "no longer feeding the watchdog");
        }
        was_stuck = stuck.is_some();
        let is_sent = send(&messages);
        // A start that could not be sent is sent again with the next message.
        if starts && is_sent {
            has_started = true;
        }
    }
    send(&[NotifyState::Stopping, NotifyState::Status("stopping")]);
}

/// The status line for `systemctl status`.
fn status(health: &HealthStatus, stuck: Option<&str>) -> String {
    let text = match stuck {
        Some(reason) => format!("stuck: {reason}"),
        None => sentence(health),
    };
    // A line break would end the message.
    text.chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .take(LONGEST)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use parking_lot::Mutex;
    use std::sync::Arc;

    #[tokio::test(start_paused = true)]
    async fn a_waiting_service_is_ready_after_30_seconds_and_feeds_the_watchdog_unless_it_is_stuck()
    {
        let waiting = HealthStatus {
            state: HealthState::NotReady,
            reasons: [("zenoh".to_owned(), "no\nrouter".to_owned())].into(),
        };
        let state = Arc::new(Mutex::new((waiting, None)));
        let sent = Arc::<Mutex<Vec<String>>>::default();
        let read = Arc::clone(&state);
        let messages = Arc::clone(&sent);
        tokio::spawn(async move {
            let period = Some(Duration::from_secs(1));
            let send = |sent: &[NotifyState<'_>]| {
                messages.lock().extend(sent.iter().map(ToString::to_string));
                true
            };
            let forever = CancellationToken::new();
            watch_state(send, period, || read.lock().clone(), forever).await;
        });
        let count = |message: &str| {
            let sent = sent.lock();
            sent.iter().filter(|one| one.starts_with(message)).count()
        };
        tokio::time::sleep(Duration::from_millis(29_500)).await;
        assert_eq!(count("READY=1"), 0);
        assert_eq!(count("WATCHDOG=1"), 30);
        assert!(count("STATUS=not ready: zenoh: no router") > 0);
        tokio::time::sleep(Duration::from_secs(1)).await;
        assert_eq!(count("READY=1"), 1);
        let stuck = Some("the detector".to_owned());
        *state.lock() = (HealthStatus::default(), stuck);
        let fed = count("WATCHDOG=1");
        tokio::time::sleep(Duration::from_secs(5)).await;
        assert_eq!(count("WATCHDOG=1"), fed);
        assert!(count("STATUS=stuck: the detector") > 0);
        state.lock().1 = None;
        tokio::time::sleep(Duration::from_secs(2)).await;
        assert_eq!(count("READY=1"), 1);
        assert_eq!(count("WATCHDOG=1"), fed + 2);
    }
}
