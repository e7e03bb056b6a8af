//! Sets up the log: on standard error, with the last lines kept in memory.

mod tail;
mod writer;

pub use tail::{LogLine, conceal, lines_after};
pub use writer::{dropped_lines, finish, last_words};

use crate::ServiceError;
use crate::config::{LogConfig, LogFormat, check_level};
use std::io::IsTerminal;
use tracing::Subscriber;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer};

/// Levels for libraries whose messages concern only their developers: ONNX Runtime logs every graph node of a
/// model at INFO, Zenoh every session and link. The user's own directive for the same target takes precedence.
const QUIET: [&str; 6] = [
    "ort=warn",
    "zenoh=warn",
    "zenoh_transport=warn",
    "zenoh_link=warn",
    "zenoh_ext=warn",
    "hyper=warn",
];

/// Sends the log and panics to standard error, as configured. `RUST_LOG`, common to many programs, takes precedence
/// over `log.level`. The last lines from level `info` on are kept in memory, even if a single level lets
/// fewer through to standard error.
///
/// # Errors
/// [`ServiceError`] if the level is invalid or a log was already set up.
pub fn start(config: &LogConfig) -> Result<(), ServiceError> {
    let variable = std::env::var("RUST_LOG").unwrap_or_default();
    let (source, level) = match variable.as_str() {
        "" => ("log.level", config.level.as_str()),
        level => ("environment variable RUST_LOG", level),
    };
    check_level(level).map_err(|why| ServiceError(format!("{source}: {why}")))?;
    let log = subscriber(level, config.format).try_init();
    log.map_err(|why| ServiceError(format!("the log cannot be set up: {why}")))?;
    crate::panics::log_panics();
    Ok(())
}

/// Creates the subscriber for the level and format. The level was checked.
fn subscriber(level: &str, format: LogFormat) -> impl Subscriber + Send + Sync {
    let lines = tracing_subscriber::fmt::layer().with_writer(writer::lines());
    let written = match format {
        LogFormat::Human => lines
            .with_ansi(std::io::stderr().is_terminal())
            .with_filter(filter(level))
            .boxed(),
        LogFormat::Json => lines.json().flatten_event(true).with_filter(filter(level)).boxed(),
    };
    let kept = filter(tail_level(level));
    tracing_subscriber::registry()
        .with(written)
        .with(tail::layer().with_filter(kept))
}

/// The level of the kept lines: a level that is stricter than `info` becomes `info`, so that the page has useful lines
/// even if standard error has fewer. A list of directives stays as it is.
fn tail_level(level: &str) -> &str {
    let level = level.trim();
    let is_stricter = ["off", "error", "warn"]
        .iter()
        .any(|stricter| level.eq_ignore_ascii_case(stricter));
    if is_stricter { "info" } else { level }
}

fn filter(level: &str) -> EnvFilter {
    // The last of two directives for the same target applies, so the user's come last.
    EnvFilter::builder().parse_lossy(QUIET.join(",") + "," + level)
}

#[cfg(test)]
mod tests {
    use super::{filter, lines_after, subscriber, tail_level};
    use crate::config::LogFormat;
    use parking_lot::Mutex;
    use tracing::{Level, subscriber::with_default};

    /// Held by each test that sets a subscriber: `tracing` caches the interest of all subscribers process-wide.
    pub(super) static ONE_SUBSCRIBER: Mutex<()> = Mutex::new(());

    #[test]
    fn events_that_nothing_records_are_disabled() {
        let _alone = ONE_SUBSCRIBER.lock();
        let log = subscriber("warn", LogFormat::Human);
        with_default(log, || {
            assert!(tracing::enabled!(Level::INFO));
            assert!(tracing::enabled!(target: "zenoh", Level::WARN));
            for unread in [
                tracing::enabled!(Level::DEBUG),
                tracing::enabled!(target: "zenoh", Level::INFO),
                !tracing::trace_span!(target: "zenoh", "of every message").is_disabled(),
            ] {
                assert!(!unread);
            }
        });
    }

    #[test]
    fn a_kept_line_of_zenoh_names_no_place_in_its_source_and_one_of_a_panic_does() {
        let _alone = ONE_SUBSCRIBER.lock();
        let before = lines_after(0, usize::MAX).last().map_or(0, |line| line.number);
        with_default(subscriber("warn", LogFormat::Human), || {
            tracing::warn!(target: "zenoh::net", "it cannot listen [in use at /b/.cargo/a-1/tcp.rs:61.]");
            tracing::warn!("panicked at src/a.rs:5");
        });
        let lines = lines_after(before, usize::MAX);
        let kept = |text: &str| lines.iter().any(|line| line.text.contains(text));
        assert!(
            kept("it cannot listen [in use.]") && kept("panicked at src/a.rs:5"),
            "{lines:?}"
        );
    }

    #[test]
    fn a_plain_tail_level_is_at_least_info() {
        assert_eq!(tail_level(" warn"), "info");
        assert_eq!(tail_level("WARN"), "info");
        assert_eq!(tail_level("debug"), "debug");
        let directives = "warn,albireo_node=debug";
        assert_eq!(tail_level(directives), directives);
    }

    #[test]
    fn ort_logs_only_warnings_unless_configured() {
        let directives = |level: &str| -> Vec<String> {
            filter(level).to_string().split(',').map(str::to_owned).collect()
        };
        assert!(directives("info").contains(&"ort=warn".to_owned()));
        let variable = directives("info,ort=debug");
        assert!(variable.contains(&"ort=debug".to_owned()), "{variable:?}");
        assert!(!variable.contains(&"ort=warn".to_owned()), "{variable:?}");
    }
}
