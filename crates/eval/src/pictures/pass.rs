//! The one pass over a clip's pictures: what detector and screen say of every frame, and how long it took.

use super::observer::{Observation, Observer};
use crate::average_precision::ScoredBox;
use crate::data::{Clip, LoadReport};
use crate::error::EvalError;
use crate::footage::FrameSource;
use crate::replay::FrameRecord;
use crate::run::build;
use crate::spec::PolicySpec;
use albireo_core::geometry::{Corners, PictureSize};
use albireo_core::policy::Need;
use albireo_vision::picture::Picture;

/// What to keep of the pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PassSettings {
    /// Whether to keep the grey pictures at half size: a quarter of a byte for each pixel of the clip.
    pub keep_grey: bool,
    /// Width of the small grey pictures to keep.
    pub keep_small: Option<u32>,
    /// Look at no more frames than this.
    pub most_frames: Option<usize>,
}

/// Milliseconds that each step took on one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepTimes {
    /// Decoding to colour.
    pub decode: f64,
    /// Letterbox, model and head.
    pub detector: f64,
    /// The screen; 0 without one.
    pub screen: f64,
    /// Decoding to grey at half size; 0 where that is not kept.
    pub grey: f64,
    /// Decoding to a small grey picture; 0 where that is not kept.
    pub small: f64,
}

/// What the pass over a clip's pictures keeps beside detections and verdicts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pass {
    /// The grey picture of each frame at half size; empty when not kept.
    pub grey: Vec<Picture>,
    /// The small grey picture of each frame; empty when not kept.
    pub small: Vec<Picture>,
    /// The width that was asked for when these were made.
    pub small_width: Option<u32>,
    /// The time of each step on each frame.
    pub times: Vec<StepTimes>,
}

impl Pass {
    /// Milliseconds of each frame under a policy that looks at `pictures`: its decision as `records` has it, and the steps
    /// that it asked for as they were measured in the pass. Screen and detector share one decoded picture; `screened` says
    /// whether it was this clip's screen that answered.
    pub(crate) fn frame_times(
        &self,
        records: &[FrameRecord],
        pictures: Option<Need>,
        screened: bool,
    ) -> Vec<f64> {
        let time = |(record, times): (&FrameRecord, &StepTimes)| {
            let screen = record.screen && screened;
            let grey = match pictures {
                Some(Need::GreyPicture) => times.grey,
                _ => times.small,
            };
            let steps = [
                (record.detector || screen, times.decode),
                (record.detector, times.detector),
                (screen, times.screen),
                (record.examined, grey),
            ];
            let needed = steps.into_iter().filter(|(needed, _)| *needed);
            record.decision.as_secs_f64() * 1e3 + needed.map(|(_, step)| step).sum::<f64>()
        };
        records.iter().zip(&self.times).map(time).collect()
    }
}

/// What the pass has to keep for `policies`.
///
/// # Errors
/// When one cannot be built.
pub fn looks_at_pixels(policies: &[PolicySpec]) -> Result<PassSettings, EvalError> {
    let mut settings = PassSettings::default();
    for policy in policies {
        match build(policy)?.pictures() {
            Some(Need::GreyPicture) => settings.keep_grey = true,
            Some(Need::SmallGreyPicture { width }) => settings.keep_small = Some(width),
            _ => {}
        }
    }
    Ok(settings)
}

/// Looks at every picture of `source`. What is left out goes to `report`; `seen` is called after each frame.
///
/// # Errors
/// [`EvalError`] at the first frame that cannot be read or examined: frames would no longer be in step with
/// their ground truth.
pub fn collect(
    source: &mut dyn FrameSource,
    observer: &mut Observer,
    settings: &PassSettings,
    report: &mut LoadReport,
    progress: &mut dyn FnMut(),
) -> Result<Clip, EvalError> {
    let name = source.name().to_owned();
    let mut size = None;
    let mut detections = Vec::new();
    let mut verdicts = Vec::new();
    let (mut grey, mut small) = (Vec::new(), Vec::new());
    let mut times = Vec::new();
    while settings.most_frames.is_none_or(|most| times.len() < most) {
        let next = source.next()?;
        let Some(encoded) = next else { break };
        let frame = times.len();
        let first = *size.get_or_insert(encoded.size);
        if encoded.size != first {
            return Err(EvalError::new(format!(
                "{name}, frame {frame}: the picture is {}, those before it are {first}: a clip has pictures of one size",
                encoded.size
            )));
        }
        let failed = |error: EvalError| error.of(format!("{name}, frame {frame}"));
        let observed = observer.look(&encoded).map_err(failed)?;
        let mut step = observed.times;
        if settings.keep_grey {
            let (picture, time) = observer.grey(&encoded, Need::GreyPicture).map_err(failed)?;
            grey.push(picture);
            step.grey = time;
        }
        if let Some(width) = settings.keep_small {
            let need = Need::SmallGreyPicture { width };
            let (picture, time) = observer.grey(&encoded, need).map_err(failed)?;
            small.push(picture);
            step.small = time;
        }
        verdicts.push(observed.empty);
        detections.push(stored(&observed, first, &name, frame, report));
        times.push(step);
        progress();
    }
    let frames = times.len();
    let Some(picture) = size else {
        return Err(EvalError::new(format!(
            "{name}: not a single frame came out of it"
        )));
    };
    if observer.has_screen() {
        let silent = verdicts.iter().filter(|verdict| verdict.is_none()).count();
        if silent > 0 {
            report.notes.push(format!(
                "{name}: the screen could not say on {silent} frames"
            ));
        }
    }
    Ok(Clip {
        frame_rate: Some(source.rate()),
        detections: Some(detections),
        screen: observer.has_screen().then_some(verdicts),
        pass: Some(Pass {
            grey,
            small,
            small_width: settings.keep_small,
            times,
        }),
        ..Clip::new(name, picture, frames)
    })
}

/// The detections as they are stored, in pixels. The replay starts from these in the same process too, so
/// that a run on files of `--save-detections` decides alike to the last bit.
fn stored(
    observed: &Observation,
    picture: PictureSize,
    clip: &str,
    frame: usize,
    report: &mut LoadReport,
) -> Vec<ScoredBox> {
    let place = || format!("{clip}, frame {frame}");
    for class in &observed.unmapped {
        report.leave_out_class(class, place);
    }
    let (width, height) = (f64::from(picture.width), f64::from(picture.height));
    let mut kept = Vec::with_capacity(observed.detections.len());
    for detection in &observed.detections {
        let corners = detection.bounding_box.pixel_corners(picture);
        // The detector cuts boxes at the picture's edge; the way through the normalised form may take them
        // over it again by a rounding error.
        let corners = Corners {
            x1: corners.x1.clamp(0.0, width),
            y1: corners.y1.clamp(0.0, height),
            x2: corners.x2.clamp(0.0, width),
            y2: corners.y2.clamp(0.0, height),
        };
        match report.check(corners, picture) {
            Some(reason) => report.leave_out(reason, place),
            None => kept.push(ScoredBox {
                corners,
                class: detection.class,
                confidence: detection.confidence,
                object: None,
            }),
        }
    }
    kept
}
