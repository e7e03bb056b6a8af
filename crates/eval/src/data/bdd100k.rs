//! BDD100K multiple object tracking (`box_track_20`) and every other file in the Scalabel form: JSON, a
//! list of frames or an object with `frames`, each with its video, index and labels.
//!
//! Both spellings of the keys are read: `videoName`/`frameIndex` and the older `video_name`/`index`. A file
//! of predictions is the same with a `score` in each label. Boxes marked as crowd are ground truth like any
//! other: neither the paper nor its published evaluator makes an exception for them.

use super::classes::{Meaning, from_name};
use super::rows::read_text;
use super::{Clip, Clips, DataError, LoadReport, StoredDetection, judge_confidence};
use crate::average_precision::TruthBox;
use albireo_core::detection::ClassId;
use albireo_core::geometry::{Corners, PictureSize};
use serde::Deserialize;
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// Size of all pictures of BDD100K.
pub(crate) const BDD100K_SIZE: PictureSize = PictureSize::new(1280, 720);
/// The tracking set is annotated at this rate.
pub const BDD100K_FRAME_RATE: f64 = 5.0;
/// A frame index above this is taken for a broken file.
const MOST_FRAMES: usize = 1_000_000;

/// The form with the frames inside an object.
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

/// What to read and how the pictures are, which the files do not say.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// Labels: a file, or a folder of files.
    pub truth: Option<&'a Path>,
    /// Predictions: a file, or a folder of files.
    pub detections: Option<&'a Path>,
    /// Size of all pictures.
    pub picture: PictureSize,
    /// Frames a second.
    pub frame_rate: Option<f64>,
}

/// One judged label of a frame.
struct Entry {
    corners: Corners,
    class: ClassId,
    score: Option<f64>,
    object: Option<u64>,
}

/// Frames of each video, by index.
type Videos = BTreeMap<String, BTreeMap<usize, Vec<Entry>>>;

/// Reads labels, predictions or both; clips are the videos named in either.
///
/// # Errors
/// [`DataError`] for a missing or broken file, a prediction without a score, or a frame that comes twice.
pub fn read(source: &Source<'_>) -> Result<Clips, DataError> {
    let mut clips = Clips::default();
    let mut read = |path: Option<&Path>, scored: bool| {
        path.map(|path| read_videos(path, source.picture, scored, &mut clips.report))
            .transpose()
    };
    let truths = read(source.truth, false)?;
    let mut found = read(source.detections, true)?;
    let mut truths = truths.map(|truths| truths.into_iter().collect::<HashMap<_, _>>());
    let names: std::collections::BTreeSet<String> = truths
        .iter()
        .flat_map(HashMap::keys)
        .chain(found.iter().flat_map(BTreeMap::keys))
        .cloned()
        .collect();
    for name in names {
        let truth = truths.as_mut().and_then(|truths| truths.remove(&name));
        let detections = found.as_mut().and_then(|found| found.remove(&name));
        let last = |frames: &Option<BTreeMap<usize, Vec<Entry>>>| {
            let last = frames.as_ref().and_then(BTreeMap::last_key_value);
            last.map_or(0, |(index, _)| index + 1)
        };
        let frames = last(&truth).max(last(&detections));
        clips.push(Clip {
            name,
            picture: source.picture,
            frame_rate: source.frame_rate,
            camera: None,
            frames,
            detections: detections.map(|detections| {
                spread(detections, frames, |entry| StoredDetection {
                    corners: entry.corners,
                    class: entry.class,
                    confidence: entry.score.unwrap_or_default(),
                })
            }),
            truth: truth.map(|truth| {
                spread(truth, frames, |entry| TruthBox {
                    corners: entry.corners,
                    class: entry.class,
                    object: entry.object,
                })
            }),
            screen: None,
            pictures: Vec::new(),
            ignored: Vec::new(),
        });
    }
    let place = source.truth.or(source.detections).unwrap_or(Path::new("."));
    clips.nonempty(place)
}

