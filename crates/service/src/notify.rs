//! Tells the service manager (systemd, `Type=notify`) how the service is, and feeds its watchdog for as long as that is
//! well. Without a manager nothing is sent.
//!
//! Two rules. A service that waits for others (a router, a database) counts as started after a while: a manager that
//! killed it would bring nobody closer. And the watchdog is fed by the task that checks the service's real health, on
//! the runtime everything else runs on: workers that hang, a lock that is never given back, or a part that has been
//! broken for too long all end the feeding, and the manager restarts the service.

use sd_notify::NotifyState;
use std::time::Duration;
use tokio::time::{Instant, MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;

/// How the service is, at one look.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Look {
    /// Whether it does what it is there for.
    pub ready: bool,
    /// Why it does not, or with what missing; empty when all is well.
    pub reasons: String,
    /// What only a new start can repair: while it lasts the watchdog is not fed.
    pub stuck: Option<String>,
}

/// After this time a service counts as started although it still waits for others.
const STARTED_AFTER: Duration = Duration::from_secs(30);

/// Interval of the check where the manager has no watchdog.
const LOOK_EVERY: Duration = Duration::from_secs(5);

/// The longest text that is sent.
const LONGEST: usize = 400;

/// Where messages go: the manager, or a test.
trait Manager {
    fn tell(&mut self, messages: &[NotifyState<'_>]);
}

struct Systemd {
    failed: bool,
}

impl Manager for Systemd {
    fn tell(&mut self, messages: &[NotifyState<'_>]) {
        let told = sd_notify::notify(messages);
        if let (Err(error), false) = (&told, self.failed) {
            tracing::warn!(%error, "the service manager cannot be notified");
        }
        self.failed = told.is_err();
    }
}

/// Tells the service manager how the service is until `shutdown`, then that it stops. `look` is asked at half the
/// watchdog's period at the latest; it must neither wait nor take long.
pub async fn run(look: impl Fn() -> Look + Send, shutdown: CancellationToken) {
    if std::env::var_os("NOTIFY_SOCKET").is_none() {
        return;
    }
    let period = sd_notify::watchdog_enabled().map(|watchdog| watchdog / 2);
    tell(&mut Systemd { failed: false }, period, look, shutdown).await;
}

async fn tell(
    manager: &mut impl Manager,
    watchdog: Option<Duration>,
    look: impl Fn() -> Look,
    shutdown: CancellationToken,
) {
    let period = watchdog.unwrap_or(LOOK_EVERY).min(LOOK_EVERY);
    // A watchdog of nothing would be a loop without pause.
    let period = period.max(Duration::from_millis(1));
    let mut ticks = interval(period);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let begun = Instant::now();
    let (mut started, mut told, mut starving) = (false, None, false);
    loop {
        tokio::select! {
            biased;
            () = shutdown.cancelled() => break,
            _ = ticks.tick() => {}
        }
        let seen = look();
        let status = status(&seen);
        let mut messages = Vec::new();
        if !started && (seen.ready || begun.elapsed() >= STARTED_AFTER) {
            started = true;
            messages.push(NotifyState::Ready);
        }
        if told.as_deref() != Some(&*status) {
            messages.push(NotifyState::Status(&status));
        }
        if watchdog.is_some() && seen.stuck.is_none() {
            messages.push(NotifyState::Watchdog);
        }
        if let (Some(reason), false) = (&seen.stuck, starving) {
            tracing::error!(reason, "the watchdog is not fed any more");
        }
        starving = seen.stuck.is_some();
        if !messages.is_empty() {
            manager.tell(&messages);
        }
        told = Some(status);
    }
    manager.tell(&[NotifyState::Stopping, NotifyState::Status("stopping")]);
}

/// One line for `systemctl status`.
fn status(seen: &Look) -> String {
    let state = match (&seen.stuck, seen.ready, seen.reasons.is_empty()) {
        (Some(reason), ..) => return line(&format!("stuck: {reason}")),
        (None, true, true) => return "every part works".to_owned(),
        (None, true, false) => "degraded",
        (None, false, _) => "not ready",
    };
    line(&format!("{state}: {}", seen.reasons))
}

/// The text in one line, not too long: a line break would end the message.
fn line(text: &str) -> String {
    let text: String = text
        .chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    match text.char_indices().nth(LONGEST) {
        Some((cut, _)) => format!("{}…", &text[..cut]),
        None => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use parking_lot::Mutex;
    use std::sync::Arc;

    #[derive(Clone, Default)]
    struct Heard(Arc<Mutex<Vec<String>>>);

    impl Manager for Heard {
        fn tell(&mut self, messages: &[NotifyState<'_>]) {
            let mut heard = self.0.lock();
            heard.extend(messages.iter().map(ToString::to_string));
        }
    }

    impl Heard {
        fn count(&self, message: &str) -> usize {
            let heard = self.0.lock();
            heard.iter().filter(|one| one.starts_with(message)).count()
        }
    }

    fn watch(
        look: Look,
    ) -> (
        Heard,
        Arc<Mutex<Look>>,
        CancellationToken,
        tokio::task::JoinHandle<()>,
    ) {
        let (heard, look, shutdown) = (
            Heard::default(),
            Arc::new(Mutex::new(look)),
            CancellationToken::new(),
        );
        let (mut manager, seen, stop) = (heard.clone(), Arc::clone(&look), shutdown.clone());
        let task = tokio::spawn(async move {
            let period = Some(Duration::from_secs(1));
            tell(&mut manager, period, || seen.lock().clone(), stop).await;
        });
        (heard, look, shutdown, task)
    }

    fn well() -> Look {
        Look {
            ready: true,
            ..Look::default()
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_service_that_is_well_is_ready_once_and_feeds_the_watchdog() {
        let (heard, _look, shutdown, task) = watch(well());
        tokio::time::sleep(Duration::from_millis(10_500)).await;
        assert_eq!(heard.count("READY=1"), 1);
        assert_eq!(heard.count("WATCHDOG=1"), 11);
        assert_eq!(heard.count("STATUS="), 1);
        shutdown.cancel();
        task.await.unwrap();
        assert_eq!(heard.count("STOPPING=1"), 1);
    }

    #[tokio::test(start_paused = true)]
    async fn one_that_waits_for_others_is_fed_and_counts_as_started_after_a_while() {
        let waits = Look {
            reasons: "zenoh: no\nrouter".to_owned(),
            ..Look::default()
        };
        let (heard, look, shutdown, task) = watch(waits);
        tokio::time::sleep(Duration::from_millis(29_500)).await;
        assert_eq!((heard.count("READY=1"), heard.count("WATCHDOG=1")), (0, 30));
        assert_eq!(heard.count("STATUS=not ready: zenoh: no router"), 1);
        tokio::time::sleep(Duration::from_secs(1)).await;
        assert_eq!(heard.count("READY=1"), 1);
        *look.lock() = well();
        tokio::time::sleep(Duration::from_secs(1)).await;
        assert_eq!(heard.count("READY=1"), 1);
        shutdown.cancel();
        task.await.unwrap();
    }

    #[tokio::test(start_paused = true)]
    async fn one_that_is_stuck_is_not_fed_until_it_works_again() {
        let (heard, look, shutdown, task) = watch(well());
        tokio::time::sleep(Duration::from_millis(2_500)).await;
        look.lock().stuck = Some("the detector".to_owned());
        let fed = heard.count("WATCHDOG=1");
        tokio::time::sleep(Duration::from_secs(5)).await;
        assert_eq!(heard.count("WATCHDOG=1"), fed);
        assert_eq!(heard.count("STATUS=stuck: the detector"), 1);
        look.lock().stuck = None;
        tokio::time::sleep(Duration::from_secs(2)).await;
        assert_eq!(heard.count("WATCHDOG=1"), fed + 2);
        shutdown.cancel();
        task.await.unwrap();
    }
}
