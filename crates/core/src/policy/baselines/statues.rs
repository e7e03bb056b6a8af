//! The Statues policy: the detector runs when the picture has changed, by frame differencing without objects.
//!
//! Kim, Kim and Ryu, "Statues: Energy-Efficient Video Object Detection on Edge Security Devices with Computational
//! Skipping" (ISLPED 2024), as implemented in the published code of the Albireo paper. The grey picture, halved by area
//! averaging, is compared with that of the previous frame; pixels that differ by [`StatuesSettings::pixel_difference`]
//! or more have changed, and the detector runs when their largest 4-connected component has more pixels than
//! [`StatuesSettings::component_size`]. Otherwise the boxes of the last detector frame are repeated.
//!
//! As in that code, the comparison is with the previous frame, not with the last detector frame, so slow enough objects
//! go unnoticed. If the previous frame was lost or has no picture, the last available picture replaces it.

use super::changed_region::ChangedRegion;
use crate::geometry::PictureSize;
use crate::policy::detector_boxes::DetectorBoxes;
use crate::policy::progress::Progress;
use crate::policy::tracker::check_setting;
use crate::policy::{
    CallCause, Evidence, FrameHead, GreyPicture, InvalidThreshold, Need, Outcome, Policy,
    PolicyConfig, PolicyConfigError, ThresholdSpec,
};
use serde::{Deserialize, Serialize};

/// The settings of the policy.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StatuesSettings {
    /// The detector runs when more connected pixels than this have changed, counted in the halved picture.
    pub component_size: f64,
    /// A pixel has changed if its grey value, 0 to 255, differs by this or more. At least 1.
    pub pixel_difference: u8,
}

impl Default for StatuesSettings {
    fn default() -> Self {
        Self {
            component_size: Statues::THRESHOLD.default,
            pixel_difference: 30,
        }
    }
}

/// The Statues policy. It keeps no objects.
#[derive(Clone, Debug)]
pub struct Statues {
    settings: StatuesSettings,
    region: ChangedRegion,
    /// The last available picture.
    pixels: Vec<u8>,
    size: Option<PictureSize>,
    boxes: DetectorBoxes,
    progress: Progress,
    /// True if the detector has not answered since the last call.
    detector_owed: bool,
}

impl Statues {
    /// The name in configuration and reports.
    pub const NAME: &'static str = "statues";

    /// The size of a change. The Albireo paper uses 25, 75, 200 and 500; the default is that of the Statues paper.
    pub const THRESHOLD: ThresholdSpec = ThresholdSpec {
        name: "component_size",
        meaning: "The detector is skipped while no more pixels than this have changed in one piece: \
                  higher saves more energy, lower is more accurate",
        minimum: 0.0,
        maximum: 1e9,
        default: 75.0,
        useful_minimum: 10.0,
        useful_maximum: 10_000.0,
    };

    pub(in crate::policy) fn from_config(config: &PolicyConfig) -> Result<Self, PolicyConfigError> {
        let settings = config.statues;
        check_setting(Self::NAME, Self::THRESHOLD, settings.component_size)?;
        if settings.pixel_difference == 0 {
            return Err(PolicyConfigError::Setting {
                table: Self::NAME,
                reason: "`pixel_difference` is 0; it must be a whole number from 1 to 255"
                    .to_owned(),
            });
        }
        Ok(Self {
            settings,
            region: ChangedRegion::default(),
            pixels: Vec::new(),
            size: None,
            boxes: DetectorBoxes::default(),
            progress: Progress::default(),
            detector_owed: true,
        })
    }

    /// True if `picture` differs enough from the last one or cannot be compared. Keeps it as the last one, unless its
    /// number of pixels does not match its size.
    fn has_changed(&mut self, picture: GreyPicture<'_>) -> bool {
        let pixels = picture.pixels;
        if !picture.is_whole() {
            return true;
        }
        let changed = if self.size == Some(picture.size) {
            let width = picture.size.width as usize;
            let difference = self.settings.pixel_difference;
            let size = self.settings.component_size as u64;
            self.region.exceeds(width, &self.pixels, pixels, difference, size)
        } else {
            true
        };
        self.size = Some(picture.size);
        self.pixels.clear();
        self.pixels.extend_from_slice(pixels);
        changed
    }

    fn call_detector(&mut self, cause: CallCause) -> Need {
        self.detector_owed = true;
        self.progress.call(Some(cause))
    }
}

impl Policy for Statues {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn threshold_spec(&self) -> Option<ThresholdSpec> {
        Some(Self::THRESHOLD)
    }

    fn threshold(&self) -> Option<f64> {
        Some(self.settings.component_size)
    }

    fn set_threshold(&mut self, value: f64) -> Result<(), InvalidThreshold> {
        self.settings.component_size = Self::THRESHOLD.check(value)?;
        Ok(())
    }

    fn pictures(&self) -> Option<Need> {
        Some(Need::GreyPicture)
    }

    fn begin(&mut self, _: FrameHead) -> Need {
        self.progress = Progress::default();
        self.progress.ask(Need::GreyPicture)
    }

    /// Without the picture a change cannot be excluded, so the detector runs. A failed detector call is repeated on the
    /// next frame, changed or not.
    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        match (self.progress.need, evidence) {
            (Need::GreyPicture, Evidence::GreyPicture(picture)) => {
                if self.has_changed(picture) {
                    self.call_detector(CallCause::Changed)
                } else if self.detector_owed {
                    self.call_detector(CallCause::Retry)
                } else {
                    self.progress.ask(Need::Nothing)
                }
            }
            (Need::GreyPicture, _) => self.call_detector(CallCause::Changed),
            (Need::Detections, Evidence::Detections(detections)) => {
                self.boxes.take(detections);
                self.detector_owed = false;
                self.progress.detected()
            }
            _ => Need::Nothing,
        }
    }

    fn finish(&mut self, outcome: &mut Outcome) {
        self.boxes.finish(&self.progress, outcome);
    }

    fn reset(&mut self) {
        self.size = None;
        self.boxes.clear();
        self.progress = Progress::default();
        self.detector_owed = true;
    }

    fn rejected_detections(&self) -> u64 {
        self.boxes.rejected()
    }
}

#[cfg(test)]
mod tests;
