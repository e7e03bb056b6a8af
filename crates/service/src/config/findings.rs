//! The errors in a configuration: the source, the key, and the reason.

use std::fmt::{self, Display};
use std::path::Path;

/// Seconds per day: longer timeouts and windows are mistakes.
pub const DAY_S: f64 = 86_400.0;

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

impl Display for Finding {
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

impl Display for ConfigError {
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

/// Collects errors, in the order in which they are added.
#[derive(Debug, Default)]
pub struct Findings(pub Vec<Finding>);

impl Findings {
    /// Adds an error about `key`.
    pub fn add(&mut self, key: impl Into<String>, reason: impl Into<String>) {
        self.0.push(Finding::new(key, reason));
    }

    /// Returns the checked value; adds the error about `key` if there is one.
    pub fn check<T>(
        &mut self,
        key: impl Into<String>,
        checked: Result<T, impl Display>,
    ) -> Option<T> {
        match checked {
            Ok(value) => Some(value),
            Err(error) => {
                self.add(key, error.to_string());
                None
            }
        }
    }

    /// Requires a value above 0 and at most `high`.
    pub fn above_zero(&mut self, key: &str, value: f64, high: f64) {
        // Written so that NaN is rejected.
        if !(value > 0.0 && value <= high) {
            self.add(
                key,
                format!("must be above 0 and at most {high}, not {value}"),
            );
        }
    }

    /// Requires a number from `low` to `high`.
    pub fn within(&mut self, key: &str, value: f64, low: f64, high: f64) {
        // NaN is in no range.
        if !(low..=high).contains(&value) {
            self.add(key, format!("must be from {low} to {high}, not {value}"));
        }
    }

    /// Requires a value from `low` to `high`.
    pub fn count(&mut self, key: &str, value: u64, low: u64, high: u64) {
        if !(low..=high).contains(&value) {
            self.add(key, format!("must be from {low} to {high}, not {value}"));
        }
    }

    /// Requires a non-empty path, if one is given.
    pub fn path(&mut self, key: &str, path: Option<&Path>) {
        let Some(path) = path else { return };
        if path.as_os_str().is_empty() {
            self.add(key, "is empty; leave the key out instead");
        } else if path.as_os_str().as_encoded_bytes().starts_with(b"~") {
            // A home folder is already in place of `~/`.
            let shown = path.display();
            let reason = format!(
                "`{shown}` is no path in a home folder: write `~/` for that, or `./{shown}` if it is really called so"
            );
            self.add(key, reason);
        } else if path.as_os_str().as_encoded_bytes().contains(&b'$') {
            let shown = path.display();
            let reason = format!(
                "`{shown}` has a `$`, but no variable is replaced in a path: write the path itself"
            );
            self.add(key, reason);
        }
    }
}
