//! Sets up the log.

use crate::config::{LogConfig, LogFormat};
use parking_lot::Mutex;
use std::collections::VecDeque;
use std::io::{IsTerminal, Write};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::ParseError;
use tracing_subscriber::fmt::writer::MakeWriterExt;
use tracing_subscriber::layer::{Identity, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{Layer, Registry};

/// Lines of the log that are kept, and the most bytes of one.
const KEPT: usize = 1000;
const LONGEST: usize = 4096;

/// The last lines of the log.
static LAST: Mutex<VecDeque<String>> = Mutex::new(VecDeque::new());

/// The last lines of the log, the oldest first: what a service can tell of its past when it is asked.
pub fn last_lines() -> Vec<String> {
    LAST.lock().iter().cloned().collect()
}

/// Keeps what is written to it; each write is a line.
struct Keeper;

impl Write for Keeper {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        keep(&mut LAST.lock(), bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

fn keep(lines: &mut VecDeque<String>, bytes: &[u8]) {
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(LONGEST)]);
    let line = without_colours(text.trim_end());
    if lines.len() == KEPT {
        lines.pop_front();
    }
    lines.push_back(line);
}

/// The text without the sequences that colour it on a terminal.
fn without_colours(text: &str) -> String {
    let mut parts = text.split('\x1b');
    let mut plain = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        plain.push_str(part.split_once('m').map_or("", |(_, rest)| rest));
    }
    plain
}

/// What libraries say at a level where it concerns only who debugs them: ONNX Runtime lists every node of
/// a model at INFO, Zenoh every session and link. A directive of the user's own for the same target wins.
const QUIET: [&str; 6] = [
    "ort=warn",
    "zenoh=warn",
    "zenoh_transport=warn",
    "zenoh_link=warn",
    "zenoh_ext=warn",
    "hyper=warn",
];

/// Why there is no log.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// `log.level` is no list of directives.
    #[error("log.level: {0}")]
    Level(#[from] ParseError),
    /// A log was set up before.
    #[error("the log cannot be set up: {0}")]
    Taken(String),
}

/// Sends the log to standard error, as the configuration wants it, and panics with it.
///
/// # Errors
/// When the level cannot be read, or a log was set up before.
pub fn start(config: &LogConfig) -> Result<(), LogError> {
    start_beside(config, Identity::new())
}

/// As [`start`], with a layer of the service's own that sees what it wants, whatever the level of the log.
///
/// # Errors
/// As there.
pub fn start_beside(
    config: &LogConfig,
    beside: impl Layer<Registry> + Send + Sync,
) -> Result<(), LogError> {
    let filter = filter(&config.level)?;
    let lines = tracing_subscriber::fmt::layer().with_writer(std::io::stderr.and(|| Keeper));
    let registry = tracing_subscriber::registry().with(beside);
    let started = match config.format {
        LogFormat::Human => {
            let lines = lines.with_ansi(std::io::stderr().is_terminal());
            registry.with(lines.with_filter(filter)).try_init()
        }
        LogFormat::Json => {
            let lines = lines.json().flatten_event(true);
            registry.with(lines.with_filter(filter)).try_init()
        }
    };
    started.map_err(|error| LogError::Taken(error.to_string()))?;
    crate::panics::log_panics();
    Ok(())
}

fn filter(level: &str) -> Result<EnvFilter, ParseError> {
    // The later of two directives for the same target holds, so the user's come last.
    let directives = QUIET.join(",") + "," + level;
    EnvFilter::builder().parse(directives)
}

#[cfg(test)]
mod tests {
    use super::{KEPT, filter, keep};
    use std::collections::VecDeque;

    #[test]
    fn the_last_lines_are_kept_without_their_colours() {
        let mut lines = VecDeque::new();
        for number in 0..KEPT + 3 {
            keep(
                &mut lines,
                format!("\x1b[2m{number}\x1b[0m \x1b[32m INFO\x1b[0m ready\n").as_bytes(),
            );
        }
        assert_eq!(lines.len(), KEPT);
        assert_eq!(lines.front().map(String::as_str), Some("3  INFO ready"));
    }

    #[test]
    fn libraries_are_quiet_unless_asked_for() {
        let directives = |level: &str| -> Vec<String> {
            let filter = filter(level).unwrap().to_string();
            filter.split(',').map(str::to_owned).collect()
        };
        assert!(directives("info").contains(&"ort=warn".to_owned()));
        let asked = directives("info,ort=debug");
        assert!(asked.contains(&"ort=debug".to_owned()), "{asked:?}");
        assert!(!asked.contains(&"ort=warn".to_owned()), "{asked:?}");
    }
}
