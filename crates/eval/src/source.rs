//! Where the evidence that a policy asks for comes from: stored detections here, a real detector elsewhere.

use crate::data::Clip;
use albireo_core::detection::Detection;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::GreyPicture;
use serde::{Deserialize, Serialize};

/// Evidence about the frames of one clip. The driver asks only for what the policy needs, in order of
/// frames.
///
/// Every question answers `Ok(None)` when this one frame's evidence cannot be had (the policy is told so),
/// and an error when the clip cannot be evaluated at all.
pub trait EvidenceSource {
    /// Size of the clip's pictures.
    fn picture(&self) -> PictureSize;

    /// Number of frames.
    fn frames(&self) -> usize;

    /// Frames since the one before it, which were lost if there are more than one.
    fn step(&self, frame: usize) -> u32 {
        let _ = frame;
        1
    }

    /// What the detector finds in a frame, at or above the run's confidence, in the detector's order.
    ///
    /// # Errors
    /// [`SourceError`] when the source has no detector.
    fn detections(&mut self, frame: usize) -> Result<Option<&[Detection]>, SourceError>;

    /// Whether the empty-scene screen says that nothing is in view.
    ///
    /// # Errors
    /// [`SourceError`] when the source has no screen.
    fn screen_says_empty(&mut self, frame: usize) -> Result<Option<bool>, SourceError>;

    /// The picture in grey at half its size.
    ///
    /// # Errors
    /// [`SourceError::NoPictures`] when the source has no pictures.
    fn grey_picture(&mut self, frame: usize) -> Result<Option<GreyPicture<'_>>, SourceError>;
}

/// Evidence that a source cannot give.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SourceError {
    /// The policy looks at pixels and there are none.
    #[error(
        "this policy looks at pixels, and stored detections have none: evaluate it on a video or a folder \
         of pictures"
    )]
    NoPictures,
    /// The agnostic screen is asked for and there are no pictures.
    #[error(
        "the agnostic screen looks at pictures, and stored detections have none: evaluate it with \
         `albireo eval video`, `pictures` or `synth`"
    )]
    AgnosticNeedsPictures,
    /// The screen's verdicts are asked for and there are none.
    #[error(
        "no verdicts of an empty-scene screen are stored with the clip: use another --screen, or store \
         them with `albireo eval video … --screen-model FILE --save-detections DIR`"
    )]
    NoScreenVerdicts,
    /// Ground truth without anything to compare with it.
    #[error(
        "the clip has no stored detections: give some, or evaluate its pictures with a real detector"
    )]
    NoDetections,
    /// The source failed for a reason of its own.
    #[error("{0}")]
    Failed(String),
}

/// What stands in for the empty-scene screen when there are no pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum ScreenRule {
    /// A screen that never says "empty".
    Nonempty,
    /// A screen that is always right: "empty" exactly when the frame has no stored detection.
    Detections,
    /// The screen that learns from the detector while it runs; needs pictures.
    Agnostic,
    /// What a real screen said when the pictures were there: `screen/*.csv` beside the detections.
    Recorded,
}

impl ScreenRule {
    /// The name on the command line and in traces.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Nonempty => "nonempty",
            Self::Detections => "detections",
            Self::Agnostic => "agnostic",
            Self::Recorded => "recorded",
        }
    }
}

/// Stored detections of a clip as evidence.
#[derive(Clone, Debug)]
pub(crate) struct StoredEvidence {
    picture: PictureSize,
    detections: Vec<Vec<Detection>>,
    screen: ScreenRule,
    /// One a frame where the rule is [`ScreenRule::Recorded`].
    verdicts: Vec<Option<bool>>,
}

impl StoredEvidence {
    /// The detections of `clip` whose confidence is at least `confidence`.
    ///
    /// # Errors
    /// [`SourceError::NoDetections`] if the clip has none stored, [`SourceError::NoScreenVerdicts`] if they are
    /// asked for and the clip has none.
    pub(crate) fn new(
        clip: &Clip,
        confidence: f64,
        screen: ScreenRule,
    ) -> Result<Self, SourceError> {
        let stored = clip.detections.as_ref().ok_or(SourceError::NoDetections)?;
        let detections = stored
            .iter()
            .map(|frame| {
                frame
                    .iter()
                    .filter(|detection| detection.confidence >= confidence)
                    .map(|detection| detection.normalise(clip.picture))
                    .collect()
            })
            .collect();
        let verdicts = match screen {
            ScreenRule::Recorded => clip.screen.clone().ok_or(SourceError::NoScreenVerdicts)?,
            ScreenRule::Agnostic => return Err(SourceError::AgnosticNeedsPictures),
            ScreenRule::Nonempty | ScreenRule::Detections => Vec::new(),
        };
        Ok(Self {
            picture: clip.picture,
            detections,
            screen,
            verdicts,
        })
    }

    /// Whether a frame has a detection at or above the run's confidence.
    pub(crate) fn is_occupied(&self, frame: usize) -> bool {
        !self.frame(frame).is_empty()
    }

    fn frame(&self, frame: usize) -> &[Detection] {
        self.detections.get(frame).map_or(&[], Vec::as_slice)
    }
}

impl EvidenceSource for StoredEvidence {
    fn picture(&self) -> PictureSize {
        self.picture
    }

    fn frames(&self) -> usize {
        self.detections.len()
    }

    fn detections(&mut self, frame: usize) -> Result<Option<&[Detection]>, SourceError> {
        Ok(Some(self.frame(frame)))
    }

    fn screen_says_empty(&mut self, frame: usize) -> Result<Option<bool>, SourceError> {
        Ok(match self.screen {
            // The agnostic screen never gets this far.
            ScreenRule::Nonempty | ScreenRule::Agnostic => Some(false),
            ScreenRule::Detections => Some(self.frame(frame).is_empty()),
            ScreenRule::Recorded => self.verdicts.get(frame).copied().flatten(),
        })
    }

    fn grey_picture(&mut self, _frame: usize) -> Result<Option<GreyPicture<'_>>, SourceError> {
        Err(SourceError::NoPictures)
    }
}
