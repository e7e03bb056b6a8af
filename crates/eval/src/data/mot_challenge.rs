//! Reads MOTChallenge (2015 to 2020): one folder per sequence with `seqinfo.ini`, `gt/gt.txt`, `det/det.txt` and
//! the pictures in `img1/`.
//!
//! Rows are `frame,id,left,top,width,height,…` with frames and pixels counted from 1. In ground truth of
//! 2016 and later (nine columns) the seventh is 0 for boxes not to be judged and the eighth the class; the
//! 2015 release (ten columns) has pedestrians only, and their place in the world, or -1, from the eighth on. Source:
//! MOT16 paper, arXiv 1603.00831, table 3. If the eighth of ten columns is the number of a class, or -1, in every row
//! of a file, these are classes, too.
//!
//! Files in this form that have classes of their own name them: `classes.txt` beside `seqinfo.ini` has lines such as
//! `14 truck`, as `albireo export` writes it, and `gt/labels.txt` a name in each line, of the classes from 1 on, as CVAT
//! writes it. A `classes.txt` without numbers is another program's.
//!
//! The benchmark judges pedestrians. It excuses boxes on people on vehicles, people who stand still, distractors and
//! reflections, since 2020 also on vehicles without motor, and on no other label, as in TrackEval 1.3.0
//! (`mot_challenge_2d_box.py`). Cars, bicycles and motorcycles, which its own files mark with 0, are excused for boxes
//! of their own class; files in this form that mark them with 1 have them judged.

use super::classes::{PERSON, from_mot_challenge, from_name};
use super::rows::{GONE, Row, Table};
use super::{Clip, DataSet, LabelledBox, LeftOut, LoadReport, TRUTH_CONFIDENCE, pictures_in};
use crate::boxes::ScoredBox;
use crate::error::EvalError;
use crate::files::{entries, read_text};
use crate::judge::{Ignored, Mark};
use albireo_core::detection::ClassId;
use albireo_core::geometry::{Corners, PictureSize};
use std::collections::HashMap;
use std::path::Path;

/// Reads a sequence's folder, or a folder of such folders. Detections and ground truth are read if they
/// exist.
///
/// # Errors
/// [`EvalError`] for a missing or broken file, with the line if there is one.
pub fn read(folder: &Path) -> Result<DataSet, EvalError> {
    let is_sequence = |folder: &Path| folder.join("seqinfo.ini").exists();
    let folders = if is_sequence(folder) {
        vec![folder.to_owned()]
    } else {
        entries(folder, is_sequence).map_err(|error| {
            EvalError::read(
                folder,
                error,
                "give a sequence's folder or a folder of them",
            )
        })?
    };
    let mut data = DataSet::default();
    for sequence in folders {
        let clip = read_sequence(&sequence, &mut data.report)?;
        data.push(clip);
    }
    data.nonempty(
        folder,
        "a sequence with seqinfo.ini and gt/gt.txt, such as MOT17/train/MOT17-02-FRCNN, or a folder of them",
    )
}

fn read_sequence(folder: &Path, report: &mut LoadReport) -> Result<Clip, EvalError> {
    let info = Info::read(&folder.join("seqinfo.ini"))?;
    let picture = info.picture;
    let frames = info.frames;
    let table = |file: &str| Table {
        path: folder.join(file),
        separator: Some(','),
        header: None,
        first: 1,
        frames: Some(frames),
    };
    let labels = table("gt/gt.txt");
    let found = table("det/det.txt");
    let mut clip = Clip {
        frame_rate: info.frame_rate,
        pictures: pictures_in(&folder.join(info.pictures)),
        ..Clip::new(info.name, picture, frames)
    };
    if labels.path.exists() {
        let numbers = SequenceClasses::read(folder, &clip.name)?;
        let has_classes = has_classes(&labels, &numbers)?;
        let by_frame = labels.read(GONE, |row, lines| {
            let number = if has_classes || row.len() < WITH_PLACES {
                row.integer(CLASS, "class")?
            } else {
                PEDESTRIAN_OF_2015
            };
            lines.extend(truth_line(row, number, &numbers, picture, report)?);
            Ok(())
        })?;
        let mut truth = vec![Vec::new(); by_frame.len()];
        for (frame, lines) in by_frame.into_iter().enumerate() {
            for line in lines {
                match line {
                    TruthLine::Object(object) => truth[frame].push(object),
                    TruthLine::Marked(marked) => clip.ignore(frame, marked),
                }
            }
        }
        clip.truth = Some(truth);
    }
    if found.path.exists() {
        clip.detections = Some(found.boxes(GONE, picture, report, labelled_detection)?);
    }
    Ok(clip)
}

