//! Where replayed frames come from.

use super::folder::PictureFolder;
use super::synthetic::Synthetic;
use super::video::{Ffmpeg, Video, VideoEncoding};
use albireo_node::frame::{EncodedPicture, is_picture_file};
use anyhow::{Context, bail};
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Ends a source from another thread: its pending and later [`FrameSource::next`] calls return soon.
pub type Stopper = Box<dyn FnOnce() + Send>;

/// A sequence of encoded pictures. It is driven on a thread of its own, so its calls may block.
pub trait FrameSource: Send {
    /// A short name, usable as a clip id: a file's stem, `synth-7`.
    fn name(&self) -> &str;

    /// Frames per second of its own.
    fn rate(&self) -> f64;

    /// How many frames one pass has, where that is known beforehand.
    fn frames(&self) -> Option<u64>;

    /// Length of one of its clips, seconds, where it is cut into clips by itself.
    fn clip_seconds(&self) -> Option<f64> {
        None
    }

    /// The next picture; `None` at the end of the pass.
    ///
    /// # Errors
    /// When the source fails. Nothing more can be had from it then.
    fn next(&mut self) -> anyhow::Result<Option<EncodedPicture>>;

    /// Goes back to the first picture.
    ///
    /// # Errors
    /// When the source cannot be opened again.
    fn rewind(&mut self) -> anyhow::Result<()>;

    /// How to end a [`next`](Self::next) that waits for something outside, such as another program.
    fn stopper(&self) -> Option<Stopper> {
        None
    }
}

/// What to replay, as it is named on the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SourceName {
    /// `synth` or `synth:SEED`: the synthetic dashcam.
    Synthetic {
        /// Seed of the scene.
        seed: u64,
    },
    /// A folder of JPEG and PNG files, or one such file.
    Pictures(PathBuf),
    /// A video file, or an address that `ffmpeg` can open (`rtsp://…`).
    Video(String),
}

impl FromStr for SourceName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "synth" {
            return Ok(Self::Synthetic { seed: 1 });
        }
        if let Some(seed) = text.strip_prefix("synth:") {
            return seed
                .parse()
                .map(|seed| Self::Synthetic { seed })
                .map_err(|_| format!("`{seed}` is not a seed: use a whole number, as in synth:7"));
        }
        let path = Path::new(text);
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
    ) -> anyhow::Result<Box<dyn FrameSource>> {
        match self {
            Self::Synthetic { seed } => {
                let source = Synthetic::open(*seed, rate.unwrap_or(Synthetic::RATE))?;
                Ok(Box::new(source))
            }
            Self::Pictures(path) => {
                let folder = PictureFolder::open(path, rate.unwrap_or(PictureFolder::RATE))?;
                Ok(Box::new(folder))
            }
            Self::Video(input) => {
                if !input.contains("://") && !Path::new(input).exists() {
                    bail!("{input}: no such file or folder");
                }
                let input = input.clone();
                // ffprobe reads the file first; an address may take its time.
                let video = tokio::task::spawn_blocking(move || {
                    Video::open(&input, rate, encoding, Ffmpeg::default())
                })
                .await
                .context("opening the video")??;
                Ok(Box::new(video))
            }
        }
    }
}

/// The name that the clip of a file or folder gets: its stem, or its parent's for the folder `img1`, in which
/// MOTChallenge keeps every sequence's pictures.
pub fn clip_name(path: &Path) -> String {
    let own = path.file_stem().unwrap_or_default();
    let parent = path.parent().and_then(Path::file_name);
    let stem = parent.filter(|_| own == "img1").unwrap_or(own);
    // A name that begins with a dot hides the files named after it.
    plain_name(stem.to_string_lossy().trim_start_matches('.'))
}

/// `text` as a name that can stand in a clip id.
fn plain_name(text: &str) -> String {
    let name: String = text
        .chars()
        .take(100)
        .map(|c| {
            if c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.') {
                c
            } else {
                '_'
            }
        })
        .collect();
    if name.is_empty() {
        "clip".to_owned()
    } else {
        name
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_source_is_told_by_its_name() {
        let synthetic = |seed| Ok(SourceName::Synthetic { seed });
        assert_eq!("synth".parse(), synthetic(1));
        assert_eq!("synth:42".parse(), synthetic(42));
        assert!("synth:x".parse::<SourceName>().is_err());
        assert_eq!(
            "rtsp://camera/1".parse(),
            Ok(SourceName::Video("rtsp://camera/1".to_owned()))
        );
        assert_eq!(
            "one.PNG".parse(),
            Ok(SourceName::Pictures(PathBuf::from("one.PNG")))
        );
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
