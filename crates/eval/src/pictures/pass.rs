//! Passes once over a clip's pictures: runs detector and screen on every frame and measures the time.

use super::model_runner::{ModelResults, ModelRunner};
use crate::boxes::ScoredBox;
use crate::data::{Clip, LoadReport, Pass};
use crate::error::EvalError;
use crate::footage::FrameSource;
use crate::spec::PolicySpec;
use albireo_core::geometry::{Corners, PictureSize};
use albireo_core::policy::Need;

/// Settings of the pass: what to keep, and how many frames to process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PassSettings {
    /// True to keep the grey pictures at half size: a quarter of a byte for each pixel of the clip.
    pub keep_grey: bool,
    /// Width of the small grey pictures to keep; `None` to keep none.
    pub keep_small: Option<u32>,
    /// The most frames to process; `None` for all.
    pub max_frames: Option<usize>,
}

impl PassSettings {
    /// Keeps the grey pictures that `policies` need.
    ///
    /// # Errors
    /// When a policy cannot be built.
    pub fn for_policies(policies: &[PolicySpec]) -> Result<Self, EvalError> {
        let mut settings = Self::default();
        for policy in policies {
            match policy.build()?.pictures() {
                Some(Need::GreyPicture) => settings.keep_grey = true,
                Some(Need::SmallGreyPicture { width }) => settings.keep_small = Some(width),
                _ => {}
            }
        }
        Ok(settings)
    }
}

/// Runs the models on every picture of `source`. `report` counts what is left out; `progress` is called after each frame.
///
/// # Errors
/// [`EvalError`] at the first frame that cannot be read or examined: frames would no longer be in step with
/// their ground truth.
pub fn run_pass(
    source: &mut dyn FrameSource,
    models: &mut ModelRunner,
    settings: &PassSettings,
    report: &mut LoadReport,
    progress: &mut dyn FnMut(),
) -> Result<Clip, EvalError> {
    let name = source.name().to_owned();
    let mut size = None;
    let mut detections = Vec::new();
    let mut verdicts = Vec::new();
    let mut grey = Vec::new();
    let mut small = Vec::new();
    let mut times = Vec::new();
    while settings.max_frames.is_none_or(|most| times.len() < most) {
        let next = source.next()?;
        let Some(encoded) = next else { break };
        let frame = times.len();
        let first = *size.get_or_insert(encoded.size);
        if encoded.size != first {
            return Err(EvalError::new(format!(
                "{name}, frame {frame}: the picture is {}, those before it are {first}: all pictures of a clip must have the same size",
                encoded.size
            )));
        }
        let failed = |error: EvalError| error.context(format!("{name}, frame {frame}"));
        let results = models.run(&encoded).map_err(failed)?;
        let mut step = results.times;
        if settings.keep_grey {
            let (picture, time) = models.grey(&encoded, Need::GreyPicture).map_err(failed)?;
            grey.push(picture);
            step.grey = time;
        }
        if let Some(width) = settings.keep_small {
            let need = Need::SmallGreyPicture { width };
            let (picture, time) = models.grey(&encoded, need).map_err(failed)?;
            small.push(picture);
            step.small = time;
        }
        verdicts.push(results.empty);
        detections.push(stored(&results, first, &name, frame, report));
        times.push(step);
        progress();
    }
    let frames = times.len();
    let Some(picture) = size else {
        return Err(EvalError::new(format!("{name}: it has no frames")));
    };
    if models.has_screen() {
        let missing = verdicts.iter().filter(|verdict| verdict.is_none()).count();
        if missing > 0 {
            report.notes.push(format!(
                "{name}: the screen gave no verdict on {missing} frames"
            ));
        }
    }
    Ok(Clip {
        frame_rate: Some(source.rate()),
        detections: Some(detections),
        screen: models.has_screen().then_some(verdicts),
        pass: Some(Pass {
            grey,
            small,
            small_width: settings.keep_small,
            times,
        }),
        ..Clip::new(name, picture, frames)
    })
}

/// Converts detections to pixels, as they are stored. The replay in this process starts from these too, so that
/// a run on the files of `--save-detections` decides the same to the last bit.
fn stored(
    results: &ModelResults,
    picture: PictureSize,
    clip: &str,
    frame: usize,
    report: &mut LoadReport,
) -> Vec<ScoredBox> {
    let place = || format!("{clip}, frame {frame}");
    for class in &results.unmapped {
        report.leave_out_class(class, place);
    }
    let (width, height) = (f64::from(picture.width), f64::from(picture.height));
    let mut kept = Vec::with_capacity(results.detections.len());
    for detection in &results.detections {
        let corners = detection.bounding_box.pixel_corners(picture);
        // The detector cuts boxes at the picture's edge, but normalising them can move them beyond it again by a
        // rounding error.
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
