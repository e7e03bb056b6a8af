//! Gives a policy the evidence about the frames of a clip that it requests.

use crate::boxes::ScoredBox;
use crate::data::Clip;
use crate::error::EvalError;
use crate::settings::{ScreenRule, Settings};
use albireo_core::detection::Detection;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{Evidence, GreyPicture, Need};
use albireo_vision::screen::EmptyRun;

/// Answers a policy's questions with the stored data of a clip.
#[derive(Clone, Debug)]
pub(crate) struct StoredEvidence<'a> {
    clip: &'a Clip,
    detections: Vec<Vec<Detection>>,
    screen: ScreenRule,
    /// The node's limit on empty frames in a row, for recorded verdicts.
    run: EmptyRun,
}

impl<'a> StoredEvidence<'a> {
    /// Takes the clip's detections and screen verdicts that `settings` select.
    ///
    /// # Errors
    /// When the clip has no stored detections, or lacks the screen verdicts that `settings` select.
    pub(crate) fn new(clip: &'a Clip, settings: &Settings) -> Result<Self, EvalError> {
        let stored = clip.detections.as_ref().ok_or_else(|| {
            EvalError::new(
                "the clip has no stored detections: give some, or evaluate its pictures with a real detector",
            )
        })?;
        let normalised = |frame: &Vec<ScoredBox>| {
            let sure = frame.iter().filter(|found| found.confidence >= settings.confidence);
            sure.map(|found| found.normalise(clip.picture)).collect()
        };
        if settings.screen == ScreenRule::Recorded && clip.screen.is_none() {
            return Err(EvalError::new(
                "no verdicts of an empty-scene screen are stored with the clip: use another --screen, or store them with \
                 `albireo eval video … --screen-model FILE --save-detections DIR`",
            ));
        }
        Ok(Self {
            clip,
            detections: stored.iter().map(normalised).collect(),
            screen: settings.screen,
            run: EmptyRun::new(settings.longest_empty_run),
        })
    }

    /// Size of the clip's pictures.
    pub(crate) fn picture(&self) -> PictureSize {
        self.clip.picture
    }

    /// Number of frames.
    pub(crate) fn frames(&self) -> usize {
        self.detections.len()
    }

    /// The detections of every frame, at or above the run's confidence.
    pub(crate) fn all_detections(&self) -> &[Vec<Detection>] {
        &self.detections
    }

    /// Returns what a policy needs for a frame. Calls must be in order of frames; a frame may have several.
    ///
    /// # Errors
    /// When the policy needs pictures that the clip does not have.
    pub(crate) fn evidence(&mut self, frame: usize, need: Need) -> Result<Evidence<'_>, EvalError> {
        let evidence = match need {
            Need::Nothing => Evidence::Unavailable,
            Need::Screen => match self.verdict(frame) {
                Some(empty) => Evidence::Screen { empty },
                None => Evidence::Unavailable,
            },
            Need::Detections => {
                self.run.detector_ran();
                Evidence::Detections(self.detections_of(frame))
            }
            Need::GreyPicture | Need::SmallGreyPicture { .. } => {
                Evidence::GreyPicture(self.grey_picture(frame, need)?)
            }
        };
        Ok(evidence)
    }

    fn detections_of(&self, frame: usize) -> &[Detection] {
        self.detections.get(frame).map_or(&[], Vec::as_slice)
    }

    /// The screen's verdict, true for an empty frame; `None` if none was recorded.
    fn verdict(&mut self, frame: usize) -> Option<bool> {
        match self.screen {
            ScreenRule::Nonempty => Some(false),
            ScreenRule::Detections => Some(self.detections_of(frame).is_empty()),
            ScreenRule::Recorded => {
                let verdicts = self.clip.screen.as_deref().unwrap_or_default();
                let recorded = verdicts.get(frame).copied().flatten()?;
                Some(self.run.limit(recorded))
            }
        }
    }

    /// Returns the frame's grey picture in the size that `need` names.
    fn grey_picture(&self, frame: usize, need: Need) -> Result<GreyPicture<'_>, EvalError> {
        let no_pixels = || {
            EvalError::new(
                "this policy looks at pixels, and stored detections have none: evaluate it on a video or a folder of pictures",
            )
        };
        let pass = self.clip.pass.as_ref().ok_or_else(no_pixels)?;
        let kept = match need {
            Need::GreyPicture => pass.grey.get(frame),
            Need::SmallGreyPicture { width } if pass.small_width == Some(width) => {
                pass.small.get(frame)
            }
            _ => None,
        };
        let picture = kept.ok_or_else(no_pixels)?;
        Ok(GreyPicture {
            size: picture.size,
            pixels: &picture.pixels,
        })
    }
}
