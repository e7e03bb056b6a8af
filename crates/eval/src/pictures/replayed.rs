//! A policy over a clip that was looked at: the evidence it asks for, and the time that would have taken.

use super::pass::PicturedClip;
use crate::replay::FrameRecord;
use crate::result::{ClipResult, FrameTime, Provenance, Spread};
use crate::run::{RunError, Settings, in_parallel, no_evidence, run_policy};
use crate::source::{ClipEvidence, ScreenRule, SourceError, StoredEvidence};
use crate::spec::PolicySpec;
use albireo_core::detection::Detection;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{FrameState, GreyPicture, Need};

/// Which steps a frame needed.
#[derive(Clone, Copy, Debug, Default)]
struct Requested {
    detector: bool,
    screen: bool,
    grey: bool,
    small: bool,
}

/// A [`PicturedClip`] as evidence. Remembers what was asked for, and so what it would have cost.
pub(crate) struct PictureEvidence<'a> {
    stored: StoredEvidence<'a>,
    pictured: &'a PicturedClip,
    rule: ScreenRule,
    requested: Vec<Requested>,
}

impl<'a> PictureEvidence<'a> {
    /// Detections and screen as `settings` have them.
    ///
    /// # Errors
    /// [`SourceError::NoScreenVerdicts`] when a real screen's verdicts are asked for and there was none.
    pub(crate) fn new(
        pictured: &'a PicturedClip,
        settings: &Settings,
    ) -> Result<Self, SourceError> {
        Ok(Self {
            stored: StoredEvidence::new(&pictured.clip, settings)?,
            pictured,
            rule: settings.screen,
            requested: vec![Requested::default(); pictured.clip.frames],
        })
    }

    /// Frames of the wanted states in which the detector finds something.
    fn occupied(&self, records: &[FrameRecord], wanted: fn(FrameState) -> bool) -> usize {
        let records = records.iter().enumerate();
        let wanted = records.filter(|(_, record)| wanted(record.state));
        wanted
            .filter(|(frame, _)| self.stored.is_occupied(*frame))
            .count()
    }

    /// Milliseconds of each frame: its decision as `records` has it, and the steps it asked for as they were
    /// measured in the pass. Screen and detector share one decoded picture.
    pub(crate) fn frame_times(&self, records: &[FrameRecord]) -> Vec<f64> {
        let steps = self.requested.iter().zip(&self.pictured.times);
        records
            .iter()
            .zip(steps)
            .map(|(record, (requested, times))| {
                let real_screen = requested.screen && self.rule == ScreenRule::Recorded;
                let mut time = record.decision.as_secs_f64() * 1e3;
                for (needed, step) in [
                    (requested.detector || real_screen, times.decode),
                    (requested.detector, times.detector),
                    (real_screen, times.screen),
                    (requested.grey, times.grey),
                    (requested.small, times.small),
                ] {
                    if needed {
                        time += step;
                    }
                }
                time
            })
            .collect()
    }
}

impl ClipEvidence for PictureEvidence<'_> {
    fn picture(&self) -> PictureSize {
        self.stored.picture()
    }

    fn frames(&self) -> usize {
        self.stored.frames()
    }

    fn detections(&mut self, frame: usize) -> Result<Option<&[Detection]>, SourceError> {
        if let Some(requested) = self.requested.get_mut(frame) {
            requested.detector = true;
        }
        self.stored.detections(frame)
    }

    fn screen_says_empty(&mut self, frame: usize) -> Result<Option<bool>, SourceError> {
        if let Some(requested) = self.requested.get_mut(frame) {
            requested.screen = true;
        }
        self.stored.screen_says_empty(frame)
    }

    fn grey_picture(
        &mut self,
        frame: usize,
        need: Need,
    ) -> Result<Option<GreyPicture<'_>>, SourceError> {
        let pictured = self.pictured;
        let kept = match need {
            Need::SmallGreyPicture { width } if pictured.small_width == Some(width) => {
                pictured.small.get(frame).map(AsRef::as_ref)
            }
            Need::GreyPicture => pictured.grey.get(frame),
            _ => None,
        };
        let picture = kept.ok_or(SourceError::NoPictures)?;
        if let Some(requested) = self.requested.get_mut(frame) {
            match need {
                Need::GreyPicture => requested.grey = true,
                _ => requested.small = true,
            }
        }
        Ok(Some(GreyPicture {
            size: picture.size,
            pixels: &picture.pixels,
        }))
    }
}

/// The grey pictures that policies ask for, so that the pass must keep them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelsRequested {
    /// Those at half size.
    pub half: bool,
    /// Small ones, of this width.
    pub small: Option<u32>,
}

/// Which grey pictures `policies` ask for.
///
/// # Errors
/// [`RunError::Policy`] when one cannot be built.
pub fn looks_at_pixels(policies: &[PolicySpec]) -> Result<PixelsRequested, RunError> {
    let mut requested = PixelsRequested::default();
    for policy in policies {
        let built = policy.config.build().map_err(|source| RunError::Policy {
            policy: policy.label.clone(),
            source,
        })?;
        match built.pictures() {
            Some(Need::GreyPicture) => requested.half = true,
            Some(Need::SmallGreyPicture { width }) => requested.small = Some(width),
            _ => {}
        }
    }
    Ok(requested)
}

/// Every policy over one clip, in parallel; the results in order of policies. Frame times are composed of
/// the times measured in the pass. `done` is called after each policy, from any thread.
///
/// # Errors
/// The first [`RunError`] met.
pub fn run_pictured(
    pictured: &PicturedClip,
    policies: &[PolicySpec],
    settings: &Settings,
    done: &(dyn Fn() + Sync),
) -> Result<Vec<ClipResult>, RunError> {
    let steps: Vec<usize> = (0..policies.len()).collect();
    // A model of a board projects both energy and frame time; the times measured here are another machine's.
    let projected = settings.energy_model.is_some();
    in_parallel(&steps, settings.threads, done, &|policy| {
        let (clip, policy) = (&pictured.clip, &policies[policy]);
        let mut source = PictureEvidence::new(pictured, settings)
            .map_err(|source| no_evidence(clip, policy, source))?;
        let (mut result, replayed) = run_policy(clip, policy, settings, &mut source)?;
        result.occupied_frames = source.occupied(&replayed.frames, |_| true);
        result.false_empty_frames =
            source.occupied(&replayed.frames, |state| state == FrameState::E);
        if !projected {
            let times = source.frame_times(&replayed.frames);
            result.frame_time = Spread::of(times).map(|milliseconds| FrameTime {
                milliseconds,
                provenance: Provenance::Composed,
            });
        }
        Ok(result)
    })
}
