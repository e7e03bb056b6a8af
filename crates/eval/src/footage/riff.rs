//! Finds out whether an AVI file was cut short.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// The most parts that are looked at: a part has about a gigabyte.
const MOST_PARTS: usize = 1000;

/// Says how much of an AVI file is missing, by the lengths of its parts; `None` if nothing is, and for another file.
pub(super) fn missing_of_riff(path: &Path) -> Option<String> {
    let mut file = File::open(path).ok()?;
    let length = file.metadata().ok()?.len();
    let end = end_of_parts(&mut file).ok()?;
    (end > length).then(|| format!("it is cut short: {length} of {end} bytes are there"))
}

/// Where the last part ends, by its length: 0 if there is none. A file that was not closed does not know that of its
/// last.
fn end_of_parts(file: &mut File) -> io::Result<u64> {
    let mut end = 0;
    for _ in 0..MOST_PARTS {
        file.seek(SeekFrom::Start(end))?;
        let mut head = Vec::with_capacity(12);
        file.by_ref().take(12).read_to_end(&mut head)?;
        let is_avi = head.get(8..11).is_some_and(|kind| kind == b"AVI");
        let is_part = head.starts_with(b"RIFF") && is_avi;
        let Some(size) = head.get(4..8).and_then(|bytes| bytes.first_chunk::<4>()) else {
            break;
        };
        let size = u32::from_le_bytes(*size);
        if !is_part || size == 0 || size == u32::MAX {
            break;
        }
        end += 8 + u64::from(size);
    }
    Ok(end)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The head of a part of an AVI file of this size.
    fn head(kind: &[u8; 4], size: u32) -> Vec<u8> {
        [b"RIFF".as_slice(), &size.to_le_bytes(), kind].concat()
    }

    #[test]
    fn an_avi_file_is_cut_short_if_a_part_of_it_reaches_beyond_its_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.avi");
        let first = [head(b"AVI ", 14), vec![0; 10]].concat();
        for (parts, said) in [
            (first.clone(), None),
            ([first.clone(), head(b"AVIX", 4)].concat(), None),
            (
                [first.clone(), head(b"AVIX", 100)].concat(),
                Some("34 of 130 bytes"),
            ),
            // It was not closed, and the other has something behind its end.
            (head(b"AVI ", 0), None),
            ([first, b"more than that".to_vec()].concat(), None),
            (head(b"WAVE", 100), None),
        ] {
            std::fs::write(&path, &parts).unwrap();
            let found = missing_of_riff(&path);
            assert_eq!(found.is_some(), said.is_some(), "{found:?}");
            assert!(found.unwrap_or_default().contains(said.unwrap_or_default()));
        }
    }
}
