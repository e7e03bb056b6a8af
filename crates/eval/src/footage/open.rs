//! Opens footage by its name on the command line.

use super::pictures::Pictures;
use super::recording::Recording;
use super::source::{FrameSource, clip_name};
use super::video::{Ffmpeg, Video, VideoEncoding};
use super::video_files::VideoFiles;
use crate::error::EvalError;
use crate::files::{entries, has_extension};
use albireo_recording::is_recording;
use albireo_vision::picture::is_picture_file;
use albireo_vision::recordings::{FileKind, are_several, is_video_file};
use std::fmt::{Display, Formatter};
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// The demonstration's road and its ground truth, relative to the project's folder.
const ROAD: &str = "demo/road.tar";
const ROAD_TRUTH: &str = "demo/truth.json";
/// Frames per second of the cameras that recorded the road.
const ROAD_RATE: f64 = 25.0;

/// Footage, named on the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SourceName {
    /// A folder of JPEG and PNG files, or one such file.
    Pictures(PathBuf),
    /// A tar archive of such folders.
    Archive(PathBuf),
    /// `demo`: the demonstration's road, which is such an archive.
    Demo,
    /// An MCAP file, and the topic of its pictures if it is named.
    Recording(PathBuf, Option<String>),
    /// A video file.
    Video(PathBuf),
    /// A folder of video files, or a pattern for their names.
    VideoFiles(PathBuf),
}

impl FromStr for SourceName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "demo" {
            return Ok(Self::Demo);
        }
        // An address, whatever it ends in; `Video::open` says what it takes in place of a live camera.
        if text.contains("://") {
            return Ok(Self::Video(text.into()));
        }
        // A topic begins with a slash.
        for (end, _) in text.match_indices(":/") {
            let (file, topic) = (Path::new(&text[..end]), &text[end + 1..]);
            if is_recording(file) || FileKind::of(file) == Some(FileKind::Mcap) {
                return Ok(Self::Recording(file.to_path_buf(), Some(topic.to_owned())));
            }
        }
        let path = Path::new(text);
        // What a file holds says more than its name.
        match FileKind::of(path) {
            Some(FileKind::Mcap) => return Ok(Self::Recording(path.to_path_buf(), None)),
            Some(FileKind::Tar) => return Ok(Self::Archive(path.to_path_buf())),
            _ if is_recording(path) => return Ok(Self::Recording(path.to_path_buf(), None)),
            _ if has_extension(path, &["tar"]) => return Ok(Self::Archive(path.to_path_buf())),
            _ => {}
        }
        let holds_only_videos = holds(path, is_video_file) && !holds(path, is_picture_file);
        let is_pattern = are_several(text) && !path.is_dir();
        if holds_only_videos || is_pattern {
            return Ok(Self::VideoFiles(path.to_path_buf()));
        }
        if path.is_dir() || is_picture_file(path) {
            return Ok(Self::Pictures(path.to_path_buf()));
        }
        Ok(Self::Video(path.to_path_buf()))
    }
}

const HOLDS_BOTH: &str = "it holds pictures and videos: name the videos by a pattern, such as FOLDER/*.mp4, or put \
    the pictures into a folder of their own";

/// What can be played in a folder without pictures and videos of its own, for an error.
fn found_in(folder: &Path) -> Option<String> {
    let recordings = entries(folder, is_recording).ok()?;
    if let Some(recording) = recordings.first() {
        return Some(format!("name the recording in it, {}", recording.display()));
    }
    for file in entries(folder, Path::is_file).ok()? {
        if let Some(kind @ (FileKind::Rosbag | FileKind::Database)) = FileKind::of(&file) {
            return Some(format!("{}: {}", file.display(), kind.remedy()));
        }
    }
    let is_footage =
        |path: &Path| is_picture_file(path) || is_video_file(path) || is_recording(path);
    let below = entries(folder, Path::is_dir).ok()?;
    let named = below.iter().find(|below| holds(below, is_footage))?;
    Some(format!("there are some in {}", named.display()))
}

/// Checks that a folder has pictures; another path is a picture itself.
///
/// # Errors
/// What it has instead, if that can be played.
fn check_has_pictures(path: &Path) -> Result<(), EvalError> {
    if !path.is_dir() || holds(path, is_picture_file) {
        return Ok(());
    }
    match found_in(path) {
        Some(found) => {
            let what = format!("no pictures and no videos in it; {found}");
            Err(EvalError::content(path, what))
        }
        None => Ok(()),
    }
}

/// True for a folder with such files.
fn holds(folder: &Path, wanted: impl Fn(&Path) -> bool) -> bool {
    folder.is_dir() && entries(folder, wanted).is_ok_and(|files| !files.is_empty())
}

