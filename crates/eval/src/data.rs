//! Data sets: clips with stored detections, ground truth, or both, one file a layout.
//!
//! Every reader answers with [`Clips`]: the clips, and a count of every row that was left out and why. A
//! file that cannot be what it claims to be (missing, a row with the wrong number of columns, a frame
//! number outside the clip) is an error that names file and line; a row that is well-formed but
//! meaningless (an inverted box, a score that is not a number, a class outside the mapping) is left out,
//! counted and reported.

pub mod bdd100k;
pub mod classes;
pub mod coco;
pub mod kitti;
pub mod mot_challenge;
pub mod recorded;
mod rows;

use crate::average_precision::ScoredBox;
use crate::error::EvalError;
use crate::pictures::Pass;
use albireo_core::detection::ClassId;
use albireo_core::geometry::{Corners, PictureSize};
use albireo_vision::picture::picture_files;
use serde::Serialize;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// One clip of a data set.
#[derive(Clone, Debug, PartialEq)]
pub struct Clip {
    /// Its name, unique in the data set.
    pub name: String,
    /// Size of its pictures.
    pub picture: PictureSize,
    /// Frames per second, where known.
    pub frame_rate: Option<f64>,
    /// Whether the camera is `moving` or `fixed`, where known.
    pub camera: Option<String>,
    /// Number of frames.
    pub frames: usize,
    /// Stored detections as the files have them, one entry per frame in the detector's order; `None` if none are stored.
    pub detections: Option<Vec<Vec<ScoredBox>>>,
    /// What a real empty-scene screen said of each frame, where one was asked: whether it is empty, or
    /// nothing if it could not say.
    pub screen: Option<Vec<Option<bool>>>,
    /// Ground truth, one entry per frame; `None` if there is none.
    pub truth: Option<Vec<Vec<ScoredBox>>>,
    /// The clip's pictures in order, if they are files.
    pub pictures: Vec<PathBuf>,
    /// Regions whose objects the ground truth leaves out, one entry per frame; empty where the data set marks none.
    pub ignored: Vec<Vec<Corners>>,
    /// What was kept of the pictures where a detector looked at them in this run.
    pub pass: Option<Pass>,
}

impl Clip {
    /// A clip without anything but its frames.
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
            ignored: Vec::new(),
            pass: None,
        }
    }
}

/// A data set as read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Clips {
    /// The clips that can be evaluated.
    pub clips: Vec<Clip>,
    /// What was left out or is worth a word.
    pub report: LoadReport,
}

/// Why a row or a clip was left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LeftOut {
    /// A coordinate or score is NaN or infinite.
    NotFinite,
    /// The box has no area: right edge not right of the left one, or bottom not below top.
    EmptyBox,
    /// The box lies wholly outside the picture.
    OutsidePicture,
    /// A confidence below 0 or above 1.
    ConfidenceRange,
    /// The class is not in the mapping.
    UnmappedClass,
    /// A region the data set marks as not to be judged.
    IgnoredRegion,
    /// A clip with no frames.
    EmptyClip,
}

impl LeftOut {
    /// In words.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::NotFinite => "coordinate or score not a finite number",
            Self::EmptyBox => "box inverted or without area",
            Self::OutsidePicture => "box wholly outside the picture",
            Self::ConfidenceRange => "confidence outside 0 to 1",
            Self::UnmappedClass => "class not mapped",
            Self::IgnoredRegion => "region marked as not to be judged",
            Self::EmptyClip => "clip without frames",
        }
    }
}

/// What a reader left out, and notes about the data.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LoadReport {
    /// Rows by reason, with the first place of each: `file:line` or `file, what`.
    pub left_out: BTreeMap<LeftOut, (usize, String)>,
    /// Rows by class name, for classes outside the mapping.
    pub unmapped_classes: BTreeMap<String, usize>,
    /// Boxes reaching over the picture's edge: kept as they are.
    pub reaching_outside: usize,
    /// Anything else worth knowing: clips without ground truth, clips without a single detection.
    pub notes: Vec<String>,
}

impl LoadReport {
    /// Counts one row left out; `place` is only asked for the first of its kind.
    pub(crate) fn leave_out(&mut self, reason: LeftOut, place: impl FnOnce() -> String) {
        let counted = self.left_out.entry(reason);
        counted.or_insert_with(|| (0, place())).0 += 1;
    }

    /// Counts one row of a class outside the mapping.
    pub(crate) fn leave_out_class(&mut self, class: &str, place: impl FnOnce() -> String) {
        self.leave_out(LeftOut::UnmappedClass, place);
        *self.unmapped_classes.entry(class.to_owned()).or_default() += 1;
    }

