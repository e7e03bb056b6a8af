//! Pictures from files: finds and orders the pictures of a folder, and reads one of them as a camera would send it.

use super::{EncodedPicture, FrameLimits, picture_of_file};
use bytes::Bytes;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The file or folder from which no picture can be read, and why.
#[derive(Debug, Error)]
#[error("{0}")]
pub struct PictureFileError(String);

impl PictureFileError {
    fn new(path: &Path, reason: impl Display) -> Self {
        Self(format!("{}: {reason}", path.display()))
    }

    fn unreadable(path: &Path) -> impl Fn(std::io::Error) -> Self {
        move |error| Self::new(path, format_args!("cannot be read: {error}"))
    }
}

/// True if the file's name is that of a JPEG or PNG file. Hidden files are none: a Mac writes `._1.jpg` beside `1.jpg` on
/// cards and into archives.
pub fn is_picture_file(path: &Path) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or("");
    let is_known = ["jpg", "jpeg", "png"].iter().any(|known| extension.eq_ignore_ascii_case(known));
    is_known && !is_hidden(path)
}

/// True if the file's name begins with a dot.
pub(crate) fn is_hidden(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."))
}

/// Returns the JPEG and PNG files of a folder, ordered by name with numbers by value (`9.jpg` before `10.jpg`), or
/// `path` itself if it is not a folder.
///
/// # Errors
/// If the folder cannot be read or has no pictures.
pub fn picture_files(path: &Path) -> Result<Vec<PathBuf>, PictureFileError> {
    if !path.is_dir() {
        return Ok(vec![path.to_path_buf()]);
    }
    let unreadable = PictureFileError::unreadable(path);
    let mut files = Vec::new();
    for entry in std::fs::read_dir(path).map_err(&unreadable)? {
        let file = entry.map_err(&unreadable)?.path();
        if is_picture_file(&file) && file.is_file() {
            files.push(file);
        }
    }
    if files.is_empty() {
        let reason = "no .jpg, .jpeg or .png files in it";
        return Err(PictureFileError::new(path, reason));
    }
    files.sort_by_cached_key(|file| natural_key(file));
    Ok(files)
}

/// The file's name with its numbers padded, so that they compare by value, and its path, which tells files of one key apart.
pub fn natural_key(file: &Path) -> (String, PathBuf) {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let is_digit = |byte: &u8| byte.is_ascii_digit();
    let padded = |part: &[u8]| {
        let text = String::from_utf8_lossy(part);
        if part.iter().all(is_digit) {
            format!("{:0>20}", text.trim_start_matches('0'))
        } else {
            text.into_owned()
        }
    };
    let key = name
        .as_bytes()
        .chunk_by(|a, b| is_digit(a) == is_digit(b))
        .map(padded)
        .collect();
    (key, file.to_path_buf())
}

/// Reads a file, and its header as a node would.
///
/// # Errors
/// If it cannot be read, or is not a picture that a node accepts.
pub fn read_picture_file(path: &Path) -> Result<EncodedPicture, PictureFileError> {
    let bytes = std::fs::read(path).map_err(PictureFileError::unreadable(path))?;
    picture_of_file(Bytes::from(bytes), &FrameLimits::default()).map_err(|fault| {
        PictureFileError::new(
            path,
            format_args!("not a picture that can be sent: {fault}"),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_come_in_natural_order_and_other_files_are_ignored() {
        let folder = tempfile::tempdir().unwrap();
        for name in "f10.jpg f9.jpg f9b.PNG notes.txt ._f9.jpg a2.jpeg f010.jpg".split(' ') {
            std::fs::write(folder.path().join(name), b"").unwrap();
        }
        std::fs::create_dir(folder.path().join("sub.jpg")).unwrap();
        let files = picture_files(folder.path()).unwrap();
        let names = files.iter().map(|file| file.file_name().unwrap());
        let expected = ["a2.jpeg", "f9.jpg", "f9b.PNG", "f010.jpg", "f10.jpg"];
        assert!(names.eq(expected), "{files:?}");
    }

    #[test]
    fn a_folder_without_pictures_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("x.txt"), b"").unwrap();
        let error = picture_files(folder.path()).unwrap_err().to_string();
        assert!(error.contains("no .jpg"), "{error}");
    }

    #[test]
    fn a_broken_picture_and_a_missing_one_are_named() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("x.jpg"), b"GIF89a").unwrap();
        for (name, said) in [
            ("x.jpg", "x.jpg: not a picture"),
            ("gone.jpg", "gone.jpg: cannot be read"),
        ] {
            let error = read_picture_file(&folder.path().join(name)).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
    }
}
