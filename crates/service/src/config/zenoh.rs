//! The `[zenoh]` section of the configuration.

use super::Findings;
use ::zenoh::config::EndPoint;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The part a node plays among Zenoh's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ZenohMode {
    /// Talks to others directly, and through routers.
    #[default]
    Peer,
    /// Talks through one router.
    Client,
    /// Routes for others too.
    Router,
}

impl ZenohMode {
    /// The name in Zenoh's own configuration.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Peer => "peer",
            Self::Client => "client",
            Self::Router => "router",
        }
    }
}

/// How a node reaches Zenoh.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ZenohConfig {
    /// Its part.
    pub mode: ZenohMode,
    /// Endpoints to connect to: `tcp/router.example:7447`.
    pub connect: Vec<String>,
    /// Endpoints to listen on.
    pub listen: Vec<String>,
    /// Whether to look for others on the local network by multicast.
    pub multicast_scouting: bool,
    /// Whether a program on this machine may place its frames in memory that the node reads in place. Zenoh never gives
    /// that memory back: each session that comes and goes leaves some MB.
    pub shared_memory: bool,
    /// A Zenoh configuration file (JSON5). When it is given, the other keys of this section are not used.
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
    /// The same in Zenoh's own terms. `max_payload_bytes` bounds what is taken from the network:
    /// Zenoh's own bound is 1 GiB.
    ///
    /// # Errors
    /// What Zenoh does not accept, in words.
    pub(crate) fn to_zenoh(&self, max_payload_bytes: usize) -> Result<::zenoh::Config, String> {
        if let Some(file) = &self.config_file {
            return ::zenoh::Config::from_file(file)
                .map_err(|error| format!("config_file {}: {error}", file.display()));
        }
        let mut config = ::zenoh::Config::default();
        let mut insert = |key: &str, value: serde_json::Value| {
            config
                .insert_json5(key, &value.to_string())
                .map_err(|error| format!("{key} = {value}: {error}"))
        };
        insert("mode", self.mode.as_str().into())?;
        insert("connect/endpoints", self.connect.clone().into())?;
        insert("listen/endpoints", self.listen.clone().into())?;
        insert("scouting/multicast/enabled", self.multicast_scouting.into())?;
        insert("transport/shared_memory/enabled", self.shared_memory.into())?;
        // What others place is read; what the node itself sends goes as bytes: Zenoh's own placing of what is large can
        // lose a race (eclipse-zenoh/zenoh#2628).
        insert(
            "transport/shared_memory/transport_optimization/enabled",
            false.into(),
        )?;
        // Zenoh drops what is above its own bound without a word: with room above ours, a frame that is too large
        // comes this far and is counted.
        let largest = max_payload_bytes
            .saturating_mul(8)
            .min(256 << 20)
            .max(max_payload_bytes)
            .saturating_add(64 << 10);
        insert("transport/link/rx/max_message_size", largest.into())?;
        Ok(config)
    }

    /// Notes what is wrong with the section, called `section` in the file.
    pub fn check(&self, section: &str, max_payload_bytes: usize, findings: &mut Findings) {
        let key = |name: &str| format!("{section}.{name}");
        let before = findings.len();
        for (name, endpoints) in [
            (key("connect"), &self.connect),
            (key("listen"), &self.listen),
        ] {
            check_endpoints(&name, endpoints, findings);
        }
        findings.path(&key("config_file"), self.config_file.as_deref());
        if findings.len() == before
            && self.config_file.is_none()
            && let Err(error) = self.to_zenoh(max_payload_bytes)
        {
            findings.add(section, error);
        }
        if self.mode == ZenohMode::Client
            && self.connect.is_empty()
            && self.config_file.is_none()
            && !self.multicast_scouting
        {
            findings.add(
                key("connect"),
                "is empty: a client needs a router to connect to (or multicast_scouting = true)",
            );
        }
    }
}

/// Transports that are compiled in.
const TRANSPORTS: [&str; 4] = ["tcp", "tls", "udp", "unixsock-stream"];

/// Notes endpoints that Zenoh cannot read or this program cannot open.
pub(super) fn check_endpoints(key: &str, endpoints: &[String], findings: &mut Findings) {
    for endpoint in endpoints {
        match endpoint.parse::<EndPoint>() {
            Err(error) => findings.add(
                key,
                format!("`{endpoint}` is no endpoint such as `tcp/127.0.0.1:7447`: {error}"),
            ),
            Ok(parsed) => {
                let transport = parsed.protocol().as_str().to_owned();
                if !TRANSPORTS.contains(&transport.as_str()) {
                    findings.add(
                        key,
                        format!(
                            "`{endpoint}`: transport `{transport}` is not built in; there are {}",
                            TRANSPORTS.join(", ")
                        ),
                    );
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_endpoint_whose_transport_is_not_built_in_is_refused_in_words() {
        let endpoints = [
            "quic/hub:1",
            "ws/hub:1",
            "serial/dev/tty",
            "tls/hub:1",
            "tcp/hub:1",
        ];
        let zenoh = ZenohConfig {
            connect: endpoints.map(str::to_owned).to_vec(),
            ..ZenohConfig::default()
        };
        let mut findings = Findings::default();
        zenoh.check("zenoh", 1 << 20, &mut findings);
        let findings = findings.into_vec();
        assert_eq!(findings.len(), 3, "{findings:?}");
        assert!(
            findings[0].to_string().contains("`quic` is not built in"),
            "{}",
            findings[0]
        );
    }

    #[test]
    fn the_section_is_something_zenoh_understands() {
        let mut zenoh = ZenohConfig::default();
        zenoh.to_zenoh(1 << 20).unwrap();
        zenoh.config_file = Some("/nowhere/zenoh.json5".into());
        assert!(zenoh.to_zenoh(1 << 20).unwrap_err().contains("/nowhere"));
    }
}