impl SourceName {
    /// Opens the source. `rate`: frames per second of a source that has none of its own.
    ///
    /// # Errors
    /// When it does not exist, cannot be read, or needs a program that is not installed.
    pub fn open(
        &self,
        rate: Option<f64>,
        encoding: VideoEncoding,
    ) -> Result<Box<dyn FrameSource>, EvalError> {
        let path = self.existing()?;
        if matches!(self, Self::Pictures(_)) && holds(path, is_video_file) {
            return Err(EvalError::content(path, HOLDS_BOTH));
        }
        let text = path.to_string_lossy();
        let programs = Ffmpeg::default();
        let source: Box<dyn FrameSource> = match self {
            Self::Pictures(_) => {
                check_has_pictures(path)?;
                Box::new(Pictures::of_folder(path, self.pictures_rate(rate))?)
            }
            Self::Archive(_) | Self::Demo => {
                Box::new(Pictures::of_archive(path, self.pictures_rate(rate))?)
            }
            Self::Recording(_, topic) => Box::new(Recording::open(path, topic.as_deref(), rate)?),
            Self::Video(_) => Box::new(Video::open(&text, rate, encoding, programs)?),
            Self::VideoFiles(_) => Box::new(VideoFiles::open(&text, rate, encoding, programs)?),
        };
        Ok(source)
    }

    /// Returns the ground truth that belongs to the source: a file of labels in the Scalabel form.
    pub fn truth(&self) -> Option<&'static Path> {
        matches!(self, Self::Demo).then_some(Path::new(ROAD_TRUTH))
    }

    /// Returns `rate`, or the frames per second that pictures are taken to have.
    fn pictures_rate(&self, rate: Option<f64>) -> f64 {
        let own = match self {
            Self::Demo => ROAD_RATE,
            _ => Pictures::DEFAULT_RATE,
        };
        rate.unwrap_or(own)
    }

    fn path(&self) -> &Path {
        match self {
            Self::Pictures(path)
            | Self::Archive(path)
            | Self::Recording(path, _)
            | Self::Video(path)
            | Self::VideoFiles(path) => path,
            Self::Demo => Path::new(ROAD),
        }
    }

    /// Splits a folder that has no picture itself, such as that of a whole data set, into the folders of pictures in it
    /// (those of a MOTChallenge sequence are in its `img1`), and a recording into its topics of pictures. Any other
    /// source is returned as it is.
    ///
    /// # Errors
    /// When the folder cannot be read.
    pub fn split(&self) -> Result<Vec<Self>, EvalError> {
        if let Self::Recording(path, None) = self {
            return Ok(Recording::topics(path)?
                .into_iter()
                .map(|topic| Self::Recording(path.clone(), Some(topic)))
                .collect());
        }
        let inside = |folder: &Path, wanted: fn(&Path) -> bool| {
            entries(folder, wanted)
                .map_err(|error| EvalError::read(folder, error, "name a folder of pictures"))
        };
        let mut folders = Vec::new();
        if let Self::Pictures(path) = self
            && path.is_dir()
            && inside(path, is_picture_file)?.is_empty()
        {
            for folder in inside(path, Path::is_dir)? {
                let sequence = folder.join("img1");
                let pictures = if sequence.is_dir() { sequence } else { folder };
                if !inside(&pictures, is_picture_file)?.is_empty() {
                    folders.push(Self::Pictures(pictures));
                }
            }
        }
        if folders.is_empty() {
            folders.push(self.clone());
        }
        Ok(folders)
    }

    /// Returns the path if it exists and can be footage, or if it is an address, which [`Video::open`] refuses.
    fn existing(&self) -> Result<&Path, EvalError> {
        let path = self.path();
        match FileKind::of(path) {
            None | Some(FileKind::Mcap | FileKind::Tar) => {}
            Some(other) => return Err(EvalError::content(path, other.remedy())),
        }
        // A pattern that matches nothing says so itself.
        let is_pattern = matches!(self, Self::VideoFiles(_));
        if is_pattern || path.exists() || path.to_string_lossy().contains("://") {
            Ok(path)
        } else {
            Err(EvalError::content(path, "no such file or folder"))
        }
    }

    /// Opens each clip as a source: one clip, unless it is an archive.
    ///
    /// # Errors
    /// The same as for [`open`](Self::open).
    pub fn open_clips(
        &self,
        rate: Option<f64>,
        encoding: VideoEncoding,
    ) -> Result<Vec<Box<dyn FrameSource>>, EvalError> {
        let path = self.existing()?;
        let mut clips: Vec<Box<dyn FrameSource>> = Vec::new();
        if matches!(self, Self::Archive(_) | Self::Demo) {
            for clip in Pictures::of_archive(path, self.pictures_rate(rate))?.into_clips() {
                clips.push(Box::new(clip));
            }
        } else {
            for clip in self.split()? {
                clips.push(clip.open(rate, encoding)?);
            }
        }
        Ok(clips)
    }

    /// Returns the names of the clips, without opening a video.
    ///
    /// # Errors
    /// When it does not exist, or has pictures and these cannot be listed.
    pub fn clip_names(&self) -> Result<Vec<String>, EvalError> {
        let path = self.existing()?;
        let any_rate = Pictures::DEFAULT_RATE;
        if matches!(self, Self::Archive(_) | Self::Demo) {
            let clips = Pictures::of_archive(path, any_rate)?.into_clips();
            return Ok(clips.iter().map(|clip| clip.name().to_owned()).collect());
        }
        let mut names = Vec::new();
        for clip in self.split()? {
            let name = match &clip {
                // Opened so that a folder without pictures is reported before anything else is done.
                Self::Pictures(folder) => {
                    check_has_pictures(folder)?;
                    Pictures::of_folder(folder, any_rate)?.name().to_owned()
                }
                Self::Recording(path, topic) => Recording::name_of(path, topic.as_deref())?,
                Self::VideoFiles(path) => VideoFiles::name_of(path),
                Self::Video(_) | Self::Archive(_) | Self::Demo => clip_name(clip.path()),
            };
            names.push(name);
        }
        Ok(names)
    }
}

