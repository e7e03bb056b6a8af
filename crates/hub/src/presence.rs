//! The state of each node, judged by the age of its last status, its health and, if configured, its liveliness token.

mod entry;
mod fleet;
mod listen;
mod news;
mod node;
mod state;
#[cfg(test)]
mod tests;
mod today;

pub use fleet::{Fleet, FleetTallies};
pub use listen::Notifier;
pub(crate) use listen::listen;
pub use news::News;
pub use node::NodeView;
#[cfg(test)]
pub(crate) use node::tests::reported;
pub use state::PresenceState;
pub use today::TodaysEnergy;
