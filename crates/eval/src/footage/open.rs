//! Opens the footage that a name on the command line means.

use super::archive::PictureArchive;
use super::error::FootageError;
use super::folder::PictureFolder;
use super::source::FrameSource;
use super::video::{Ffmpeg, Video, VideoEncoding};
use albireo_vision::picture::is_picture_file;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// The demonstration's road, in the project's folder.
const ROAD: &str = "demo/road.tar";

/// What to replay, as it is named on the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SourceName {
    /// A folder of JPEG and PNG files, or one such file.
    Pictures(PathBuf),
    /// A tar archive of such folders; `demo` is the demonstration's.
    Archive(PathBuf),
    /// A video file.
    Video(String),
}

impl FromStr for SourceName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let path = Path::new(if text == "demo" { ROAD } else { text });
        if path.extension().is_some_and(|extension| extension == "tar") {
            return Ok(Self::Archive(path.to_path_buf()));
        }
        if path.is_dir() || is_picture_file(path) {
            return Ok(Self::Pictures(path.to_path_buf()));
        }
        Ok(Self::Video(text.to_owned()))
    }
}

impl SourceName {
    /// Opens the source. `rate`: frames per second of a source that has none of its own.
    ///
    /// # Errors
    /// When it does not exist, cannot be read, or needs a program that is not installed.
    pub async fn open(
        &self,
        rate: Option<f64>,
        encoding: VideoEncoding,
    ) -> Result<Box<dyn FrameSource>, FootageError> {
        match self {
            Self::Pictures(path) => {
                let folder = PictureFolder::open(path, rate.unwrap_or(PictureFolder::RATE))?;
                Ok(Box::new(folder))
            }
            Self::Archive(path) => {
                let archive = PictureArchive::open(path, rate.unwrap_or(PictureFolder::RATE))?;
                Ok(Box::new(archive))
            }
            Self::Video(input) => {
                if !input.contains("://") && !Path::new(input).exists() {
                    return Err(FootageError::Missing(input.clone()));
                }
                let input = input.clone();
                // ffprobe reads the file first.
                let video = tokio::task::spawn_blocking(move || {
                    Video::open(&input, rate, encoding, Ffmpeg::default())
                })
                .await??;
                Ok(Box::new(video))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_source_is_told_by_its_name() {
        assert_eq!(
            "drive.mp4".parse(),
            Ok(SourceName::Video("drive.mp4".to_owned()))
        );
        assert_eq!(
            "one.PNG".parse(),
            Ok(SourceName::Pictures(PathBuf::from("one.PNG")))
        );
        let archive = |path: &str| Ok(SourceName::Archive(PathBuf::from(path)));
        assert_eq!("demo".parse(), archive("demo/road.tar"));
        assert_eq!("other.tar".parse(), archive("other.tar"));
        let folder = env!("CARGO_MANIFEST_DIR");
        assert_eq!(
            folder.parse(),
            Ok(SourceName::Pictures(PathBuf::from(folder)))
        );
    }

    #[tokio::test]
    async fn a_missing_file_is_named() {
        let name: SourceName = "no/such/drive.mp4".parse().unwrap();
        let error = name.open(None, VideoEncoding::Jpeg).await.err().unwrap();
        assert!(error.to_string().contains("no/such/drive.mp4"));
    }
}
