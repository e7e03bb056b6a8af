//! Reads KITTI tracking: `label_02/NNNN.txt`, optional detections in `det_02/NNNN.txt` in the same form with a
//! score at the end, and the pictures in `image_02/NNNN/`.
//!
//! Rows are `frame id type truncated occluded alpha x1 y1 x2 y2 height width length x y z rotation [score]`,
//! frames and pixels from 0. Source: KITTI tracking development kit, readme.

use super::classes::from_kitti;
use super::rows::{GONE, Row, Table};
use super::{Clip, DataSet, LabelledBox, LoadReport, TRUTH_CONFIDENCE, pictures_in};
use crate::boxes::ScoredBox;
use crate::error::EvalError;
use crate::files::{entries, has_extension};
use crate::judge::Mark;
use albireo_core::geometry::{Corners, PictureSize};
use albireo_vision::picture::read_picture_file;
use std::path::Path;

/// The picture size of most sequences, used if a sequence has no pictures.
const USUAL_SIZE: PictureSize = PictureSize::new(1242, 375);
/// Frames per second of all sequences.
const FRAME_RATE: f64 = 10.0;

/// Reads all sequences of the folder that contains `label_02`.
///
/// # Errors
/// [`EvalError`] for a missing or broken file, with the line if there is one.
pub fn read(folder: &Path) -> Result<DataSet, EvalError> {
    let labels = folder.join("label_02");
    let files = entries(&labels, |path| has_extension(path, &["txt"])).map_err(|error| {
        EvalError::read(
            &labels,
            error,
            "give the folder that contains label_02 with one file per sequence",
        )
    })?;
    let mut data = DataSet::default();
    for file in files {
        let name = file.file_stem().unwrap_or_default().to_string_lossy();
        let clip = read_sequence(folder, &name, &mut data.report)?;
        data.push(clip);
    }
    data.nonempty(
        folder,
        "label_02 with a file for each sequence, as in training/label_02/0000.txt",
    )
}

fn read_sequence(folder: &Path, name: &str, report: &mut LoadReport) -> Result<Clip, EvalError> {
    let pictures = pictures_in(&folder.join("image_02").join(name));
    let first = pictures.first().and_then(|first| read_picture_file(first).ok());
    let picture = first.map_or(USUAL_SIZE, |first| first.size);
    let known_frames = if pictures.is_empty() {
        None
    } else {
        Some(pictures.len())
    };
    let table = |kind: &str| Table {
        path: folder.join(kind).join(format!("{name}.txt")),
        separator: None,
        header: None,
        first: 0,
        frames: known_frames,
    };
    let labels = table("label_02");
    let mut truth: Vec<Vec<ScoredBox>> = labels.read(GONE, |row, boxes| {
        if !is_region(row)? {
            let mut object = labelled(row, TRUTH_CONFIDENCE)?;
            object.object = row.object(1, "id")?;
            boxes.extend(report.keep(&object, picture, || row.place()));
        }
        Ok(())
    })?;
    let ignored = labels.read(GONE, |row, regions| {
        if is_region(row)? {
            let corners = labelled(row, TRUTH_CONFIDENCE)?.corners;
            let any_class = None;
            regions.extend(report.mark(corners, any_class, Mark::Region, picture, || row.place()));
        }
        Ok(())
    })?;
    let found = table("det_02");
    let mut detections = None;
    if found.path.exists() {
        let boxes = found.boxes(GONE, picture, report, |row| {
            let confidence = row.number(17, "score")?;
            labelled(row, confidence)
        })?;
        detections = Some(boxes);
    }
    let frames = truth.len().max(detections.as_ref().map_or(0, Vec::len));
    truth.resize(frames, Vec::new());
    if let Some(detections) = &mut detections {
        detections.resize(frames, Vec::new());
    }
    Ok(Clip {
        frame_rate: Some(FRAME_RATE),
        detections,
        truth: Some(truth),
        pictures,
        ignored,
        ..Clip::new(name.to_owned(), picture, frames)
    })
}

/// True for a row of a region in which boxes are not judged.
fn is_region(row: &Row<'_>) -> Result<bool, EvalError> {
    Ok(row.text(2, "type")?.eq_ignore_ascii_case("DontCare"))
}

fn labelled<'r>(row: &'r Row<'_>, confidence: f64) -> Result<LabelledBox<'r>, EvalError> {
    let [x1, y1, x2, y2] = row.numbers(6, ["x1", "y1", "x2", "y2"])?;
    let class_name = row.text(2, "type")?;
    Ok(LabelledBox {
        corners: Corners { x1, y1, x2, y2 },
        class: from_kitti(class_name),
        class_name: class_name.into(),
        confidence,
        object: None,
    })
}
