//! The empty-scene screen: a small classifier that says whether anything is in view. A trained model
//! ([`ScreenHandle`]), or one that learns from the detector while it runs ([`AgnosticScreen`]).

mod agnostic;
mod camera;
mod config;
mod empty_run;
mod handle;
mod network;

pub use crate::frame::ColorOrder;
pub use agnostic::{AgnosticCounters, AgnosticScreen, AgnosticSettings, Thumbnail};
pub use camera::{CameraScreen, ScreenCounts, decoding_target};
pub use config::{ScreenConfig, ScreenKind};
pub use empty_run::EmptyRun;
pub use handle::{ScreenHandle, ScreenVerdict};
pub use network::Logits;
