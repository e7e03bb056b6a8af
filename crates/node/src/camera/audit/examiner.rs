//! Runs the detector on a drawn frame.

use super::DrawnFrame;
use albireo_power::CameraEnergy;
use albireo_vision::detector::DetectorHandle;
use albireo_vision::picture::InputFormat;
use albireo_vision::pixel_work::PixelWork;
use albireo_vision::screen::decoding_target;
use albireo_wire::AuditReport;
use std::time::Duration;
use tokio::time::{Instant, timeout_at};

/// A drawn frame counts as missed after waiting this long for the detector. A detector that is busy for longer is
/// overloaded, and longer waits would keep pictures in memory.
const LONGEST_WAIT: Duration = Duration::from_secs(5);

/// Examines one camera's drawn frames.
#[derive(Clone)]
pub(crate) struct Examiner {
    /// The detector that runs on them.
    pub detector: DetectorHandle,
    /// The screen's input, which the camera's frames are also decoded for, if the screen is a model.
    pub screen: Option<InputFormat>,
    /// Decodes pictures.
    pub pixels: PixelWork,
    /// The energy of the audited camera.
    pub energy: CameraEnergy,
}

impl Examiner {
    /// Compares a frame; `None` if the detector has no time for it or its picture is broken.
    pub(crate) async fn look(self, frame: DrawnFrame) -> Option<AuditReport> {
        let until = Instant::now() + LONGEST_WAIT;
        let turn = timeout_at(until, self.detector.spare_turn()).await.ok()??;
        // Only now that the detector is free: most pictures are never decoded.
        let input = self.detector.preparation().format();
        let target = decoding_target(input, self.screen, frame.picture.size);
        let prepared = self.pixels.prepared(frame.picture.clone(), target).await;
        let answer = timeout_at(until, self.detector.detect_spare(turn, prepared?)).await;
        // The detector counts and logs its failures itself.
        let detected = answer.ok()?.ok()?;
        self.energy.detector_called(Instant::now(), detected.took);
        let mut found = AuditReport {
            calls: 1,
            detector_us: u64::try_from(detected.took.as_micros()).unwrap_or(u64::MAX),
            ..AuditReport::default()
        };
        found.sums.add(&frame.shown, &detected.output.detections);
        Some(found)
    }
}
