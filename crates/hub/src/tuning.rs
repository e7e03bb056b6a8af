//! Tunes the fleet: desired settings of selected nodes, rollouts in stages with gates on measured figures, and trials that compare
//! values on random groups.
//!
//! All decisions are pure: [`selector`], [`gate`] and [`run`] use no clock, network or database.

pub mod desired;
pub mod effect;
pub mod gate;
pub mod member;
pub mod metric;
pub mod outcome;
pub mod plan;
pub mod revision;
pub mod run;
pub mod runs;
pub mod selector;
mod tables;
pub mod tuner;

pub use desired::{DesiredSettings, Notice};
pub(crate) use tables::delete_old;
pub use tuner::Tuner;
pub(crate) use tuner::follow;