impl Display for SourceName {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> std::fmt::Result {
        self.path().display().fmt(formatter)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tempfile::TempDir;

    const NO_RATE: Option<f64> = None;
    const ROAD_FILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../demo/road.tar");

    /// A folder with empty files at these paths.
    fn folder(files: &[&str]) -> TempDir {
        let folder = tempfile::tempdir().unwrap();
        for file in files {
            let path = folder.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "").unwrap();
        }
        folder
    }

    fn named(folder: &TempDir) -> SourceName {
        folder.path().to_str().unwrap().parse().unwrap()
    }

    #[test]
    fn a_source_is_recognised_by_its_name() {
        let folder = env!("CARGO_MANIFEST_DIR");
        for (text, expected) in [
            ("drive.mp4", SourceName::Video("drive.mp4".into())),
            (
                "http://camera/snap.jpg",
                SourceName::Video("http://camera/snap.jpg".into()),
            ),
            ("one.PNG", SourceName::Pictures("one.PNG".into())),
            ("demo", SourceName::Demo),
            ("other.tar", SourceName::Archive("other.tar".into())),
            ("a/b.mcap", SourceName::Recording("a/b.mcap".into(), None)),
            (
                "b.mcap:/front/image",
                SourceName::Recording("b.mcap".into(), Some("/front/image".to_owned())),
            ),
            (folder, SourceName::Pictures(folder.into())),
        ] {
            assert_eq!(text.parse(), Ok(expected));
        }
    }

    /// A file of this name that begins so.
    fn file(folder: &TempDir, name: &str, begins: &[u8]) -> String {
        let path = folder.path().join(name);
        std::fs::write(&path, begins).unwrap();
        path.to_str().unwrap().to_owned()
    }

    #[test]
    fn what_a_file_holds_says_more_than_its_name_and_capital_letters_say_as_much_as_small_ones() {
        let folder = folder(&[]);
        let mut tar = vec![0; 512];
        tar[257..262].copy_from_slice(b"ustar");
        let named = |text: &str| text.parse::<SourceName>().unwrap();
        let archive = file(&folder, "drive", &tar);
        assert_eq!(named(&archive), SourceName::Archive(archive.into()));
        let bag = file(&folder, "drive.bin", b"\x89MCAP0\r\n");
        assert_eq!(named(&bag), SourceName::Recording((&bag).into(), None));
        let front = named(&format!("{bag}:/front"));
        assert_eq!(
            front,
            SourceName::Recording(bag.into(), Some("/front".to_owned()))
        );
        assert_eq!(named("A.TAR"), SourceName::Archive("A.TAR".into()));
        let in_capitals = SourceName::Recording("A.MCAP".into(), Some("/front".to_owned()));
        assert_eq!(named("A.MCAP:/front"), in_capitals);
        assert_eq!(
            named("A.MCAP"),
            SourceName::Recording("A.MCAP".into(), None)
        );
    }

