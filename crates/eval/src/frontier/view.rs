//! Ways to look at a recording: which of its frames arrive, and which detections are sure enough.

use crate::average_precision::TruthBox;
use crate::data::{Clip, StoredDetection};
use crate::source::{ClipEvidence, SourceError};
use albireo_core::detection::Detection;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{GreyPicture, Need};
use albireo_vision::picture::Picture;
use rand_core::{RngCore, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::Serialize;
use std::sync::Arc;

/// A way to look at recordings.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct View {
    /// Its name in tables.
    pub name: String,
    /// Detections below this are not shown to the policies.
    pub confidence: f64,
    /// One frame of so many is used, as if the camera were so much slower.
    pub every: usize,
    /// Share of the frames that are lost at random on their way. The policies are told the gap; lost
    /// frames are not judged.
    pub lost: f64,
}

impl View {
    /// All frames, with detections of at least `confidence`.
    pub fn as_recorded(confidence: f64) -> Self {
        Self {
            name: format!("as recorded, detections ≥ {confidence}"),
            confidence,
            every: 1,
            lost: 0.0,
        }
    }

    /// Every second frame.
    pub fn half_rate(confidence: f64) -> Self {
        Self {
            name: format!("half the frame rate, detections ≥ {confidence}"),
            every: 2,
            ..Self::as_recorded(confidence)
        }
    }

    /// A tenth of the frames lost.
    pub fn lossy(confidence: f64) -> Self {
        Self {
            name: format!("10 % of the frames lost, detections ≥ {confidence}"),
            lost: 0.1,
            ..Self::as_recorded(confidence)
        }
    }

    /// `clip` as it looks from here; `None` without detections or without a box of ground truth. Which
    /// frames are lost depends on nothing but the clip's name.
    pub fn look(&self, clip: &Clip) -> Option<ViewedClip> {
        let (detections, truth) = (clip.detections.as_ref()?, clip.truth.as_ref()?);
        let mut random = Pcg64Mcg::seed_from_u64(seed(&clip.name));
        let mut viewed = ViewedClip::new(clip);
        let mut step = 0;
        for (detections, truth) in detections.iter().zip(truth).step_by(self.every.max(1)) {
            step += 1;
            let chance = (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
            // The first frame is where the stream begins, so it is never lost.
            if chance < self.lost && !viewed.steps.is_empty() {
                continue;
            }
            viewed.arrive(step, detections, self.confidence, truth.clone());
            step = 0;
        }
        viewed.has_truth().then_some(viewed)
    }
}

/// A number that depends on every letter of `name` (FNV-1a).
fn seed(name: &str) -> u64 {
    name.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

/// The frames of a clip that arrive.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewedClip {
    /// Name of the clip.
    pub name: String,
    /// Size of its pictures.
    pub picture: PictureSize,
    /// For each frame, the frames since the one before it.
    pub steps: Vec<u32>,
    /// What the detector finds in each frame.
    pub detections: Vec<Vec<Detection>>,
    /// What is in each frame.
    pub truth: Vec<Vec<TruthBox>>,
    /// Each frame in grey; empty where there are no pictures.
    pub grey: Vec<Arc<Picture>>,
    /// The width that was asked for when these were made.
    pub grey_width: Option<u32>,
}

impl ViewedClip {
    /// `clip` of which no frame has arrived yet, without pictures.
    pub(super) fn new(clip: &Clip) -> Self {
        Self {
            name: clip.name.clone(),
            picture: clip.picture,
            steps: Vec::new(),
            detections: Vec::new(),
            truth: Vec::new(),
            grey: Vec::new(),
            grey_width: None,
        }
    }

    /// A frame arrives, `step` frames after the one before it, with those of its detections that reach `confidence`.
    pub(super) fn arrive(
        &mut self,
        step: u32,
        detections: &[StoredDetection],
        confidence: f64,
        truth: Vec<TruthBox>,
    ) {
        let sure = (detections.iter()).filter(|detection| detection.confidence >= confidence);
        let normalised = sure.map(|detection| detection.normalise(self.picture));
        self.detections.push(normalised.collect());
        self.steps.push(step);
        self.truth.push(truth);
    }

