//! Reads a clip into memory once, so that no run spends time on reading.

use crate::cli::values::counted;
use albireo_core::geometry::PictureSize;
use albireo_eval::footage::{FrameSource, Pictures};
use albireo_vision::picture::{EncodedPicture, FrameLimits, Picture, decode_small_grey};
use anyhow::{Context, bail};

/// Largest clip, bytes.
const MAX_BYTES: usize = 1 << 30;

/// The width at which pictures are decoded to learn whether they are whole, which costs least.
const TRIED_WIDTH: u32 = 64;

/// A clip in memory.
pub(in crate::cli) struct Loaded {
    pub pictures: Pictures,
    /// The size of its first picture.
    pub size: PictureSize,
    /// The pictures that cannot be decoded, with their names and why.
    pub unusable: Vec<String>,
}

impl Loaded {
    /// Says what cannot be decoded and what that means; `None` if all can.
    pub(in crate::cli) fn warning(&self) -> Option<String> {
        let first = self.unusable.first()?;
        let all = self.pictures.frames().unwrap_or_default();
        Some(format!(
            "{}: {} of {} cannot be used, and {} as a frame without boxes for every policy that looks at it; repair or leave \
             out what `albireo detect` names. The first: {first}",
            self.pictures.name(),
            self.unusable.len(),
            counted(all, "picture", "pictures"),
            if self.unusable.len() == 1 {
                "counts"
            } else {
                "each counts"
            },
        ))
    }
}

/// Reads the first `seconds` of `source`, and tries each picture.
///
/// # Errors
/// When the source fails, is empty, or is too large for the memory.
pub(in crate::cli) fn load(
    mut source: Box<dyn FrameSource>,
    seconds: f64,
) -> anyhow::Result<Loaded> {
    let most = (seconds * source.rate()).round().max(1.0) as usize;
    let limits = FrameLimits::default();
    let mut tried = Picture::default();
    let mut unusable = Vec::new();
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
        if let Err(fault) = decode_small_grey(&picture, &limits, TRIED_WIDTH, &mut tried) {
            let name = match source.picture_name() {
                Some(name) => name,
                None => format!("picture {}", pictures.len() + 1),
            };
            unusable.push(format!("{name}: {fault}"));
        }
        pictures.push(picture);
    }
    let Some(size) = pictures.first().map(|first| first.size) else {
        bail!("--clip {}: it has no frames", source.name());
    };
    Ok(Loaded {
        pictures: Pictures::in_memory(source.name().to_owned(), pictures, source.rate()),
        size,
        unusable,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn a_clip_is_as_long_as_asked_for() {
        let source = Pictures::of_archive(Path::new("demo/road.tar"), 10.0).unwrap();
        let loaded = load(Box::new(source), 0.3).unwrap();
        assert_eq!(loaded.pictures.frames(), Some(3));
        assert_eq!(loaded.warning(), None);
    }

    #[test]
    fn a_picture_that_is_cut_short_is_played_named_and_counted() {
        let folder = tempfile::tempdir().unwrap();
        let mut road = Pictures::of_archive(Path::new("demo/road.tar"), 10.0).unwrap();
        for name in ["1.jpg", "2.jpg", "3.jpg"] {
            let bytes = road.next().unwrap().unwrap().bytes;
            let whole = if name == "2.jpg" { 3000 } else { bytes.len() };
            std::fs::write(folder.path().join(name), &bytes[..whole]).unwrap();
        }
        let source = Pictures::of_folder(folder.path(), 10.0).unwrap();
        let loaded = load(Box::new(source), 10.0).unwrap();
        assert_eq!(loaded.pictures.frames(), Some(3));
        let said = loaded.warning().unwrap();
        let words = [
            "1 of 3 pictures cannot be used, and counts as",
            "2.jpg: undecodable",
            "cut short",
        ];
        assert!(words.iter().all(|word| said.contains(word)), "{said}");
    }
}
