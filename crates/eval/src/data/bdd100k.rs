//! Reads BDD100K multiple object tracking (`box_track_20`) and other labels in the Scalabel format: JSON with a
//! list of frames, or an object with `frames`; each frame has its video, index and labels.
//!
//! Both spellings of the keys are read: `videoName`/`frameIndex` and the older `video_name`/`index`. A file
//! of predictions has the same form and a `score` in each label.
//!
//! Frames without an index are in the order of the numbers in their names, as pictures are, or else in that of the
//! list.
//!
//! Labels with a gap, a frame that they do not list although they list one behind it, are of some frames only: what
//! they do not list is not judged. A frame that is listed without labels has no objects. Labels that name pictures and
//! no video, as those of the paper's authors, need not list the last ones, either.
//!
//! Crowds, labels with the attribute `ignored`, and the categories "other person", "other vehicle" and "trailer" are
//! regions in which boxes are not judged, as in BDD100K's own evaluation and TrackEval's. The paper's evaluator makes
//! no exception: under [`Rules::Paper`] crowds are ground truth like any other box.

use super::classes::Evaluated;
use super::picture_name::NumberedName;
use super::rows::MAX_FRAMES;
use super::{Clip, DataSet, LabelledBox, LeftOut, LoadReport, Rules, TRUTH_CONFIDENCE};
use crate::boxes::ScoredBox;
use crate::error::EvalError;
use crate::files::{entries, has_extension, read_text};
use crate::judge::{Ignored, Mark};
use albireo_core::geometry::{Corners, PictureSize};
use serde::de::IgnoredAny;
use serde::{Deserialize, Deserializer};
use std::collections::{BTreeMap, BTreeSet, HashMap, btree_map};
use std::path::{Path, PathBuf};

/// Frames per second at which the tracking set is annotated.
pub const BDD100K_FRAME_RATE: f64 = 5.0;

/// Labels whose frames are inside an object.
#[derive(Deserialize)]
struct Export {
    frames: Vec<Frame>,
}

#[derive(Deserialize)]
struct Frame {
    #[serde(default)]
    name: String,
    #[serde(default, rename = "videoName", alias = "video_name")]
    video: Option<String>,
    #[serde(default, rename = "frameIndex", alias = "index")]
    index: Option<usize>,
    /// `None` if the key is missing.
    #[serde(default, deserialize_with = "listed")]
    labels: Option<Vec<Label>>,
    /// What the labels are called in other formats.
    #[serde(default, rename = "frames", alias = "objects")]
    foreign: Option<IgnoredAny>,
}

/// Reads the labels of a frame; BDD100K writes `null` for none.
fn listed<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Vec<Label>>, D::Error> {
    let labels: Option<Vec<Label>> = Option::deserialize(deserializer)?;
    Ok(Some(labels.unwrap_or_default()))
}

#[derive(Deserialize)]
struct Label {
    #[serde(default)]
    id: Option<serde_json::Value>,
    category: String,
    #[serde(default)]
    score: Option<f64>,
    #[serde(default)]
    box2d: Option<Box2d>,
    #[serde(default)]
    attributes: Option<HashMap<String, serde_json::Value>>,
}

/// Categories that BDD100K labels and does not evaluate.
const DISTRACTORS: [&str; 3] = ["other person", "other vehicle", "trailer"];

impl Label {
    /// True if boxes at this label are not judged.
    fn is_region(&self, rules: Rules) -> bool {
        if rules == Rules::Paper {
            return false;
        }
        let is_true = |value: &serde_json::Value| value == true || value.as_str() == Some("true");
        let is_set = |name: &str| {
            self.attributes
                .iter()
                .flatten()
                .any(|(key, value)| key.eq_ignore_ascii_case(name) && is_true(value))
        };
        is_set("crowd") || is_set("ignored") || DISTRACTORS.contains(&self.category.as_str())
    }
}

#[derive(Clone, Copy, Deserialize)]
struct Box2d {
    x1: f64,
    y1: f64,
    x2: f64,
    y2: f64,
}

