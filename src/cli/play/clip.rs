//! Reads a clip into memory once, so that no run spends time on reading.

use crate::cli::values::counted;
use albireo_core::geometry::PictureSize;
use albireo_eval::footage::{FrameSource, Pictures};
use albireo_vision::picture::{EncodedPicture, FrameLimits, Picture, decode_small_grey};
use anyhow::{bail, ensure};

/// The most bytes of a clip, many times those of any picture.
const MAX_BYTES: usize = 1 << 30;

/// The width at which pictures are decoded to learn whether they are whole, which costs least.
const TRIED_WIDTH: u32 = 64;

/// How much of a clip is played.
#[derive(Clone, Copy, Debug)]
pub(in crate::cli) enum Extent {
    /// All of it, as `eval board` does.
    Whole,
    /// Its first seconds, as `compare --seconds` does.
    Seconds(f64),
}

impl Extent {
    /// What can be done about a clip that is too long.
    pub(in crate::cli) const fn way_out(self) -> &'static str {
        match self {
            Self::Whole => "split it, and its ground truth, into several clips",
            Self::Seconds(_) => "play less of it with --seconds",
        }
    }
}

/// A clip in memory.
pub(in crate::cli) struct Loaded {
    pub pictures: Pictures,
    /// The size of its first picture.
    pub size: PictureSize,
    /// True if the source has more.
    pub is_cut: bool,
    /// The pictures that cannot be decoded, with their names and why.
    pub unusable: Vec<String>,
    /// The places in the source of those that cannot be read, which are none of its pictures.
    pub left_out: Vec<usize>,
    /// What is missing of the source, and what was made of its times.
    pub remarks: Vec<String>,
}

impl Loaded {
    /// Says what cannot be decoded and what that means; `None` if all can.
    pub(in crate::cli) fn warning(&self) -> Option<String> {
        let first = self.unusable.first()?;
        let name = self.pictures.name();
        let unusable = self.unusable.len();
        let all = counted(
            self.pictures.frames().unwrap_or_default(),
            "picture",
            "pictures",
        );
        let it_counts = if unusable == 1 {
            "it counts"
        } else {
            "each counts"
        };
        Some(format!(
            "{name}: {unusable} of {all} cannot be used: {it_counts} as a frame without boxes for every policy that looks at \
             it. Repair or leave out such pictures. The first: {first}"
        ))
    }
}

/// Refuses a whole clip that is too large for the memory, if its size is known before it is read.
///
/// # Errors
/// Its size, and what can be done.
pub(in crate::cli) fn check_size(source: &dyn FrameSource) -> anyhow::Result<()> {
    let bytes = source.bytes().unwrap_or_default();
    ensure!(
        bytes <= MAX_BYTES as u64,
        "{}: its pictures have {} MiB, and a clip may take {} MiB of memory: {}",
        source.name(),
        bytes >> 20,
        MAX_BYTES >> 20,
        Extent::Whole.way_out()
    );
    Ok(())
}

/// Says that a whole video of so many `frames` will not fit into the memory if all are as large as its `first`; `None` if
/// they will. What they really take is known once all are decoded.
pub(in crate::cli) fn doubt_of_size(
    name: &str,
    first: &EncodedPicture,
    frames: u64,
) -> Option<String> {
    let bytes = frames.saturating_mul(first.bytes.len() as u64);
    if bytes <= MAX_BYTES as u64 {
        return None;
    }
    Some(format!(
        "{name}: if all of its {frames} pictures are as large as the first, they have {} MiB, and a clip may take {} MiB \
         of memory. If they do not fit when its turn comes, {}",
        bytes >> 20,
        MAX_BYTES >> 20,
        Extent::Whole.way_out()
    ))
}