struct Info {
    name: String,
    picture: PictureSize,
    frames: usize,
    frame_rate: Option<f64>,
    pictures: String,
}

impl Info {
    fn read(path: &Path) -> Result<Self, EvalError> {
        let text = read_text(
            path,
            "a MOTChallenge sequence is described by its seqinfo.ini",
        )?;
        let values: HashMap<&str, &str> = text
            .lines()
            .filter_map(|line| line.split_once('='))
            .map(|(key, value)| (key.trim(), value.trim()))
            .collect();
        let number = |key: &str| -> Result<u32, EvalError> {
            let value = values
                .get(key)
                .ok_or_else(|| EvalError::content(path, format!("the key `{key}` is missing")))?;
            value.parse().map_err(|_| {
                EvalError::content(path, format!("`{key}` is `{value}`, not a whole number"))
            })
        };
        let width = number("imWidth")?;
        let height = number("imHeight")?;
        if width == 0 || height == 0 {
            return Err(EvalError::content(path, "the pictures have no size"));
        }
        let folder_name = path.parent().and_then(Path::file_name).map_or_else(
            || "sequence".to_owned(),
            |name| name.to_string_lossy().into_owned(),
        );
        Ok(Self {
            name: values.get("name").map_or(folder_name, |&name| name.to_owned()),
            picture: PictureSize::new(width, height),
            frames: number("seqLength")? as usize,
            frame_rate: values
                .get("frameRate")
                .and_then(|rate| rate.parse().ok())
                .filter(|rate: &f64| rate.is_finite() && *rate > 0.0),
            pictures: values.get("imDir").copied().unwrap_or("img1").to_owned(),
        })
    }
}

/// Reads the box in columns 3 to 6; files count pixels from 1, boxes count them from 0.
fn corners(row: &Row<'_>) -> Result<Corners, EvalError> {
    let [left, top, width, height] = row.numbers(2, ["left", "top", "width", "height"])?;
    Ok(Corners {
        x1: left - 1.0,
        y1: top - 1.0,
        x2: left - 1.0 + width,
        y2: top - 1.0 + height,
    })
}

/// A row of ground truth.
#[derive(Clone)]
enum TruthLine {
    Object(ScoredBox),
    Marked(Ignored),
}

/// What the numbers of a sequence's classes mean.
struct SequenceClasses {
    /// The names of classes by the sequence's own files; other numbers are those of MOTChallenge.
    names: HashMap<i64, String>,
    /// True if vehicles without motor are distractors, too.
    with_vehicles: bool,
}

impl SequenceClasses {
    /// Reads the names of the sequence `name` in `folder`, if it has some.
    fn read(folder: &Path, name: &str) -> Result<Self, EvalError> {
        let mut names = HashMap::new();
        let numbered = folder.join("classes.txt");
        let listed = folder.join("gt/labels.txt");
        let mut text = String::new();
        if numbered.exists() {
            text = read_text(&numbered, GONE)?;
        }
        if text.lines().any(|line| numbered_name(line).is_some()) {
            for (number, line) in (1..).zip(text.lines()) {
                if line.trim().is_empty() {
                    continue;
                }
                let Some((class, class_name)) = numbered_name(line) else {
                    let what = format!("`{line}` is no number and name, such as `14 truck`");
                    return Err(EvalError::line(&numbered, number, what));
                };
                names.insert(class, class_name);
            }
        } else if listed.exists() {
            let text = read_text(&listed, GONE)?;
            for (class, line) in (1..).zip(text.lines()) {
                names.insert(class, line.trim().to_owned());
            }
        }
        Ok(Self {
            names,
            with_vehicles: name.contains("MOT20"),
        })
    }

