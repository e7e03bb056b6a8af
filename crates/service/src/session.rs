//! Opens the Zenoh session a node or a tool talks through.

use super::config::ZenohConfig;
use anyhow::anyhow;
use zenoh::Session;

/// Opens a session as configured. `max_payload_bytes` bounds what is taken from the network.
///
/// # Errors
/// When the configuration makes no sense to Zenoh, or an endpoint cannot be reached or listened on.
pub async fn open(config: &ZenohConfig, max_payload_bytes: usize) -> anyhow::Result<Session> {
    let zenoh = config
        .to_zenoh(max_payload_bytes)
        .map_err(|reason| anyhow!("[zenoh] {reason}"))?;
    zenoh::open(zenoh).await.map_err(|error| {
        let place = match &config.config_file {
            Some(file) => format!("configuration file {}", file.display()),
            None => format!("listen {:?}, connect {:?}", config.listen, config.connect),
        };
        anyhow!("Zenoh session not opened ({place}): {error}")
    })
}
