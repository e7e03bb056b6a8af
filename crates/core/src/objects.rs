//! Object states: what is remembered of each object in view, how they are matched with detections, and
//! when they are created, confirmed, rescued and removed.
//!
//! `ObjectStates` is the collection a policy keeps. It advances by frames (`ObjectStates::predict`)
//! and takes detections (`ObjectStates::observe`); the matching is `Matcher`'s, the rules of birth
//! and death are [`LifeCycle`]'s.

mod assignment;
mod collection;
mod components;
mod life_cycle;
mod matching;
mod pairing;
mod screening;
mod state;
mod sweep;

use assignment::AssignmentSolver;
pub use collection::ObjectSettings;
pub(crate) use collection::ObjectStates;
pub(crate) use components::{ComponentSolver, Edge};
pub use life_cycle::{LifeCycle, Missed};
use matching::Matcher;
pub use matching::{Association, GateOrder};
pub(crate) use pairing::{Pairing, by_overlap, overlaps};
pub(crate) use screening::is_usable;
pub use state::ObjectState;
