//! Errors in a configuration: the source, the key, and the reason.

use std::fmt;

/// One error in a configuration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The key, such as `http.listen` or `camera.cabin.source`; empty if the error is not about one key.
    pub key: String,
    /// The error, and what is allowed.
    pub reason: String,
}

impl Finding {
    /// Creates a finding about the value of `key`.
    pub fn new(key: impl Into<String>, reason: impl Into<String>) -> Self {
        Self {
            key: key.into(),
            reason: reason.into(),
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.key.is_empty() {
            write!(f, "{}: ", self.key)?;
        }
        f.write_str(&self.reason)
    }
}

/// An invalid configuration, with all its errors, not only the first.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct ConfigError {
    /// The file, or `built-in defaults` if none was given.
    pub file: String,
    /// The errors; never empty.
    pub findings: Vec<Finding>,
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} cannot be used:", self.file)?;
        for finding in &self.findings {
            // A TOML syntax error has several lines, with the position underlined.
            let text = finding.to_string();
            write!(f, "\n  {}", text.trim_end().replace('\n', "\n  "))?;
        }
        Ok(())
    }
}
