//! The empty-scene screen: a small classifier that says whether anything is in view. A trained model
//! ([`ScreenHandle`]), or one that learns from the detector while it runs ([`AgnosticScreen`]).

mod agnostic;
mod camera;
mod config;
mod empty_run;
mod handle;
mod judge;
mod network;

pub use crate::picture::ColorOrder;
pub use agnostic::{AgnosticSettings, Thumbnail};
pub use camera::CameraScreen;
pub use camera::ScreenCounts;
pub use camera::decoding_target;
pub use config::ScreenConfig;
pub use config::ScreenKind;
pub use empty_run::EmptyRun;
pub use handle::ScreenHandle;
pub use handle::ScreenVerdict;
pub use judge::ScreenJudge;
pub use network::Logits;
