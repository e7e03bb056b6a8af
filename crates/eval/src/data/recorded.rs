//! Reads and writes recorded detections: a folder with `sequences.json` and comma-separated tables.
//!
//! - `sequences.json`: `{"sequences": [{"name", "width", "height", "fps", "frames", "camera", "ground_truth_boxes"}, …],
//!   "class_names": […]}`; other keys are ignored,
//! - `detections/<name>.csv`: `frame,x1,y1,x2,y2,score,class`, required for each sequence,
//! - `groundtruth/<name>.csv`: `frame,x1,y1,x2,y2,class,object_id`, optional,
//! - `ignore/<name>.csv`: `frame,x1,y1,x2,y2`, optional: regions in which the ground truth labels no objects; or
//!   `frame,x1,y1,x2,y2,class,mark` with the class of the boxes that are not judged there (-1 for any) and the rule:
//!   `region`, `crowd`, `object`, `distractor` or `unjudged`; `unlabelled` for a whole frame that nobody labelled,
//! - `screen/<name>.csv`: `frame,empty`, optional: the verdicts of an empty-scene screen (1: nothing is in view,
//!   0: something is); a frame without a row has no verdict.
//!
//! Coordinates are pixels, frames count from 0, and classes are COCO numbers, or those of the names that
//! `sequences.json` lists (`"class_names": ["helmet", …]`). A sequence whose entry counts ground-truth boxes
//! (`ground_truth_boxes`) must have the file. [`write`] writes the same layout.

use super::classes::Evaluated;
use super::rows::{MAX_FRAMES, Row, Table};
use super::{Clip, DataSet, LabelledBox, LoadReport, TRUTH_CONFIDENCE};
use crate::error::EvalError;
use crate::files::{self, read_text};
use crate::judge::{Ignored, Mark};
use albireo_core::detection::ClassId;
use albireo_core::geometry::{Corners, PictureSize};
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

const DETECTION_HEADER: &str = "frame,x1,y1,x2,y2,score,class";
const DETECTION_CLASS: usize = 6;
const TRUTH_HEADER: &str = "frame,x1,y1,x2,y2,class,object_id";
const TRUTH_CLASS: usize = 5;
const REGION_HEADER: &str = "frame,x1,y1,x2,y2";
const IGNORED_HEADER: &str = "frame,x1,y1,x2,y2,class,mark";
const SCREEN_HEADER: &str = "frame,empty";

/// The rules by their names in a table.
const MARKS: [(Mark, &str); 6] = [
    (Mark::Region, "region"),
    (Mark::Crowd, "crowd"),
    (Mark::Object, "object"),
    (Mark::Distractor, "distractor"),
    (Mark::Unjudged, "unjudged"),
    (Mark::Unlabelled, "unlabelled"),
];

