//! Gives a clip of pictures its ground truth: from a file, or from Vanilla's own output.

use super::{Clip, DataSet, LoadReport, bdd100k, coco, kitti, mot_challenge, recorded};
use crate::boxes::ScoredBox;
use crate::error::EvalError;
use albireo_core::geometry::PictureSize;
use std::collections::BTreeSet;
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
    /// The layout of `--save-detections`: a folder with sequences.json and groundtruth/.
    Recorded,
}

/// Files of ground truth.
#[derive(Clone, Debug)]
pub struct GroundTruth {
    paths: Vec<PathBuf>,
    format: TruthFormat,
    /// Paths whose report has been added to the run's.
    reported: BTreeSet<PathBuf>,
}

impl GroundTruth {
    /// Takes files or folders of one layout.
    pub fn new(paths: Vec<PathBuf>, format: TruthFormat) -> Self {
        Self {
            paths,
            format,
            reported: BTreeSet::new(),
        }
    }

    /// Reads all files, to find errors before the pictures are processed.
    ///
    /// # Errors
    /// [`EvalError`] when one cannot be read, or none is for any of the clips `names`.
    pub fn check(&self, names: &[String]) -> Result<(), EvalError> {
        let mut truths = Vec::new();
        for path in &self.paths {
            let data = self.read(path, bdd100k::BDD100K_SIZE)?;
            truths.extend(data.clips.into_iter().map(|clip| clip.name));
        }
        let alone = truths.len() == 1 && names.len() == 1;
        if alone || names.iter().any(|name| truths.contains(name)) {
            return Ok(());
        }
        truths.truncate(8);
        Err(EvalError::new(format!(
            "the ground truth is for the clips {}, and none of them is evaluated here ({}): a clip is named after its file",
            truths.join(", "),
            names.join(", ")
        )))
    }

    /// Gives `clip` the ground truth of its name, if there is any, or the only one there is if it is the only clip
    /// (`alone`). `report` counts what is left out.
    ///
    /// # Errors
    /// [`EvalError`] when it cannot be read or is for other pictures.
    pub fn attach_to(
        &mut self,
        clip: &mut Clip,
        alone: bool,
        report: &mut LoadReport,
    ) -> Result<(), EvalError> {
        for path in &self.paths {
            let mut read = self.read(path, clip.picture)?;
            let place = read.clips.iter().position(|truth| truth.name == clip.name);
            let only = alone && self.paths.len() == 1 && read.clips.len() == 1;
            let Some(index) = place.or(only.then_some(0)) else {
                continue;
            };
            let found = read.clips.swap_remove(index);
            let Some(mut truth) = found.truth else {
                continue;
            };
            let first = self.reported.insert(path.clone());
            let wrong = |what: String| {
                let (clip, path) = (&clip.name, path.display());
                EvalError::new(format!("{clip}: its ground truth ({path}) is for {what}"))
            };
            // Only these layouts say how many frames they are for; the others end with the last object.
            let counted = matches!(
                self.format,
                TruthFormat::MotChallenge | TruthFormat::Bdd100k | TruthFormat::Recorded
            );
            if truth.len() > clip.frames || (counted && truth.len() < clip.frames) {
                return Err(wrong(format!(
                    "{} frames, the clip has {}: are they the same recording, at the same frame rate?",
                    truth.len(),
                    clip.frames
                )));
            }
            // KITTI's labels have no picture size; the reader assumes the usual one if there are no pictures.
            if found.picture != clip.picture && self.format != TruthFormat::Kitti {
                let (truth, clip) = (found.picture, clip.picture);
                return Err(wrong(format!("pictures of {truth}, the clip's are {clip}")));
            }
            truth.resize(clip.frames, Vec::new());
            // A file's rows are counted once, even if it contains several clips.
            if first {
                merge(report, read.report);
            }
            (clip.truth, clip.ignored) = (Some(truth), found.ignored);
            return Ok(());
        }
        Ok(())
    }

    fn read(&self, path: &Path, picture: PictureSize) -> Result<DataSet, EvalError> {
        match self.format {
            TruthFormat::Bdd100k => bdd100k::read(&bdd100k::Source {
                truth: Some(path),
                detections: None,
                picture,
                frame_rate: None,
            }),
            TruthFormat::MotChallenge => mot_challenge::read(path),
            TruthFormat::Kitti => kitti::read(path),
            TruthFormat::Coco => coco::read(path, None),
            TruthFormat::Recorded => recorded::read(path),
        }
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