    /// Whether there is a box to be found in it.
    pub(super) fn has_truth(&self) -> bool {
        self.truth.iter().any(|truth| !truth.is_empty())
    }
}

/// The evidence of a viewed clip; the screen never says "empty".
pub(super) struct ViewedEvidence<'a>(pub &'a ViewedClip);

impl ClipEvidence for ViewedEvidence<'_> {
    fn picture(&self) -> PictureSize {
        self.0.picture
    }

    fn frames(&self) -> usize {
        self.0.steps.len()
    }

    fn step(&self, frame: usize) -> u32 {
        self.0.steps.get(frame).copied().unwrap_or(1)
    }

    fn detections(&mut self, frame: usize) -> Result<Option<&[Detection]>, SourceError> {
        Ok(self.0.detections.get(frame).map(Vec::as_slice))
    }

    fn screen_says_empty(&mut self, _frame: usize) -> Result<Option<bool>, SourceError> {
        Ok(Some(false))
    }

    fn grey_picture(
        &mut self,
        frame: usize,
        need: Need,
    ) -> Result<Option<GreyPicture<'_>>, SourceError> {
        let wanted = match need {
            Need::SmallGreyPicture { width } => Some(width),
            _ => None,
        };
        let kept = self.0.grey.get(frame).filter(|_| wanted.is_some());
        let kept = kept.filter(|_| wanted == self.0.grey_width);
        let picture = kept.ok_or(SourceError::NoPictures)?;
        Ok(Some(GreyPicture {
            size: picture.size,
            pixels: &picture.pixels,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::StoredDetection;
    use albireo_core::detection::ClassId;
    use albireo_core::geometry::Corners;

    fn clip(frames: usize) -> Clip {
        let corners = Corners {
            x1: 10.0,
            y1: 10.0,
            x2: 20.0,
            y2: 20.0,
        };
        let detection = |frame: usize| StoredDetection {
            corners,
            class: ClassId(0),
            confidence: frame as f64 / frames as f64,
        };
        let truth = TruthBox {
            corners,
            class: ClassId(0),
            object: None,
        };
        Clip {
            name: "a clip".to_owned(),
            picture: PictureSize::new(100, 100),
            frame_rate: None,
            camera: None,
            frames,
            detections: Some((0..frames).map(|frame| vec![detection(frame)]).collect()),
            screen: None,
            truth: Some(vec![vec![truth]; frames]),
            pictures: Vec::new(),
        }
    }

    #[test]
    fn half_the_rate_is_every_second_frame_as_if_there_were_no_others() {
        let viewed = View::half_rate(0.5)
            .look(&clip(10))
            .expect("there is truth");
        assert_eq!(viewed.steps, [1; 5]);
        let counts: Vec<_> = viewed.detections.iter().map(Vec::len).collect();
        assert_eq!(counts, [0, 0, 0, 1, 1]);
    }

    #[test]
    fn lost_frames_leave_gaps_that_the_steps_tell() {
        let viewed = View::lossy(0.0).look(&clip(2000)).expect("there is truth");
        assert!((1750..=1850).contains(&viewed.steps.len()));
        assert_eq!(viewed.truth.len(), viewed.steps.len());
        let last: u32 = viewed.steps.iter().sum();
        assert!((1990..=2000).contains(&last), "{last}");
        assert_eq!(View::lossy(0.0).look(&clip(2000)), Some(viewed));
    }

    #[test]
    fn a_clip_without_a_box_of_truth_cannot_be_judged() {
        let mut empty = clip(3);
        empty.truth = Some(vec![Vec::new(); 3]);
        assert_eq!(View::as_recorded(0.5).look(&empty), None);
    }
}
