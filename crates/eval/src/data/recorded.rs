//! Recorded detections: a folder with `sequences.json` and comma-separated tables.
//!
//! - `sequences.json`: `{"sequences": [{"name", "width", "height", "fps", "frames", "camera"}, …]}`;
//!   further keys are passed over,
//! - `detections/<name>.csv`: `frame,x1,y1,x2,y2,score,class`, required for each sequence,
//! - `groundtruth/<name>.csv`: `frame,x1,y1,x2,y2,class,object_id`, optional,
//! - `ignore/<name>.csv`: `frame,x1,y1,x2,y2`, optional: regions whose objects the ground truth leaves out,
//! - `screen/<name>.csv`: `frame,empty`, optional: what an empty-scene screen said of the pictures (1: nothing
//!   is in view, 0: something is). A frame without a row is one of which it could not say.
//!
//! Pixels, frames from 0, classes by their COCO numbers. A sequence whose entry counts ground-truth boxes
//! (`ground_truth_boxes`) must have the file. [`write`] makes the same layout.

use super::rows::{Row, comma_separated, read_text};
use super::{Clip, Clips, DataError, LabelledBox, LoadReport, StoredDetection};
use crate::average_precision::TruthBox;
use albireo_core::detection::ClassId;
use albireo_core::geometry::{Corners, PictureSize};
use serde::{Deserialize, Serialize};
use std::fmt::Write;
use std::path::Path;

const DETECTION_HEADER: &str = "frame,x1,y1,x2,y2,score,class";
const TRUTH_HEADER: &str = "frame,x1,y1,x2,y2,class,object_id";
const IGNORED_HEADER: &str = "frame,x1,y1,x2,y2";

#[derive(Serialize, Deserialize)]
struct Index {
    sequences: Vec<Entry>,
}

#[derive(Serialize, Deserialize)]
struct Entry {
    name: String,
    width: u32,
    height: u32,
    #[serde(default)]
    fps: Option<f64>,
    frames: usize,
    #[serde(default)]
    camera: Option<String>,
    #[serde(default)]
    ground_truth_boxes: Option<usize>,
}

/// Reads the folder.
///
/// # Errors
/// [`DataError`] for a missing or broken file, with the line where there is one.
pub fn read(folder: &Path) -> Result<Clips, DataError> {
    let path = folder.join("sequences.json");
    let text = read_text(
        &path,
        "a folder of recorded detections has a sequences.json that lists its sequences",
    )?;
    let index: Index = serde_json::from_str(&text)
        .map_err(|error| DataError::line(&path, error.line() as u64, error.to_string()))?;
    let mut clips = Clips::default();
    let mut names = std::collections::BTreeSet::new();
    for entry in index.sequences {
        check(&entry, &path)?;
        if !names.insert(entry.name.clone()) {
            return Err(DataError::file(
                &path,
                format!("the sequence `{}` is listed twice", entry.name),
            ));
        }
        let clip = read_sequence(folder, entry, &mut clips.report)?;
        clips.push(clip);
    }
    clips.nonempty(folder)
}

fn check(entry: &Entry, path: &Path) -> Result<(), DataError> {
    let plain =
        !entry.name.is_empty() && !entry.name.starts_with('.') && !entry.name.contains(['/', '\\']);
    if !plain {
        return Err(DataError::file(
            path,
            format!(
                "`{}` cannot be a sequence's name: it names a file",
                entry.name
            ),
        ));
    }
    if entry.width == 0 || entry.height == 0 {
        return Err(DataError::file(
            path,
            format!(
                "the sequence `{}` has pictures of {}x{} pixels",
                entry.name, entry.width, entry.height
            ),
        ));
    }
    if entry
        .fps
        .is_some_and(|rate| !(rate.is_finite() && rate > 0.0))
    {
        return Err(DataError::file(
            path,
            format!(
                "the sequence `{}` has a frame rate that is not positive",
                entry.name
            ),
        ));
    }
    Ok(())
}

fn read_sequence(folder: &Path, entry: Entry, report: &mut LoadReport) -> Result<Clip, DataError> {
    let picture = PictureSize::new(entry.width, entry.height);
    let path = folder
        .join("detections")
        .join(format!("{}.csv", entry.name));
    let text = read_text(
        &path,
        "every sequence in sequences.json needs its detections; a sequence without any has a file with \
         only the header",
    )?;
    let mut detections = vec![Vec::new(); entry.frames];
    comma_separated(&path, &text, Some(DETECTION_HEADER), |row| {
        let frame = columns(row, 7)?.frame(0, 0, entry.frames)?;
        let (corners, confidence) = (corners(row)?, row.number(5, "score")?);
        let labelled = labelled(corners, class(row, 6)?, Some(confidence));
        if let Some(class) = report.keep(&labelled, picture, || row.place()) {
            detections[frame].push(StoredDetection {
                corners,
                class,
                confidence,
            });
        }
        Ok(())
    })?;

    let path = folder
        .join("groundtruth")
        .join(format!("{}.csv", entry.name));
    let expected = entry.ground_truth_boxes.is_some_and(|boxes| boxes > 0);
    let truth = if expected || path.exists() {
        let text = read_text(
            &path,
            "sequences.json says that this sequence has ground truth",
        )?;
        let mut truth = vec![Vec::new(); entry.frames];
        comma_separated(&path, &text, Some(TRUTH_HEADER), |row| {
            let frame = columns(row, 7)?.frame(0, 0, entry.frames)?;
            let corners = corners(row)?;
            let object = u64::try_from(row.integer(6, "object_id")?).ok();
            let labelled = labelled(corners, class(row, 5)?, None);
            if let Some(class) = report.keep(&labelled, picture, || row.place()) {
                truth[frame].push(TruthBox {
                    corners,
                    class,
                    object,
                });
            }
            Ok(())
        })?;
        Some(truth)
    } else {
        None
    };
    let path = folder.join("ignore").join(format!("{}.csv", entry.name));
    let mut ignored = Vec::new();
    if path.exists() {
        let text = read_text(&path, "it was there a moment ago")?;
        ignored.resize(entry.frames, Vec::new());
        comma_separated(&path, &text, Some(IGNORED_HEADER), |row| {
            let frame = columns(row, 5)?.frame(0, 0, entry.frames)?;
            ignored[frame].push(corners(row)?);
            Ok(())
        })?;
    }
    let screen = super::screen_verdicts::read(folder, &entry.name, entry.frames)?;
    Ok(Clip {
        frame_rate: entry.fps,
        camera: entry.camera,
        detections: Some(detections),
        truth,
        screen,
        ignored,
        ..Clip::new(entry.name, picture, entry.frames)
    })
}

