//! Reads data sets: clips with stored detections, ground truth, or both. Each layout has a module.
//!
//! Every reader returns [`DataSet`]: the clips, and how many rows were left out for which reason. A
//! file that cannot be what it claims to be (missing, a row with the wrong number of columns, a frame
//! number outside the clip) is an error that names file and line; a row that is well-formed but
//! meaningless (an inverted box, a score that is not a number, a class outside the mapping) is left out,
//! counted and reported.

pub mod bdd100k;
pub mod classes;
pub mod coco;
pub mod imagenet_vid;
pub mod kitti;
pub mod mot_challenge;
mod pass;
mod picture_name;
pub mod recorded;
mod rows;
mod truth;
pub mod visdrone;

pub use pass::{Pass, StepTimes};
pub use truth::{GroundTruth, TruthFormat, vanilla_as_truth};

use crate::boxes::ScoredBox;
use crate::data::classes::Evaluated;
use crate::error::EvalError;
use crate::footage::{FrameSelection, unused_name};
use crate::judge::{Ignored, Mark, only_unlabelled, unlabelled};
use crate::text::counted;
use albireo_core::detection::ClassId;
use albireo_core::geometry::{Corners, PictureSize};
use albireo_vision::picture::picture_files;
use serde::Serialize;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The rules by which boxes on marked places are judged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Rules {
    /// Those of the benchmark that the data comes from: boxes on crowds, distractors and ignored regions are not
    /// judged.
    #[default]
    Benchmark,
    /// Those of the paper's evaluator: nothing is excused, and crowds of BDD100K are ground truth like any other box.
    Paper,
}

impl Rules {
    /// The rules in words.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Benchmark => "not judged, by the rules of the data's benchmark",
            Self::Paper => "judged like all others, as the paper's evaluator does",
        }
    }
}

/// A clip of a data set.
#[derive(Clone, Debug, PartialEq)]
pub struct Clip {
    /// The clip's name, unique in the data set.
    pub name: String,
    /// Size of the clip's pictures.
    pub picture: PictureSize,
    /// Frames per second, if known.
    pub frame_rate: Option<f64>,
    /// `moving` or `fixed`, if known.
    pub camera: Option<String>,
    /// Number of frames.
    pub frames: usize,
    /// Stored detections, one list per frame in the detector's order; `None` if none are stored.
    pub detections: Option<Vec<Vec<ScoredBox>>>,
    /// Verdicts of a real empty-scene screen, one entry per frame: true if the frame is empty, `None` if the screen
    /// gave no verdict.
    pub screen: Option<Vec<Option<bool>>>,
    /// Ground truth, one list per frame; `None` if there is none.
    pub truth: Option<Vec<Vec<ScoredBox>>>,
    /// The clip's pictures in order, if they are files.
    pub pictures: Vec<PathBuf>,
    /// The file names of all pictures of its source, also of those that are none of its frames; without entries if they
    /// are no files.
    pub file_names: Vec<String>,
    /// The names by which its ground truth calls the picture of each frame, empty if it does not list the frame;
    /// without entries if it has no names.
    pub label_names: Vec<String>,
    /// What the ground truth marks as not to be judged, one list per frame; empty if it marks nothing.
    pub ignored: Vec<Vec<Ignored>>,
    /// Grey pictures and step times, if a detector ran on the pictures in this run.
    pub pass: Option<Pass>,
    /// The classes of its boxes.
    pub classes: Evaluated,
    /// The pictures of its source that cannot be used, by their places in it; they are none of its frames.
    pub unusable: Vec<usize>,
    /// The places of its frames in the video that they are taken from, if its ground truth says them.
    pub places: Vec<usize>,
}

impl Clip {
    /// Creates a clip without detections, ground truth or pictures.
    pub const fn new(name: String, picture: PictureSize, frames: usize) -> Self {
        Self {
            name,
            picture,
            frame_rate: None,
            camera: None,
            frames,
            detections: None,
            screen: None,
            truth: None,
            pictures: Vec::new(),
            file_names: Vec::new(),
            label_names: Vec::new(),
            ignored: Vec::new(),
            pass: None,
            classes: Evaluated::Road,
            unusable: Vec::new(),
            places: Vec::new(),
        }
    }