/// Reads `extent` of `source`, and tries each picture.
///
/// # Errors
/// When the source fails, is empty, or is too large for the memory.
pub(in crate::cli) fn load(
    mut source: Box<dyn FrameSource>,
    extent: Extent,
) -> anyhow::Result<Loaded> {
    let most = match extent {
        Extent::Whole => usize::MAX,
        Extent::Seconds(seconds) => (seconds * source.rate()).round().max(1.0) as usize,
    };
    let limits = FrameLimits::default();
    let mut tried = Picture::default();
    let mut unusable = Vec::new();
    let mut unread = Unread::default();
    let mut pictures: Vec<EncodedPicture> = Vec::new();
    let mut bytes = 0;
    while pictures.len() < most {
        let picture = match source.next() {
            Ok(None) => break,
            Ok(Some(picture)) => picture,
            Err(fault) => {
                unread.add(pictures.len(), fault.into(), &*source)?;
                continue;
            }
        };
        bytes += picture.bytes.len();
        if bytes > MAX_BYTES {
            bail!(
                "{}: only its first {} pictures ({:.2} s) fit into the {} MiB of memory that a clip may take: {}",
                source.name(),
                pictures.len(),
                pictures.len() as f64 / source.rate(),
                MAX_BYTES >> 20,
                extent.way_out()
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
    let is_cut = pictures.len() == most && has_more(&mut *source);
    let Some(first) = pictures.first() else {
        match unread.first {
            Some(fault) => bail!("{}: nothing of it can be read: {fault}", source.name()),
            None => bail!("{}: it has no frames", source.name()),
        }
    };
    let mut remarks = unread.remarks(source.name());
    remarks.extend(source.remarks());
    Ok(Loaded {
        size: first.size,
        is_cut,
        pictures: Pictures::in_memory(source.name().to_owned(), pictures, source.rate()),
        unusable,
        left_out: unread.places,
        remarks,
    })
}

/// What of a source cannot be read although what follows it can.
#[derive(Default)]
struct Unread {
    places: Vec<usize>,
    /// Why the first cannot be read, with its name.
    first: Option<String>,
}

impl Unread {
    /// Adds what follows so many pictures.
    ///
    /// # Errors
    /// The `fault` itself, if nothing follows.
    fn add(
        &mut self,
        pictures: usize,
        fault: anyhow::Error,
        source: &dyn FrameSource,
    ) -> anyhow::Result<()> {
        let Some(name) = source.picture_name() else {
            return Err(fault);
        };
        self.places.push(pictures + self.places.len());
        if self.first.is_none() {
            let said = fault.to_string();
            // What reads a file names it already.
            self.first = Some(if said.contains(&name) {
                said
            } else {
                format!("{name}: {said}")
            });
        }
        Ok(())
    }

    /// What is to be said of it.
    fn remarks(&self, source: &str) -> Vec<String> {
        let mut remarks = Vec::new();
        if let Some(first) = &self.first {
            let unread = counted(
                self.places.len() as u64,
                "picture or file",
                "pictures or files",
            );
            remarks.push(format!(
                "{source}: {unread} cannot be read and are left out, with their ground truth. The first: {first}"
            ));
        }
        remarks
    }
}

/// The first picture of a source that can be read; `None` if there is none.
///
/// # Errors
/// When the source fails.
pub(in crate::cli) fn first_picture(
    source: &mut dyn FrameSource,
) -> anyhow::Result<Option<EncodedPicture>> {
    loop {
        match source.next() {
            Ok(first) => return Ok(first),
            Err(fault) if source.picture_name().is_none() => return Err(fault.into()),
            Err(_) => {}
        }
    }
}

/// Reads on, and tells whether there is another picture; one that cannot be read is one, too.
fn has_more(source: &mut dyn FrameSource) -> bool {
    match source.next() {
        Ok(None) => false,
        Ok(Some(_)) | Err(_) => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// The first pictures of the demonstration's road.
    fn first_pictures(count: usize) -> Vec<EncodedPicture> {
        let mut road = Pictures::of_archive(Path::new("demo/road.tar"), 10.0).unwrap();
        (0..count).map(|_| road.next().unwrap().unwrap()).collect()
    }

    #[test]
    fn a_clip_is_as_long_as_asked_for_and_tells_whether_there_is_more() {
        let road = Pictures::in_memory("road".to_owned(), first_pictures(5), 10.0);
        for (seconds, frames, is_cut) in [(0.3, 3, true), (0.5, 5, false), (9.0, 5, false)] {
            let loaded = load(Box::new(road.clone()), Extent::Seconds(seconds)).unwrap();
            assert_eq!(loaded.pictures.frames(), Some(frames), "{seconds}");
            assert_eq!(loaded.is_cut, is_cut, "{seconds}");
        }
    }

    #[test]
    fn a_clip_whose_pictures_can_all_be_used_has_no_warning() {
        let road = Pictures::in_memory("road".to_owned(), first_pictures(2), 10.0);
        let loaded = load(Box::new(road), Extent::Whole).unwrap();
        assert_eq!(loaded.warning(), None);
    }

    #[test]
    fn a_whole_clip_is_read_to_its_end_however_slow_its_rate_is() {
        let two_hours = Pictures::in_memory("slow".to_owned(), first_pictures(8), 1e-3);
        let loaded = load(Box::new(two_hours), Extent::Whole).unwrap();
        assert_eq!(loaded.pictures.frames(), Some(8));
    }

    #[test]
    fn a_clip_that_is_too_large_says_how_much_fits_and_what_its_user_can_do() {
        let [mut picture] = first_pictures(1).try_into().unwrap();
        picture.bytes = vec![0; 300 << 20].into();
        for (extent, way_out) in [
            (Extent::Whole, "split it, and its ground truth"),
            (Extent::Seconds(9.0), "with --seconds"),
        ] {
            let large = Pictures::in_memory("large".to_owned(), vec![picture.clone(); 5], 10.0);
            let refused = load(Box::new(large), extent).err().unwrap().to_string();
            let fits = "large: only its first 3 pictures (0.30 s) fit into the 1024 MiB";
            assert!(refused.starts_with(fits), "{refused}");
            assert!(refused.contains(way_out), "{refused}");
        }
    }

    #[test]
    fn a_video_that_will_hardly_fit_is_doubted_with_the_way_out() {
        let [mut picture] = first_pictures(1).try_into().unwrap();
        picture.bytes = vec![0; 1 << 20].into();
        assert_eq!(doubt_of_size("drive", &picture, 1024), None);
        let said = doubt_of_size("drive", &picture, 1025).unwrap();
        let sizes = "they have 1025 MiB, and a clip may take 1024 MiB";
        assert!(said.contains(sizes), "{said}");
        assert!(said.contains("split it, and its ground truth"), "{said}");
    }

    #[test]
    fn a_picture_that_cannot_be_read_is_left_out_and_told_with_the_first_name() {
        let folder = tempfile::tempdir().unwrap();
        for (name, picture) in ["2.jpg", "4.jpg"].into_iter().zip(first_pictures(2)) {
            std::fs::write(folder.path().join(name), &picture.bytes).unwrap();
        }
        let pictures = || Pictures::of_folder(folder.path(), 10.0).unwrap();
        for name in ["1.jpg", "3.jpg"] {
            std::fs::write(folder.path().join(name), "not a picture").unwrap();
        }
        let loaded = load(Box::new(pictures()), Extent::Whole).unwrap();
        assert_eq!(loaded.pictures.frames(), Some(2));
        assert_eq!(loaded.left_out, [0, 2]);
        let said = loaded.remarks.join("");
        let unread = "2 pictures or files cannot be read";
        assert!(said.contains(unread), "{said}");
        assert!(said.contains("1.jpg: "), "{said}");
        assert!(first_picture(&mut pictures()).unwrap().is_some());
        for name in ["2.jpg", "4.jpg"] {
            std::fs::remove_file(folder.path().join(name)).unwrap();
        }
        let refused = load(Box::new(pictures()), Extent::Whole).err().unwrap().to_string();
        assert!(refused.contains("nothing of it can be read: "), "{refused}");
        assert!(first_picture(&mut pictures()).unwrap().is_none());
    }

    #[test]
    fn a_picture_that_is_cut_short_is_played_named_and_counted() {
        let folder = tempfile::tempdir().unwrap();
        for (name, picture) in ["1.jpg", "2.jpg", "3.jpg"].into_iter().zip(first_pictures(3)) {
            let bytes = picture.bytes;
            let kept = if name == "2.jpg" { 3000 } else { bytes.len() };
            std::fs::write(folder.path().join(name), &bytes[..kept]).unwrap();
        }
        let source = Pictures::of_folder(folder.path(), 10.0).unwrap();
        let loaded = load(Box::new(source), Extent::Whole).unwrap();
        assert_eq!(loaded.pictures.frames(), Some(3));
        let said = loaded.warning().unwrap();
        let words = [
            "1 of 3 pictures cannot be used: it counts as",
            "2.jpg: undecodable",
            "cut short",
        ];
        assert!(words.iter().all(|word| said.contains(word)), "{said}");
    }
}
