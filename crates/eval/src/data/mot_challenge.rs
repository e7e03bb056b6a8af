//! MOTChallenge (2015 to 2020): one folder a sequence with `seqinfo.ini`, `gt/gt.txt`, `det/det.txt` and
//! the pictures in `img1/`.
//!
//! Rows are `frame,id,left,top,width,height,…` with frames and pixels counted from 1. In ground truth of
//! 2016 and later (nine columns) the seventh is 0 for boxes not to be judged and the eighth the class; the
//! 2015 release (ten columns) has pedestrians only. Source: MOT16 paper, arXiv 1603.00831, table 3.

use super::classes::{PERSON, from_mot_challenge};
use super::pictures::pictures_in;
use super::rows::{Row, comma_separated, read_text};
use super::{Clip, Clips, DataError, LabelledBox, LeftOut, LoadReport, StoredDetection, entries};
use crate::average_precision::TruthBox;
use albireo_core::geometry::{Corners, PictureSize};
use std::collections::HashMap;
use std::path::Path;

/// Reads a sequence's folder, or a folder of such folders. Detections and ground truth are taken where they
/// are there.
///
/// # Errors
/// [`DataError`] for a missing or broken file, with the line where there is one.
pub fn read(folder: &Path) -> Result<Clips, DataError> {
    let is_sequence = |folder: &Path| folder.join("seqinfo.ini").exists();
    let folders = if is_sequence(folder) {
        vec![folder.to_owned()]
    } else {
        entries(folder, is_sequence).map_err(|error| {
            DataError::read(
                folder,
                error,
                "give a sequence's folder or a folder of them",
            )
        })?
    };
    let mut clips = Clips::default();
    for folder in folders {
        let clip = read_sequence(&folder, &mut clips.report)?;
        clips.push(clip);
    }
    clips.nonempty(folder)
}

fn read_sequence(folder: &Path, report: &mut LoadReport) -> Result<Clip, DataError> {
    let info = Info::read(&folder.join("seqinfo.ini"))?;
    let (picture, frames) = (info.picture, info.frames);
    let truth_file = folder.join("gt").join("gt.txt");
    let truth = truth_file
        .exists()
        .then(|| read_truth(&truth_file, picture, frames, report))
        .transpose()?;
    let detection_file = folder.join("det").join("det.txt");
    let detections = detection_file
        .exists()
        .then(|| read_detections(&detection_file, picture, frames, report))
        .transpose()?;
    Ok(Clip {
        frame_rate: info.frame_rate,
        detections,
        truth,
        pictures: pictures_in(&folder.join(info.pictures)),
        ..Clip::new(info.name, picture, frames)
    })
}

struct Info {
    name: String,
    picture: PictureSize,
    frames: usize,
    frame_rate: Option<f64>,
    pictures: String,
}

impl Info {
    fn read(path: &Path) -> Result<Self, DataError> {
        let text = read_text(
            path,
            "a MOTChallenge sequence is described by its seqinfo.ini",
        )?;
        let values: HashMap<&str, &str> = text
            .lines()
            .filter_map(|line| line.split_once('='))
            .map(|(key, value)| (key.trim(), value.trim()))
            .collect();
        let number = |key: &str| -> Result<u32, DataError> {
            let value = values
                .get(key)
                .ok_or_else(|| DataError::file(path, format!("the key `{key}` is missing")))?;
            value.parse().map_err(|_| {
                DataError::file(path, format!("`{key}` is `{value}`, not a whole number"))
            })
        };
        let (width, height) = (number("imWidth")?, number("imHeight")?);
        if width == 0 || height == 0 {
            return Err(DataError::file(path, "the pictures have no size"));
        }
        let folder_name = path.parent().and_then(Path::file_name).map_or_else(
            || "sequence".to_owned(),
            |name| name.to_string_lossy().into_owned(),
        );
        Ok(Self {
            name: values
                .get("name")
                .map_or(folder_name, |name| (*name).to_owned()),
            picture: PictureSize::new(width, height),
            frames: number("seqLength")? as usize,
            frame_rate: values
                .get("frameRate")
                .and_then(|rate| rate.parse().ok())
                .filter(|rate: &f64| rate.is_finite() && *rate > 0.0),
            pictures: (*values.get("imDir").unwrap_or(&"img1")).to_owned(),
        })
    }
}

/// The box in columns 3 to 6, from pixels counted from 1 to pixels counted from 0.
fn corners(row: &Row<'_>) -> Result<Corners, DataError> {
    let (left, top): (f64, f64) = (row.number(2, "left")?, row.number(3, "top")?);
    let (width, height): (f64, f64) = (row.number(4, "width")?, row.number(5, "height")?);
    Ok(Corners {
        x1: left - 1.0,
        y1: top - 1.0,
        x2: left - 1.0 + width,
        y2: top - 1.0 + height,
    })
}

fn read_truth(
    path: &Path,
    picture: PictureSize,
    frames: usize,
    report: &mut LoadReport,
) -> Result<Vec<Vec<TruthBox>>, DataError> {
    let text = read_text(path, "it was there a moment ago")?;
    let mut truth = vec![Vec::new(); frames];
    comma_separated(path, &text, None, |row| {
        let frame = row.frame(0, 1, frames)?;
        let corners = corners(row)?;
        let is_judged = row.number::<f64>(6, "whether it is judged")? != 0.0;
        let (class, class_name) = if row.len() <= 9 {
            let number = row.integer(7, "class")?;
            (from_mot_challenge(number), number.to_string().into())
        } else {
            (Ok(PERSON), "".into())
        };
        let labelled = LabelledBox {
            corners,
            class: class.and_then(|class| is_judged.then_some(class).ok_or(LeftOut::IgnoredRegion)),
            class_name,
            confidence: None,
        };
        if let Some(class) = report.keep(&labelled, picture, || row.place()) {
            truth[frame].push(TruthBox {
                corners,
                class,
                object: u64::try_from(row.integer(1, "id")?).ok(),
            });
        }
        Ok(())
    })?;
    Ok(truth)
}

fn read_detections(
    path: &Path,
    picture: PictureSize,
    frames: usize,
    report: &mut LoadReport,
) -> Result<Vec<Vec<StoredDetection>>, DataError> {
    let text = read_text(path, "it was there a moment ago")?;
    let mut detections = vec![Vec::new(); frames];
    comma_separated(path, &text, None, |row| {
        let frame = row.frame(0, 1, frames)?;
        let (corners, confidence) = (corners(row)?, row.number(6, "score")?);
        let labelled = LabelledBox {
            corners,
            class: Ok(PERSON),
            class_name: "".into(),
            confidence: Some(confidence),
        };
        if let Some(class) = report.keep(&labelled, picture, || row.place()) {
            detections[frame].push(StoredDetection {
                corners,
                class,
                confidence,
            });
        }
        Ok(())
    })?;
    Ok(detections)
}
