//! The configuration of a hub: one TOML file, overridden by environment variables, checked as a whole before anything
//! starts. Every key with its default is in `config/hub.toml`.

mod machine;
mod sections;
#[cfg(test)]
mod tests;

pub use sections::{
    DatabaseConfig, HistoryConfig, HubSection, IngestConfig, LocalChange, PresenceConfig,
    TuningConfig,
};

use albireo_service::config::{
    Configuration, DAY_S, Finding, Findings, HttpConfig, LogConfig, NamedToken, ZenohConfig,
    ZenohMode,
};
use albireo_service::identity::{exposed, exposed_files};
use albireo_wire::NodeKeys;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::Path;

/// Largest payload accepted from the network, bytes.
pub(crate) const MAX_PAYLOAD_BYTES: usize = 4 << 20;

/// All settings of a hub.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HubConfig {
    /// The fleet.
    pub hub: HubSection,
    /// The connection to Zenoh.
    pub zenoh: ZenohConfig,
    /// The HTTP interface.
    pub http: HttpConfig,
    /// The database that holds the history.
    pub database: DatabaseConfig,
    /// The commits and limits of incoming reports.
    pub ingest: IngestConfig,
    /// The times after which a node counts as silent or offline.
    pub presence: PresenceConfig,
    /// The retention of the history.
    pub history: HistoryConfig,
    /// The time limit of desired settings, and the reaction to local changes.
    pub tuning: TuningConfig,
    /// The log.
    pub log: LogConfig,
    /// Tokens of the HTTP interface in addition to `http.token`, one `[[token]]` each.
    #[serde(rename = "token")]
    pub tokens: Vec<NamedToken>,
}

impl Default for HubConfig {
    fn default() -> Self {
        Self {
            hub: HubSection::default(),
            // The ports differ from a node's, so that a node and a hub can run on one machine.
            zenoh: ZenohConfig {
                mode: ZenohMode::Router,
                listen: vec!["tcp/127.0.0.1:7448".to_owned()],
                ..ZenohConfig::default()
            },
            http: HttpConfig {
                listen: SocketAddr::from((Ipv4Addr::LOCALHOST, 8090)),
                ..HttpConfig::default()
            },
            database: DatabaseConfig::default(),
            ingest: IngestConfig::default(),
            presence: PresenceConfig::default(),
            history: HistoryConfig::default(),
            tuning: TuningConfig::default(),
            log: LogConfig::default(),
            tokens: Vec::new(),
        }
    }
}

impl HubConfig {
    /// Finds files with secrets that other users of this machine can read; `file` is the configuration's.
    pub fn exposed_here(&self, file: Option<&Path>) -> Vec<Finding> {
        let mut found = exposed_files(file, &self.http, &self.tokens, &self.zenoh);
        if self.database.passwords().next().is_some() {
            found.extend(file.and_then(|file| exposed("database.url", file)));
        }
        found
    }
}

impl Configuration for HubConfig {
    const SECTIONS: &'static [&'static str] = &[
        "HUB", "ZENOH", "HTTP", "DATABASE", "INGEST", "PRESENCE", "HISTORY", "TUNING", "LOG",
        "TOKEN",
    ];

    fn defaults() -> Value {
        let Self { zenoh, http, .. } = Self::default();
        json!({
            "zenoh": { "mode": zenoh.mode, "listen": zenoh.listen },
            "http": { "listen": http.listen },
        })
    }

    fn findings(&self) -> Vec<Finding> {
        let mut findings = Findings::default();
        findings.check("hub.prefix", NodeKeys::all(&self.hub.prefix));
        self.zenoh.check(&mut findings);
        self.http.check(&self.tokens, &mut findings);
        self.database.check(&mut findings);
        let ingest = &self.ingest;
        let presence = &self.presence;
        let history = &self.history;
        let timeout_ms = self.database.timeout_ms;
        let share = ingest.camera_bytes_per_day;
        findings.count("database.timeout_ms", timeout_ms, 100, 600_000);
        findings.count("ingest.commit_ms", ingest.commit_ms, 0, 10_000);
        findings.count("ingest.camera_bytes_per_day", share, 100_000, 1 << 40);
        for (key, days) in [
            ("history.clips_days", history.clips_days),
            ("history.five_minutes_days", history.five_minutes_days),
            ("history.events_days", history.events_days),
            ("history.set_aside_days", history.set_aside_days),
        ] {
            findings.count(key, days.into(), 1, 36_500);
        }
        let silent_s = presence.silent_after_s;
        let offline_s = presence.offline_after_s;
        findings.above_zero("presence.silent_after_s", silent_s, DAY_S);
        findings.above_zero("presence.offline_after_s", offline_s, 30.0 * DAY_S);
        if offline_s < silent_s {
            findings.add(
                "presence.offline_after_s",
                "is below presence.silent_after_s",
            );
        }
        let apply_s = self.tuning.apply_within_s;
        findings.above_zero("tuning.apply_within_s", apply_s, DAY_S);
        self.log.check(&mut findings);
        findings.0
    }
}
