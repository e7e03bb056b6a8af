//! Gives a clip of pictures its ground truth: from a file, or from Vanilla's own output.

use super::classes::{self, Evaluated};
use super::{
    Clip, DataSet, LoadReport, Rules, bdd100k, coco, kitti, mot_challenge, recorded, visdrone,
};
use crate::boxes::ScoredBox;
use crate::error::EvalError;
use albireo_core::geometry::PictureSize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The layout of ground truth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum TruthFormat {
    /// JSON of BDD100K MOT (box_track_20), or any labels in the Scalabel form.
    Bdd100k,
    /// A MOTChallenge sequence, or a folder of sequences.
    #[cfg_attr(feature = "cli", value(name = "motchallenge"))]
    MotChallenge,
    /// KITTI tracking: a folder with label_02/.
    Kitti,
    /// COCO JSON with images and annotations.
    Coco,
    /// VisDrone: a folder with annotations/.
    #[cfg_attr(feature = "cli", value(name = "visdrone"))]
    VisDrone,
    /// The layout of `--save-detections`: a folder with sequences.json and groundtruth/.
    Recorded,
}

/// A size in which every box of labels fits whose pictures are not known yet.
const UNKNOWN_SIZE: PictureSize = PictureSize::new(u32::MAX, u32::MAX);

/// The ground truth of all clips. The files are read once.
#[derive(Clone, Debug)]
pub struct GroundTruth {
    format: TruthFormat,
    classes: Evaluated,
    /// The ground truth by the clip's name, and the number of its file.
    clips: BTreeMap<String, (usize, Clip)>,
    files: Vec<TruthFile>,
}

/// A file or folder of ground truth.
#[derive(Clone, Debug)]
struct TruthFile {
    path: PathBuf,
    /// What was left out of it, until the report of the run has it.
    report: Option<LoadReport>,
}

impl GroundTruth {
    /// Reads files or folders of one layout.
    ///
    /// # Errors
    /// [`EvalError`] when one cannot be read.
    pub fn read(paths: &[PathBuf], format: TruthFormat, rules: Rules) -> Result<Self, EvalError> {
        Self::read_as(paths, format, rules, &Evaluated::Road)
    }

    /// [`read`](Self::read) for a model with the classes `names`: of BDD100K's and the other benchmarks' ground truth the six
    /// of the paper, of COCO's and of labels of one's own all that the model has.
    ///
    /// # Errors
    /// Like [`read`](Self::read), and when the model has none of its classes.
    pub fn for_model(
        paths: &[PathBuf],
        format: TruthFormat,
        rules: Rules,
        names: &[String],
    ) -> Result<Self, EvalError> {
        let own = Evaluated::Own(names.into());
        if format == TruthFormat::Coco {
            return Self::read_as(paths, format, rules, &own)?.with_boxes(names);
        }
        let truth = Self::read_as(paths, format, rules, &Evaluated::Road)?;
        let is_foreign = truth.unmapped().any(|(name, _)| classes::is_foreign_to_bdd100k(name));
        if format == TruthFormat::Bdd100k && is_foreign {
            return Self::read_as(paths, format, rules, &own)?.with_boxes(names);
        }
        Ok(truth)
    }

    /// The classes of other names than those that are evaluated, with the number of their boxes.
    fn unmapped(&self) -> impl Iterator<Item = (&String, &usize)> {
        self.files
            .iter()
            .flat_map(|file| &file.report)
            .flat_map(|report| &report.unmapped_classes)
    }

    /// Refuses ground truth of which no box has a class of the model.
    fn with_boxes(self, names: &[String]) -> Result<Self, EvalError> {
        let has_boxes =
            |(_, clip): &(usize, Clip)| clip.truth.iter().flatten().any(|of| !of.is_empty());
        let others: Vec<&str> = self.unmapped().map(|(name, _)| name.as_str()).take(8).collect();
        if others.is_empty() || self.clips.values().any(has_boxes) {
            return Ok(self);
        }
        let own: Vec<&str> = names.iter().map(String::as_str).take(8).collect();
        Err(EvalError::new(format!(
            "the model has none of the classes of the ground truth: {}; its own are {}. Are these the right labels, or the \
             right names (--class-names)?",
            others.join(", "),
            own.join(", ")
        )))
    }

