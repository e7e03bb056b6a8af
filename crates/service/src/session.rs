//! Opens the Zenoh session a node, a hub or a tool talks through.

use super::config::ZenohConfig;
use anyhow::anyhow;
use std::time::Duration;
use tokio_util::sync::CancellationToken;
use zenoh::{Session, Wait};

/// The longest pause between two attempts of [`open_patiently`].
const LONGEST_PAUSE: Duration = Duration::from_secs(30);

/// Opens a session as configured. `max_payload_bytes` bounds what is taken from the network.
///
/// # Errors
/// When the configuration makes no sense to Zenoh, or an endpoint cannot be reached or listened on.
pub async fn open(config: &ZenohConfig, max_payload_bytes: usize) -> anyhow::Result<Session> {
    let zenoh = config
        .to_zenoh(max_payload_bytes)
        .map_err(|reason| anyhow!("[zenoh] {reason}"))?;
    zenoh::open(zenoh)
        .await
        .map_err(|error| not_opened(config, &error))
}

/// What [`open_patiently`] sets beyond the `[zenoh]` section: settings in Zenoh's own terms, as
/// `("transport/link/tx/lease", "60000")`.
pub type Settings<'a> = &'a [(&'a str, &'a str)];

/// Opens a session as [`open`] does, with more settings, on a thread of its own (opening may block for seconds), and
/// tries again until it is open: a router that is not there yet is no reason to end. Each failure is given to
/// `failed`. `None` when `shutdown` is cancelled first.
///
/// # Errors
/// When the configuration makes no sense to Zenoh: that does not pass by itself.
pub async fn open_patiently(
    config: &ZenohConfig,
    max_payload_bytes: usize,
    settings: Settings<'_>,
    shutdown: &CancellationToken,
    mut failed: impl FnMut(&anyhow::Error),
) -> anyhow::Result<Option<Session>> {
    let mut zenoh = config
        .to_zenoh(max_payload_bytes)
        .map_err(|reason| anyhow!("[zenoh] {reason}"))?;
    for (key, value) in settings {
        zenoh
            .insert_json5(key, value)
            .map_err(|error| anyhow!("[zenoh] {key} = {value}: {error}"))?;
    }
    let mut pause = Duration::from_millis(500);
    loop {
        let attempt = zenoh.clone();
        let opening = tokio::task::spawn_blocking(move || zenoh::open(attempt).wait());
        let opened = tokio::select! {
            opened = opening => opened,
            () = shutdown.cancelled() => return Ok(None),
        };
        let error = match opened {
            Ok(Ok(session)) => return Ok(Some(session)),
            Ok(Err(error)) => not_opened(config, &error),
            Err(error) => anyhow!("opening the Zenoh session failed: {error}"),
        };
        failed(&error);
        tokio::select! {
            () = tokio::time::sleep(pause) => {}
            () = shutdown.cancelled() => return Ok(None),
        }
        pause = (pause * 2).min(LONGEST_PAUSE);
    }
}

fn not_opened(config: &ZenohConfig, error: &zenoh::Error) -> anyhow::Error {
    let place = match &config.config_file {
        Some(file) => format!("configuration file {}", file.display()),
        None => format!("listen {:?}, connect {:?}", config.listen, config.connect),
    };
    anyhow!("Zenoh session not opened ({place}): {error}")
}
