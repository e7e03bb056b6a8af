//! The empty-scene screen: a small classifier that says whether anything is in view.

mod config;
mod handle;
mod network;

pub use crate::frame::ColorOrder;
pub use config::ScreenConfig;
pub use handle::{ScreenHandle, ScreenVerdict};
pub use network::Logits;
