//! A folder of pictures as a source of frames.

use super::source::{FrameSource, clip_name};
use albireo_node::frame::{EncodedPicture, FrameLimits, PayloadFormat, RawSample, read_frame};
use anyhow::{Context, anyhow, bail};
use bytes::Bytes;
use std::path::{Path, PathBuf};
use tokio::time::Instant;

/// The JPEG and PNG files of a folder, ordered by name with numbers by value (`9.jpg` before `10.jpg`).
#[derive(Debug)]
pub struct PictureFolder {
    name: String,
    files: Vec<PathBuf>,
    at: usize,
    rate: f64,
}

/// Whether the file's name is that of a picture.
pub(super) fn is_picture(path: &Path) -> bool {
    path.extension()
        .and_then(|extension| extension.to_str())
        .is_some_and(|extension| {
            ["jpg", "jpeg", "png"]
                .iter()
                .any(|known| extension.eq_ignore_ascii_case(known))
        })
}

impl PictureFolder {
    /// Frames per second, where nobody says.
    pub const RATE: f64 = 10.0;

    /// The pictures of a folder, or one picture.
    ///
    /// # Errors
    /// When the folder cannot be read or has no pictures.
    pub fn open(path: &Path, rate: f64) -> anyhow::Result<Self> {
        let mut files = Vec::new();
        if path.is_dir() {
            let entries = std::fs::read_dir(path)
                .with_context(|| format!("{}: cannot be read", path.display()))?;
            for entry in entries {
                let file = entry
                    .with_context(|| format!("{}: cannot be read", path.display()))?
                    .path();
                if is_picture(&file) && file.is_file() {
                    files.push(file);
                }
            }
        } else {
            files.push(path.to_path_buf());
        }
        if files.is_empty() {
            bail!("{}: no .jpg, .jpeg or .png files in it", path.display());
        }
        files.sort_by_cached_key(|file| natural_key(file));
        Ok(Self {
            name: clip_name(path),
            files,
            at: 0,
            rate,
        })
    }

    /// Its files, in their order.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }
}

/// The file's name in parts that compare as people count: text as text, digits by value.
fn natural_key(file: &Path) -> Vec<(String, u64, String)> {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let mut parts = Vec::new();
    let mut rest = name.as_ref();
    while !rest.is_empty() {
        let text_end = rest
            .find(|c: char| c.is_ascii_digit())
            .unwrap_or(rest.len());
        let (text, after) = rest.split_at(text_end);
        let digits_end = after
            .find(|c: char| !c.is_ascii_digit())
            .unwrap_or(after.len());
        let (digits, after) = after.split_at(digits_end);
        parts.push((
            text.to_owned(),
            digits.parse().unwrap_or(u64::MAX),
            digits.to_owned(),
        ));
        rest = after;
    }
    parts
}

/// Reads the file's header as a node would.
fn picture(bytes: Vec<u8>) -> anyhow::Result<EncodedPicture> {
    let raw = RawSample {
        payload: Bytes::from(bytes),
        encoding: "",
        attachment: None,
        timestamp_ns: None,
        arrival: 0,
        received: Instant::now(),
    };
    read_frame(raw, PayloadFormat::Encoding, &FrameLimits::default())
        .map(|frame| frame.picture)
        .map_err(|rejected| anyhow!(rejected))
}

impl FrameSource for PictureFolder {
    fn name(&self) -> &str {
        &self.name
    }

    fn rate(&self) -> f64 {
        self.rate
    }

    fn frames(&self) -> Option<u64> {
        Some(self.files.len() as u64)
    }

    fn next(&mut self) -> anyhow::Result<Option<EncodedPicture>> {
        let Some(file) = self.files.get(self.at) else {
            return Ok(None);
        };
        self.at += 1;
        std::fs::read(file)
            .map_err(anyhow::Error::from)
            .and_then(picture)
            .with_context(|| format!("{}: not a picture that can be sent", file.display()))
            .map(Some)
    }

    fn rewind(&mut self) -> anyhow::Result<()> {
        self.at = 0;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_come_in_the_order_people_count_and_other_files_are_passed_over() {
        let folder = tempfile::tempdir().unwrap();
        for name in [
            "f10.jpg",
            "f9.jpg",
            "f9b.PNG",
            "notes.txt",
            "a2.jpeg",
            "f010.jpg",
        ] {
            std::fs::write(folder.path().join(name), b"").unwrap();
        }
        std::fs::create_dir(folder.path().join("sub.jpg")).unwrap();
        let opened = PictureFolder::open(folder.path(), 5.0).unwrap();
        let names: Vec<_> = opened
            .files
            .iter()
            .map(|file| file.file_name().unwrap().to_str().unwrap())
            .collect();
        assert_eq!(
            names,
            ["a2.jpeg", "f9.jpg", "f9b.PNG", "f010.jpg", "f10.jpg"]
        );
        assert_eq!(opened.frames(), Some(5));
    }

    #[test]
    fn a_folder_without_pictures_and_a_broken_picture_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let error = PictureFolder::open(folder.path(), 5.0).unwrap_err();
        assert!(error.to_string().contains("no .jpg"));
        std::fs::write(folder.path().join("x.jpg"), b"GIF89a").unwrap();
        let mut opened = PictureFolder::open(folder.path(), 5.0).unwrap();
        let error = opened.next().unwrap_err();
        assert!(format!("{error:#}").contains("x.jpg"), "{error:#}");
    }
}
