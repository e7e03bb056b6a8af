//! Errors in a configuration: where it was read, which key, and why.

use std::fmt;

/// One thing that is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The key, `http.listen` or `camera.cabin.source`; empty when it is not about one key.
    pub key: String,
    /// What is wrong and what would do.
    pub reason: String,
    /// Where the value comes from, when it is not the file: an environment variable.
    pub source: Option<String>,
}

impl Finding {
    /// A finding about the value of `key`.
    pub fn new(key: impl Into<String>, reason: impl Into<String>) -> Self {
        Self {
            key: key.into(),
            reason: reason.into(),
            source: None,
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.key.is_empty() {
            write!(f, "{}: ", self.key)?;
        }
        f.write_str(&self.reason)?;
        match &self.source {
            Some(source) => write!(f, " (from {source})"),
            None => Ok(()),
        }
    }
}

/// A configuration that cannot be used: everything that is wrong with it, not the first thing only.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct ConfigError {
    /// The file, or `built-in defaults` when none was given.
    pub file: String,
    /// What is wrong; never empty.
    pub findings: Vec<Finding>,
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} cannot be used:", self.file)?;
        for finding in &self.findings {
            // A TOML syntax error has several lines, with the place underlined.
            write!(
                f,
                "\n  {}",
                finding.to_string().trim_end().replace('\n', "\n  ")
            )?;
        }
        Ok(())
    }
}
