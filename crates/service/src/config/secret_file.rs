//! Reads secrets from files.

use std::path::Path;

/// The mark that editors on Windows put before the first character of a file.
const BYTE_ORDER_MARK: char = '\u{feff}';

/// The first line of a file, without spaces around it.
///
/// # Errors
/// If the file cannot be read as text.
pub fn first_line(file: &Path) -> std::io::Result<String> {
    let text = std::fs::read_to_string(file)?;
    let first = text.lines().next().unwrap_or_default();
    Ok(first.trim_start_matches(BYTE_ORDER_MARK).trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_secret_that_was_written_on_windows_is_read_as_it_was_typed() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("token");
        for (text, secret) in [
            ("\u{feff}s3cret\r\nmore\r\n", "s3cret"),
            (" s3cret \n", "s3cret"),
            ("", ""),
        ] {
            std::fs::write(&file, text).unwrap();
            assert_eq!(first_line(&file).unwrap(), secret);
        }
    }
}
