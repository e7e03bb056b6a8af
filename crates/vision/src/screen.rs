//! The empty-scene screen: a small classifier that decides whether anything is in view.

mod config;
mod empty_run;
mod handle;
mod network;

pub use crate::picture::ColorOrder;
pub use config::ScreenConfig;
pub use empty_run::EmptyRun;
pub use handle::{ScreenHandle, ScreenVerdict};
pub use network::Logits;

use crate::picture::InputFormat;
use albireo_core::geometry::PictureSize;

/// The size to which a picture of `source` may be decoded for a detector and a screen with these inputs: both look at
/// the same pixels.
pub fn decoding_target(
    detector: InputFormat,
    screen: Option<InputFormat>,
    source: PictureSize,
) -> PictureSize {
    let of_detector = detector.fitted(source);
    let of_screen = screen.map_or(of_detector, |screen| screen.fitted(source));
    PictureSize::new(
        of_detector.width.max(of_screen.width),
        of_detector.height.max(of_screen.height),
    )
}
