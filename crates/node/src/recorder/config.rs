//! The `[record]` section of the configuration.

use albireo_service::config::Findings;
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
    /// Adds the errors in the section.
    pub(crate) fn check(&self, findings: &mut Findings) {
        findings.path("record.folder", self.folder.as_deref());
        findings.within("record.before_s", self.before_s, 0.0, 600.0);
        findings.within("record.after_s", self.after_s, 0.0, 3600.0);
        findings.within("record.max_gb", self.max_gb, 0.01, 100_000.0);
        findings.within("record.keep_days", self.keep_days, 0.01, 3650.0);
        if self.folder.is_none() && !self.when.is_empty() {
            let reason = "is set, but nothing is recorded without record.folder";
            findings.add("record.when", reason);
        }
    }

    /// The most bytes of all recordings.
    pub(crate) fn max_bytes(&self) -> u64 {
        (self.max_gb * 1e9) as u64
    }
}
