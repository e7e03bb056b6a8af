//! The `[log]` section of the configuration.

use super::Findings;
use serde::{Deserialize, Serialize};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::LevelFilter;

/// The format of log lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    /// Human-readable lines.
    #[default]
    Human,
    /// One JSON object per line.
    Json,
}

/// The `[log]` section.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LogConfig {
    /// The format of the lines.
    pub format: LogFormat,
    /// `error`, `warn`, `info`, `debug`, `trace`, or filter directives such as
    /// `info,albireo_node=debug`.
    pub level: String,
}

impl Default for LogConfig {
    fn default() -> Self {
        Self {
            format: LogFormat::Human,
            level: "info".to_owned(),
        }
    }
}

impl LogConfig {
    /// Adds the errors in the section.
    pub fn check(&self, findings: &mut Findings) {
        findings.check("log.level", check_level(&self.level));
    }
}

/// Checks a level or filter and returns why it is invalid.
pub(crate) fn check_level(level: &str) -> Result<(), String> {
    // The filter takes a single word that is not a level for a module name, and then logs nothing else.
    let mut words = level.split(',').filter(|part| !part.contains(['=', '[']));
    let fault = match words.find(|word| word.trim().parse::<LevelFilter>().is_err()) {
        Some(word) => format!("`{word}` is not a level"),
        None => match EnvFilter::builder().parse(level) {
            Ok(_) => return Ok(()),
            Err(error) => error.to_string(),
        },
    };
    Err(format!(
        "`{level}` is neither error, warn, info, debug, trace nor a filter: {fault}"
    ))
}
