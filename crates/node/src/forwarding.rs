//! Tells others what the cameras see: hooks, which post or record when a class appears or leaves, and an MQTT broker.

mod address;
mod config;
mod discovery;
mod hook;
mod mailbox;
mod mqtt;
mod record;

pub use config::{HookConfig, MqttConfig};
pub(crate) use hook::Hook;
pub(crate) use mqtt::{Mqtt, MqttSetup};
pub(crate) use record::record_sightings;

/// The first pause between attempts to reach a hook or a broker, milliseconds.
const FIRST_PAUSE_MS: u64 = 1000;
/// The longest of these pauses, milliseconds.
const LONGEST_PAUSE_MS: u64 = 60_000;