fn columns<'a, 'b>(row: &'a Row<'b>, count: usize) -> Result<&'a Row<'b>, DataError> {
    if row.len() == count {
        Ok(row)
    } else {
        Err(row.broken(format!(
            "the row has {} columns, expected {count}",
            row.len()
        )))
    }
}

fn corners(row: &Row<'_>) -> Result<Corners, DataError> {
    Ok(Corners {
        x1: row.number(1, "x1")?,
        y1: row.number(2, "y1")?,
        x2: row.number(3, "x2")?,
        y2: row.number(4, "y2")?,
    })
}

fn class(row: &Row<'_>, index: usize) -> Result<ClassId, DataError> {
    row.number(index, "class").map(ClassId)
}

/// A box of these files, which have numbers of classes and no names.
fn labelled(corners: Corners, class: ClassId, confidence: Option<f64>) -> LabelledBox<'static> {
    LabelledBox {
        corners,
        class: Ok(class),
        class_name: "".into(),
        confidence,
    }
}

/// Writes `clips` in this layout, so that they can be replayed; numbers are written so that reading gives
/// the same doubles back. Files that are there are replaced.
///
/// # Errors
/// [`DataError::Write`] when a file cannot be written.
pub fn write(folder: &Path, clips: &[Clip]) -> Result<(), DataError> {
    let mut index = Index {
        sequences: Vec::new(),
    };
    // Writing to a string cannot fail.
    for clip in clips {
        let file = format!("{}.csv", clip.name);
        let mut text = format!("{DETECTION_HEADER}\n");
        for (frame, boxes) in clip.detections.iter().flatten().enumerate() {
            for found in boxes {
                let (place, class) = (cells(found.corners), found.class.0);
                let _ = writeln!(text, "{frame},{place},{},{class}", found.confidence);
            }
        }
        put(&folder.join("detections").join(&file), Some(text))?;
        let truth = clip.truth.as_ref().map(|truth| {
            let mut text = format!("{TRUTH_HEADER}\n");
            for (frame, boxes) in truth.iter().enumerate() {
                for known in boxes {
                    let (place, class) = (cells(known.corners), known.class.0);
                    let object = known.object.map_or(-1, |object| object as i64);
                    let _ = writeln!(text, "{frame},{place},{class},{object}");
                }
            }
            text
        });
        put(&folder.join("groundtruth").join(&file), truth)?;
        let ignored = (!clip.ignored.is_empty()).then(|| {
            let mut text = format!("{IGNORED_HEADER}\n");
            for (frame, regions) in clip.ignored.iter().enumerate() {
                for region in regions {
                    let _ = writeln!(text, "{frame},{}", cells(*region));
                }
            }
            text
        });
        put(&folder.join("ignore").join(&file), ignored)?;
        super::screen_verdicts::write(folder, clip)?;
        index.sequences.push(Entry {
            name: clip.name.clone(),
            width: clip.picture.width,
            height: clip.picture.height,
            fps: clip.frame_rate,
            frames: clip.frames,
            camera: clip.camera.clone(),
            ground_truth_boxes: clip
                .truth
                .as_ref()
                .map(|truth| truth.iter().map(Vec::len).sum()),
        });
    }
    let path = folder.join("sequences.json");
    let text = serde_json::to_string_pretty(&index)
        .map_err(|error| DataError::file(&path, error.to_string()))?;
    put(&path, Some(text))
}

fn cells(b: Corners) -> String {
    format!("{},{},{},{}", b.x1, b.y1, b.x2, b.y2)
}

/// Writes a file, or removes that of an earlier run, which would be taken for this clip's.
pub(super) fn put(path: &Path, text: Option<String>) -> Result<(), DataError> {
    let done = match (text, path.parent()) {
        (Some(text), Some(folder)) => {
            std::fs::create_dir_all(folder).and_then(|()| std::fs::write(path, text))
        }
        _ => std::fs::remove_file(path).or_else(|error| match error.kind() {
            std::io::ErrorKind::NotFound => Ok(()),
            _ => Err(error),
        }),
    };
    done.map_err(|error| DataError::write(path, error))
}
