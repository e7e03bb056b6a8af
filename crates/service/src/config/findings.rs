//! Collects errors in the values of a configuration, beyond their types.

use super::Finding;
use std::fmt::Display;
use std::path::Path;

/// Seconds per day: longer timeouts and windows are mistakes.
pub const DAY_S: f64 = 86_400.0;

/// Collects errors.
#[derive(Debug, Default)]
pub struct Findings(Vec<Finding>);

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
        checked
            .map_err(|error| self.add(key, error.to_string()))
            .ok()
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

    /// Requires a value from `low` to `high`.
    pub fn count(&mut self, key: &str, value: u64, low: u64, high: u64) {
        if !(low..=high).contains(&value) {
            self.add(key, format!("must be from {low} to {high}, not {value}"));
        }
    }

    /// Requires a non-empty path, if one is given.
    pub fn path(&mut self, key: &str, path: Option<&Path>) {
        if path.is_some_and(|path| path.as_os_str().is_empty()) {
            self.add(key, "is empty; leave the key out instead");
        }
    }

    /// All errors, in the order in which they were added.
    pub fn into_vec(self) -> Vec<Finding> {
        self.0
    }
}