#[derive(Serialize, Deserialize)]
struct Index {
    /// The names of the classes by their numbers; none for those of COCO.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    class_names: Vec<String>,
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
/// [`EvalError`] for a missing or broken file, with the line if there is one.
pub fn read(folder: &Path) -> Result<DataSet, EvalError> {
    let path = folder.join("sequences.json");
    let text = read_text(
        &path,
        "a folder of recorded detections has a sequences.json that lists its sequences",
    )?;
    let index: Index =
        serde_json::from_str(&text).map_err(|error| EvalError::json(&path, &error))?;
    let classes = match index.class_names.as_slice() {
        [] => Evaluated::Road,
        names => Evaluated::Own(names.into()),
    };
    let mut data = DataSet::default();
    let mut names = std::collections::BTreeSet::new();
    for entry in index.sequences {
        check(&entry, &path)?;
        if names.contains(&entry.name) {
            let what = format!("the sequence `{}` is listed twice", entry.name);
            return Err(EvalError::content(&path, what));
        }
        names.insert(entry.name.clone());
        let clip = read_sequence(folder, entry, &mut data.report)?;
        data.push(Clip {
            classes: classes.clone(),
            ..clip
        });
    }
    data.nonempty(
        folder,
        "sequences.json and groundtruth/, as --save-detections writes them",
    )
}

fn check(entry: &Entry, path: &Path) -> Result<(), EvalError> {
    let name = &entry.name;
    let cannot_name_a_file = name.is_empty() || name.starts_with('.') || name.contains(['/', '\\']);
    let is_no_rate = |rate: f64| !rate.is_finite() || rate <= 0.0;
    let what = if cannot_name_a_file {
        format!("`{name}` cannot be a sequence's name: files are named after it")
    } else if entry.frames > MAX_FRAMES {
        format!(
            "the sequence `{name}` has {} frames; at most {MAX_FRAMES} are read",
            entry.frames
        )
    } else if entry.width == 0 || entry.height == 0 {
        format!(
            "the sequence `{name}` has pictures of {}x{} pixels",
            entry.width, entry.height
        )
    } else if entry.fps.is_some_and(is_no_rate) {
        format!("the sequence `{name}` has a frame rate that is not positive")
    } else {
        return Ok(());
    };
    Err(EvalError::content(path, what))
}

fn read_sequence(folder: &Path, entry: Entry, report: &mut LoadReport) -> Result<Clip, EvalError> {
    let picture = PictureSize::new(entry.width, entry.height);
    let table = |kind: &str, header: &'static str| Table {
        path: table_path(folder, kind, &entry.name),
        separator: Some(','),
        header: Some(header),
        first: 0,
        frames: Some(entry.frames),
    };
    let detections = table("detections", DETECTION_HEADER).boxes(
        "every sequence in sequences.json needs its detections; a sequence without any has a file with only the header",
        picture,
        report,
        |row| {
            let confidence = row.number(5, "score")?;
            let no_object = None;
            labelled(row, DETECTION_CLASS, confidence, no_object)
        },
    )?;
    let labels = table("groundtruth", TRUTH_HEADER);
    let expected = entry.ground_truth_boxes.is_some_and(|boxes| boxes > 0);
    let truth = if expected || labels.path.exists() {
        let help = "sequences.json says that this sequence has ground truth";
        Some(labels.boxes(help, picture, report, |row| {
            let object = row.object(6, "object_id")?;
            labelled(row, TRUTH_CLASS, TRUTH_CONFIDENCE, object)
        })?)
    } else {
        None
    };
    let help = "is the file readable?";
    let path = table_path(folder, "ignore", &entry.name);
    let mut ignored = Vec::new();
    if path.exists() {
        // Recordings from before there were several rules have only regions.
        let has_marks = read_text(&path, help)?.starts_with(IGNORED_HEADER);
        let header = if has_marks {
            IGNORED_HEADER
        } else {
            REGION_HEADER
        };
        ignored = table("ignore", header).read(help, |row, places| {
            places.push(marked(row, has_marks)?);
            Ok(())
        })?;
    }
    let verdicts = table("screen", SCREEN_HEADER);
    let mut screen = None;
    if verdicts.path.exists() {
        let frames = verdicts.read(help, screen_verdict)?;
        screen = Some(frames.iter().map(|verdict| verdict.first().copied()).collect());
    }
    Ok(Clip {
        frame_rate: entry.fps,
        detections: Some(detections),
        truth,
        screen,
        ignored,
        camera: entry.camera,
        ..Clip::new(entry.name, picture, entry.frames)
    })
}

/// The path of a sequence's table.
fn table_path(folder: &Path, kind: &str, name: &str) -> PathBuf {
    folder.join(kind).join(format!("{name}.csv"))
}

fn screen_verdict(row: &Row<'_>, frame: &mut Vec<bool>) -> Result<(), EvalError> {
    if !frame.is_empty() {
        return Err(row.broken("its frame occurs twice"));
    }
    let is_empty = match row.text(1, "empty")? {
        "0" => false,
        "1" => true,
        other => return Err(row.broken(format!("`empty` is `{other}`, expected 0 or 1"))),
    };
    frame.push(is_empty);
    Ok(())
}

fn corners(row: &Row<'_>) -> Result<Corners, EvalError> {
    let [x1, y1, x2, y2] = row.numbers(1, ["x1", "y1", "x2", "y2"])?;
    Ok(Corners { x1, y1, x2, y2 })
}

/// Reads a place where boxes are not judged.
fn marked(row: &Row<'_>, has_mark: bool) -> Result<Ignored, EvalError> {
    let corners = corners(row)?;
    if !has_mark {
        return Ok(Ignored {
            corners,
            class: None,
            mark: Mark::Region,
        });
    }
    let name = row.text(6, "mark")?;
    let Some((mark, _)) = MARKS.iter().find(|(_, known)| *known == name) else {
        return Err(row.broken(format!("`mark` is `{name}`, which is no rule")));
    };
    let class = match row.integer(5, "class")? {
        // Boxes of any class.
        -1 => None,
        number => match u16::try_from(number) {
            Ok(number) => Some(ClassId(number)),
            Err(_) => return Err(row.broken(format!("`class` is {number}, which is no class"))),
        },
    };
    Ok(Ignored {
        corners,
        class,
        mark: *mark,
    })
}

/// Writes the places of a clip where boxes are not judged; in the short form, if all are regions for any class.
fn ignored_table(ignored: &[Vec<Ignored>]) -> String {
    let is_plain = |place: &Ignored| place.mark == Mark::Region && place.class.is_none();
    if ignored.iter().flatten().all(is_plain) {
        return formatted(REGION_HEADER, ignored, |place: &Ignored| {
            cells(place.corners)
        });
    }
    formatted(IGNORED_HEADER, ignored, |place: &Ignored| {
        let class = place.class.map_or(-1, |class| i32::from(class.0));
        let mark = MARKS.iter().find(|(mark, _)| *mark == place.mark);
        format!(
            "{},{class},{}",
            cells(place.corners),
            mark.map_or("", |(_, name)| name)
        )
    })
}

