//! Object states: the state of each object in view, its matching with detections, and its creation, confirmation,
//! rescue and removal.
//!
//! `ObjectStates` is the collection that a policy keeps. It advances by frames (`ObjectStates::predict`) and receives
//! detections (`ObjectStates::observe`); `Matcher` matches them, and [`LifeCycle`] holds the rules of birth and death.

mod assignment;
mod collection;
mod components;
mod life_cycle;
mod matching;
mod near;
mod pairing;
mod screening;
mod state;

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
