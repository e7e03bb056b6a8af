//! KITTI tracking: `label_02/NNNN.txt`, optional detections in `det_02/NNNN.txt` in the same form with a
//! score at the end, and the pictures in `image_02/NNNN/`.
//!
//! Rows are `frame id type truncated occluded alpha x1 y1 x2 y2 height width length x y z rotation [score]`,
//! frames and pixels from 0. Source: KITTI tracking development kit, readme.

use super::classes::from_kitti;
use super::pictures::{pictures_in, png_size};
use super::rows::{Row, read_text, space_separated};
use super::{
    Clip, Clips, DataError, LabelledBox, LoadReport, StoredDetection, entries, has_extension,
};
use crate::average_precision::TruthBox;
use albireo_core::detection::ClassId;
use albireo_core::geometry::{Corners, PictureSize};
use std::path::Path;

/// Pictures of most sequences, used where no picture says otherwise.
const USUAL_SIZE: PictureSize = PictureSize::new(1242, 375);
/// All sequences were recorded at this rate.
const FRAME_RATE: f64 = 10.0;
/// A frame number above this is taken for a broken file rather than for a clip of more than a day.
const MOST_FRAMES: usize = 1_000_000;

/// Reads all sequences of the folder that has `label_02`.
///
/// # Errors
/// [`DataError`] for a missing or broken file, with the line where there is one.
pub fn read(folder: &Path) -> Result<Clips, DataError> {
    let labels = folder.join("label_02");
    let files = entries(&labels, |path| has_extension(path, &["txt"])).map_err(|error| {
        DataError::read(
            &labels,
            error,
            "give the folder that holds label_02 with one file per sequence",
        )
    })?;
    let mut clips = Clips::default();
    for file in files {
        let Some(name) = file
            .file_stem()
            .map(|stem| stem.to_string_lossy().into_owned())
        else {
            continue;
        };
        let clip = read_sequence(folder, &file, &name, &mut clips.report)?;
        clips.push(clip);
    }
    clips.nonempty(folder)
}

fn read_sequence(
    folder: &Path,
    labels: &Path,
    name: &str,
    report: &mut LoadReport,
) -> Result<Clip, DataError> {
    let pictures = pictures_in(&folder.join("image_02").join(name));
    let picture = pictures
        .first()
        .and_then(|first| png_size(first))
        .unwrap_or(USUAL_SIZE);
    let mut truth: Vec<Vec<TruthBox>> = vec![Vec::new(); pictures.len()];
    let mut ignored = Vec::new();
    let known = (!pictures.is_empty()).then_some(pictures.len());
    let text = read_text(labels, "it was there a moment ago")?;
    space_separated(labels, &text, |row| {
        let frame = row.frame(0, 0, known.unwrap_or(MOST_FRAMES))?;
        grow(&mut truth, frame);
        if row.text(2, "type")? == "DontCare" {
            ignored.resize(truth.len(), Vec::new());
            ignored[frame].push(corners(row)?);
        } else if let Some((corners, class)) = kept_box(row, picture, None, report)? {
            truth[frame].push(TruthBox {
                corners,
                class,
                object: u64::try_from(row.integer(1, "id")?).ok(),
            });
        }
        Ok(())
    })?;
    let file = folder.join("det_02").join(format!("{name}.txt"));
    let mut detections: Option<Vec<Vec<StoredDetection>>> = None;
    if file.exists() {
        let found = detections.insert(vec![Vec::new(); truth.len()]);
        let text = read_text(&file, "it was there a moment ago")?;
        space_separated(&file, &text, |row| {
            let frame = row.frame(0, 0, known.unwrap_or(MOST_FRAMES))?;
            grow(found, frame);
            let confidence = row.number(17, "score")?;
            if let Some((corners, class)) = kept_box(row, picture, Some(confidence), report)? {
                found[frame].push(StoredDetection {
                    corners,
                    class,
                    confidence,
                });
            }
            Ok(())
        })?;
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

fn grow<T: Clone>(frames: &mut Vec<Vec<T>>, frame: usize) {
    if frames.len() <= frame {
        frames.resize(frame + 1, Vec::new());
    }
}

/// The row's box and class, or nothing if it was left out and counted.
fn kept_box(
    row: &Row<'_>,
    picture: PictureSize,
    confidence: Option<f64>,
    report: &mut LoadReport,
) -> Result<Option<(Corners, ClassId)>, DataError> {
    let (corners, class_name) = (corners(row)?, row.text(2, "type")?);
    let labelled = LabelledBox {
        corners,
        class: from_kitti(class_name),
        class_name: class_name.into(),
        confidence,
    };
    let class = report.keep(&labelled, picture, || row.place());
    Ok(class.map(|class| (corners, class)))
}

fn corners(row: &Row<'_>) -> Result<Corners, DataError> {
    Ok(Corners {
        x1: row.number(6, "x1")?,
        y1: row.number(7, "y1")?,
        x2: row.number(8, "x2")?,
        y2: row.number(9, "y2")?,
    })
}
