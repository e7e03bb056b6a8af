//! Reads and writes files; every error names the path.

use crate::error::EvalError;
use serde::Serialize;
use std::error::Error;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

/// The first bytes of a file that gzip has compressed.
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// The mark of the byte order, with which some editors begin a text in UTF-8, and those with which one in UTF-16
/// begins.
const UTF8: &[u8] = "\u{feff}".as_bytes();
const UTF16: [[u8; 2]; 2] = [[0xff, 0xfe], [0xfe, 0xff]];

/// Reads the text of a file, without the mark of the byte order; `help` says what to do if it is missing.
pub(crate) fn read_text(path: &Path, help: &str) -> Result<String, EvalError> {
    let mut bytes = Vec::new();
    open_text(path, help)?
        .read_to_end(&mut bytes)
        .map_err(|error| EvalError::read(path, error, help))?;
    String::from_utf8(bytes)
        .map_err(|error| EvalError::content(path, format!("it is not text in UTF-8: {error}")))
}

/// Opens the text of a file behind the mark of the byte order; `help` says what to do if it is missing.
pub(crate) fn open_text(path: &Path, help: &str) -> Result<BufReader<File>, EvalError> {
    let unreadable = |error| EvalError::read(path, error, help);
    let mut text = BufReader::new(File::open(path).map_err(unreadable)?);
    let begins = text.fill_buf().map_err(unreadable)?;
    check_is_text(path, begins)?;
    if begins.starts_with(UTF8) {
        text.consume(UTF8.len());
    }
    Ok(text)
}

/// Makes sure that what begins so is not compressed, and no text of another kind.
fn check_is_text(path: &Path, begins: &[u8]) -> Result<(), EvalError> {
    let what = if begins.starts_with(&GZIP) {
        "it is compressed: gunzip it first"
    } else if UTF16.iter().any(|mark| begins.starts_with(mark)) {
        "it is not text in UTF-8: it is in UTF-16"
    } else {
        return Ok(());
    };
    Err(EvalError::content(path, what))
}

/// True if the name of a file ends with one of these, in capitals or not.
pub(crate) fn has_extension(path: &Path, wanted: &[&str]) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str());
    extension.is_some_and(|extension| wanted.iter().any(|one| extension.eq_ignore_ascii_case(one)))
}

/// Lists the paths in a folder for which `wanted` is true, sorted; what cannot be listed is left out.
pub(crate) fn entries(
    folder: &Path,
    wanted: impl Fn(&Path) -> bool,
) -> std::io::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder)?;
    let mut paths: Vec<PathBuf> = entries
        .filter_map(Result::ok)
        .map(|entry| entry.path())
        .filter(|path| wanted(path))
        .collect();
    paths.sort();
    Ok(paths)
}

/// Writes a file, and creates its folder if needed.
///
/// # Errors
/// When the folder or the file cannot be written.
pub fn write(path: &Path, content: impl AsRef<[u8]>) -> Result<(), EvalError> {
    let failed = |error| EvalError::write(path, error);
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    std::fs::write(path, content).map_err(failed)
}

/// Writes `value` as indented JSON.
pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), EvalError> {
    let json = serde_json::to_vec_pretty(value).map_err(|error| EvalError::content(path, error))?;
    write(path, json)
}

/// A row of CSV: its cells, each with the name of its column.
pub(crate) type CsvRow = Vec<(&'static str, String)>;

/// Writes rows as CSV; the names in the first row are the header.
pub(crate) fn write_csv(path: &Path, rows: &[CsvRow]) -> Result<(), EvalError> {
    let text = csv_of(rows).map_err(|error| EvalError::content(path, error))?;
    write(path, text)
}

fn csv_of(rows: &[CsvRow]) -> Result<Vec<u8>, Box<dyn Error>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    if let Some(first) = rows.first() {
        writer.write_record(first.iter().map(|(name, _)| *name))?;
    }
    for row in rows {
        writer.write_record(row.iter().map(|(_, cell)| cell))?;
    }
    Ok(writer.into_inner().map_err(|error| error.to_string())?)
}