    /// Keeps `rate` frames per second, as if the camera were slower, and drops what a pass has kept; leaves the clip as
    /// it is, if its rate is not known or not higher.
    pub fn thinned(mut self, rate: f64) -> Self {
        let Some(own) = self.frame_rate.filter(|own| *own > rate) else {
            return self;
        };
        let selection = FrameSelection::new(own, rate);
        self.detections = self.detections.map(|frames| selected(frames, selection));
        self.screen = self.screen.map(|frames| selected(frames, selection));
        self.truth = self.truth.map(|frames| selected(frames, selection));
        self.ignored = selected(self.ignored, selection);
        self.pictures = selected(self.pictures, selection);
        self.pass = None;
        self.frames = (0..self.frames).filter(|frame| selection.takes(*frame as u64)).count();
        self.frame_rate = Some(rate);
        self
    }

    /// The number of frames that nobody labelled.
    pub fn unlabelled(&self) -> usize {
        unlabelled(&self.ignored)
    }

    /// The number of boxes of its ground truth.
    pub fn truth_boxes(&self) -> usize {
        self.truth.iter().flatten().map(Vec::len).sum()
    }

    /// Marks a place on a frame as not to be judged.
    pub(crate) fn ignore(&mut self, frame: usize, ignored: Ignored) {
        if self.ignored.len() <= frame {
            self.ignored.resize(self.frames.max(frame + 1), Vec::new());
        }
        self.ignored[frame].push(ignored);
    }
}

/// The entries of a list of frames that the selection takes.
fn selected<T>(frames: Vec<T>, selection: FrameSelection) -> Vec<T> {
    let mut taken = Vec::new();
    for (index, frame) in (0..).zip(frames) {
        if selection.takes(index) {
            taken.push(frame);
        }
    }
    taken
}

/// The clips of a data set, and a report on reading them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DataSet {
    /// The clips that can be evaluated.
    pub clips: Vec<Clip>,
    /// What was left out, and notes on the data.
    pub report: LoadReport,
}

/// The reason that a row or a clip was left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LeftOut {
    /// The label has no box: it is a polygon, a line, or one of the whole picture.
    NoBox,
    /// A coordinate or score is NaN or infinite.
    NotFinite,
    /// The box has no area: right edge not right of the left one, or bottom not below top.
    EmptyBox,
    /// The box lies wholly outside the picture.
    OutsidePicture,
    /// The confidence is below 0 or above 1.
    ConfidenceRange,
    /// The class is not in the mapping.
    UnmappedClass,
    /// The data set marks it as not to be judged.
    IgnoredRegion,
    /// The data set does not judge it, and does not excuse boxes on it either.
    Unjudged,
    /// The clip has no frames.
    EmptyClip,
}

impl LeftOut {
    /// The reason as text.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::NoBox => "label without `box2d`",
            Self::NotFinite => "coordinate or score not a finite number",
            Self::EmptyBox => "box inverted or without area",
            Self::OutsidePicture => "box wholly outside the picture",
            Self::ConfidenceRange => "confidence outside 0 to 1",
            Self::UnmappedClass => "class not mapped",
            Self::IgnoredRegion => "marked as not to be judged (crowd, distractor, region)",
            Self::Unjudged => "not looked for, and a box on it is wrong, as MOTChallenge does",
            Self::EmptyClip => "clip without frames",
        }
    }
}

/// The rows and clips that a reader left out, and notes on the data.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LoadReport {
    /// The number of rows left out for each reason, and where the first one is: `file:line` or `file, what`.
    pub left_out: BTreeMap<LeftOut, (usize, String)>,
    /// The number of rows of each class outside the mapping.
    pub unmapped_classes: BTreeMap<String, usize>,
    /// The number of boxes that extend beyond the picture; they are kept unchanged.
    pub reaching_outside: usize,
    /// Clips whose ground truth is of some classes only.
    pub partly_labelled: usize,
    /// Other remarks: clips without ground truth, clips without a single detection.
    pub notes: Vec<String>,
}

impl LoadReport {
    /// Counts a row that is left out; `place` is called only for the first one with this reason.
    pub(crate) fn leave_out(&mut self, reason: LeftOut, place: impl FnOnce() -> String) {
        let (count, _) = self.left_out.entry(reason).or_insert_with(|| (0, place()));
        *count += 1;
    }

