//! Passes once over a clip's pictures: runs detector and screen on every frame and measures the time.

use super::model_runner::{ModelResults, ModelRunner};
use crate::boxes::ScoredBox;
use crate::data::{Clip, LoadReport, Pass, StepTimes};
use crate::error::EvalError;
use crate::footage::FrameSource;
use crate::spec::PolicySpec;
use albireo_core::geometry::{Corners, PictureSize};
use albireo_core::policy::Need;
use albireo_vision::picture::{EncodedPicture, Picture};

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
        for spec in policies {
            let policy = spec.config.build().map_err(EvalError::new)?;
            match policy.pictures() {
                Some(Need::GreyPicture) => settings.keep_grey = true,
                Some(Need::SmallGreyPicture { width }) => settings.keep_small = Some(width),
                _ => {}
            }
        }
        Ok(settings)
    }
}

/// Runs the models on every picture of `source`. `report` counts what is left out; `progress` is called after each
/// frame.
///
/// A picture in a file of its own that cannot be read or decoded is named, counted and left out ([`Clip::unusable`]).
///
/// # Errors
/// [`EvalError`] at the first frame of other footage that cannot be read, at one that the detector fails on, and when
/// no picture can be used.
pub fn run_pass(
    source: &mut dyn FrameSource,
    models: &mut ModelRunner,
    settings: &PassSettings,
    report: &mut LoadReport,
    progress: &mut dyn FnMut(),
) -> Result<Clip, EvalError> {
    let name = source.name().to_owned();
    settle_input(source, models)?;
    let mut size = None;
    let mut kept = Kept::default();
    let mut faults = Faults::default();
    for frame in 0.. {
        if settings.max_frames.is_some_and(|most| frame >= most) {
            break;
        }
        let decoded = match next_decoded(source, models) {
            Ok(None) => break,
            Ok(Some(decoded)) => decoded,
            Err(fault) => {
                faults.add(frame, fault, source)?;
                progress();
                continue;
            }
        };
        let own = decoded.encoded.size;
        let first = *size.get_or_insert(own);
        if own != first {
            return Err(EvalError::new(format!(
                "{name}, frame {frame}: the picture is {own}, those before it are {first}: all pictures of a clip must have the same size"
            )));
        }
        let results = kept
            .run(&decoded, models, settings)
            .map_err(|error| error.context(format!("{name}, frame {frame}")))?;
        let boxes = stored(&results, first, &name, frame, report);
        kept.detections.push(boxes);
        progress();
    }
    let frames = kept.times.len();
    faults.report(&name, frames, report);
    report.notes.extend(source.remarks());
    let Some(picture) = size else {
        let what = match faults.named.first() {
            None => "it has no frames".to_owned(),
            Some(first) => format!("none of its pictures can be used: {first}"),
        };
        return Err(EvalError::new(format!("{name}: {what}")));
    };
    if models.has_screen() {
        let missing = kept.verdicts.iter().filter(|verdict| verdict.is_none()).count();
        if missing > 0 {
            report.notes.push(format!(
                "{name}: the screen gave no verdict on {missing} frames"
            ));
        }
    }
    Ok(Clip {
        frame_rate: Some(source.rate()),
        detections: Some(kept.detections),
        screen: models.has_screen().then_some(kept.verdicts),
        pass: Some(Pass {
            grey: kept.grey,
            small: kept.small,
            small_width: settings.keep_small,
            times: kept.times,
        }),
        classes: models.evaluated().clone(),
        file_names: source.file_names(),
        unusable: faults.places,
        ..Clip::new(name, picture, frames)
    })
}

/// What a pass keeps of each frame.
#[derive(Default)]
struct Kept {
    detections: Vec<Vec<ScoredBox>>,
    verdicts: Vec<Option<bool>>,
    grey: Vec<Picture>,
    small: Vec<Picture>,
    times: Vec<StepTimes>,
}

