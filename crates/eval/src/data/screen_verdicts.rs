//! Recorded verdicts of an empty-scene screen: `screen/<name>.csv`.

use super::recorded::put;
use super::rows::{comma_separated, read_text};
use super::{Clip, DataError};
use std::fmt::Write;
use std::path::Path;

const HEADER: &str = "frame,empty";

/// The verdicts on a sequence's frames; `None` if there is no such file.
pub(super) fn read(
    folder: &Path,
    name: &str,
    frames: usize,
) -> Result<Option<Vec<Option<bool>>>, DataError> {
    let path = folder.join("screen").join(format!("{name}.csv"));
    if !path.exists() {
        return Ok(None);
    }
    let text = read_text(&path, "is the file readable?")?;
    let mut verdicts = vec![None; frames];
    comma_separated(&path, &text, Some(HEADER), |row| {
        let frame = row.frame(0, 0, frames)?;
        let empty = match row.text(1, "empty")? {
            "0" => false,
            "1" => true,
            other => return Err(row.broken(format!("`empty` is `{other}`, expected 0 or 1"))),
        };
        if verdicts[frame].replace(empty).is_some() {
            return Err(row.broken(format!("frame {frame} comes twice")));
        }
        Ok(())
    })?;
    Ok(Some(verdicts))
}

/// Writes the verdicts on `clip`, or removes a file of an earlier run if it has none.
pub(super) fn write(folder: &Path, clip: &Clip) -> Result<(), DataError> {
    let text = clip.screen.as_ref().map(|verdicts| {
        let mut text = format!("{HEADER}\n");
        for (frame, verdict) in verdicts.iter().enumerate() {
            if let Some(empty) = verdict {
                // Writing to a string cannot fail.
                let _ = writeln!(text, "{frame},{}", u8::from(*empty));
            }
        }
        text
    });
    put(
        &folder.join("screen").join(format!("{}.csv", clip.name)),
        text,
    )
}
