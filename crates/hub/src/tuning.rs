//! Tuning the fleet: a value for selected nodes, changes in stages that are gated on what is measured, comparisons of
//! values on random groups.
//!
//! What decides is pure: [`selector`], [`gate`] and [`run`] know neither clock nor network nor database.

pub mod change;
pub mod effect;
pub mod gate;
pub mod member;
pub mod metric;
pub mod plan;
pub mod run;
pub mod runs;
pub mod selector;
pub mod tuner;

pub use tuner::Tuner;
pub(crate) use tuner::follow;