    /// The classes of its boxes.
    pub const fn classes(&self) -> &Evaluated {
        &self.classes
    }

    fn read_as(
        paths: &[PathBuf],
        format: TruthFormat,
        rules: Rules,
        classes: &Evaluated,
    ) -> Result<Self, EvalError> {
        let mut clips = BTreeMap::new();
        let mut files = Vec::new();
        for path in paths {
            let data = read(path, format, rules, classes)?.judged_by(rules, None);
            for clip in data.clips {
                clips.entry(clip.name.clone()).or_insert((files.len(), clip));
            }
            files.push(TruthFile {
                path: path.clone(),
                report: Some(data.report),
            });
        }
        // A recording says itself whose classes its numbers are.
        let recorded = clips.values().next().filter(|_| format == TruthFormat::Recorded);
        let classes = recorded.map_or(classes, |(_, clip): &(usize, Clip)| &clip.classes).clone();
        Ok(Self {
            format,
            classes,
            clips,
            files,
        })
    }

    /// Makes sure that it is for at least one of the clips `names`.
    ///
    /// # Errors
    /// [`EvalError`] when it is for none of them.
    pub fn check(&self, names: &[String]) -> Result<(), EvalError> {
        let alone = self.clips.len() == 1 && names.len() == 1;
        if alone || names.iter().any(|name| self.clips.contains_key(name)) {
            return Ok(());
        }
        let truths: Vec<&str> = self.clips.keys().map(String::as_str).take(8).collect();
        Err(EvalError::new(format!(
            "the ground truth is for the clips {}, and none of them is evaluated here ({}): a clip is named after its file",
            truths.join(", "),
            names.join(", ")
        )))
    }

    /// True if it has the clip `name`; `alone` as for [`attach_to`](Self::attach_to).
    pub fn has(&self, name: &str, alone: bool) -> bool {
        self.name_of(name, alone).is_some()
    }

    /// The frames per second of the clip `name`, if the ground truth knows them; `alone` as for
    /// [`attach_to`](Self::attach_to).
    pub fn rate(&self, name: &str, alone: bool) -> Option<f64> {
        let (_, clip) = &self.clips[self.name_of(name, alone)?];
        clip.frame_rate
    }

    /// The name under which the ground truth of the clip `name` is stored.
    fn name_of<'a>(&'a self, name: &'a str, alone: bool) -> Option<&'a str> {
        if self.clips.contains_key(name) {
            return Some(name);
        }
        let only = self.clips.keys().next().filter(|_| alone && self.clips.len() == 1);
        only.map(String::as_str)
    }

