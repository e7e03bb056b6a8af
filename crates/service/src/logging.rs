//! Sets up the log.

use crate::config::{LogConfig, LogFormat};
use std::io::IsTerminal;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::ParseError;

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
    let filter = filter(&config.level)?;
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr);
    let started = match config.format {
        LogFormat::Human => subscriber
            .with_ansi(std::io::stderr().is_terminal())
            .try_init(),
        LogFormat::Json => subscriber.json().flatten_event(true).try_init(),
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
    use super::filter;

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