/// One list a frame; frames the file does not have are empty.
fn spread<T: Clone>(
    by_index: BTreeMap<usize, Vec<Entry>>,
    frames: usize,
    make: impl Fn(Entry) -> T,
) -> Vec<Vec<T>> {
    let mut spread = vec![Vec::new(); frames];
    for (index, entries) in by_index {
        spread[index] = entries.into_iter().map(&make).collect();
    }
    spread
}

fn read_videos(
    path: &Path,
    picture: PictureSize,
    scored: bool,
    report: &mut LoadReport,
) -> Result<Videos, DataError> {
    let mut videos = Videos::new();
    for file in json_files(path)? {
        let text = read_text(&file, "give a JSON file of frames or a folder of them")?;
        let frames = if text.trim_start().starts_with('[') {
            serde_json::from_str(&text)
        } else {
            serde_json::from_str(&text).map(|export: Export| export.frames)
        };
        let frames: Vec<Frame> = frames.map_err(|error| {
            let what = format!("it is no list of frames in the Scalabel form: {error}");
            DataError::line(&file, error.line() as u64, what)
        })?;
        for (position, frame) in frames.into_iter().enumerate() {
            add_frame(&file, position, frame, picture, scored, &mut videos, report)?;
        }
    }
    Ok(videos)
}

/// The file itself, or the JSON files of a folder, sorted.
fn json_files(path: &Path) -> Result<Vec<PathBuf>, DataError> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let entries = std::fs::read_dir(path)
        .map_err(|error| DataError::read(path, error, "is the folder readable?"))?;
    let mut files: Vec<PathBuf> = entries
        .filter_map(|entry| entry.ok().map(|entry| entry.path()))
        .filter(|path| {
            path.extension()
                .is_some_and(|extension| extension == "json")
        })
        .collect();
    files.sort();
    Ok(files)
}

fn add_frame(
    file: &Path,
    position: usize,
    frame: Frame,
    picture: PictureSize,
    scored: bool,
    videos: &mut Videos,
    report: &mut LoadReport,
) -> Result<(), DataError> {
    let stem = || {
        file.file_stem().map_or_else(
            || "clip".to_owned(),
            |stem| stem.to_string_lossy().into_owned(),
        )
    };
    let video = videos.entry(frame.video.unwrap_or_else(stem)).or_default();
    let index = frame.index.unwrap_or(position);
    if index >= MOST_FRAMES {
        return Err(DataError::file(
            file,
            format!(
                "frame {} has the index {index}, which is no frame of a clip",
                frame.name
            ),
        ));
    }
    let std::collections::btree_map::Entry::Vacant(place) = video.entry(index) else {
        return Err(DataError::file(
            file,
            format!(
                "frame {} comes twice: its video already has the index {index}",
                frame.name
            ),
        ));
    };
    let mut entries = Vec::new();
    for (number, label) in frame.labels.into_iter().flatten().enumerate() {
        let spot = || format!("{}, frame {}, label {number}", file.display(), frame.name);
        let Some(corners) = label.box2d else {
            continue;
        };
        let corners = Corners {
            x1: corners.x1,
            y1: corners.y1,
            x2: corners.x2,
            y2: corners.y2,
        };
        if scored && label.score.is_none() {
            return Err(DataError::file(
                file,
                format!(
                    "frame {}, label {number} has no `score`: is this ground truth?",
                    frame.name
                ),
            ));
        }
        let reason = report
            .judge(corners, picture)
            .or_else(|| label.score.and_then(judge_confidence));
        match (reason, from_name(&label.category)) {
            (Some(reason), _) => report.leave_out(reason, spot),
            (None, Meaning::Class(class)) => entries.push(Entry {
                corners,
                class,
                score: label.score,
                object: label.id.as_ref().and_then(number_of),
            }),
            (None, _) => report.leave_out_class(&label.category, spot),
        }
    }
    place.insert(entries);
    Ok(())
}

/// An object's id as a number, whether the file writes it as one or as text.
fn number_of(id: &serde_json::Value) -> Option<u64> {
    id.as_u64().or_else(|| id.as_str()?.parse().ok())
}