    #[test]
    fn what_is_no_footage_is_refused_with_what_to_do() {
        let folder = folder(&[]);
        let cases: [(&str, &[u8], &str); 5] = [
            ("a.bag", b"#ROSBAG V2.0\n", "rosbags-convert"),
            ("a.db3", b"SQLite format 3\0", "ros2 bag convert"),
            ("a.zip", b"PK\x03\x04", "unpack it"),
            ("a.tar.gz", b"\x1f\x8b\x08", "unpack it"),
            ("gz.tar", b"\x1f\x8b\x08", "unpack it"),
        ];
        for (name, begins, remedy) in cases {
            let text = file(&folder, name, begins);
            let source: SourceName = text.parse().unwrap();
            let not_opened = source.open(NO_RATE, VideoEncoding::Jpeg).err().unwrap();
            let not_listed = source.clip_names().unwrap_err();
            let no_clips = source.open_clips(NO_RATE, VideoEncoding::Jpeg).err().unwrap();
            for refused in [not_opened, not_listed, no_clips] {
                let said = refused.to_string();
                assert!(said.contains(&text) && said.contains(remedy), "{said}");
            }
        }
    }

    #[test]
    fn a_folder_without_pictures_says_what_can_be_played_in_it() {
        for (files, said) in [
            (["metadata.yaml", "bag_0.mcap"], "bag_0.mcap"),
            (["notes.txt", "below/1.jpg"], "there are some in"),
            (["notes.txt", "below/a.mp4"], "there are some in"),
        ] {
            let refused = named(&folder(&files)).open(NO_RATE, VideoEncoding::Jpeg);
            let error = refused.err().unwrap().to_string();
            assert!(
                error.contains("no pictures") && error.contains(said),
                "{error}"
            );
        }
        let bag = folder(&["metadata.yaml"]);
        file(&bag, "bag_0.db3", b"SQLite format 3\0");
        let refused = named(&bag).open(NO_RATE, VideoEncoding::Jpeg);
        let error = refused.err().unwrap().to_string();
        assert!(
            error.contains("bag_0.db3") && error.contains("MCAP"),
            "{error}"
        );
    }

    #[test]
    fn a_missing_file_is_named() {
        for missing in [
            "no/such/drive.mp4",
            "no/such.tar",
            "no/such.jpg",
            "no/such.mcap",
        ] {
            let name: SourceName = missing.parse().unwrap();
            let not_opened = name.open(NO_RATE, VideoEncoding::Jpeg).err().unwrap();
            assert!(not_opened.to_string().contains(missing), "{not_opened}");
            let not_listed = name.clip_names().unwrap_err();
            assert!(not_listed.to_string().contains(missing), "{not_listed}");
        }
    }

    #[test]
    fn each_folder_of_pictures_in_a_data_sets_folder_is_a_clip() {
        let folder = folder(&[
            "b/2.jpg",
            "a/1.jpg",
            "MOT17-02/img1/000001.jpg",
            "notes/read.txt",
        ]);
        let name = named(&folder);
        assert_eq!(name.clip_names().unwrap(), ["MOT17-02", "a", "b"]);
        let clips = name.open_clips(NO_RATE, VideoEncoding::Jpeg).unwrap();
        assert_eq!(clips.len(), 3);
    }

    #[test]
    fn a_folder_with_pictures_of_its_own_is_one_clip_whatever_lies_in_folders_inside_it() {
        let folder = folder(&["0.jpg", "a/1.jpg", "b/2.jpg"]);
        assert_eq!(named(&folder).clip_names().unwrap().len(), 1);
    }

    #[test]
    fn each_folder_of_the_demo_is_a_clip() {
        let name: SourceName = ROAD_FILE.parse().unwrap();
        let names = ["busy", "sparse", "two-near", "empty-then-car"];
        assert_eq!(name.clip_names().unwrap(), names);
    }

    #[test]
    fn the_demo_is_at_least_forty_seconds_long() {
        let name = SourceName::Archive(ROAD_FILE.into());
        let clips = name.open_clips(Some(ROAD_RATE), VideoEncoding::Jpeg).unwrap();
        let seconds: f64 =
            clips.iter().map(|clip| clip.frames().unwrap() as f64 / clip.rate()).sum();
        assert!(seconds >= 40.0, "{seconds}");
    }

    #[test]
    fn the_demo_is_small_enough_for_a_clone() {
        let road = Path::new(ROAD_FILE);
        let bytes = |file: &Path| std::fs::metadata(file).unwrap().len();
        let truth = road.with_file_name("truth.json");
        assert!(bytes(road) + bytes(&truth) <= 14_000_000);
    }
}
