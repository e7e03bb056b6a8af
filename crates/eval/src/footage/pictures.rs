//! Reads a sequence of pictures from a folder, a tar archive, or memory.

use super::archive::{ArchivedPicture, archived_clips};
use super::source::{FrameSource, clip_name};
use crate::error::EvalError;
use albireo_vision::picture::{EncodedPicture, picture_files, read_picture_file};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A sequence of pictures. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Pictures {
    name: String,
    pictures: Vec<Member>,
    /// The number of pictures that were read.
    passed: usize,
    rate: f64,
    /// What is missing of them, in words.
    damage: Option<String>,
}

/// A picture, and the clip it belongs to if there are several.
#[derive(Clone, Debug)]
struct Member {
    clip: Option<Arc<str>>,
    location: Location,
}

/// Where a picture is stored.
#[derive(Clone, Debug)]
enum Location {
    File(PathBuf),
    Archive(ArchivedPicture),
    Memory(EncodedPicture),
}

impl Pictures {
    /// Frames per second if none are given.
    pub const DEFAULT_RATE: f64 = 10.0;

    fn new(name: String, pictures: Vec<Member>, rate: f64) -> Self {
        Self {
            name,
            pictures,
            passed: 0,
            rate,
            damage: None,
        }
    }

    /// Creates a sequence of these pictures, at `rate` frames per second.
    pub fn in_memory(name: String, pictures: Vec<EncodedPicture>, rate: f64) -> Self {
        let member = |picture| Member {
            clip: None,
            location: Location::Memory(picture),
        };
        Self::new(name, pictures.into_iter().map(member).collect(), rate)
    }

    /// Reads the JPEG and PNG files of a folder in natural order (`9.jpg` before `10.jpg`), or one such file.
    ///
    /// # Errors
    /// When the folder cannot be read or has no pictures.
    pub fn of_folder(path: &Path, rate: f64) -> Result<Self, EvalError> {
        let member = |file| Member {
            clip: None,
            location: Location::File(file),
        };
        let pictures = picture_files(path)?.into_iter().map(member).collect();
        Ok(Self::new(clip_name(path), pictures, rate))
    }

    /// Reads the JPEG and PNG files of a tar archive, one folder after the other; each is a clip, with its pictures in natural
    /// order.
    ///
    /// # Errors
    /// When the archive cannot be read or has no pictures.
    pub fn of_archive(path: &Path, rate: f64) -> Result<Self, EvalError> {
        let content = archived_clips(path)?;
        let mut pictures = Vec::new();
        for clip in content.clips {
            // Pictures of one clip share the memory of its name.
            let name: Arc<str> = clip.name.into();
            for picture in clip.pictures {
                pictures.push(Member {
                    clip: Some(Arc::clone(&name)),
                    location: Location::Archive(picture),
                });
            }
        }
        Ok(Self {
            damage: content.damage,
            ..Self::new(clip_name(path), pictures, rate)
        })
    }

    /// Splits the sequence into its clips. What is missing of it is told with the last.
    pub fn into_clips(self) -> Vec<Self> {
        let parts = self.pictures.chunk_by(|a, b| a.clip == b.clip);
        let part = |pictures: &[Member]| {
            let clip = pictures.first().and_then(|first| first.clip.as_deref());
            let name = clip.unwrap_or(&self.name).to_owned();
            Self::new(name, pictures.to_vec(), self.rate)
        };
        let mut clips: Vec<Self> = parts.map(part).collect();
        if let Some(last) = clips.last_mut() {
            last.damage = self.damage;
        }
        clips
    }
}

impl FrameSource for Pictures {
    fn name(&self) -> &str {
        &self.name
    }

    fn clip(&self) -> Option<&str> {
        self.pictures.get(self.passed.checked_sub(1)?)?.clip.as_deref()
    }

    fn picture_name(&self) -> Option<String> {
        let last = self.pictures.get(self.passed.checked_sub(1)?)?;
        let name = match &last.location {
            Location::File(file) => file.display().to_string(),
            Location::Archive(picture) => picture.name(),
            Location::Memory(_) => format!("{}, picture {}", self.name, self.passed),
        };
        Some(name)
    }

