//! The `[uplink]` section of the configuration: a separate session to the hub.

use super::Findings;
use super::endpoint::{EndpointUse, check_endpoints};
use crate::session;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Without a message for this long, the other side counts as lost. A keep-alive is sent every quarter of it, so a
/// metered link carries few of them.
const LEASE_MS: u64 = 120_000;

/// The connection of a node to its hub. Without `connect`, the `[zenoh]` session serves both.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UplinkConfig {
    /// Endpoints of the hub's router; the first reachable one is used: `tls/hub.example:7447`.
    pub connect: Vec<String>,
    /// Certificate of the authority that signed the router's certificate, for `tls/`.
    pub root_ca_certificate: Option<PathBuf>,
    /// This node's certificate, if the router requires one.
    pub certificate: Option<PathBuf>,
    /// Its private key.
    pub private_key: Option<PathBuf>,
    /// The longest pause between two attempts to reconnect to the router, milliseconds; by default 30,000: when a router
    /// returns, its fleet reconnects within half a minute, spread over that time. Not a setting.
    #[serde(skip)]
    pub retry_max_ms: Option<u64>,
    /// Declares a liveliness token. Useful for some thousand nodes, a burden with many more.
    pub liveliness: bool,
    /// Allows viewers at the hub to see the newest picture of a camera.
    pub pictures: bool,
}

impl UplinkConfig {
    /// The files named in the section, with their keys.
    pub fn files(&self) -> impl Iterator<Item = (&'static str, &Path)> {
        [
            ("uplink.root_ca_certificate", &self.root_ca_certificate),
            ("uplink.certificate", &self.certificate),
            ("uplink.private_key", &self.private_key),
        ]
        .into_iter()
        .filter_map(|(key, path)| Some((key, path.as_deref()?)))
    }

    /// True if there is a separate session.
    pub fn is_set(&self) -> bool {
        !self.connect.is_empty()
    }

    /// Converts to Zenoh's configuration; `first_retry` is drawn again for each session.
    ///
    /// # Errors
    /// The setting that Zenoh rejects, and why.
    pub(crate) fn to_zenoh(&self, first_retry: Duration) -> Result<::zenoh::Config, String> {
        let mut config = ::zenoh::Config::default();
        let first = u64::try_from(first_retry.as_millis()).unwrap_or(1000);
        let retry = json!({
            "period_init_ms": first,
            "period_max_ms": self.retry_max_ms.unwrap_or(30_000).max(first),
            "period_increase_factor": 2,
        });
        let tls = json!({
            "root_ca_certificate": self.root_ca_certificate,
            "connect_certificate": self.certificate,
            "connect_private_key": self.private_key,
            "enable_mtls": self.certificate.is_some(),
            "verify_name_on_connect": true,
        });
        let settings = [
            ("mode", json!("client")),
            ("connect/endpoints", json!(self.connect)),
            // One attempt: pauses and jitter are ours. Once open, Zenoh reconnects by itself.
            ("connect/timeout_ms", json!(0)),
            ("connect/retry", retry),
            ("scouting/multicast/enabled", json!(false)),
            ("scouting/gossip/enabled", json!(false)),
            // A link to another machine that carries a few kilobytes per minute needs no more.
            ("transport/link/tx/batch_size", json!(8192)),
            ("transport/link/rx/buffer_size", json!(8192)),
            ("transport/link/rx/max_message_size", json!(1 << 20)),
            ("transport/shared_memory/enabled", json!(false)),
            ("transport/link/tx/lease", json!(LEASE_MS)),
            ("transport/link/tls", tls),
        ];
        session::set(&mut config, &settings)?;
        Ok(config)
    }

    /// Adds the errors in the section.
    pub fn check(&self, findings: &mut Findings) {
        let usage = EndpointUse::Connect;
        check_endpoints("uplink.connect", &self.connect, usage, findings);
        for (key, file) in self.files() {
            findings.path(key, Some(file));
        }
        if self.certificate.is_some() != self.private_key.is_some() {
            findings.add(
                "uplink.private_key",
                "and uplink.certificate must be set together",
            );
        }
    }
}