    /// Counts a row of a class outside the mapping.
    pub(crate) fn leave_out_class(&mut self, class: &str, place: impl FnOnce() -> String) {
        self.leave_out(LeftOut::UnmappedClass, place);
        *self.unmapped_classes.entry(class.to_owned()).or_default() += 1;
    }

    /// Counts a place that is marked as not to be judged, and returns it if it is a place.
    pub(crate) fn mark(
        &mut self,
        corners: Corners,
        class: Option<ClassId>,
        mark: Mark,
        picture: PictureSize,
        place: impl FnOnce() -> String,
    ) -> Option<Ignored> {
        if let Some(reason) = self.check(corners, picture) {
            self.leave_out(reason, place);
            return None;
        }
        let reason = match mark {
            Mark::Unjudged => LeftOut::Unjudged,
            _ => LeftOut::IgnoredRegion,
        };
        self.leave_out(reason, place);
        Some(Ignored {
            corners,
            class,
            mark,
        })
    }

    /// Returns the box if it is valid; otherwise counts it under the reason to leave it out.
    pub(crate) fn keep(
        &mut self,
        labelled: &LabelledBox<'_>,
        picture: PictureSize,
        place: impl FnOnce() -> String,
    ) -> Option<ScoredBox> {
        let confidence = labelled.confidence;
        let reason = if let Some(of_corners) = self.check(labelled.corners, picture) {
            Some(of_corners)
        } else if !confidence.is_finite() {
            Some(LeftOut::NotFinite)
        } else if !(0.0..=1.0).contains(&confidence) {
            Some(LeftOut::ConfidenceRange)
        } else {
            None
        };
        if let Some(reason) = reason {
            self.leave_out(reason, place);
            return None;
        }
        let Ok(class) = labelled.class else {
            self.leave_out_class(&labelled.class_name, place);
            return None;
        };
        Some(ScoredBox {
            corners: labelled.corners,
            class,
            confidence,
            object: labelled.object,
        })
    }

    /// Makes sure that there are `boxes` of ground truth to judge by.
    ///
    /// # Errors
    /// [`EvalError`] when there are none, with what was left out.
    pub fn check_boxes(&self, boxes: usize) -> Result<(), EvalError> {
        if boxes > 0 {
            return Ok(());
        }
        let mut said = vec!["the ground truth has no box to judge by".to_owned()];
        said.extend(self.lines());
        Err(EvalError::new(said.join("; ")))
    }

    /// The report as text, one line per entry; empty if there is nothing to report.
    pub fn lines(&self) -> Vec<String> {
        let mut lines: Vec<String> = self
            .left_out
            .iter()
            .map(|(reason, (count, first))| {
                format!("left out {count}: {} (first: {first})", reason.as_str())
            })
            .collect();
        if !self.unmapped_classes.is_empty() {
            let names: Vec<String> = self
                .unmapped_classes
                .iter()
                .map(|(name, count)| format!("{name} {count}"))
                .collect();
            lines.push(format!("classes not mapped: {}", names.join(", ")));
        }
        if self.reaching_outside > 0 {
            lines.push(format!(
                "kept unchanged: {} boxes that extend beyond the picture",
                self.reaching_outside
            ));
        }
        if self.partly_labelled > 0 {
            lines.push(format!(
                "labelled for some classes only: {}; boxes of other classes are not judged there",
                counted(self.partly_labelled, "clip")
            ));
        }
        lines.extend(self.notes.iter().cloned());
        lines
    }

    /// Returns the reason to leave out a box in pixels, if there is one, and counts boxes that extend beyond the
    /// picture.
    pub(crate) fn check(&mut self, corners: Corners, picture: PictureSize) -> Option<LeftOut> {
        let numbers = [corners.x1, corners.y1, corners.x2, corners.y2];
        if numbers.iter().any(|number| !number.is_finite()) {
            return Some(LeftOut::NotFinite);
        }
        if corners.x2 <= corners.x1 || corners.y2 <= corners.y1 {
            return Some(LeftOut::EmptyBox);
        }
        let (width, height) = (f64::from(picture.width), f64::from(picture.height));
        if corners.x2 <= 0.0 || corners.y2 <= 0.0 || corners.x1 >= width || corners.y1 >= height {
            return Some(LeftOut::OutsidePicture);
        }
        if corners.x1 < 0.0 || corners.y1 < 0.0 || corners.x2 > width || corners.y2 > height {
            self.reaching_outside += 1;
        }
        None
    }
}