    /// Gives `clip` the ground truth of its name, if there is any, or the only one there is if it is the only clip
    /// (`alone`). `is_whole` is false if the clip was cut to its first frames. `report` counts what is left out.
    ///
    /// # Errors
    /// [`EvalError`] when it is for other pictures.
    pub fn attach_to(
        &mut self,
        clip: &mut Clip,
        alone: bool,
        is_whole: bool,
        report: &mut LoadReport,
    ) -> Result<(), EvalError> {
        let Some(name) = self.name_of(&clip.name, alone).map(str::to_owned) else {
            return Ok(());
        };
        let (file, found) = &self.clips[&name];
        let file = &mut self.files[*file];
        let Some(mut truth) = found.truth.clone() else {
            return Ok(());
        };
        let wrong = |what: String| {
            let path = file.path.display();
            EvalError::new(format!(
                "{}: its ground truth ({path}) is for {what}",
                clip.name
            ))
        };
        // Only these layouts say how many frames they are for; the others end with the last object.
        let counted = matches!(
            self.format,
            TruthFormat::MotChallenge | TruthFormat::Bdd100k | TruthFormat::Recorded
        );
        let pictures = clip.frames + clip.unusable.len();
        let is_longer = is_whole && truth.len() > pictures;
        if is_longer || (counted && truth.len() < pictures) {
            return Err(wrong(format!(
                "{} frames, the clip has {pictures}: are they the same recording, at the same frame rate?",
                truth.len(),
            )));
        }
        if found.picture != clip.picture && knows_its_pictures(self.format) {
            return Err(wrong(format!(
                "pictures of {}, the clip's are {}",
                found.picture, clip.picture
            )));
        }
        // A file's rows are counted once, even if it contains several clips.
        if let Some(left_out) = file.report.take() {
            merge(report, left_out);
        }
        truth.resize(pictures, Vec::new());
        truth = usable(truth, &clip.unusable);
        if !knows_its_pictures(self.format) {
            for (frame, known) in truth.iter_mut().enumerate() {
                known.retain(|known| {
                    let reason = report.check(known.corners, clip.picture);
                    if let Some(reason) = reason {
                        report.leave_out(reason, || format!("ground truth, frame {frame}"));
                    }
                    reason.is_none()
                });
            }
        }
        clip.truth = Some(truth);
        clip.ignored = usable(found.ignored.clone(), &clip.unusable);
        clip.ignored.truncate(clip.frames);
        Ok(())
    }
}

/// The entries of `frames` whose pictures can be used.
fn usable<T>(frames: Vec<T>, unusable: &[usize]) -> Vec<T> {
    let frames = frames.into_iter().enumerate();
    frames
        .filter(|(place, _)| !unusable.contains(place))
        .map(|(_, frame)| frame)
        .collect()
}

/// True if the layout says how large its pictures are.
fn knows_its_pictures(format: TruthFormat) -> bool {
    match format {
        TruthFormat::MotChallenge | TruthFormat::Coco | TruthFormat::Recorded => true,
        TruthFormat::Bdd100k | TruthFormat::Kitti | TruthFormat::VisDrone => false,
    }
}

fn read(
    path: &Path,
    format: TruthFormat,
    rules: Rules,
    classes: &Evaluated,
) -> Result<DataSet, EvalError> {
    match format {
        TruthFormat::Bdd100k => {
            let source = bdd100k::Source {
                truth: Some(path),
                detections: None,
                picture: UNKNOWN_SIZE,
                frame_rate: Some(bdd100k::BDD100K_FRAME_RATE),
                rules,
            };
            bdd100k::read_as(&source, classes)
        }
        TruthFormat::MotChallenge => mot_challenge::read(path),
        TruthFormat::Kitti => kitti::read(path),
        TruthFormat::Coco => coco::read_as(path, None, classes),
        TruthFormat::VisDrone => visdrone::read(path, UNKNOWN_SIZE),
        TruthFormat::Recorded => recorded::read(path),
    }
}

/// Adds the counts of a reader of ground truth. Its notes are about detections, which ground truth does not have.
fn merge(report: &mut LoadReport, other: LoadReport) {
    for (reason, (count, place)) in other.left_out {
        report.left_out.entry(reason).or_insert((0, place)).0 += count;
    }
    for (class, count) in other.unmapped_classes {
        *report.unmapped_classes.entry(class).or_default() += count;
    }
    report.reaching_outside += other.reaching_outside;
}

/// Returns Vanilla's own output as ground truth: the clip's detections from `confidence` on. It measures how far a
/// policy departs from running the detector on every frame, not how right either is.
pub fn vanilla_as_truth(clip: &Clip, confidence: f64) -> Vec<Vec<ScoredBox>> {
    let sure = |frame: &Vec<ScoredBox>| {
        let sure = frame.iter().filter(|found| found.confidence >= confidence);
        sure.copied().collect()
    };
    clip.detections.iter().flatten().map(sure).collect()
}
