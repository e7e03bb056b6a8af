//! Object states: what is remembered of each object in view, how they are matched with detections, and
//! when they are created, confirmed, rescued and removed.
//!
//! [`ObjectStates`] is the collection a policy keeps. It advances by frames ([`ObjectStates::predict`])
//! and takes detections ([`ObjectStates::observe`]); the matching is [`Matcher`]'s, the rules of birth
//! and death are [`LifeCycle`]'s.

mod assignment;
mod collection;
mod components;
mod life_cycle;
mod matching;
mod screening;
mod state;

pub use assignment::{AssignmentError, AssignmentSolver, LARGEST_COST};
pub use collection::{ObjectSettings, ObjectStates, Sighting};
pub(crate) use components::{ComponentSolver, Edge};
pub use life_cycle::{LifeCycle, Missed};
pub use matching::{Association, GateOrder, Matcher};
pub use screening::{LARGEST_COORDINATE, is_usable};
pub use state::ObjectState;