/// The confidence of a box of ground truth.
pub(crate) const TRUTH_CONFIDENCE: f64 = 1.0;

/// A box from a file, before it is checked.
pub(crate) struct LabelledBox<'a> {
    /// In pixels.
    pub corners: Corners,
    /// The class, or the reason that it is not evaluated.
    pub class: Result<ClassId, LeftOut>,
    /// The file's name for the class.
    pub class_name: Cow<'a, str>,
    /// 0 to 1; that of ground truth is [`TRUTH_CONFIDENCE`].
    pub confidence: f64,
    /// Number of the object, the same in every frame that shows it.
    pub object: Option<u64>,
}

impl DataSet {
    /// Adds a clip, and notes if boxes are missing; a clip without frames is only counted. The name is made unique and
    /// valid as a file name.
    pub(crate) fn push(&mut self, mut clip: Clip) {
        let plain = clip.name.replace(['/', '\\', ':'], "-");
        // Nothing is left of a name of dots, and that is no name for a file.
        let is_taken =
            |name: &str| name.is_empty() || self.clips.iter().any(|other| other.name == name);
        clip.name = unused_name(plain.trim_start_matches('.'), is_taken);
        if clip.frames == 0 {
            let name = clip.name.clone();
            self.report.leave_out(LeftOut::EmptyClip, || name);
            return;
        }
        if let Some(detections) = &clip.detections
            && detections.iter().all(Vec::is_empty)
        {
            self.report
                .notes
                .push(format!("{}: the whole clip has no detections", clip.name));
        }
        if clip.truth.is_none() {
            self.report.notes.push(format!(
                "{}: no ground truth, so its accuracy is not computed",
                clip.name
            ));
        } else if clip.truth.iter().flatten().all(Vec::is_empty) {
            self.report.notes.push(format!(
                "{}: ground truth without a single box, so its accuracy is undefined",
                clip.name
            ));
        }
        self.clips.push(clip);
    }

    /// Applies `rules`, and gives clips `rate` frames per second in place of the data's own.
    pub fn judged_by(mut self, rules: Rules, rate: Option<f64>) -> Self {
        for clip in &mut self.clips {
            if rules == Rules::Paper {
                only_unlabelled(&mut clip.ignored);
            }
            clip.frame_rate = rate.or(clip.frame_rate);
        }
        self
    }

    /// Leaves out the clips without stored detections, with a note for each.
    ///
    /// # Errors
    /// When no clip is left.
    pub fn only_with_detections(mut self, path: &Path) -> Result<Self, EvalError> {
        let (with, without): (Vec<Clip>, Vec<Clip>) =
            self.clips.into_iter().partition(|clip| clip.detections.is_some());
        self.clips = with;
        if self.clips.is_empty() {
            return Err(EvalError::content(
                path,
                "there is ground truth but no stored detections: give some with --detections, or \
                 evaluate the pictures with a real detector",
            ));
        }
        self.report.notes.extend(without.iter().map(|clip| {
            format!(
                "{}: ground truth without stored detections, left out",
                clip.name
            )
        }));
        Ok(self)
    }

    /// Fails unless there is a clip to evaluate; `expected` is what the layout has, with an example.
    pub(crate) fn nonempty(self, path: &Path, expected: &str) -> Result<Self, EvalError> {
        if self.clips.is_empty() {
            let said = self.report.lines().join("; ");
            let what =
                format!("no clip to evaluate was found here; expected is {expected}. {said}");
            return Err(EvalError::content(path, what.trim_end()));
        }
        Ok(self)
    }
}

/// Lists the JPEG and PNG files of a folder in order; none if the folder does not exist.
fn pictures_in(folder: &Path) -> Vec<PathBuf> {
    if folder.is_dir() {
        picture_files(folder).unwrap_or_default()
    } else {
        Vec::new()
    }
}

#[cfg(test)]
mod tests;