/// The files to read, and properties of the pictures that the files do not contain.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// Labels: a file, or a folder of files.
    pub truth: Option<&'a Path>,
    /// Predictions: a file, or a folder of files.
    pub detections: Option<&'a Path>,
    /// Size of all pictures.
    pub picture: PictureSize,
    /// Frames per second.
    pub frame_rate: Option<f64>,
    /// How crowds, ignored labels and distractors are judged.
    pub rules: Rules,
}

/// The boxes of a frame, and the regions in which none are judged.
#[derive(Clone, Default)]
struct Labelled {
    /// The name of its picture, empty if there is none.
    name: String,
    boxes: Vec<ScoredBox>,
    regions: Vec<Ignored>,
    /// True if only the picture's name says which frame it is.
    is_by_name: bool,
}

/// Labels of each video's frames, by index.
type Videos = BTreeMap<String, BTreeMap<usize, Labelled>>;

/// Reads labels, predictions or both; clips are the videos named in either.
///
/// # Errors
/// [`EvalError`] for a missing or broken file, a prediction without a score, or a frame that occurs twice.
pub fn read(source: &Source<'_>) -> Result<DataSet, EvalError> {
    read_as(source, &Evaluated::Road)
}

/// [`read`] with the boxes of these classes.
pub(super) fn read_as(source: &Source<'_>, classes: &Evaluated) -> Result<DataSet, EvalError> {
    let mut data = DataSet::default();
    let reading = Reading {
        picture: source.picture,
        rules: source.rules,
        classes,
    };
    let report = &mut data.report;
    let mut truths = Videos::new();
    if let Some(path) = source.truth {
        truths = reading.videos(path, Kind::Truth, report)?;
    }
    let mut found = Videos::new();
    if let Some(path) = source.detections {
        found = reading.videos(path, Kind::Predictions, report)?;
    }
    let names: BTreeSet<String> = truths.keys().chain(found.keys()).cloned().collect();
    for name in names {
        let truth = truths.remove(&name);
        let detections = found.remove(&name);
        let frames = length(truth.as_ref()).max(length(detections.as_ref()));
        let mut clip = Clip {
            frame_rate: source.frame_rate,
            ..Clip::new(name, source.picture, frames)
        };
        if let Some(truth) = truth {
            let are_by_name = truth.values().all(|labelled| labelled.is_by_name);
            if are_by_name {
                clip.places = truth.keys().copied().collect();
            }
            let labelled = length(Some(&truth));
            let has_gap = truth.len() < labelled;
            // Labels that name pictures need not list the last ones, either.
            let ends_early = are_by_name && labelled < frames;
            if has_gap || ends_early {
                for unlisted in (0..frames).filter(|frame| !truth.contains_key(frame)) {
                    clip.ignore(unlisted, Ignored::UNLABELLED);
                }
            }
            for (frame, labelled) in &truth {
                for region in &labelled.regions {
                    clip.ignore(*frame, *region);
                }
            }
            clip.label_names = label_names(&truth);
            clip.truth = Some(spread(truth, frames));
        }
        clip.detections = detections.map(|detections| spread(detections, frames));
        data.push(clip);
    }
    let place = source.truth.or(source.detections).unwrap_or(Path::new("."));
    data.nonempty(
        place,
        "JSON of BDD100K with frames and labels, such as labels/box_track_20/val/b1c66a42-6f7d68ca.json, or a folder of it",
    )
}

fn length<T>(frames: Option<&BTreeMap<usize, T>>) -> usize {
    frames.and_then(BTreeMap::last_key_value).map_or(0, |(index, _)| index + 1)
}

/// The name of each frame's picture, empty for a frame that is not listed; none if one that is listed has none.
fn label_names(by_index: &BTreeMap<usize, Labelled>) -> Vec<String> {
    let mut names = vec![String::new(); length(Some(by_index))];
    for (index, labelled) in by_index {
        if labelled.name.is_empty() {
            return Vec::new();
        }
        names[*index].clone_from(&labelled.name);
    }
    names
}