/// Reads a box whose class is in the column `class`; the files contain class numbers and no names.
fn labelled(
    row: &Row<'_>,
    class: usize,
    confidence: f64,
    object: Option<u64>,
) -> Result<LabelledBox<'static>, EvalError> {
    Ok(LabelledBox {
        corners: corners(row)?,
        class: Ok(ClassId(row.number(class, "class")?)),
        class_name: "".into(),
        confidence,
        object,
    })
}

/// Refuses a folder that has recorded detections: a list of other clips would replace theirs, and a table that of a clip
/// of the same name.
///
/// # Errors
/// When there are any, with the way out.
pub fn check_unused(folder: &Path) -> Result<(), EvalError> {
    let index = folder.join("sequences.json");
    if index.exists() {
        let what = "this folder has recorded detections, which are not replaced: name another folder, or remove it";
        return Err(EvalError::content(&index, what));
    }
    Ok(())
}

/// Writes `clips` in this layout, so that they can be replayed. Reading returns the same numbers to the last bit.
/// Existing files are replaced.
///
/// # Errors
/// When a file cannot be written.
pub fn write(folder: &Path, clips: &[Clip]) -> Result<(), EvalError> {
    for clip in clips {
        write_tables(folder, clip)?;
    }
    write_index(folder, clips)
}

/// Adds the last of `clips` to the others, which were written before: so a pass over many clips that is stopped has
/// kept those that were done.
///
/// # Errors
/// When a file cannot be written.
pub fn write_last(folder: &Path, clips: &[Clip]) -> Result<(), EvalError> {
    if let Some(last) = clips.last() {
        write_tables(folder, last)?;
    }
    write_index(folder, clips)
}

/// Writes the list of the clips.
fn write_index(folder: &Path, clips: &[Clip]) -> Result<(), EvalError> {
    let class_names = match clips.first().map(|clip| &clip.classes) {
        Some(Evaluated::Own(names)) => names.to_vec(),
        Some(Evaluated::Road) | None => Vec::new(),
    };
    let sequences = clips.iter().map(|clip| {
        let truth = clip.truth.as_ref();
        Entry {
            name: clip.name.clone(),
            width: clip.picture.width,
            height: clip.picture.height,
            fps: clip.frame_rate,
            frames: clip.frames,
            camera: clip.camera.clone(),
            ground_truth_boxes: truth.map(|truth| truth.iter().map(Vec::len).sum()),
        }
    });
    let index = Index {
        class_names,
        sequences: sequences.collect(),
    };
    files::write_json(&folder.join("sequences.json"), &index)
}

/// Writes what a clip has, a table of each kind, and removes an earlier run's tables of what it does not have.
fn write_tables(folder: &Path, clip: &Clip) -> Result<(), EvalError> {
    let replace = |kind: &str, text| replace_file(&table_path(folder, kind, &clip.name), text);
    let frames = clip.detections.as_deref().unwrap_or_default();
    let detections = formatted(DETECTION_HEADER, frames, |found| {
        let corners = cells(found.corners);
        format!("{corners},{},{}", found.confidence, found.class.0)
    });
    replace("detections", Some(detections))?;
    let truth = clip.truth.as_deref().map(|truth| {
        formatted(TRUTH_HEADER, truth, |known| {
            let object = match known.object {
                Some(number) => number.to_string(),
                None => "-1".to_owned(),
            };
            format!("{},{},{object}", cells(known.corners), known.class.0)
        })
    });
    replace("groundtruth", truth)?;
    let mut ignored = None;
    if !clip.ignored.is_empty() {
        ignored = Some(ignored_table(&clip.ignored));
    }
    replace("ignore", ignored)?;
    let verdicts = clip.screen.as_deref().map(|verdicts| {
        formatted(SCREEN_HEADER, verdicts, |empty| {
            u8::from(*empty).to_string()
        })
    });
    replace("screen", verdicts)
}

/// Formats a table with one row per entry: the frame's number, then what `row` returns for the entry.
fn formatted<'a, T: 'a, F>(header: &str, frames: &'a [F], row: impl Fn(&T) -> String) -> String
where
    &'a F: IntoIterator<Item = &'a T>,
{
    let mut table = format!("{header}\n");
    for (frame, entries) in frames.iter().enumerate() {
        for entry in entries {
            // Writing into text cannot fail.
            let _ = writeln!(table, "{frame},{}", row(entry));
        }
    }
    table
}

fn cells(Corners { x1, y1, x2, y2 }: Corners) -> String {
    format!("{x1},{y1},{x2},{y2}")
}

/// Writes a table, or without `text` removes that of an earlier run, which would otherwise be read as this clip's.
fn replace_file(path: &Path, text: Option<String>) -> Result<(), EvalError> {
    if let Some(text) = text {
        return files::write(path, text);
    }
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(EvalError::write(path, error))
        }
        _ => Ok(()),
    }
}
