//! A clip in memory: read and encoded once, so that no run pays for it.

use albireo_core::geometry::PictureSize;
use albireo_eval::error::EvalError;
use albireo_eval::footage::FrameSource;
use albireo_vision::picture::EncodedPicture;
use anyhow::{Context, bail};
use std::sync::Arc;

/// Most memory a clip may take, bytes.
const MOST_BYTES: usize = 1 << 30;

/// The pictures of a clip, as a camera sends them. Cheap to clone.
#[derive(Clone, Debug)]
pub(super) struct LoadedClip {
    name: String,
    rate: f64,
    size: PictureSize,
    pictures: Arc<[EncodedPicture]>,
    next: usize,
}

impl LoadedClip {
    /// Reads the first `seconds` of `source`.
    ///
    /// # Errors
    /// When the source fails, is empty, or is too large for the memory.
    pub(super) async fn read(source: Box<dyn FrameSource>, seconds: f64) -> anyhow::Result<Self> {
        tokio::task::spawn_blocking(move || Self::read_now(source, seconds))
            .await
            .context("reading the clip")?
    }

    fn read_now(mut source: Box<dyn FrameSource>, seconds: f64) -> anyhow::Result<Self> {
        let most = (seconds * source.rate()).round().max(1.0) as usize;
        let mut pictures: Vec<EncodedPicture> = Vec::new();
        let mut bytes = 0;
        while pictures.len() < most {
            let Some(picture) = source.next().context("--clip")? else {
                break;
            };
            bytes += picture.bytes.len();
            if bytes > MOST_BYTES {
                bail!(
                    "--clip: {} frames take more than {} MiB; play less of it with --seconds {:.0}",
                    pictures.len(),
                    MOST_BYTES >> 20,
                    (pictures.len() as f64 / source.rate() * 0.9).floor()
                );
            }
            pictures.push(picture);
        }
        let Some(first) = pictures.first() else {
            bail!("--clip {}: there is not one frame in it", source.name());
        };
        Ok(Self {
            name: source.name().to_owned(),
            rate: source.rate(),
            size: first.size,
            pictures: pictures.into(),
            next: 0,
        })
    }

    pub(super) fn size(&self) -> PictureSize {
        self.size
    }

    /// Its number of frames.
    pub(super) fn len(&self) -> usize {
        self.pictures.len()
    }
}

impl FrameSource for LoadedClip {
    fn name(&self) -> &str {
        &self.name
    }

    fn rate(&self) -> f64 {
        self.rate
    }

    fn frames(&self) -> Option<u64> {
        Some(self.len() as u64)
    }

    fn next(&mut self) -> Result<Option<EncodedPicture>, EvalError> {
        let picture = self.pictures.get(self.next).cloned();
        self.next += 1;
        Ok(picture)
    }

    fn rewind(&mut self) -> Result<(), EvalError> {
        self.next = 0;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_eval::footage::PictureArchive;
    use std::path::Path;

    #[tokio::test]
    async fn a_clip_is_as_long_as_asked_for_and_plays_again_from_its_start() {
        let source = PictureArchive::open(Path::new("demo/road.tar"), 10.0).unwrap();
        let clip = LoadedClip::read(Box::new(source), 0.3).await.unwrap();
        assert_eq!((clip.len(), clip.frames()), (3, Some(3)));
        let mut played = clip.clone();
        let first = played.next().unwrap();
        played.next().unwrap();
        played.next().unwrap();
        assert_eq!(played.next().unwrap(), None);
        played.rewind().unwrap();
        assert_eq!(played.next().unwrap(), first);
    }
}
