//! The errors in a configuration: the source, the key, and the reason.

use std::ffi::OsStr;
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
        } else if names_variable(path) && !path.exists() {
            let shown = path.display();
            let reason = format!(
                "`{shown}` has a `$`, but no variable is replaced in a path: write the path itself"
            );
            self.add(key, reason);
        }
    }
}

/// True if a part of a path begins like a variable of a shell.
fn names_variable(path: &Path) -> bool {
    let begins_so = |part: &OsStr| match part.as_encoded_bytes() {
        [b'$', b'{' | b'_', ..] => true,
        [b'$', letter, ..] => letter.is_ascii_alphabetic(),
        _ => false,
    };
    path.iter().any(begins_so)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_that_is_there_or_only_has_a_dollar_is_no_variable() {
        let folder = tempfile::tempdir().unwrap();
        let is_accepted = |path: &str| {
            let mut findings = Findings::default();
            findings.path("node.state_dir", Some(Path::new(path)));
            findings.0.is_empty()
        };
        for path in ["models$/x", "//nas/share$/x", "/srv/$", "a$HOME", "$1/x"] {
            assert!(is_accepted(path), "{path}");
        }
        for path in ["$HOME/x", "/srv/${NOBODY_SETS_THIS}/x", "state/$_nothing"] {
            assert!(!is_accepted(path), "{path}");
        }
        let there = folder.path().join("$RECYCLE.BIN");
        std::fs::create_dir(&there).unwrap();
        assert!(is_accepted(there.to_str().unwrap()));
    }
}
