//! Reads ground truth of VisDrone (video object detection and multi-object tracking): `annotations/NAME.txt`, and the
//! pictures in `sequences/NAME/`.
//!
//! Rows are `frame,id,left,top,width,height,score,category,truncation,occlusion`, frames counted from 1 and pixels
//! from 0. Boxes are not judged in ignored regions (category 0), on objects of no category (11), and on objects whose
//! score is 0. Source: VisDrone toolkit, readme.

use super::classes::from_visdrone;
use super::rows::{GONE, Row, Table};
use super::{Clip, DataSet, LabelledBox, LoadReport, TRUTH_CONFIDENCE, pictures_in};
use crate::error::EvalError;
use crate::files::{entries, has_extension};
use crate::judge::Mark;
use albireo_core::geometry::{Corners, PictureSize};
use albireo_vision::picture::read_picture_file;
use std::borrow::Cow;
use std::path::Path;

/// Reads all sequences of the folder that contains `annotations`. `picture` is the size of sequences whose pictures are
/// not there.
///
/// # Errors
/// [`EvalError`] for a missing or broken file, with the line if there is one.
pub fn read(folder: &Path, picture: PictureSize) -> Result<DataSet, EvalError> {
    let labels = folder.join("annotations");
    let files = entries(&labels, |path| has_extension(path, &["txt"])).map_err(|error| {
        EvalError::read(
            &labels,
            error,
            "give the folder that contains annotations with one file per sequence",
        )
    })?;
    let mut data = DataSet::default();
    for file in files {
        let clip = read_sequence(folder, &file, picture, &mut data.report)?;
        data.push(clip);
    }
    data.nonempty(
        folder,
        "annotations/ with a file for each clip, as in VisDrone2019-VID-val/annotations",
    )
}

fn read_sequence(
    folder: &Path,
    file: &Path,
    size_without_pictures: PictureSize,
    report: &mut LoadReport,
) -> Result<Clip, EvalError> {
    let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let pictures = pictures_in(&folder.join("sequences").join(&name));
    let first = pictures.first().and_then(|first| read_picture_file(first).ok());
    let picture = first.map_or(size_without_pictures, |first| first.size);
    let known_frames = if pictures.is_empty() {
        None
    } else {
        Some(pictures.len())
    };
    let table = Table {
        path: file.to_owned(),
        separator: Some(','),
        header: None,
        first: 1,
        frames: known_frames,
    };
    let truth = table.read(GONE, |row, boxes| {
        if is_judged(row)? {
            let category = row.integer(7, "category")?;
            let labelled = LabelledBox {
                corners: corners(row)?,
                class: from_visdrone(category),
                class_name: named(category),
                confidence: TRUTH_CONFIDENCE,
                object: row.object(1, "id")?,
            };
            boxes.extend(report.keep(&labelled, picture, || row.place()));
        }
        Ok(())
    })?;
    let ignored = table.read(GONE, |row, regions| {
        if !is_judged(row)? {
            let corners = corners(row)?;
            let any_class = None;
            regions.extend(report.mark(corners, any_class, Mark::Region, picture, || row.place()));
        }
        Ok(())
    })?;
    let frames = truth.len();
    Ok(Clip {
        truth: Some(truth),
        pictures,
        ignored,
        ..Clip::new(name, picture, frames)
    })
}

/// True for a row of an object; false for one of a place where boxes are not judged.
fn is_judged(row: &Row<'_>) -> Result<bool, EvalError> {
    let score = row.number::<f64>(6, "score")?;
    let category = row.integer(7, "category")?;
    Ok(score != 0.0 && !matches!(category, 0 | 11))
}

/// The data set's names of its categories, from 0.
const CATEGORIES: [&str; 12] = [
    "ignored region",
    "pedestrian",
    "people",
    "bicycle",
    "car",
    "van",
    "truck",
    "tricycle",
    "awning-tricycle",
    "bus",
    "motor",
    "others",
];

fn named(category: i64) -> Cow<'static, str> {
    let known = usize::try_from(category).ok().and_then(|category| CATEGORIES.get(category));
    known.map_or_else(|| category.to_string().into(), |name| (*name).into())
}

fn corners(row: &Row<'_>) -> Result<Corners, EvalError> {
    let [left, top, width, height] = row.numbers(2, ["left", "top", "width", "height"])?;
    Ok(Corners {
        x1: left,
        y1: top,
        x2: left + width,
        y2: top + height,
    })
}
