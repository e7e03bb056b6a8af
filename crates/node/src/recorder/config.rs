//! The `[record]` section of the configuration.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What begins a recording by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Occasion {
    /// Every frame is recorded.
    Always,
    /// The audit found a difference between the boxes shown and those of the detector.
    Audit,
}

/// The settings of recordings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecordConfig {
    /// Folder of the recordings; nothing is recorded without it.
    pub folder: Option<PathBuf>,
    /// What begins a recording, besides requests.
    pub when: Vec<Occasion>,
    /// Seconds kept before an event.
    pub before_s: f64,
    /// Seconds kept after it.
    pub after_s: f64,
    /// The most that all recordings take on the disk, gigabytes.
    pub max_gb: f64,
    /// Days after which a recording is deleted.
    pub keep_days: f64,
}

impl Default for RecordConfig {
    fn default() -> Self {
        Self {
            folder: None,
            when: Vec::new(),
            before_s: 10.0,
            after_s: 10.0,
            max_gb: 2.0,
            keep_days: 14.0,
        }
    }
}

impl RecordConfig {
    /// What is wrong: the key and the reason.
    pub(crate) fn problems(&self) -> Vec<(&'static str, String)> {
        let mut problems = Vec::new();
        for (key, value, least, most) in [
            ("before_s", self.before_s, 0.0, 600.0),
            ("after_s", self.after_s, 0.0, 3600.0),
            ("max_gb", self.max_gb, 0.01, 100_000.0),
            ("keep_days", self.keep_days, 0.01, 3650.0),
        ] {
            if !(least..=most).contains(&value) {
                let reason = format!("must be from {least} to {most}, not {value}");
                problems.push((key, reason));
            }
        }
        if self.folder.is_none() && !self.when.is_empty() {
            let reason = "is set, but nothing is recorded without record.folder";
            problems.push(("when", reason.to_owned()));
        }
        problems
    }

    /// The most bytes of all recordings.
    pub(crate) fn max_bytes(&self) -> u64 {
        (self.max_gb * 1e9) as u64
    }
}
