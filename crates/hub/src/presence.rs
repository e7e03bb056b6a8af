//! Which nodes are there and how they are: by the freshness of their status, their health, and, where it is to be had,
//! the liveliness token.

mod entry;
mod fleet;
mod listen;
mod news;
mod state;
#[cfg(test)]
mod tests;
mod today;

pub(crate) use fleet::Remembered;
pub use fleet::{Fleet, FleetTallies, NodeView};
pub use listen::ListenCounters;
pub(crate) use listen::{ListenSetup, Notifier, listen};
pub(crate) use news::News;
pub use state::{Facts, Limits, PresenceState, Token, judge};
pub use today::TodaysEnergy;
pub(crate) use today::{Used, day_of};
