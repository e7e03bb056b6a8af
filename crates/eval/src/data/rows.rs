//! Reading tables of numbers row by row, with the line number in every complaint.

use super::DataError;
use std::path::Path;
use std::str::FromStr;

/// One row of a table.
pub(super) struct Row<'a> {
    path: &'a Path,
    line: u64,
    fields: Vec<&'a str>,
}

impl Row<'_> {
    /// Number of fields.
    pub(crate) fn len(&self) -> usize {
        self.fields.len()
    }

    /// The field at `index` as text.
    pub(crate) fn text(&self, index: usize, name: &str) -> Result<&str, DataError> {
        self.fields
            .get(index)
            .map(|field| field.trim())
            .ok_or_else(|| {
                self.broken(format!(
                    "the column `{name}` (number {}) is missing: the row has {} columns",
                    index + 1,
                    self.fields.len()
                ))
            })
    }

    /// The field at `index` as a number.
    pub(crate) fn number<T: FromStr>(&self, index: usize, name: &str) -> Result<T, DataError> {
        let text = self.text(index, name)?;
        text.parse().map_err(|_| {
            self.broken(format!(
                "`{name}` is `{text}`, which is not a number of its kind"
            ))
        })
    }

    /// A whole number, also where the file writes it with a decimal point.
    pub(crate) fn integer(&self, index: usize, name: &str) -> Result<i64, DataError> {
        let text = self.text(index, name)?;
        if let Ok(value) = text.parse() {
            return Ok(value);
        }
        match text.parse::<f64>() {
            Ok(value) if value.fract() == 0.0 && value.abs() < 1e15 => Ok(value as i64),
            _ => Err(self.broken(format!("`{name}` is `{text}`, which is not a whole number"))),
        }
    }

    /// The frame at `index`, counted from `first` in the file, as an index from 0 below `frames`.
    pub(crate) fn frame(
        &self,
        index: usize,
        first: i64,
        frames: usize,
    ) -> Result<usize, DataError> {
        let number = self.integer(index, "frame")?;
        usize::try_from(number - first)
            .ok()
            .filter(|&frame| frame < frames)
            .ok_or_else(|| {
                self.broken(format!(
                    "frame {number} does not exist: the clip's frames are {first} to {}",
                    first + frames as i64 - 1
                ))
            })
    }

    /// An error about this row.
    pub(crate) fn broken(&self, what: impl Into<String>) -> DataError {
        DataError::line(self.path, self.line, what)
    }

    /// `file:line`.
    pub(crate) fn place(&self) -> String {
        format!("{}:{}", self.path.display(), self.line)
    }
}

/// The text of a file; `help` says what to do when it is missing.
pub(super) fn read_text(path: &Path, help: &str) -> Result<String, DataError> {
    std::fs::read_to_string(path).map_err(|error| DataError::read(path, error, help))
}

/// Calls `visit` for each row of `text`, comma-separated. The first row must be `header` where one is
/// given. Blank lines are passed over.
pub(super) fn comma_separated(
    path: &Path,
    text: &str,
    header: Option<&str>,
    mut visit: impl FnMut(&Row<'_>) -> Result<(), DataError>,
) -> Result<(), DataError> {
    // Neither field quoting nor escapes occur in these layouts, and plain splitting keeps the line number.
    let mut lines = (1..).zip(text.lines());
    if let Some(header) = header {
        let first = lines.next().map_or("", |(_, first)| first.trim());
        if first.trim_start_matches('\u{feff}') != header {
            return Err(DataError::line(
                path,
                1,
                format!("the header is `{first}`, expected `{header}`"),
            ));
        }
    }
    for (line, text) in lines.filter(|(_, text)| !text.trim().is_empty()) {
        visit(&Row {
            path,
            line,
            fields: text.split(',').collect(),
        })?;
    }
    Ok(())
}

/// As [`comma_separated`], with columns separated by white space and no header.
pub(super) fn space_separated(
    path: &Path,
    text: &str,
    mut visit: impl FnMut(&Row<'_>) -> Result<(), DataError>,
) -> Result<(), DataError> {
    for (line, text) in (1..)
        .zip(text.lines())
        .filter(|(_, text)| !text.trim().is_empty())
    {
        visit(&Row {
            path,
            line,
            fields: text.split_whitespace().collect(),
        })?;
    }
    Ok(())
}
