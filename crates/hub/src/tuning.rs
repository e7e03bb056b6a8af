//! Tuning the fleet: a value for selected nodes, changes in stages that are gated on what is measured, comparisons of
//! values on random groups.
//!
//! What decides is pure: [`selector`], [`gate`], [`rollout`], [`trial`] know neither clock nor network nor database.

pub mod desired;
pub mod gate;
pub mod members;
pub mod metric;
pub mod rollout;
pub mod selector;
pub mod statistics;
pub mod trial;
