//! The state of each node, judged by the age of its last status, its health and, if configured, its liveliness token.

mod entry;
mod fleet;
mod listen;
mod node;
#[cfg(test)]
mod tests;
mod today;

pub use fleet::Fleet;
pub(crate) use listen::{listen, send_notices, watch};
#[cfg(test)]
pub(crate) use node::tests::reported;
pub use node::{NodeView, PresenceState};
pub use today::TodaysEnergy;
pub(crate) use today::follow_today;
