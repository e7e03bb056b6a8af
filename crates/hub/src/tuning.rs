//! Tuning the fleet: a value for selected nodes, changes in stages that are gated on what is measured, comparisons of
//! values on random groups.
//!
//! What decides is pure: [`selector`], [`gate`], [`rollout`], [`trial`] know neither clock nor network nor database.

pub mod change;
pub mod effect;
pub mod gate;
pub mod members;
pub mod metric;
pub mod rollout;
pub mod runs;
pub mod selector;
mod task;
pub mod trial;
pub mod tuner;

pub(crate) use task::follow;
pub use tuner::Tuner;