    /// The box, if it is kept; one that is not is counted under its reason.
    pub(crate) fn keep(
        &mut self,
        labelled: &LabelledBox<'_>,
        picture: PictureSize,
        place: impl FnOnce() -> String,
    ) -> Option<ScoredBox> {
        let confidence = labelled.confidence;
        let reason = match labelled.class {
            Err(LeftOut::IgnoredRegion) => Some(LeftOut::IgnoredRegion),
            _ => self
                .check(labelled.corners, picture)
                .or_else(|| (!confidence.is_finite()).then_some(LeftOut::NotFinite))
                .or_else(|| {
                    (!(0.0..=1.0).contains(&confidence)).then_some(LeftOut::ConfidenceRange)
                }),
        };
        match (reason, labelled.class) {
            (None, Ok(class)) => {
                return Some(ScoredBox {
                    corners: labelled.corners,
                    class,
                    confidence,
                    object: labelled.object,
                });
            }
            (None, Err(_)) => self.leave_out_class(&labelled.class_name, place),
            (Some(reason), _) => self.leave_out(reason, place),
        }
        None
    }

    /// The report in words, one line an entry; empty when there is nothing to say.
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
                "kept as they are: {} boxes reaching over the picture's edge",
                self.reaching_outside
            ));
        }
        lines.extend(self.notes.iter().cloned());
        lines
    }

    /// The reason to leave out a box in pixels, if there is one. Boxes that reach outside the picture are counted.
    pub fn check(&mut self, corners: Corners, picture: PictureSize) -> Option<LeftOut> {
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

/// A box as a file has it.
pub(crate) struct LabelledBox<'a> {
    /// In pixels.
    pub corners: Corners,
    /// What the class is here, or why it is none that is evaluated.
    pub class: Result<ClassId, LeftOut>,
    /// What the file calls the class.
    pub class_name: Cow<'a, str>,
    /// 0 to 1; that of ground truth is 1.
    pub confidence: f64,
    /// Which object, the same number in every frame that shows it.
    pub object: Option<u64>,
}

impl Clips {
    /// Adds a clip, or counts it as empty; notes what it lacks. Its name is made fit for a file's name and
    /// unlike the others'.
    pub(crate) fn push(&mut self, mut clip: Clip) {
        let plain = clip.name.replace(['/', '\\', ':'], "-");
        clip.name = plain.trim_start_matches('.').to_owned();
        let taken = |name: &str| self.clips.iter().any(|other| other.name == name);
        if clip.name.is_empty() || taken(&clip.name) {
            let base = std::mem::take(&mut clip.name);
            let mut number = 2..;
            while clip.name.is_empty() || taken(&clip.name) {
                clip.name = format!("{base}-{}", number.next().unwrap_or_default());
            }
        }
        if clip.frames == 0 {
            let name = clip.name.clone();
            self.report.leave_out(LeftOut::EmptyClip, || name);
            return;
        }
        if let Some(detections) = &clip.detections
            && detections.iter().all(Vec::is_empty)
        {
            self.report.notes.push(format!(
                "{}: not one detection in the whole clip",
                clip.name
            ));
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

    /// Leaves out the clips without stored detections, with a note for each.
    ///
    /// # Errors
    /// When none is left.
    pub fn only_with_detections(mut self, path: &Path) -> Result<Self, EvalError> {
        let (with, without): (Vec<Clip>, Vec<Clip>) = self
            .clips
            .into_iter()
            .partition(|clip| clip.detections.is_some());
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

    /// Fails unless there is a clip to evaluate.
    pub(crate) fn nonempty(self, path: &Path) -> Result<Self, EvalError> {
        if self.clips.is_empty() {
            let said = self.report.lines().join("; ");
            return Err(EvalError::content(
                path,
                format!("no clip to evaluate was found here. {said}"),
            ));
        }
        Ok(self)
    }
}

/// What a folder holds, sorted, if `wanted`.
fn entries(folder: &Path, wanted: impl Fn(&Path) -> bool) -> std::io::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder)?;
    let mut paths: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| wanted(path))
        .collect();
    paths.sort();
    Ok(paths)
}

fn has_extension(path: &Path, wanted: &[&str]) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str());
    extension.is_some_and(|extension| {
        let mut wanted = wanted.iter();
        wanted.any(|wanted| extension.eq_ignore_ascii_case(wanted))
    })
}

/// The JPEG and PNG files of a folder in order; none if there is no such folder.
fn pictures_in(folder: &Path) -> Vec<PathBuf> {
    match folder.is_dir() {
        true => picture_files(folder).unwrap_or_default(),
        false => Vec::new(),
    }
}

#[cfg(test)]
mod tests;
