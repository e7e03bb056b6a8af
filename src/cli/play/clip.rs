//! Reads a clip into memory once, so that no run spends time on reading.

use albireo_core::geometry::PictureSize;
use albireo_eval::footage::{FrameSource, Pictures};
use albireo_vision::picture::EncodedPicture;
use anyhow::{Context, bail};

/// Largest clip, bytes.
const MAX_BYTES: usize = 1 << 30;

/// Reads the first `seconds` of `source`; also returns the size of its first picture.
///
/// # Errors
/// When the source fails, is empty, or is too large for the memory.
pub(in crate::cli) fn load(
    mut source: Box<dyn FrameSource>,
    seconds: f64,
) -> anyhow::Result<(Pictures, PictureSize)> {
    let most = (seconds * source.rate()).round().max(1.0) as usize;
    let mut pictures: Vec<EncodedPicture> = Vec::new();
    let mut bytes = 0;
    while pictures.len() < most {
        let Some(picture) = source.next().context("--clip")? else {
            break;
        };
        bytes += picture.bytes.len();
        if bytes > MAX_BYTES {
            bail!(
                "--clip: {} frames take more than {} MiB; play less of it with --seconds {:.0}",
                pictures.len(),
                MAX_BYTES >> 20,
                (pictures.len() as f64 / source.rate() * 0.9).floor()
            );
        }
        pictures.push(picture);
    }
    let Some(size) = pictures.first().map(|first| first.size) else {
        bail!("--clip {}: it has no frames", source.name());
    };
    let clip = Pictures::in_memory(source.name().to_owned(), pictures, source.rate());
    Ok((clip, size))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn a_clip_is_as_long_as_asked_for() {
        let source = Pictures::of_archive(Path::new("demo/road.tar"), 10.0).unwrap();
        let (clip, _) = load(Box::new(source), 0.3).unwrap();
        assert_eq!(clip.frames(), Some(3));
    }
}
