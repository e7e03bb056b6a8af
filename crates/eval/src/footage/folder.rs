//! A folder of pictures as a source of frames.

use super::source::{FrameSource, clip_name};
use crate::error::EvalError;
use albireo_vision::picture::{EncodedPicture, picture_files, read_picture_file};
use std::path::{Path, PathBuf};

/// The JPEG and PNG files of a folder, ordered by name with numbers by value (`9.jpg` before `10.jpg`).
#[derive(Debug)]
pub struct PictureFolder {
    name: String,
    files: Vec<PathBuf>,
    at: usize,
    rate: f64,
}

impl PictureFolder {
    /// Frames per second where none are given.
    pub const RATE: f64 = 10.0;

    /// The pictures of a folder, or one picture.
    ///
    /// # Errors
    /// When the folder cannot be read or has no pictures.
    pub fn open(path: &Path, rate: f64) -> Result<Self, EvalError> {
        Ok(Self {
            name: clip_name(path),
            files: picture_files(path)?,
            at: 0,
            rate,
        })
    }
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

    fn next(&mut self) -> Result<Option<EncodedPicture>, EvalError> {
        let Some(file) = self.files.get(self.at) else {
            return Ok(None);
        };
        self.at += 1;
        Ok(Some(read_picture_file(file)?))
    }

    fn rewind(&mut self) -> Result<(), EvalError> {
        self.at = 0;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_s_pictures_come_in_order_to_the_end_and_again() {
        let folder = tempfile::tempdir().unwrap();
        let picture = |name: &str, side: u16| {
            let file = jpeg_encoder::Encoder::new_file(folder.path().join(name), 80).unwrap();
            let pixels = vec![0; 3 * usize::from(side) * usize::from(side)];
            file.encode(&pixels, side, side, jpeg_encoder::ColorType::Rgb)
                .unwrap();
        };
        picture("10.jpg", 16);
        picture("9.jpg", 8);
        let mut opened = PictureFolder::open(folder.path(), 5.0).unwrap();
        assert_eq!(opened.frames(), Some(2));
        for _ in 0..2 {
            for side in [8, 16] {
                assert_eq!(opened.next().unwrap().unwrap().size.width, side);
            }
            assert!(opened.next().unwrap().is_none());
            opened.rewind().unwrap();
        }
    }
}
