//! Tells others what the cameras see: HTTP hooks when a class appears or leaves, and an MQTT broker.

mod address;
mod config;
mod connection;
mod discovery;
mod hook;
mod mailbox;
mod mqtt;

pub use config::{HookConfig, MqttConfig};
pub(crate) use hook::Hook;
pub(crate) use mqtt::{Mqtt, MqttSetup};
