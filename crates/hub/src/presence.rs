//! The state of each node, judged by the age of its last status, its health and, if configured, its liveliness token.

mod entry;
mod fleet;
mod node;
mod tables;
#[cfg(test)]
mod tests;
mod today;

pub use fleet::Fleet;
#[cfg(test)]
pub(crate) use node::tests::reported;
pub use node::{NodeView, PresenceState};
pub use today::TodaysEnergy;
pub(crate) use today::follow_today;
