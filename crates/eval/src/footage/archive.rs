//! Reads pictures from a tar archive, each folder in it a clip.

use super::source::{FrameSource, clip_name, plain_name};
use crate::error::EvalError;
use albireo_vision::picture::{EncodedPicture, FrameLimits, is_picture_file, picture_of_file};
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The JPEG and PNG files of an archive, in their order there.
#[derive(Clone, Debug)]
pub struct PictureArchive {
    name: String,
    path: PathBuf,
    file: Arc<File>,
    pictures: Vec<Member>,
    at: usize,
    rate: f64,
}

/// Where a picture lies in the archive.
#[derive(Clone, Debug)]
struct Member {
    clip: Arc<str>,
    offset: u64,
    length: usize,
}

impl PictureArchive {
    /// The pictures of the archive at `path`, `rate` of them a second.
    ///
    /// # Errors
    /// When the archive cannot be read or has no pictures.
    pub fn open(path: &Path, rate: f64) -> Result<Self, EvalError> {
        let unreadable = |error: std::io::Error| EvalError::content(path, error);
        let file = File::open(path).map_err(unreadable)?;
        let name = clip_name(path);
        let mut pictures: Vec<Member> = Vec::new();
        let mut archive = tar::Archive::new(&file);
        for entry in archive.entries_with_seek().map_err(unreadable)? {
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
            let clip =
                folder.map_or_else(|| name.clone(), |own| plain_name(&own.to_string_lossy()));
            // Pictures of one clip share its name.
            let clip = match pictures.last() {
                Some(last) if *last.clip == *clip => Arc::clone(&last.clip),
                _ => clip.into(),
            };
            pictures.push(Member {
                clip,
                offset: entry.raw_file_position(),
                length,
            });
        }
        if pictures.is_empty() {
            let what = "there are no JPEG or PNG files in it";
            return Err(EvalError::content(path, what));
        }
        Ok(Self {
            name,
            path: path.to_path_buf(),
            file: Arc::new(file),
            pictures,
            at: 0,
            rate,
        })
    }

    /// A source for each clip.
    pub fn into_clips(self) -> Vec<Self> {
        let parts = self.pictures.chunk_by(|a, b| Arc::ptr_eq(&a.clip, &b.clip));
        let part = |pictures: &[Member]| Self {
            name: pictures[0].clip.to_string(),
            pictures: pictures.to_vec(),
            ..self.clone()
        };
        parts.map(part).collect()
    }
}

impl FrameSource for PictureArchive {
    fn name(&self) -> &str {
        &self.name
    }

    fn clip(&self) -> Option<&str> {
        let last = self.pictures.get(self.at.checked_sub(1)?)?;
        Some(&last.clip)
    }

    fn rate(&self) -> f64 {
        self.rate
    }

    fn frames(&self) -> Option<u64> {
        Some(self.pictures.len() as u64)
    }

    fn next(&mut self) -> Result<Option<EncodedPicture>, EvalError> {
        let Some(member) = self.pictures.get(self.at) else {
            return Ok(None);
        };
        self.at += 1;
        let mut bytes = vec![0; member.length];
        let read = self.file.read_exact_at(&mut bytes, member.offset);
        read.map_err(|error| EvalError::content(&self.path, error))?;
        picture_of_file(bytes.into(), &FrameLimits::default())
            .map(Some)
            .map_err(|fault| {
                let (path, number) = (self.path.display(), self.at);
                EvalError::new(format!(
                    "{path}, picture {number}: a frame cannot be sent: {fault}"
                ))
            })
    }

    fn rewind(&mut self) -> Result<(), EvalError> {
        self.at = 0;
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
            builder
                .append_data(&mut header, name, bytes.as_slice())
                .unwrap();
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
        let mut all = PictureArchive::open(file.path(), 5.0).unwrap();
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
        let named: Vec<_> = (clips.iter())
            .map(|clip| (clip.name(), clip.frames()))
            .collect();
        assert_eq!(named, [("busy", Some(2)), ("night", Some(1))]);
    }

    #[test]
    fn an_archive_that_cannot_be_played_is_refused_by_name() {
        let refused = |file: &Path| PictureArchive::open(file, 5.0).unwrap_err().to_string();
        let missing = refused(Path::new("no/such.tar"));
        assert!(missing.starts_with("no/such.tar: "), "{missing}");
        let empty = archive(&[("busy/readme.txt", b"hello".to_vec())]);
        assert!(refused(empty.path()).contains("no JPEG or PNG files"));
        let torn = archive(&[("busy/1.jpg", jpeg(64))]);
        torn.as_file().set_len(700).unwrap();
        let mut opened = PictureArchive::open(torn.path(), 5.0).unwrap();
        let error = opened.next().unwrap_err().to_string();
        assert!(error.contains(".tar"), "{error}");
        let wrong = archive(&[("busy/1.jpg", b"not a JPEG".to_vec())]);
        let error = PictureArchive::open(wrong.path(), 5.0).unwrap().next();
        assert!(error.unwrap_err().to_string().contains("picture 1"));
    }
}
