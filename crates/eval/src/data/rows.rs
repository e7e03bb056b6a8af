//! Reads tables of numbers row by row, with the line number in every error.

use super::{LabelledBox, LoadReport};
use crate::boxes::ScoredBox;
use crate::error::EvalError;
use crate::files::read_text;
use albireo_core::geometry::PictureSize;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// The largest number of frames of a clip; a larger one means that the file is broken.
pub(super) const MAX_FRAMES: usize = 1_000_000;

/// The help for a file that was listed, but cannot be read.
pub(super) const GONE: &str = "it existed a moment ago";

/// One row of a table.
pub(super) struct Row<'a> {
    path: &'a Path,
    line: u64,
    fields: Vec<&'a str>,
}

impl Row<'_> {
    /// Number of fields.
    pub(super) fn len(&self) -> usize {
        self.fields.len()
    }

    /// The field at `index` as text.
    pub(super) fn text(&self, index: usize, name: &str) -> Result<&str, EvalError> {
        self.fields.get(index).map(|field| field.trim()).ok_or_else(|| {
            self.broken(format!(
                "the column `{name}` (number {}) is missing: the row has {} columns",
                index + 1,
                self.len()
            ))
        })
    }

    /// The field at `index` as a number.
    pub(super) fn number<T: FromStr>(&self, index: usize, name: &str) -> Result<T, EvalError> {
        let text = self.text(index, name)?;
        text.parse()
            .map_err(|_| self.broken(format!("`{name}` is `{text}`, which is not a valid number")))
    }

    /// Four consecutive fields as numbers, the first of them at `index`.
    pub(super) fn numbers(&self, index: usize, names: [&str; 4]) -> Result<[f64; 4], EvalError> {
        let [first, second, third, fourth] = names;
        Ok([
            self.number(index, first)?,
            self.number(index + 1, second)?,
            self.number(index + 2, third)?,
            self.number(index + 3, fourth)?,
        ])
    }

    /// The field at `index` as a whole number, which the file may write with a decimal point.
    pub(super) fn integer(&self, index: usize, name: &str) -> Result<i64, EvalError> {
        let text = self.text(index, name)?;
        if let Ok(value) = text.parse() {
            return Ok(value);
        }
        match text.parse::<f64>() {
            // Up to there every whole number is exact as f64.
            Ok(value) if value.fract() == 0.0 && value.abs() < 1e15 => Ok(value as i64),
            _ => Err(self.broken(format!("`{name}` is `{text}`, which is not a whole number"))),
        }
    }

    /// The field at `index` as an object's number; `None` if it is negative.
    pub(super) fn object(&self, index: usize, name: &str) -> Result<Option<u64>, EvalError> {
        // A whole number of a table is signed, and the largest numbers of objects are not.
        if let Ok(number) = self.text(index, name)?.parse() {
            return Ok(Some(number));
        }
        Ok(u64::try_from(self.integer(index, name)?).ok())
    }

    /// Creates an error about this row.
    pub(super) fn broken(&self, what: impl std::fmt::Display) -> EvalError {
        EvalError::line(self.path, self.line, what)
    }

    /// `file:line`.
    pub(super) fn place(&self) -> String {
        format!("{}:{}", self.path.display(), self.line)
    }
}

/// A table whose first column is the frame.
pub(super) struct Table<'a> {
    pub path: PathBuf,
    /// The column separator; white space if `None`.
    pub separator: Option<char>,
    /// The expected first row, which also sets the number of columns; `None` if the table has no header.
    pub header: Option<&'a str>,
    /// Number of the first frame.
    pub first: i64,
    /// The number of frames, if known.
    pub frames: Option<usize>,
}

impl Table<'_> {
    /// Calls `visit` for each row with the list of its frame, and returns one list per frame. Blank lines are skipped;
    /// `help` says what to do if the file is missing.
    pub(super) fn read<T: Clone>(
        &self,
        help: &str,
        mut visit: impl FnMut(&Row<'_>, &mut Vec<T>) -> Result<(), EvalError>,
    ) -> Result<Vec<Vec<T>>, EvalError> {
        let text = read_text(&self.path, help)?;
        let mut lists = vec![Vec::new(); self.frames.unwrap_or(0)];
        // These layouts have no quoting and no escapes, and plain splitting keeps the line numbers.
        let mut lines = (1..).zip(text.lines());
        if let Some(header) = self.header {
            let first = lines.next().map_or("", |(_, first)| first.trim());
            if first != header {
                let found = if first.is_empty() {
                    "missing".to_owned()
                } else {
                    format!("`{first}`")
                };
                let what = format!("the header is {found}, expected `{header}`");
                return Err(EvalError::line(&self.path, 1, what));
            }
        }
        let columns = self.header.map(|header| header.split(',').count());
        for (number, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
            let row = Row {
                path: &self.path,
                line: number,
                fields: match self.separator {
                    Some(separator) => line.split(separator).collect(),
                    None => line.split_whitespace().collect(),
                },
            };
            if let Some(columns) = columns
                && columns != row.len()
            {
                let what = format!("the row has {} columns, expected {columns}", row.len());
                return Err(row.broken(what));
            }
            let frame = self.frame(&row)?;
            if lists.len() <= frame {
                lists.resize(frame + 1, Vec::new());
            }
            visit(&row, &mut lists[frame])?;
        }
        Ok(lists)
    }

    /// Reads the boxes of each frame; boxes that are left out are counted in `report`.
    pub(super) fn boxes(
        &self,
        help: &str,
        picture: PictureSize,
        report: &mut LoadReport,
        labelled: impl for<'r> Fn(&'r Row<'_>) -> Result<LabelledBox<'r>, EvalError>,
    ) -> Result<Vec<Vec<ScoredBox>>, EvalError> {
        self.read(help, |row, boxes| {
            let read = labelled(row)?;
            if let Some(kept) = report.keep(&read, picture, || row.place()) {
                boxes.push(kept);
            }
            Ok(())
        })
    }

    /// The index of the row's frame.
    fn frame(&self, row: &Row<'_>) -> Result<usize, EvalError> {
        let number = row.integer(0, "frame")?;
        let frames = self.frames.unwrap_or(MAX_FRAMES);
        if let Ok(frame) = usize::try_from(number.saturating_sub(self.first))
            && frame < frames
        {
            return Ok(frame);
        }
        let what = match self.frames {
            Some(_) => "the clip's frames are",
            None => "the frames that are read are",
        };
        let last = self.first + frames as i64 - 1;
        let first = self.first;
        Err(row.broken(format!(
            "frame {number} does not exist: {what} {first} to {last}"
        )))
    }
}