/// Returns one list of boxes per frame; those of frames that the file does not contain are empty.
fn spread(by_index: BTreeMap<usize, Labelled>, frames: usize) -> Vec<Vec<ScoredBox>> {
    let mut spread = vec![Vec::new(); frames];
    for (index, labelled) in by_index {
        spread[index] = labelled.boxes;
    }
    spread
}

/// What is said of a file of another format.
const NO_FRAMES: &str = "this is not a list of frames in the Scalabel format";

/// Makes sure that these are frames: other formats are lists of objects, too.
///
/// # Errors
/// What they lack, in words.
fn check(frames: &[Frame]) -> Result<(), String> {
    let is_nameless = |frame: &Frame| frame.name.is_empty() && frame.index.is_none();
    let is_no_frame = |frame: &Frame| is_nameless(frame) && frame.labels.is_none();
    if let Some(number) = frames.iter().position(is_no_frame) {
        return Err(format!(
            "{NO_FRAMES}: entry {number} has neither `name` nor `frameIndex` nor `labels`"
        ));
    }
    let is_foreign = |frame: &Frame| frame.labels.is_none() && frame.foreign.is_some();
    if let Some(number) = frames.iter().position(is_foreign) {
        return Err(format!(
            "{NO_FRAMES}: entry {number} has `frames` or `objects` in place of `labels`"
        ));
    }
    Ok(())
}

/// Puts frames without an index into the order of the numbers in their names. A video whose names differ in more than
/// their numbers, such as random ones, keeps the order of the list.
fn sort(frames: &mut [Frame]) {
    let mut patterns: BTreeMap<Option<String>, BTreeSet<String>> = BTreeMap::new();
    for frame in frames.iter() {
        let pattern = NumberedName::of(&frame.name).pattern;
        patterns.entry(frame.video.clone()).or_default().insert(pattern);
    }
    frames.sort_by_cached_key(|frame| {
        let has_one_pattern = patterns.get(&frame.video).is_some_and(|all| all.len() == 1);
        let numbers = NumberedName::of(&frame.name).numbers;
        has_one_pattern.then_some(numbers)
    });
}

/// What a file of labels contains.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Truth,
    /// Each label has a score.
    Predictions,
}

/// What the reader of a file has to know beside it.
#[derive(Clone, Copy)]
struct Reading<'a> {
    picture: PictureSize,
    rules: Rules,
    classes: &'a Evaluated,
}

