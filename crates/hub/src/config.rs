//! The configuration of a hub: one TOML file, overridden by environment variables, checked as a whole before anything
//! starts. Every key with its default is in `config/hub.toml`.

mod sections;
#[cfg(test)]
mod tests;
mod tuning;

pub use sections::{DatabaseConfig, HistoryConfig, HubSection, IngestConfig, PresenceConfig};
pub use tuning::{LocalChange, TuningConfig};

use albireo_service::config::{
    Configuration, Finding, Findings, HttpConfig, LogConfig, NamedToken, ZenohConfig, ZenohMode,
};
use albireo_wire::NodeKeys;
use serde::de::{DeserializeOwned, Deserializer, Error as _};
use serde::{Deserialize, Serialize};
use std::net::{Ipv4Addr, SocketAddr};

/// Largest payload accepted from the network, bytes.
pub(crate) const MAX_PAYLOAD_BYTES: usize = 4 << 20;

/// All settings of a hub.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HubConfig {
    /// The fleet.
    pub hub: HubSection,
    /// The connection to Zenoh.
    #[serde(deserialize_with = "zenoh_section")]
    pub zenoh: ZenohConfig,
    /// The HTTP interface.
    #[serde(deserialize_with = "http_section")]
    pub http: HttpConfig,
    /// The database that holds the history.
    pub database: DatabaseConfig,
    /// The commits and limits of incoming reports.
    pub ingest: IngestConfig,
    /// The times after which a node counts as silent or offline.
    pub presence: PresenceConfig,
    /// The retention of the history.
    pub history: HistoryConfig,
    /// The time limit of orders, and the reaction to local changes.
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
            zenoh: default_zenoh(),
            http: default_http(),
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

/// The port differs from a node's default, so that a node and a hub can run on one machine.
fn default_zenoh() -> ZenohConfig {
    ZenohConfig {
        mode: ZenohMode::Router,
        listen: vec!["tcp/127.0.0.1:7448".to_owned()],
        // The nodes are on other machines.
        shared_memory: false,
        ..ZenohConfig::default()
    }
}

fn default_http() -> HttpConfig {
    HttpConfig {
        listen: SocketAddr::from((Ipv4Addr::LOCALHOST, 8090)),
        ..HttpConfig::default()
    }
}

fn zenoh_section<'de, D: Deserializer<'de>>(deserializer: D) -> Result<ZenohConfig, D::Error> {
    over(&default_zenoh(), deserializer)
}

fn http_section<'de, D: Deserializer<'de>>(deserializer: D) -> Result<HttpConfig, D::Error> {
    over(&default_http(), deserializer)
}

/// Reads a section in which absent keys get the hub's `defaults` instead of the section type's.
fn over<'de, T, D>(defaults: &T, deserializer: D) -> Result<T, D::Error>
where
    T: Serialize + DeserializeOwned,
    D: Deserializer<'de>,
{
    let given = serde_json::Map::deserialize(deserializer)?;
    let mut section = serde_json::to_value(defaults).map_err(D::Error::custom)?;
    if let Some(section) = section.as_object_mut() {
        section.extend(given);
    }
    serde_json::from_value(section).map_err(D::Error::custom)
}

impl HubConfig {
    /// The keys of all nodes of the fleet.
    ///
    /// # Errors
    /// When the prefix is invalid, which the configuration's check rules out.
    pub(crate) fn keys(&self) -> Result<NodeKeys, albireo_wire::KeyError> {
        NodeKeys::all(&self.hub.prefix)
    }
}

impl Configuration for HubConfig {
    const SECTIONS: &'static [&'static str] = &[
        "HUB", "ZENOH", "HTTP", "DATABASE", "INGEST", "PRESENCE", "HISTORY", "TUNING", "LOG",
        "TOKEN",
    ];

    const REMOVED: &'static str = "\
http.timeout_ms: a request may take 10 s
http.idle_timeout_ms: a connection that is silent for 30 s is closed
http.max_connections: 256 connections may be open at a time
tuning.set_back_times: a node is set back at most three times
database.readers: four connections are open for reading
ingest.busy_after_ms: a batch that would wait longer than 3 s is answered \"busy\"
ingest.busy_retry_ms: a node that is answered \"busy\" retries after 2 s";

    fn findings(&self) -> Vec<Finding> {
        let mut findings = Findings::default();
        if let Err(error) = NodeKeys::all(&self.hub.prefix) {
            findings.add("hub.prefix", error.to_string());
        }
        self.zenoh.check(&mut findings);
        self.http.check(&self.tokens, &mut findings);
        self.database.check(&mut findings);
        self.ingest.check(&mut findings);
        self.presence.check(&mut findings);
        self.history.check(&mut findings);
        self.tuning.check(&mut findings);
        self.log.check(&mut findings);
        findings.into_vec()
    }
}
