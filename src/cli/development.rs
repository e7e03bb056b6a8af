//! Changes constants of a node for tests, only in builds with the feature `development`. The variable
//! `ALBIREO_DEVELOPMENT` contains them as `name=value`, separated by white space.

use albireo_node::config::NodeConfig;
use anyhow::{Context, bail};
use std::time::Duration;

/// Sets the constants in the variable in `config`.
pub(super) fn apply(config: &mut NodeConfig) -> anyhow::Result<()> {
    let constants = std::env::var("ALBIREO_DEVELOPMENT").unwrap_or_default();
    for pair in constants.split_whitespace() {
        set(config, pair).with_context(|| format!("ALBIREO_DEVELOPMENT: {pair}"))?;
    }
    Ok(())
}

fn set(config: &mut NodeConfig, pair: &str) -> anyhow::Result<()> {
    let (name, value) = pair.split_once('=').context("is not name=value")?;
    match name {
        "sysfs" => config.power.sysfs = value.into(),
        "nvpmodel" => config.power.nvpmodel = value.into(),
        "stop_timeout_s" => {
            config.node.stop_timeout = Duration::from_secs(value.parse()?);
        }
        "retry_min_ms" => config.outbox.retry_min_ms = value.parse()?,
        "retry_max_ms" => config.outbox.retry_max_ms = value.parse()?,
        "answer_timeout_ms" => config.outbox.answer_timeout_ms = value.parse()?,
        "reconnect_max_ms" => config.uplink.retry_max_ms = Some(value.parse()?),
        "ring" => {
            let ring = value.parse()?;
            for camera in &mut config.cameras {
                camera.ring = ring;
            }
        }
        _ => bail!("is not a constant that tests change"),
    }
    Ok(())
}
