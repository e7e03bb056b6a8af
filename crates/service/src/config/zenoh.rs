//! The `[zenoh]` section of the configuration.

use super::Findings;
use super::endpoint::{EndpointUse, check_endpoints};
use crate::{identity, session};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::PathBuf;

/// A node's role in Zenoh: `peer` connects directly to others and through routers, `client` through one router,
/// `router` also routes for others.
pub use ::zenoh::config::WhatAmI as ZenohMode;

/// A node's connection to Zenoh.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ZenohConfig {
    /// The role.
    pub mode: ZenohMode,
    /// Endpoints to connect to: `tcp/router.example:7447`.
    pub connect: Vec<String>,
    /// Endpoints to listen on.
    pub listen: Vec<String>,
    /// Looks for others on the local network by multicast.
    pub multicast_scouting: bool,
    /// Allows a program on this machine to place its frames in memory that the node reads in place. Zenoh never returns
    /// that memory: each session that ends leaves some MB allocated.
    pub shared_memory: bool,
    /// A Zenoh configuration file (JSON5). If set, the other keys of this section are ignored.
    pub config_file: Option<PathBuf>,
}

impl Default for ZenohConfig {
    fn default() -> Self {
        Self {
            mode: ZenohMode::Peer,
            connect: Vec::new(),
            listen: vec!["tcp/127.0.0.1:7447".to_owned()],
            multicast_scouting: false,
            shared_memory: false,
            config_file: None,
        }
    }
}

impl ZenohConfig {
    /// Converts to Zenoh's configuration. `max_payload_bytes` limits what is accepted from the network:
    /// Zenoh's own limit is 1 GiB.
    ///
    /// # Errors
    /// The setting that Zenoh rejects, and why.
    pub(crate) fn to_zenoh(&self, max_payload_bytes: usize) -> Result<::zenoh::Config, String> {
        if let Some(file) = &self.config_file {
            return ::zenoh::Config::from_file(file)
                .map_err(|error| format!("config_file {}: {error}", file.display()));
        }
        let mut config = ::zenoh::Config::default();
        // Zenoh silently drops messages above its own limit. With a limit above ours, an oversized frame arrives
        // here and is counted.
        let largest = max_payload_bytes
            .saturating_mul(8)
            .min(256 << 20)
            .max(max_payload_bytes)
            .saturating_add(64 << 10);
        let settings = [
            ("mode", json!(self.mode)),
            ("connect/endpoints", json!(self.connect)),
            ("listen/endpoints", json!(self.listen)),
            ("scouting/multicast/enabled", json!(self.multicast_scouting)),
            ("transport/shared_memory/enabled", json!(self.shared_memory)),
            // Reads what others place in shared memory, but sends the node's own data as bytes: Zenoh's own placing of
            // large payloads can lose a race (eclipse-zenoh/zenoh#2628).
            (
                "transport/shared_memory/transport_optimization/enabled",
                json!(false),
            ),
            ("transport/link/rx/max_message_size", json!(largest)),
        ];
        session::set(&mut config, &settings)?;
        Ok(config)
    }

    /// The files of a kind, `certificate` or `private_key`, that the configuration file of Zenoh names. None if it cannot be
    /// read, which the session reports.
    pub fn tls_files(&self, kind: &str) -> Vec<(String, PathBuf)> {
        let Some(file) = &self.config_file else {
            return Vec::new();
        };
        match ::zenoh::Config::from_file(file) {
            Ok(config) => identity::tls_files(&config, kind),
            Err(_) => Vec::new(),
        }
    }

    /// Adds the errors in the section.
    pub fn check(&self, findings: &mut Findings) {
        check_endpoints(
            "zenoh.connect",
            &self.connect,
            EndpointUse::Connect,
            findings,
        );
        check_endpoints("zenoh.listen", &self.listen, EndpointUse::Listen, findings);
        findings.path("zenoh.config_file", self.config_file.as_deref());
        let finds_none = self.connect.is_empty() && !self.multicast_scouting;
        if self.config_file.is_none() && self.mode == ZenohMode::Client && finds_none {
            findings.add(
                "zenoh.connect",
                "is empty: a client needs a router to connect to (or multicast_scouting = true)",
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endpoints_are_checked_for_what_they_are_used_for() {
        let endpoints: Vec<_> = ["tcp/hub:0", "tcp/hub:99999"].map(str::to_owned).into();
        let zenoh = ZenohConfig {
            connect: endpoints.clone(),
            listen: endpoints,
            ..ZenohConfig::default()
        };
        let mut findings = Findings::default();
        zenoh.check(&mut findings);
        let keys: Vec<_> = findings.0.iter().map(|finding| finding.key.as_str()).collect();
        assert_eq!(keys, ["zenoh.connect", "zenoh.connect", "zenoh.listen"]);
    }

    #[test]
    fn the_default_section_is_valid_and_a_missing_file_is_named() {
        let mut zenoh = ZenohConfig::default();
        zenoh.to_zenoh(1 << 20).unwrap();
        zenoh.config_file = Some("/nowhere/zenoh.json5".into());
        assert!(zenoh.to_zenoh(1 << 20).unwrap_err().contains("/nowhere"));
    }
}
