//! The `[log]` section of the configuration.

use super::Findings;
use serde::{Deserialize, Serialize};

/// How log lines look.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    /// Lines for people.
    #[default]
    Human,
    /// One JSON object a line.
    Json,
}

/// The log: the `[log]` section.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LogConfig {
    /// How lines look.
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
    /// Notes what is wrong with the section.
    pub fn check(&self, findings: &mut Findings) {
        if let Err(reason) = check_level(&self.level) {
            findings.add("log.level", reason);
        }
    }
}

/// Why a level or filter cannot be used.
pub(crate) fn check_level(level: &str) -> Result<(), String> {
    let fault = |error: &dyn std::fmt::Display| {
        format!("`{level}` is neither error, warn, info, debug, trace nor a filter: {error}")
    };
    // The filter takes a lone word that is no level for the name of a module, and then logs nothing else.
    for word in level.split(',').filter(|part| !part.contains(['=', '['])) {
        word.trim()
            .parse::<tracing::level_filters::LevelFilter>()
            .map_err(|_| fault(&format!("`{word}` is no level")))?;
    }
    tracing_subscriber::EnvFilter::builder()
        .parse(level)
        .map(drop)
        .map_err(|error| fault(&error))
}
