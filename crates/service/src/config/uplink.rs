//! The `[uplink]` section of the configuration: a separate session to the hub.

use super::Findings;
use super::zenoh::check_endpoints;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// After this long without a message the other side counts as lost. A keep-alive goes every quarter of it, so a metered
/// link carries few of them.
const LEASE_MS: u64 = 120_000;

/// How a node reaches its hub. Without `connect` the session of `[zenoh]` serves both.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UplinkConfig {
    /// Endpoints of the hub's router, the first that can be reached: `tls/hub.example:7447`.
    pub connect: Vec<String>,
    /// Certificate of the authority that signed the router's, for `tls/`.
    pub root_ca_certificate: Option<PathBuf>,
    /// This node's certificate, where the router asks for one.
    pub certificate: Option<PathBuf>,
    /// Its private key.
    pub private_key: Option<PathBuf>,
    /// Longest pause between two attempts to reach the router again, milliseconds. No setting: a fleet whose router
    /// was away comes back within half a minute, spread over it.
    #[serde(skip)]
    pub retry_max_ms: u64,
    /// Whether to declare a liveliness token. A help for some thousand nodes, a burden for many more.
    pub liveliness: bool,
    /// Whether those who watch the node through the hub may see the newest picture of a camera.
    pub pictures: bool,
}

impl Default for UplinkConfig {
    fn default() -> Self {
        Self {
            connect: Vec::new(),
            root_ca_certificate: None,
            certificate: None,
            private_key: None,
            retry_max_ms: 30_000,
            liveliness: false,
            pictures: false,
        }
    }
}

impl UplinkConfig {
    /// The files that the section names, with their keys.
    pub fn files(&self) -> impl Iterator<Item = (&'static str, &Path)> {
        [
            ("uplink.root_ca_certificate", &self.root_ca_certificate),
            ("uplink.certificate", &self.certificate),
            ("uplink.private_key", &self.private_key),
        ]
        .into_iter()
        .filter_map(|(key, path)| Some((key, path.as_deref()?)))
    }

    /// Whether there is a separate session.
    pub fn is_set(&self) -> bool {
        !self.connect.is_empty()
    }

    /// The same in Zenoh's own terms; `first_retry` is drawn again for each session.
    ///
    /// # Errors
    /// What Zenoh does not accept, in words.
    pub(crate) fn to_zenoh(&self, first_retry: Duration) -> Result<::zenoh::Config, String> {
        let mut config = ::zenoh::Config::default();
        let mut insert = |key: &str, value: serde_json::Value| {
            config
                .insert_json5(key, &value.to_string())
                .map_err(|error| format!("{key}: {error}"))
        };
        insert("mode", "client".into())?;
        insert("connect/endpoints", self.connect.clone().into())?;
        // One attempt: pauses and jitter are ours. Once open, Zenoh connects again by itself.
        insert("connect/timeout_ms", 0.into())?;
        let first = u64::try_from(first_retry.as_millis())
            .unwrap_or(1000)
            .max(1);
        let retry = serde_json::json!({
            "period_init_ms": first,
            "period_max_ms": self.retry_max_ms.max(first),
            "period_increase_factor": 2,
        });
        insert("connect/retry", retry)?;
        insert("scouting/multicast/enabled", false.into())?;
        insert("scouting/gossip/enabled", false.into())?;
        // A link that carries a few kilobytes a minute needs no more.
        insert("transport/link/tx/batch_size", 8192.into())?;
        insert("transport/link/rx/buffer_size", 8192.into())?;
        insert("transport/link/rx/max_message_size", (1 << 20).into())?;
        // A few kilobytes a minute, to another machine.
        insert("transport/shared_memory/enabled", false.into())?;
        insert("transport/link/tx/lease", LEASE_MS.into())?;
        let mut tls = serde_json::Map::new();
        for (key, file) in [
            ("root_ca_certificate", &self.root_ca_certificate),
            ("connect_certificate", &self.certificate),
            ("connect_private_key", &self.private_key),
        ] {
            if let Some(file) = file {
                tls.insert(key.to_owned(), file.display().to_string().into());
            }
        }
        if !tls.is_empty() {
            tls.insert("enable_mtls".to_owned(), self.certificate.is_some().into());
            tls.insert("verify_name_on_connect".to_owned(), true.into());
            insert("transport/link/tls", tls.into())?;
        }
        Ok(config)
    }

    /// Notes what is wrong with the section, called `section` in the file.
    pub fn check(&self, section: &str, findings: &mut Findings) {
        let key = |name: &str| format!("{section}.{name}");
        check_endpoints(&key("connect"), &self.connect, findings);
        for (name, file) in [
            ("root_ca_certificate", &self.root_ca_certificate),
            ("certificate", &self.certificate),
            ("private_key", &self.private_key),
        ] {
            findings.path(&key(name), file.as_deref());
        }
        if self.certificate.is_some() != self.private_key.is_some() {
            findings.add(
                key("private_key"),
                "and certificate belong together: name both, or neither",
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_section_is_something_zenoh_understands() {
        let uplink = UplinkConfig {
            connect: vec!["tls/hub.example:7447".to_owned()],
            root_ca_certificate: Some("ca.pem".into()),
            certificate: Some("node.pem".into()),
            private_key: Some("node.key".into()),
            ..UplinkConfig::default()
        };
        uplink.to_zenoh(Duration::from_millis(700)).unwrap();
        let mut findings = Findings::default();
        uplink.check("uplink", &mut findings);
        assert!(findings.is_empty());
    }
}
