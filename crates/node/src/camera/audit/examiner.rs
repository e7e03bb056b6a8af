//! Runs the detector on a drawn frame.

use crate::camera::answer::detected_messages;
use crate::recorder::CameraRecorder;
use albireo_core::detection::Detection;
use albireo_core::policy::OutputBox;
use albireo_power::CameraEnergy;
use albireo_recording::AuditMessage;
use albireo_vision::detector::DetectorHandle;
use albireo_vision::picture::EncodedPicture;
use albireo_vision::pixel_work::PixelWork;
use albireo_wire::{AuditReport, DetectionsMessage, VERSION};
use std::sync::Arc;
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
    /// Decodes pictures.
    pub pixels: PixelWork,
    /// The energy of the audited camera.
    pub energy: CameraEnergy,
    /// Records frames on which there is a difference.
    pub recorder: CameraRecorder,
}

impl Examiner {
    /// Compares the boxes of a picture, which `published` holds, with the detector's; `None` if the detector has no time for
    /// it or the picture is broken. If there is a difference, the frame is worth recording.
    pub(crate) async fn examine(
        self,
        picture: EncodedPicture,
        shown: Vec<OutputBox>,
        published: Arc<DetectionsMessage>,
    ) -> Option<AuditReport> {
        let until = Instant::now() + LONGEST_WAIT;
        let Ok(Some(turn)) = timeout_at(until, self.detector.spare_turn()).await else {
            return None;
        };
        // Only now that the detector is free: most pictures are never decoded.
        let prepared = self.pixels.prepared(picture.clone()).await?;
        // The detector counts and logs its failures itself.
        let detecting = self.detector.detect_spare(turn, prepared);
        let Ok(Ok(mut detected)) = timeout_at(until, detecting).await else {
            return None;
        };
        let detections = &mut detected.output.detections;
        detections.retain(|found| !picture.hides(found.bounding_box));
        self.energy.detector_called(Instant::now(), detected.took);
        let mut found = AuditReport {
            calls: 1,
            detector_us: u64::try_from(detected.took.as_micros()).unwrap_or(u64::MAX),
            ..AuditReport::default()
        };
        found.sums.add(&shown, &detected.output.detections);
        let sums = &found.sums;
        let differs = sums.paired != sums.detected || sums.paired != sums.shown;
        if differs && self.recorder.wants_audited() {
            let audit = self.message(&published, &picture, &detected.output.detections);
            self.recorder.audited(picture, audit);
        }
        Some(found)
    }

    /// The frame's boxes beside those that the detector found.
    fn message(
        &self,
        published: &DetectionsMessage,
        picture: &EncodedPicture,
        detected: &[Detection],
    ) -> AuditMessage {
        AuditMessage {
            v: VERSION,
            seq: published.seq,
            t_ns: published.t_ns,
            width: published.width,
            height: published.height,
            shown: published.boxes.clone(),
            detected: detected_messages(detected, picture.size, self.detector.class_names()),
        }
    }
}