impl Kept {
    /// Runs the models on a decoded picture, and keeps the verdict, the grey pictures and the times.
    fn run(
        &mut self,
        decoded: &Decoded,
        models: &mut ModelRunner,
        settings: &PassSettings,
    ) -> Result<ModelResults, EvalError> {
        let encoded = &decoded.encoded;
        let results = models.run()?;
        let mut step = StepTimes {
            decode: decoded.milliseconds,
            ..results.times
        };
        if settings.keep_grey {
            let grey = models.grey(encoded, Need::GreyPicture)?;
            self.grey.push(grey.picture);
            step.grey = grey.milliseconds;
        }
        if let Some(width) = settings.keep_small {
            let small = models.grey(encoded, Need::SmallGreyPicture { width })?;
            self.small.push(small.picture);
            step.small = small.milliseconds;
        }
        self.verdicts.push(results.empty);
        self.times.push(step);
        Ok(results)
    }
}

/// A picture that the models have decoded.
struct Decoded {
    encoded: EncodedPicture,
    /// The time that decoding took.
    milliseconds: f64,
}

/// Reads the next picture, and has `models` decode it.
fn next_decoded(
    source: &mut dyn FrameSource,
    models: &mut ModelRunner,
) -> Result<Option<Decoded>, EvalError> {
    let Some(encoded) = source.next()? else {
        return Ok(None);
    };
    let milliseconds = models.decode(&encoded)?;
    Ok(Some(Decoded {
        encoded,
        milliseconds,
    }))
}

/// The pictures of a clip that cannot be used.
#[derive(Default)]
struct Faults {
    places: Vec<usize>,
    /// The first of them, with their names.
    named: Vec<EvalError>,
}

impl Faults {
    /// The most faults that are kept by name.
    const MOST_NAMED: usize = 20;

    /// Notes the picture at `place`, which cannot be used, if it has a file of its own: the next one can still be read
    /// then.
    ///
    /// # Errors
    /// The `fault` itself, if the picture has no such file.
    fn add(
        &mut self,
        place: usize,
        fault: EvalError,
        source: &dyn FrameSource,
    ) -> Result<(), EvalError> {
        let Some(picture) = source.picture_name() else {
            return Err(fault.context(format!("{}, frame {place}", source.name())));
        };
        self.places.push(place);
        if self.named.len() < Self::MOST_NAMED {
            // What reads a file names it already.
            let is_named = fault.to_string().contains(&picture);
            let named = if is_named {
                fault
            } else {
                fault.context(picture)
            };
            self.named.push(named);
        }
        Ok(())
    }

    fn report(&self, clip: &str, frames: usize, report: &mut LoadReport) {
        let count = self.places.len();
        if count == 0 {
            return;
        }
        report.notes.push(format!(
            "{clip}: {count} of {} pictures cannot be used and are left out, with their ground truth",
            frames + count
        ));
        report.notes.extend(self.named.iter().map(EvalError::to_string));
    }
}

/// Lets the detector choose its input on the first pictures, as a node does, so that the whole clip runs at one size
/// and the pass gives the same boxes wherever it begins.
fn settle_input(source: &mut dyn FrameSource, models: &mut ModelRunner) -> Result<(), EvalError> {
    if !models.chooses_input() {
        return Ok(());
    }
    while let Ok(Some(_)) = next_decoded(source, models) {
        if models.has_chosen_input() {
            break;
        }
        if models.run().is_err() {
            break;
        }
    }
    // What failed here fails again in the pass, which reports it.
    source.rewind()
}

/// Converts detections to pixels, as they are stored; counts in `report` what is left out. The replay in this process
/// starts from these too, so that a run on the files of `--save-detections` decides the same to the last bit.
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
        let unclamped = detection.bounding_box.pixel_corners(picture);
        // The detector cuts boxes at the picture's edge, but normalising them can move them beyond it again by a
        // rounding error.
        let corners = Corners {
            x1: unclamped.x1.clamp(0.0, width),
            y1: unclamped.y1.clamp(0.0, height),
            x2: unclamped.x2.clamp(0.0, width),
            y2: unclamped.y2.clamp(0.0, height),
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
