//! Writes recorded frames as pictures with labels, as COCO or in the layout of MOTChallenge, for training and labelling
//! tools.

mod coco;
mod frames;
mod mot;

use crate::error::EvalError;
use crate::footage::clip_name;
use albireo_recording::is_recording;
use frames::LabelledFrame;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The layout of an export.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum ExportFormat {
    /// Pictures in `images`, boxes in `annotations.json`.
    Coco,
    /// MOTChallenge: a folder for each recording, with `img1`, `seqinfo.ini`, and `gt/gt.txt` or `det/det.txt`.
    Mot,
}

/// The frames of an export.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum ExportedFrames {
    /// Frames on which the audit found a difference, with the boxes of the detector.
    #[default]
    Audit,
    /// All recorded frames, with the boxes that were published, and their track ids.
    Shown,
}

/// What was exported.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Exported {
    /// Recordings with such frames.
    pub recordings: u64,
    /// Pictures.
    pub pictures: u64,
    /// Boxes.
    pub boxes: u64,
    /// What was left out, a sentence each.
    pub left_out: Vec<String>,
    /// What a user of the frames must know, a sentence each.
    pub notes: Vec<String>,
}

/// The recordings in a folder in the order of their names, or the one file.
///
/// # Errors
/// When there is none.
pub fn recordings(path: &Path) -> Result<Vec<PathBuf>, EvalError> {
    if path.is_file() {
        return Ok(vec![path.to_owned()]);
    }
    let help = "name a folder of recordings ([record] folder) or an MCAP file";
    let found = crate::files::entries(path, is_recording)
        .map_err(|error| EvalError::read(path, error, help))?;
    if found.is_empty() {
        return Err(EvalError::content(
            path,
            format!("it has no MCAP file: {help}"),
        ));
    }
    Ok(found)
}

/// Exports the frames of `recordings` into `out`, a new or empty folder. `done` is told after each recording.
///
/// # Errors
/// When `out` is not empty or cannot be written, or there is no such frame.
pub fn export(
    recordings: &[PathBuf],
    out: &Path,
    format: ExportFormat,
    frames: ExportedFrames,
    mut done: impl FnMut(&Exported),
) -> Result<Exported, EvalError> {
    if crate::files::entries(out, |_| true).is_ok_and(|found| !found.is_empty()) {
        let what = "the folder is not empty: name a new one with --out";
        return Err(EvalError::content(out, what));
    }
    let mut exported = Exported::default();
    let mut coco = coco::Coco::default();
    let mut readable = 0;
    for path in recordings {
        let before = exported.pictures;
        let mut sequences = BTreeMap::<String, mot::Sequence>::new();
        let write_frame = |frame: LabelledFrame| {
            exported.pictures += 1;
            exported.boxes += frame.boxes.len() as u64;
            match format {
                ExportFormat::Coco => coco.add(path, &frame, out),
                ExportFormat::Mot => {
                    let sequence = sequences
                        .entry(frame.camera.clone())
                        .or_insert_with(|| mot::Sequence::new(path, &frame, frames, out));
                    sequence.add(&frame)
                }
            }
        };
        let read = frames::read(path, frames, write_frame)?;
        readable += usize::from(read.is_recording);
        exported.left_out.extend(read.left_out);
        exported.notes.extend(read.notes);
        for sequence in sequences.into_values() {
            exported.notes.extend(sequence.finish()?);
        }
        if exported.pictures > before {
            exported.recordings += 1;
        }
        done(&exported);
    }
    if exported.pictures == 0 {
        let reasons = [exported.left_out, exported.notes].concat().join("; ");
        let were_read = match readable {
            0 => return Err(EvalError::new(&reasons)),
            1 => "1 recording was".to_owned(),
            number => format!("{number} recordings were"),
        };
        let help = match frames {
            ExportedFrames::Audit => {
                "no frame of the audit: record them with when = [\"audit\"] in [record], or export the frames as shown with \
                 --frames shown"
            }
            ExportedFrames::Shown => "no frame with its boxes",
        };
        let text = format!("{were_read} read, and there is {help}. {reasons}");
        return Err(EvalError::new(text.trim_end()));
    }
    if format == ExportFormat::Coco {
        coco.finish(out)?;
    }
    Ok(exported)
}

/// The place of a name among `names`, to which it is added if it is new.
fn place_of(names: &mut Vec<String>, name: &str) -> usize {
    if let Some(place) = names.iter().position(|known| known == name) {
        return place;
    }
    names.push(name.to_owned());
    names.len() - 1
}

/// The name of a camera's frames. The names of a node's own recordings already end with the camera.
fn sequence_name(recording: &Path, camera: &str) -> String {
    let name = clip_name(recording);
    let ending = format!("_{camera}");
    if name.ends_with(&ending) {
        name
    } else {
        name + &ending
    }
}

#[cfg(test)]
mod tests;
