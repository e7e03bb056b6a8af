//! Reads BDD100K multiple object tracking (`box_track_20`) and other labels in the Scalabel format: JSON with a
//! list of frames, or an object with `frames`; each frame has its video, index and labels.
//!
//! Both spellings of the keys are read: `videoName`/`frameIndex` and the older `video_name`/`index`. A file
//! of predictions has the same form and a `score` in each label. Boxes marked as crowd are ground truth like any
//! other: neither the paper nor its published evaluator makes an exception for them.

use super::classes::from_name;
use super::rows::MAX_FRAMES;
use super::{Clip, DataSet, LabelledBox, LoadReport, entries, has_extension};
use crate::boxes::ScoredBox;
use crate::error::EvalError;
use crate::files::read_text;
use albireo_core::geometry::{Corners, PictureSize};
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet, btree_map};
use std::path::{Path, PathBuf};

/// Size of all pictures of BDD100K.
pub(crate) const BDD100K_SIZE: PictureSize = PictureSize::new(1280, 720);
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
    #[serde(default)]
    labels: Option<Vec<Label>>,
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
}

/// Boxes of each video's frames, by index.
type Videos = BTreeMap<String, BTreeMap<usize, Vec<ScoredBox>>>;

/// Reads labels, predictions or both; clips are the videos named in either.
///
/// # Errors
/// [`EvalError`] for a missing or broken file, a prediction without a score, or a frame that occurs twice.
pub fn read(source: &Source<'_>) -> Result<DataSet, EvalError> {
    let mut data = DataSet::default();
    let picture = source.picture;
    let report = &mut data.report;
    let mut truths =
        source.truth.map(|path| read_videos(path, picture, false, report)).transpose()?;
    let mut found = source
        .detections
        .map(|path| read_videos(path, picture, true, report))
        .transpose()?;
    let names: BTreeSet<String> = truths
        .iter()
        .flat_map(BTreeMap::keys)
        .chain(found.iter().flat_map(BTreeMap::keys))
        .cloned()
        .collect();
    for name in names {
        let truth = truths.as_mut().and_then(|truths| truths.remove(&name));
        let detections = found.as_mut().and_then(|found| found.remove(&name));
        let frames = length(truth.as_ref()).max(length(detections.as_ref()));
        data.push(Clip {
            frame_rate: source.frame_rate,
            detections: detections.map(|detections| spread(detections, frames)),
            truth: truth.map(|truth| spread(truth, frames)),
            ..Clip::new(name, picture, frames)
        });
    }
    let place = source.truth.or(source.detections).unwrap_or(Path::new("."));
    data.nonempty(place)
}

fn length<T>(frames: Option<&BTreeMap<usize, T>>) -> usize {
    frames.and_then(BTreeMap::last_key_value).map_or(0, |(index, _)| index + 1)
}

/// Returns one list per frame; frames that the file does not contain are empty.
fn spread(by_index: BTreeMap<usize, Vec<ScoredBox>>, frames: usize) -> Vec<Vec<ScoredBox>> {
    let mut spread = vec![Vec::new(); frames];
    for (index, boxes) in by_index {
        spread[index] = boxes;
    }
    spread
}

fn read_videos(
    path: &Path,
    picture: PictureSize,
    scored: bool,
    report: &mut LoadReport,
) -> Result<Videos, EvalError> {
    let mut videos = Videos::new();
    for file in json_files(path)? {
        let text = read_text(&file, "give a JSON file of frames or a folder of them")?;
        let parsed = if text.trim_start().starts_with('[') {
            serde_json::from_str(&text)
        } else {
            serde_json::from_str(&text).map(|export: Export| export.frames)
        };
        let frames: Vec<Frame> = parsed.map_err(|error| {
            let what = format!("this is not a list of frames in the Scalabel format: {error}");
            EvalError::line(&file, error.line() as u64, what)
        })?;
        let stem = file.file_stem().unwrap_or("clip".as_ref()).to_string_lossy();
        for (position, frame) in frames.into_iter().enumerate() {
            let index = frame.index.unwrap_or(position);
            let video = frame.video.as_deref().unwrap_or(&stem).to_owned();
            let place = videos.entry(video).or_default().entry(index);
            let btree_map::Entry::Vacant(place) = place else {
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
            place.insert(boxes(&file, &frame, picture, scored, report)?);
        }
    }
    Ok(videos)
}

/// Returns the file itself, or the JSON files of a folder, sorted.
fn json_files(path: &Path) -> Result<Vec<PathBuf>, EvalError> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    entries(path, |path| has_extension(path, &["json"]))
        .map_err(|error| EvalError::read(path, error, "is the folder readable?"))
}

/// Reads the boxes of a frame, without those that are left out.
fn boxes(
    file: &Path,
    frame: &Frame,
    picture: PictureSize,
    scored: bool,
    report: &mut LoadReport,
) -> Result<Vec<ScoredBox>, EvalError> {
    let mut boxes = Vec::new();
    for (number, label) in frame.labels.iter().flatten().enumerate() {
        let Some(Box2d { x1, y1, x2, y2 }) = label.box2d else {
            continue;
        };
        let confidence = match label.score.filter(|_| scored) {
            None if scored => {
                let what = format!(
                    "frame {}, label {number} has no `score`: is this ground truth?",
                    frame.name
                );
                return Err(EvalError::content(file, what));
            }
            score => score.unwrap_or(1.0),
        };
        let labelled = LabelledBox {
            corners: Corners { x1, y1, x2, y2 },
            class: from_name(&label.category),
            class_name: label.category.as_str().into(),
            confidence,
            object: label.id.as_ref().and_then(number_of),
        };
        let place = || format!("{}, frame {}, label {number}", file.display(), frame.name);
        boxes.extend(report.keep(&labelled, picture, place));
    }
    Ok(boxes)
}

/// Reads an object's id, which files write as a number or as text.
fn number_of(id: &serde_json::Value) -> Option<u64> {
    id.as_u64().or_else(|| id.as_str()?.parse().ok())
}
