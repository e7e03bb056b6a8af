//! A policy over a clip that was looked at: the evidence it asks for, and the time that would have taken.

use super::pass::PicturedClip;
use crate::replay::FrameRecord;
use crate::result::{ClipResult, FrameTime, Provenance, Spread};
use crate::run::{RunError, Settings, in_parallel, no_evidence, run_policy};
use crate::source::{EvidenceSource, ScreenRule, SourceError, StoredEvidence};
use crate::spec::PolicySpec;
use albireo_core::detection::Detection;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{FrameHead, FrameState, GreyPicture, Need};
use albireo_node::screen::{AgnosticScreen, EmptyRun, ScreenConfig, Thumbnail};

/// Which steps a frame needed.
#[derive(Clone, Copy, Debug, Default)]
struct Asked {
    detector: bool,
    screen: bool,
    grey: bool,
}

/// A [`PicturedClip`] as evidence. Remembers what was asked for, and so what it would have cost.
pub(crate) struct PictureEvidence<'a> {
    stored: StoredEvidence,
    pictured: &'a PicturedClip,
    rule: ScreenRule,
    agnostic: Option<Agnostic>,
    asked: Vec<Asked>,
}

/// The agnostic screen at work on one clip.
struct Agnostic {
    screen: AgnosticScreen,
    run: EmptyRun,
    /// The frame in hand.
    frame: usize,
}

impl Agnostic {
    /// Questions come in order of frames, several of one frame perhaps.
    fn turn_to(&mut self, frame: usize) {
        if self.frame != frame {
            self.frame = frame;
            self.screen.next_frame();
        }
    }
}

impl<'a> PictureEvidence<'a> {
    /// Detections from `confidence` on, and the screen as `rule` has it.
    ///
    /// # Errors
    /// [`SourceError::NoScreenVerdicts`] when a real screen's verdicts are asked for and there was none.
    pub(crate) fn new(
        pictured: &'a PicturedClip,
        confidence: f64,
        rule: ScreenRule,
    ) -> Result<Self, SourceError> {
        let settings = ScreenConfig::default();
        let (agnostic, stored) = match rule {
            ScreenRule::Agnostic => {
                let agnostic = Agnostic {
                    screen: AgnosticScreen::new(&settings.agnostic, 0),
                    run: EmptyRun::new(settings.longest_empty_run),
                    frame: 0,
                };
                (Some(agnostic), ScreenRule::Nonempty)
            }
            _ => (None, rule),
        };
        Ok(Self {
            stored: StoredEvidence::new(&pictured.clip, confidence, stored)?,
            pictured,
            rule,
            agnostic,
            asked: vec![Asked::default(); pictured.clip.frames],
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
        let steps = self.asked.iter().zip(&self.pictured.times);
        records
            .iter()
            .zip(steps)
            .map(|(record, (asked, times))| {
                // The agnostic screen costs the decoding; its own time is not measured.
                let real_screen = asked.screen
                    && matches!(self.rule, ScreenRule::Recorded | ScreenRule::Agnostic);
                let mut time = record.decision.as_secs_f64() * 1e3;
                for (needed, step) in [
                    (asked.detector || real_screen, times.decode),
                    (asked.detector, times.detector),
                    (real_screen, times.screen),
                    (asked.grey, times.grey),
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

/// What the agnostic screen sees of a frame.
fn thumbnail(pictured: &PicturedClip, frame: usize) -> Option<Thumbnail> {
    pictured.thumbnails.get(frame).cloned().flatten()
}

impl EvidenceSource for PictureEvidence<'_> {
    fn picture(&self) -> PictureSize {
        self.stored.picture()
    }

    fn frames(&self) -> usize {
        self.stored.frames()
    }

    fn detections(&mut self, frame: usize) -> Result<Option<&[Detection]>, SourceError> {
        if let Some(asked) = self.asked.get_mut(frame) {
            asked.detector = true;
        }
        let found = self.stored.detections(frame)?;
        if let (Some(agnostic), Some(found)) = (&mut self.agnostic, found) {
            agnostic.turn_to(frame);
            agnostic.run.looked();
            let thumbnail = || thumbnail(self.pictured, frame);
            agnostic.screen.detected(!found.is_empty(), thumbnail);
        }
        Ok(found)
    }

    fn screen_says_empty(&mut self, frame: usize) -> Result<Option<bool>, SourceError> {
        if let Some(asked) = self.asked.get_mut(frame) {
            asked.screen = true;
        }
        let Some(agnostic) = &mut self.agnostic else {
            return self.stored.screen_says_empty(frame);
        };
        agnostic.turn_to(frame);
        let thumbnail = thumbnail(self.pictured, frame);
        let empty = thumbnail.map(|thumbnail| agnostic.screen.empty(thumbnail));
        Ok(empty.map(|empty| agnostic.run.judge(empty)))
    }

    fn grey_picture(&mut self, frame: usize) -> Result<Option<GreyPicture<'_>>, SourceError> {
        let grey = self
            .pictured
            .grey
            .get(frame)
            .ok_or(SourceError::NoPictures)?;
        if let Some(asked) = self.asked.get_mut(frame) {
            asked.grey = true;
        }
        Ok(Some(GreyPicture {
            size: grey.size,
            pixels: &grey.pixels,
        }))
    }
}

/// Whether any of `policies` asks for grey pictures, so that the pass must keep them.
///
/// # Errors
/// [`RunError::Policy`] when one cannot be built.
pub fn looks_at_pixels(policies: &[PolicySpec]) -> Result<bool, RunError> {
    let head = FrameHead {
        index: 0,
        step: 1,
        picture: PictureSize::new(2, 2),
    };
    for policy in policies {
        let built = policy.config.build().map_err(|source| RunError::Policy {
            policy: policy.label.clone(),
            source,
        });
        // Nothing is known at the first frame, so a policy that compares pictures wants the first of them.
        if built?.begin(head) == Need::GreyPicture {
            return Ok(true);
        }
    }
    Ok(false)
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
        let mut source = PictureEvidence::new(pictured, settings.confidence, settings.screen)
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
