//! Defines the configuration sections that only a hub has.

use albireo_service::config::Findings;
use serde::{Deserialize, Serialize};

/// The fleet: the `[hub]` section.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HubSection {
    /// First part (or parts) of every key of its nodes.
    pub prefix: String,
}

impl Default for HubSection {
    fn default() -> Self {
        Self {
            prefix: "albireo".to_owned(),
        }
    }
}

/// The database that holds the history: the `[database]` section.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DatabaseConfig {
    /// `sqlite:FILE`, or `postgres://USER:PASSWORD@HOST/DATABASE`.
    pub url: String,
    /// Longest wait of a statement for a connection or a lock, milliseconds.
    pub timeout_ms: u64,
}

impl std::fmt::Debug for DatabaseConfig {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("DatabaseConfig")
            .field("url", &self.shown())
            .field("timeout_ms", &self.timeout_ms)
            .finish()
    }
}

impl Default for DatabaseConfig {
    fn default() -> Self {
        Self {
            url: "sqlite:albireo-hub.db".to_owned(),
            timeout_ms: 5_000,
        }
    }
}

impl DatabaseConfig {
    /// The URL without its password and parameters, which may contain a password too.
    pub fn shown(&self) -> String {
        let mut shown = self.url.clone();
        for secret in self.passwords() {
            shown = shown.replace(&format!(":{secret}@"), "@");
        }
        match shown.split_once('?') {
            Some((place, _)) if place.contains("://") => format!("{place}?***"),
            _ => shown,
        }
    }

    /// The passwords in the URL: the user's, and any in the parameters.
    pub(crate) fn passwords(&self) -> impl Iterator<Item = &str> {
        let of_user = password_of_user(&self.url);
        let (_place, parameters) = self.url.split_once('?').unwrap_or((&self.url, ""));
        let others = parameters.split('&').filter_map(|one| one.strip_prefix("password="));
        of_user.into_iter().chain(others)
    }

    pub(super) fn check(&self, findings: &mut Findings) {
        let fault = match self.url.split_once(':') {
            Some(("postgres" | "postgresql", place)) if place.starts_with("//") => {
                if !host_ends_in_password(&self.url) {
                    return;
                }
                "cannot be read: in the password, write @ as %40, / as %2F and # as %23"
            }
            Some(("sqlite", file)) if file.is_empty() || file.contains(":memory:") => {
                "names no file: acknowledged reports must survive a restart"
            }
            Some(("sqlite", _)) => return,
            _ => "must be sqlite:FILE or postgres://USER:PASSWORD@HOST/DATABASE",
        };
        findings.add("database.url", fault);
    }
}

/// The password in `postgres://USER:PASSWORD@HOST/DATABASE`.
fn password_of_user(url: &str) -> Option<&str> {
    let (_scheme, behind_scheme) = url.split_once("://")?;
    let (mut place, _parameters) = behind_scheme.split_once('?').unwrap_or((behind_scheme, ""));
    // A `?` of the password must be written as %3F. A password in which it is not must not be shown all the same.
    if !place.contains(['@', '/']) {
        place = behind_scheme;
    }
    let (login, _host) = place.rsplit_once('@')?;
    let (_user, password) = login.split_once(':')?;
    Some(password)
}

/// True if a `/` or `#` of the password ends what is read as the host: an `@` comes after it, and a further `/`.
fn host_ends_in_password(url: &str) -> bool {
    let Some((_scheme, behind_scheme)) = url.split_once("://") else {
        return false;
    };
    let (place, _parameters) = behind_scheme.split_once('?').unwrap_or((behind_scheme, ""));
    let Some((_host, behind_host)) = place.split_once(['/', '#']) else {
        return false;
    };
    // The name of a database may contain an `@`.
    behind_host.split_once('@').is_some_and(|(_, rest)| rest.contains('/'))
}

/// The commits and limits of incoming reports: the `[ingest]` section.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct IngestConfig {
    /// Shortest time between two commits, milliseconds: reports that arrive in between are committed together.
    pub commit_ms: u64,
    /// Bytes of reports that a node may send per day and camera; above the limit the hub refuses batches and says when
    /// to retry.
    pub camera_bytes_per_day: u64,
}

impl Default for IngestConfig {
    fn default() -> Self {
        Self {
            commit_ms: 100,
            camera_bytes_per_day: 10_000_000,
        }
    }
}

/// The times after which a node counts as silent or offline: the `[presence]` section.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PresenceConfig {
    /// A node that sent nothing for this long is silent, seconds.
    pub silent_after_s: f64,
    /// A node that sent nothing for this long is offline, seconds.
    pub offline_after_s: f64,
}

impl Default for PresenceConfig {
    fn default() -> Self {
        Self {
            silent_after_s: 95.0,
            offline_after_s: 600.0,
        }
    }
}

/// The retention of the history: the `[history]` section.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HistoryConfig {
    /// Days that individual clips are kept.
    pub clips_days: u32,
    /// Days that five-minute sums are kept. Hourly sums are kept for ever.
    pub five_minutes_days: u32,
    /// Days that events and revisions are kept.
    pub events_days: u32,
    /// Days that invalid reports are kept.
    pub set_aside_days: u32,
}

impl Default for HistoryConfig {
    fn default() -> Self {
        Self {
            clips_days: 14,
            five_minutes_days: 14,
            events_days: 90,
            set_aside_days: 90,
        }
    }
}

/// The hub's reaction when somebody at a node changes a value that the hub set.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LocalChange {
    /// The change stays, and the hub lists it as drift.
    #[default]
    Wins,
    /// The hub sets its value again.
    SetBack,
}

/// The time limit of desired settings, and the reaction to local changes: the `[tuning]` section.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TuningConfig {
    /// Time that a reachable node has to report a new value before it counts as timed out, seconds.
    pub apply_within_s: f64,
    /// The reaction to a change at the node.
    pub local_change: LocalChange,
}

impl Default for TuningConfig {
    fn default() -> Self {
        Self {
            apply_within_s: 60.0,
            local_change: LocalChange::Wins,
        }
    }
}