impl Reading<'_> {
    fn videos(self, path: &Path, kind: Kind, report: &mut LoadReport) -> Result<Videos, EvalError> {
        let mut videos = Videos::new();
        // Some exporters leave out the key `labels` of frames without any.
        let mut are_frames = false;
        let mut first = None;
        for file in json_files(path)? {
            let text = read_text(&file, "give a JSON file of frames or a folder of them")?;
            let parsed = if text.trim_start().starts_with('[') {
                serde_json::from_str(&text)
            } else {
                serde_json::from_str(&text).map(|export: Export| export.frames)
            };
            let mut frames: Vec<Frame> = parsed.map_err(|error| {
                let what = format!("{NO_FRAMES}: {error}");
                EvalError::line(&file, error.line() as u64, what)
            })?;
            check(&frames).map_err(|what| EvalError::content(&file, what))?;
            are_frames |= frames.iter().any(|frame| {
                frame.labels.is_some() || frame.index.is_some() || frame.video.is_some()
            });
            if !frames.is_empty() {
                first.get_or_insert_with(|| file.clone());
            }
            if frames.iter().all(|frame| frame.index.is_none()) {
                sort(&mut frames);
            }
            let stem = file.file_stem().unwrap_or("clip".as_ref()).to_string_lossy();
            for frame in frames {
                let FramePlace {
                    video,
                    index,
                    is_by_name,
                } = frame.place(&stem);
                let by_index = videos.entry(video).or_default();
                let index = index.unwrap_or(by_index.len());
                let btree_map::Entry::Vacant(vacant) = by_index.entry(index) else {
                    let what = format!(
                        "frame {} occurs twice: its video already has the index {index}",
                        frame.name
                    );
                    return Err(EvalError::content(&file, what));
                };
                if index >= MAX_FRAMES {
                    let what = format!(
                        "frame {} has the index {index}, which is too large for a clip",
                        frame.name
                    );
                    return Err(EvalError::content(&file, what));
                }
                let labelled = self.labelled(&file, &frame, kind, report)?;
                vacant.insert(Labelled {
                    name: frame.name,
                    is_by_name,
                    ..labelled
                });
            }
        }
        match first {
            Some(file) if !are_frames => {
                let what =
                    format!("{NO_FRAMES}: no frame has `labels`, `frameIndex` or `videoName`");
                Err(EvalError::content(&file, what))
            }
            _ => Ok(videos),
        }
    }

    /// Reads the labels of a frame, without those that are left out.
    fn labelled(
        self,
        file: &Path,
        frame: &Frame,
        kind: Kind,
        report: &mut LoadReport,
    ) -> Result<Labelled, EvalError> {
        let mut read = Labelled::default();
        for (number, label) in frame.labels.iter().flatten().enumerate() {
            let place = || format!("{}, frame {}, label {number}", file.display(), frame.name);
            let Some(Box2d { x1, y1, x2, y2 }) = label.box2d else {
                report.leave_out(LeftOut::NoBox, place);
                continue;
            };
            let confidence = match (kind, label.score) {
                // Ground truth may have scores, too, which mean nothing.
                (Kind::Truth, _) => TRUTH_CONFIDENCE,
                (Kind::Predictions, Some(score)) => score,
                (Kind::Predictions, None) => {
                    let what = format!(
                        "frame {}, label {number} has no `score`: is this ground truth?",
                        frame.name
                    );
                    return Err(EvalError::content(file, what));
                }
            };
            let corners = Corners { x1, y1, x2, y2 };
            if kind == Kind::Truth && label.is_region(self.rules) {
                let any_class = None;
                let region = report.mark(corners, any_class, Mark::Region, self.picture, place);
                read.regions.extend(region);
                continue;
            }
            let labelled = LabelledBox {
                corners,
                class: self.classes.find(&label.category),
                class_name: label.category.as_str().into(),
                confidence,
                object: label.id.as_ref().and_then(number_of),
            };
            read.boxes.extend(report.keep(&labelled, self.picture, place));
        }
        Ok(read)
    }
}

/// The place of a frame.
struct FramePlace {
    video: String,
    /// `None` if neither an index nor a name says it.
    index: Option<usize>,
    /// True if both are from the name of its picture.
    is_by_name: bool,
}

impl Frame {
    /// Finds the place of the frame. One that names no video, as in the label file of the paper's authors, has it in its
    /// picture's name, `<video>-<7 digits>.jpg` counted from 1, or else belongs to the file's video. Its own index counts
    /// before that of the name.
    fn place(&self, file_stem: &str) -> FramePlace {
        if self.video.is_none()
            && let Some((video, index)) = self.place_by_name()
        {
            return FramePlace {
                video: video.to_owned(),
                index: self.index.or(Some(index)),
                is_by_name: self.index.is_none(),
            };
        }
        FramePlace {
            video: self.video.as_deref().unwrap_or(file_stem).to_owned(),
            index: self.index,
            is_by_name: false,
        }
    }

    /// The video and the index that the name of its picture says, if it says them.
    fn place_by_name(&self) -> Option<(&str, usize)> {
        let stem = self.name.rsplit_once('.').map_or(self.name.as_str(), |(stem, _)| stem);
        let (video, digits) = stem.rsplit_once('-')?;
        if digits.len() != 7 {
            return None;
        }
        let number: usize = digits.parse().ok()?;
        Some((video, number.checked_sub(1)?))
    }
}

/// Returns the file itself, or the JSON files of a folder, sorted.
fn json_files(path: &Path) -> Result<Vec<PathBuf>, EvalError> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    entries(path, |path| has_extension(path, &["json"]))
        .map_err(|error| EvalError::read(path, error, "is the folder readable?"))
}

/// Reads an object's id, which files write as a number or as text.
fn number_of(id: &serde_json::Value) -> Option<u64> {
    id.as_u64().or_else(|| id.as_str()?.parse().ok())
}
