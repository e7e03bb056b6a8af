//! Pictures that lie beside labels: which there are, and how large they are.

use super::{entries, has_extension};
use albireo_core::geometry::PictureSize;
use std::io::Read;
use std::path::{Path, PathBuf};

/// The JPEG and PNG files of a folder, sorted by name; none if there is no such folder.
pub(super) fn pictures_in(folder: &Path) -> Vec<PathBuf> {
    entries(folder, |path| has_extension(path, &["jpg", "jpeg", "png"])).unwrap_or_default()
}

/// The size a PNG file says it has, from its header alone; `None` if it is not a PNG file.
pub(super) fn png_size(path: &Path) -> Option<PictureSize> {
    // Signature, then the IHDR chunk: length, name, width, height (PNG specification, 5.3 and 11.2.2).
    let mut start = [0_u8; 24];
    std::fs::File::open(path)
        .ok()?
        .read_exact(&mut start)
        .ok()?;
    if &start[..8] != b"\x89PNG\r\n\x1a\n" || &start[12..16] != b"IHDR" {
        return None;
    }
    let number = |at: usize| {
        let bytes = [start[at], start[at + 1], start[at + 2], start[at + 3]];
        u32::from_be_bytes(bytes)
    };
    let size = PictureSize::new(number(16), number(20));
    (size.pixels() > 0).then_some(size)
}
