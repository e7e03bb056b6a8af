//! The target of a node: held by a controller that moves the knob of all its cameras together.

mod config;
mod held;
mod service;
mod task;
#[cfg(test)]
mod tests;

pub use config::TargetConfig;
pub use held::{NodeTarget, TargetSetup};
pub(crate) use service::TargetKey;
pub(crate) use task::TargetTask;