    fn file_names(&self) -> Vec<String> {
        let mut names = Vec::new();
        for member in &self.pictures {
            let path = match &member.location {
                Location::File(file) => file.as_path(),
                Location::Archive(picture) => picture.inside(),
                Location::Memory(_) => return Vec::new(),
            };
            let name = path.file_name().unwrap_or_default();
            names.push(name.to_string_lossy().into_owned());
        }
        names
    }

    fn rate(&self) -> f64 {
        self.rate
    }

    fn frames(&self) -> Option<u64> {
        Some(self.pictures.len() as u64)
    }

    fn bytes(&self) -> Option<u64> {
        let mut bytes = 0;
        for member in &self.pictures {
            bytes += match &member.location {
                Location::File(file) => file.metadata().ok()?.len(),
                Location::Archive(picture) => picture.bytes(),
                Location::Memory(picture) => picture.bytes.len() as u64,
            };
        }
        Some(bytes)
    }

    fn remarks(&self) -> Vec<String> {
        self.damage.iter().cloned().collect()
    }

    fn next(&mut self) -> Result<Option<EncodedPicture>, EvalError> {
        let Some(member) = self.pictures.get(self.passed) else {
            return Ok(None);
        };
        self.passed += 1;
        let picture = match &member.location {
            Location::File(file) => read_picture_file(file)?,
            Location::Archive(picture) => picture.read()?,
            Location::Memory(picture) => picture.clone(),
        };
        Ok(Some(picture))
    }