    /// The class of this number.
    fn class(&self, number: i64) -> Result<ClassId, LeftOut> {
        match self.names.get(&number) {
            Some(name) => from_name(&name.to_ascii_lowercase()),
            None => from_mot_challenge(number),
        }
    }

    /// True if a class can have this number.
    fn can_be(&self, number: i64) -> bool {
        number >= 1 || number == PEDESTRIAN_OF_2015 || self.names.contains_key(&number)
    }

    /// The rule by which MOTChallenge excuses boxes of all classes at labels of this number, if it does.
    fn excuse(&self, number: i64) -> Option<Mark> {
        match number {
            _ if self.names.contains_key(&number) => None,
            2 | 7 | 8 | 12 => Some(Mark::Distractor),
            6 if self.with_vehicles => Some(Mark::Distractor),
            // Occluders and crowds.
            9 | 10 | 11 | 13 => Some(Mark::Unjudged),
            _ => None,
        }
    }
}

/// Reads a line such as `14 truck`.
fn numbered_name(line: &str) -> Option<(i64, String)> {
    let (number, name) = line.trim().split_once(char::is_whitespace)?;
    Some((number.parse().ok()?, name.trim().to_owned()))
}

/// The column of a row's class.
const CLASS: usize = 7;

/// As many columns have the rows of the 2015 release, with a place in the world.
const WITH_PLACES: usize = 10;

/// The class of a row without one.
const PEDESTRIAN_OF_2015: i64 = -1;

/// True if all rows that can have places in the world have classes there.
fn has_classes(labels: &Table<'_>, numbers: &SequenceClasses) -> Result<bool, EvalError> {
    let mut are_classes = true;
    labels.read(GONE, |row, _: &mut Vec<()>| {
        if row.len() >= WITH_PLACES {
            let number = row.text(CLASS, "class")?.parse::<i64>();
            are_classes &= number.is_ok_and(|number| numbers.can_be(number));
        }
        Ok(())
    })?;
    Ok(are_classes)
}

/// Reads a row of ground truth with a class of this number; `None` if it was left out.
fn truth_line(
    row: &Row<'_>,
    number: i64,
    numbers: &SequenceClasses,
    picture: PictureSize,
    report: &mut LoadReport,
) -> Result<Option<TruthLine>, EvalError> {
    let is_judged = row.number::<f64>(6, "consider")? != 0.0;
    let corners = corners(row)?;
    let class = numbers.class(number);
    // Boxes of which class are excused there, and by which rule.
    let any_class = None;
    let excuse = match (numbers.excuse(number), class) {
        (Some(mark), _) => Some((any_class, mark)),
        (_, Ok(PERSON)) if !is_judged => Some((any_class, Mark::Unjudged)),
        (_, Ok(class)) if !is_judged => Some((Some(class), Mark::Distractor)),
        _ => None,
    };
    if let Some((class, mark)) = excuse {
        let marked = report.mark(corners, class, mark, picture, || row.place());
        return Ok(marked.map(TruthLine::Marked));
    }
    let labelled = LabelledBox {
        corners,
        class,
        class_name: match numbers.names.get(&number) {
            Some(name) => name.into(),
            None => number.to_string().into(),
        },
        confidence: TRUTH_CONFIDENCE,
        object: row.object(1, "id")?,
    };
    let kept = report.keep(&labelled, picture, || row.place());
    Ok(kept.map(TruthLine::Object))
}

fn labelled_detection<'r>(row: &'r Row<'_>) -> Result<LabelledBox<'r>, EvalError> {
    Ok(LabelledBox {
        corners: corners(row)?,
        class: Ok(PERSON),
        class_name: "".into(),
        confidence: row.number(6, "score")?,
        object: None,
    })
}
