//! The empty-scene screen: a small classifier that decides whether anything is in view.

mod camera;
mod config;
mod empty_run;
mod handle;
mod network;

pub use crate::picture::ColorOrder;
pub use camera::{CameraScreen, decoding_target};
pub use config::ScreenConfig;
pub use empty_run::EmptyRun;
pub use handle::{ScreenHandle, ScreenVerdict};
pub use network::Logits;
