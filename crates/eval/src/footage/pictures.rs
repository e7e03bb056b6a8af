//! Reads a sequence of pictures from a folder, a tar archive, or memory.

use super::source::{FrameSource, clip_name, plain_name};
use crate::error::EvalError;
use albireo_vision::picture::{
    EncodedPicture, FrameLimits, is_picture_file, picture_files, picture_of_file, read_picture_file,
};
use std::fs::File;
use std::os::unix::fs::FileExt;
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
    /// In an archive.
    Archive {
        archive: Arc<ArchiveFile>,
        offset: u64,
        length: usize,
    },
    Memory(EncodedPicture),
}

/// An archive that is open for reading.
#[derive(Debug)]
struct ArchiveFile {
    path: PathBuf,
    file: File,
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
        let pictures = picture_files(path)?.into_iter().map(member);
        Ok(Self::new(clip_name(path), pictures.collect(), rate))
    }

    /// Reads the JPEG and PNG files of a tar archive in their order in it; each folder is a clip.
    ///
    /// # Errors
    /// When the archive cannot be read or has no pictures.
    pub fn of_archive(path: &Path, rate: f64) -> Result<Self, EvalError> {
        let unreadable = |error: std::io::Error| EvalError::content(path, error);
        let file = File::open(path).map_err(unreadable)?;
        let archive = Arc::new(ArchiveFile {
            path: path.to_path_buf(),
            file,
        });
        let name = clip_name(path);
        let mut pictures: Vec<Member> = Vec::new();
        let mut members = tar::Archive::new(&archive.file);
        for entry in members.entries_with_seek().map_err(unreadable)? {
            let entry = entry.map_err(unreadable)?;
            let inside = entry.path().map_err(unreadable)?.into_owned();
            if !entry.header().entry_type().is_file() || !is_picture_file(&inside) {
                continue;
            }
            let length = usize::try_from(entry.size()).unwrap_or(usize::MAX);
            if length > FrameLimits::default().max_payload_bytes {
                let what = format!("{} is too large for a picture", inside.display());
                return Err(EvalError::content(path, what));
            }
            let folder = inside.parent().and_then(Path::file_name);
            let clip_name = match folder {
                Some(folder) => plain_name(&folder.to_string_lossy()),
                None => name.clone(),
            };
            // Pictures of one clip share the memory of its name.
            let clip = match pictures.last().and_then(|last| last.clip.as_ref()) {
                Some(last) if **last == *clip_name => Arc::clone(last),
                _ => clip_name.into(),
            };
            pictures.push(Member {
                clip: Some(clip),
                location: Location::Archive {
                    archive: Arc::clone(&archive),
                    offset: entry.raw_file_position(),
                    length,
                },
            });
        }
        if pictures.is_empty() {
            let what = "it has no JPEG or PNG files";
            return Err(EvalError::content(path, what));
        }
        Ok(Self::new(name, pictures, rate))
    }

    /// Splits the sequence into its clips.
    pub fn into_clips(self) -> Vec<Self> {
        let parts = self.pictures.chunk_by(|a, b| a.clip == b.clip);
        let part = |pictures: &[Member]| {
            let clip = pictures.first().and_then(|first| first.clip.as_deref());
            let name = clip.unwrap_or(&self.name).to_owned();
            Self::new(name, pictures.to_vec(), self.rate)
        };
        parts.map(part).collect()
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
        Some(match &last.location {
            Location::File(file) => file.display().to_string(),
            Location::Archive { archive, .. } => {
                format!("{}, picture {}", archive.path.display(), self.passed)
            }
            Location::Memory(_) => format!("{}, picture {}", self.name, self.passed),
        })
    }

    fn rate(&self) -> f64 {
        self.rate
    }

    fn frames(&self) -> Option<u64> {
        Some(self.pictures.len() as u64)
    }

    fn next(&mut self) -> Result<Option<EncodedPicture>, EvalError> {
        let Some(member) = self.pictures.get(self.passed) else {
            return Ok(None);
        };
        self.passed += 1;
        Ok(Some(match &member.location {
            Location::Memory(picture) => picture.clone(),
            Location::File(file) => read_picture_file(file)?,
            Location::Archive {
                archive,
                offset,
                length,
            } => {
                let ArchiveFile { path, file } = &**archive;
                let mut bytes = vec![0; *length];
                file.read_exact_at(&mut bytes, *offset)
                    .map_err(|error| EvalError::content(path, error))?;
                picture_of_file(bytes.into(), &FrameLimits::default()).map_err(|fault| {
                    EvalError::new(format!(
                        "{}, picture {}: a frame cannot be sent: {fault}",
                        path.display(),
                        self.passed
                    ))
                })?
            }
        }))
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

    #[test]
    fn each_folder_of_an_archive_is_a_clip() {
        let file = archive(&[
            ("busy/1.jpg", jpeg(8)),
            ("busy/SOURCE.txt", b"not a picture".to_vec()),
            ("busy/2.jpg", jpeg(16)),
            ("night/1.jpg", jpeg(24)),
        ]);
        let mut all = Pictures::of_archive(file.path(), 5.0).unwrap();
        assert_eq!((all.frames(), all.rate(), all.clip()), (Some(3), 5.0, None));
        for _ in 0..2 {
            for (clip, side) in [("busy", 8), ("busy", 16), ("night", 24)] {
                assert_eq!(all.next().unwrap().unwrap().size.width, side);
                assert_eq!(all.clip(), Some(clip));
            }
            assert!(all.next().unwrap().is_none());
            all.rewind().unwrap();
        }
        let clips = all.into_clips();
        let named: Vec<_> = clips.iter().map(|clip| (clip.name(), clip.frames())).collect();
        assert_eq!(named, [("busy", Some(2)), ("night", Some(1))]);
    }

    #[test]
    fn an_unplayable_archive_is_rejected_by_name() {
        let empty = archive(&[("busy/readme.txt", b"hello".to_vec())]);
        let error = Pictures::of_archive(empty.path(), 5.0).unwrap_err();
        let error = error.to_string();
        assert!(error.contains("no JPEG or PNG files"), "{error}");
        let torn = archive(&[("busy/1.jpg", jpeg(64))]);
        torn.as_file().set_len(700).unwrap();
        let mut opened = Pictures::of_archive(torn.path(), 5.0).unwrap();
        let error = opened.next().unwrap_err().to_string();
        assert!(error.contains(".tar"), "{error}");
        let wrong = archive(&[("busy/1.jpg", b"not a JPEG".to_vec())]);
        let error = Pictures::of_archive(wrong.path(), 5.0).unwrap().next();
        assert!(error.unwrap_err().to_string().contains("picture 1"));
    }
}