    fn rewind(&mut self) -> Result<(), EvalError> {
        self.passed = 0;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn jpeg(side: u16) -> Vec<u8> {
        let mut bytes = Vec::new();
        let pixels = vec![0; usize::from(side) * usize::from(side)];
        jpeg_encoder::Encoder::new(&mut bytes, 80)
            .encode(&pixels, side, side, jpeg_encoder::ColorType::Luma)
            .unwrap();
        bytes
    }

    fn archive(members: &[(&str, Vec<u8>)]) -> tempfile::NamedTempFile {
        let file = tempfile::Builder::new().suffix(".tar").tempfile().unwrap();
        let mut builder = tar::Builder::new(file.reopen().unwrap());
        for (name, bytes) in members {
            let mut header = tar::Header::new_gnu();
            header.set_size(bytes.len() as u64);
            builder.append_data(&mut header, name, bytes.as_slice()).unwrap();
        }
        builder.finish().unwrap();
        file
    }

    /// An archive with a small picture of each of these names.
    fn archive_of(names: &[&str]) -> tempfile::NamedTempFile {
        let members: Vec<_> = names.iter().map(|name| (*name, jpeg(8))).collect();
        archive(&members)
    }

    /// The clips of an archive, each with its number of pictures.
    fn clips(file: &tempfile::NamedTempFile) -> Vec<(String, u64)> {
        let all = Pictures::of_archive(file.path(), 5.0).unwrap();
        let mut clips = Vec::new();
        for clip in all.into_clips() {
            clips.push((clip.name().to_owned(), clip.frames().unwrap()));
        }
        clips
    }

    fn named(clips: &[(&str, u64)]) -> Vec<(String, u64)> {
        clips.iter().map(|(name, frames)| ((*name).to_owned(), *frames)).collect()
    }

    #[test]
    fn each_folder_of_an_archive_is_a_clip() {
        let file = archive(&[
            ("busy/1.jpg", jpeg(8)),
            ("busy/SOURCE.txt", b"not a picture".to_vec()),
            ("busy/2.jpg", jpeg(16)),
            ("night/1.jpg", jpeg(24)),
        ]);
        let mut all = Pictures::of_archive(file.path(), 5.0).unwrap();
        assert_eq!(all.frames(), Some(3));
        assert_eq!(all.rate(), 5.0);
        assert_eq!(all.clip(), None);
        for _ in 0..2 {
            for (clip, side) in [("busy", 8), ("busy", 16), ("night", 24)] {
                assert_eq!(all.next().unwrap().unwrap().size.width, side);
                assert_eq!(all.clip(), Some(clip));
            }
            assert!(all.next().unwrap().is_none());
            all.rewind().unwrap();
        }
        assert_eq!(clips(&file), named(&[("busy", 2), ("night", 1)]));
    }

    #[test]
    fn folders_of_one_name_in_different_places_are_different_clips() {
        let file = archive_of(&["a/images/1.jpg", "a/images/2.jpg", "b/images/1.jpg"]);
        assert_eq!(clips(&file), named(&[("a-images", 2), ("b-images", 1)]));
        let mut all = Pictures::of_archive(file.path(), 5.0).unwrap();
        for clip in ["a-images", "a-images", "b-images"] {
            all.next().unwrap();
            assert_eq!(all.clip(), Some(clip));
        }
    }

    #[test]
    fn sequences_of_motchallenge_in_an_archive_have_the_names_of_their_folders() {
        let file = archive_of(&[
            "train/MOT17-02/img1/000001.jpg",
            "train/MOT17-04/img1/000001.jpg",
            "train/MOT17-04/img1/000002.jpg",
        ]);
        assert_eq!(clips(&file), named(&[("MOT17-02", 1), ("MOT17-04", 2)]));
    }

    #[test]
    fn pictures_of_a_folder_are_one_clip_wherever_they_lie_in_the_archive() {
        // tar writes a folder's entries in any order: here a folder comes between two pictures beside it.
        let file = archive_of(&["drive/1.jpg", "drive/more/1.jpg", "drive/2.jpg"]);
        assert_eq!(clips(&file), named(&[("drive", 2), ("more", 1)]));
    }

    #[test]
    fn pictures_of_an_archive_are_in_natural_order_and_hidden_files_are_none() {
        // As a disk lists them, and with what a Mac adds for each file.
        let file = archive(&[
            ("drive/10.jpg", jpeg(24)),
            ("drive/._2.jpg", b"not a picture".to_vec()),
            ("drive/9.jpg", jpeg(16)),
            ("drive/2.jpg", jpeg(8)),
        ]);
        let mut all = Pictures::of_archive(file.path(), 5.0).unwrap();
        for side in [8, 16, 24] {
            assert_eq!(all.next().unwrap().unwrap().size.width, side);
        }
        assert!(all.next().unwrap().is_none());
    }

    #[test]
    fn pictures_that_are_files_have_their_names_in_their_order_and_others_have_none() {
        let names = ["9.jpg", "10.jpg"];
        let folder = tempfile::tempdir().unwrap();
        for name in names {
            std::fs::write(folder.path().join(name), jpeg(8)).unwrap();
        }
        let mut of_folder = Pictures::of_folder(folder.path(), 5.0).unwrap();
        assert_eq!(of_folder.file_names(), names);
        let archive = archive_of(&["drive/10.jpg", "drive/9.jpg"]);
        let archived = Pictures::of_archive(archive.path(), 5.0).unwrap();
        assert_eq!(archived.file_names(), names);
        let picture = of_folder.next().unwrap().unwrap();
        let in_memory = Pictures::in_memory("a".to_owned(), vec![picture], 5.0);
        assert!(in_memory.file_names().is_empty());
    }

    #[test]
    fn no_two_clips_of_an_archive_have_the_same_name() {
        let long = "x".repeat(99);
        let [left, right] = ["left", "right"].map(|side| format!("{long}/{side}/images/1.jpg"));
        for names in [
            // Names that are the same when they are made valid, and as many letters long.
            ["北京/1.jpg", "上海/1.jpg"],
            ["a/images/1.jpg", "a-images/1.jpg"],
            ["a/1.jpg", "a/img1/1.jpg"],
            ["a/img1/1.jpg", "b/a/img1/1.jpg"],
            [".a/1.jpg", "a/1.jpg"],
            [&left, &right],
        ] {
            let found = clips(&archive_of(&names));
            assert_eq!(found.len(), 2, "{names:?}: {found:?}");
            assert_ne!(found[0].0, found[1].0, "{names:?}");
        }
    }

    /// The error for an archive, when it is opened or when its first picture is read, without the archive's path.
    fn fault(file: &tempfile::NamedTempFile) -> String {
        let text = match Pictures::of_archive(file.path(), 5.0) {
            Ok(mut opened) => opened.next().unwrap_err().to_string(),
            Err(error) => error.to_string(),
        };
        let path = file.path().to_str().unwrap();
        text.strip_prefix(path).expect("the archive is named first").to_owned()
    }

    #[test]
    fn the_bytes_of_a_folder_and_an_archive_are_known_before_they_are_read() {
        let pictures = [jpeg(8), jpeg(16)];
        let folder = tempfile::tempdir().unwrap();
        for (name, picture) in ["1.jpg", "2.jpg"].into_iter().zip(&pictures) {
            std::fs::write(folder.path().join(name), picture).unwrap();
        }
        let bytes = pictures.iter().map(Vec::len).sum::<usize>() as u64;
        let of_folder = Pictures::of_folder(folder.path(), 5.0).unwrap();
        assert_eq!(of_folder.bytes(), Some(bytes));
        let [first, second] = pictures;
        let file = archive(&[("busy/1.jpg", first), ("busy/2.jpg", second)]);
        let of_archive = Pictures::of_archive(file.path(), 5.0).unwrap();
        assert_eq!(of_archive.bytes(), Some(bytes));
    }

    #[test]
    fn an_archive_without_pictures_is_rejected_by_name() {
        let empty = archive(&[("busy/readme.txt", b"hello".to_vec())]);
        assert_eq!(fault(&empty), ": it has no JPEG or PNG files");
    }

    #[test]
    fn an_archive_that_is_cut_short_plays_its_whole_pictures_and_says_how_many() {
        // tar keeps a member behind a header of 512 bytes, in blocks of as many.
        let member = 512 + (jpeg(8).len() as u64).next_multiple_of(512);
        let cut = |whole: u64| format!("the archive is cut short: {whole} pictures are whole");
        // Within the second of three pictures, behind it, and within the head of the third.
        for (length, whole, said) in [
            (member + 600, 1, cut(1)),
            (
                2 * member,
                2,
                "the archive has no end mark: if it was cut short, it was behind these 2 pictures"
                    .to_owned(),
            ),
            (2 * member + 100, 2, cut(2)),
        ] {
            let torn = archive_of(&["busy/1.jpg", "busy/2.jpg", "night/1.jpg"]);
            torn.as_file().set_len(length).unwrap();
            let mut all = Pictures::of_archive(torn.path(), 5.0).unwrap();
            for _ in 0..whole {
                assert!(all.next().unwrap().is_some(), "{length}");
            }
            assert!(all.next().unwrap().is_none(), "{length}");
            let said = format!("{}: {said}", torn.path().display());
            assert_eq!(all.remarks(), std::slice::from_ref(&said), "{length}");
            let of_last = all.into_clips().pop().unwrap().remarks();
            assert_eq!(of_last, [said], "{length}");
        }
        let whole = archive_of(&["busy/1.jpg"]);
        assert_eq!(
            Pictures::of_archive(whole.path(), 5.0).unwrap().remarks(),
            [""; 0]
        );
        whole.as_file().set_len(600).unwrap();
        assert_eq!(
            fault(&whole),
            ": it is cut short, and no JPEG or PNG file in it is whole"
        );
    }

    #[test]
    fn a_whole_archive_is_whole_whatever_lies_behind_its_end() {
        let file = archive_of(&["busy/1.jpg", "busy/2.jpg"]);
        let mut bytes = std::fs::read(file.path()).unwrap();
        bytes.push(b'\n');
        std::fs::write(file.path(), bytes).unwrap();
        let mut all = Pictures::of_archive(file.path(), 5.0).unwrap();
        assert_eq!(all.remarks(), [""; 0]);
        for _ in 0..2 {
            assert!(all.next().unwrap().is_some());
        }
        assert!(all.next().unwrap().is_none());
    }

    #[test]
    fn a_member_that_is_no_picture_is_rejected_by_name() {
        let wrong = archive(&[("busy/1.jpg", b"not a JPEG".to_vec())]);
        let expected = ": busy/1.jpg: not a picture that can be sent: ";
        assert!(fault(&wrong).starts_with(expected), "{}", fault(&wrong));
    }
}
