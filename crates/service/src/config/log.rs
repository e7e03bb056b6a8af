//! The `[log]` section of the configuration.

use super::Findings;
use serde::{Deserialize, Serialize};

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
        if let Err(reason) = check_level(&self.level) {
            findings.add("log.level", reason);
        }
    }
}

/// Checks a level or filter and returns why it is invalid.
pub(crate) fn check_level(level: &str) -> Result<(), String> {
    let fault = |error: &dyn std::fmt::Display| {
        format!("`{level}` is neither error, warn, info, debug, trace nor a filter: {error}")
    };
    // The filter takes a single word that is not a level for a module name, and then logs nothing else.
    for word in level.split(',').filter(|part| !part.contains(['=', '['])) {
        word.trim()
            .parse::<tracing::level_filters::LevelFilter>()
            .map_err(|_| fault(&format!("`{word}` is not a level")))?;
    }
    tracing_subscriber::EnvFilter::builder()
        .parse(level)
        .map(drop)
        .map_err(|error| fault(&error))
}
