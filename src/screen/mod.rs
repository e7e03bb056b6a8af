//! The empty-scene screen: a small classifier that says whether anything is in view.

mod config;

pub use config::{ColorOrder, ScreenConfig};
