//! Reads several video files, as a dashcam writes them, as one source.

use super::source::{FrameSource, Stopper, plain_name};
use super::video::{Ffmpeg, Process, Video, VideoEncoding, no_rate, stopper};
use crate::error::EvalError;
use albireo_vision::picture::EncodedPicture;
use albireo_vision::recordings::{Drives, Recording, video_files};
use parking_lot::Mutex;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The video files of a folder or a pattern, in the order in which they were recorded. Each drive is a clip. A file
/// that cannot be played counts as a picture that cannot be read: the next file follows.
#[derive(Debug)]
pub struct VideoFiles {
    /// The folder or pattern.
    text: String,
    name: String,
    default_rate: Option<f64>,
    encoding: VideoEncoding,
    programs: Ffmpeg,
    rate: f64,
    drives: Drives,
    playing: Option<PlayedFile>,
    /// The file of the last picture, or the one that cannot be played.
    last: PathBuf,
    drive: Arc<str>,
    /// What is to be said of the files of this pass that have ended.
    remarks: Vec<String>,
    /// The ffmpeg of the file that is played.
    process: Arc<Mutex<Process>>,
}

/// A file that is being played.
#[derive(Debug)]
struct PlayedFile {
    video: Video,
    recording: Recording,
    frames: u64,
}

impl VideoFiles {
    /// Lists the files, and looks for the first one that can be played.
    ///
    /// # Errors
    /// When there is none, or they come from several cameras.
    pub fn open(
        text: &str,
        default_rate: Option<f64>,
        encoding: VideoEncoding,
        programs: Ffmpeg,
    ) -> Result<Self, EvalError> {
        let mut source = Self {
            drives: drives(text, &programs)?,
            text: text.to_owned(),
            name: Self::name_of(Path::new(text)),
            default_rate,
            encoding,
            programs,
            rate: 0.0,
            playing: None,
            last: PathBuf::new(),
            drive: Arc::from(""),
            remarks: Vec::new(),
            process: Arc::default(),
        };
        let mut first_fault = None;
        let playing = loop {
            match source.open_next() {
                Ok(Some(playing)) => break playing,
                Ok(None) => {
                    let fault = first_fault.unwrap_or_else(|| EvalError::new("there is none"));
                    return Err(fault.context(format!("{text}: none of its files can be played")));
                }
                Err(fault) if first_fault.is_none() => first_fault = Some(fault),
                Err(_) => {}
            }
        };
        source.rate = playing.video.rate();
        source.playing = Some(playing);
        // If files were passed over, `next` begins with them again, to report each in its turn.
        if first_fault.is_some() {
            source.rewind()?;
        }
        Ok(source)
    }

    /// The name of the files of a folder or a pattern: the folder's.
    pub(super) fn name_of(path: &Path) -> String {
        let folder = if path.is_dir() {
            Some(path)
        } else {
            path.parent()
        };
        let name = folder.and_then(Path::file_name).unwrap_or_default();
        plain_name(&name.to_string_lossy())
    }

    /// Opens the next file, whose drive becomes the clip; `None` if there is no more.
    fn open_next(&mut self) -> Result<Option<PlayedFile>, EvalError> {
        let recording = match self.drives.next() {
            None => return Ok(None),
            Some(Ok(recording)) => recording,
            Some(Err(passed_over)) => {
                self.last.clone_from(&passed_over.path);
                return Err(EvalError::new(passed_over.to_string()));
            }
        };
        self.last.clone_from(&recording.path);
        let file = recording.path.to_string_lossy().into_owned();
        let process = Arc::clone(&self.process);
        let rate = recording.rate.or(self.default_rate).ok_or_else(|| no_rate(&file))?;
        let programs = self.programs.clone();
        let video = Video::open_probed(process, &file, rate, self.encoding, programs)?;
        self.drive = plain_name(&recording.drive).into();
        Ok(Some(PlayedFile {
            video,
            recording,
            frames: 0,
        }))
    }
}

fn drives(text: &str, programs: &Ffmpeg) -> Result<Drives, EvalError> {
    let files = video_files(text).map_err(EvalError::new)?;
    Ok(Drives::new(files, programs.ffprobe.clone()))
}

impl FrameSource for VideoFiles {
    fn name(&self) -> &str {
        &self.name
    }

    fn rate(&self) -> f64 {
        self.rate
    }

    fn frames(&self) -> Option<u64> {
        None
    }

    fn clip(&self) -> Option<&str> {
        Some(&self.drive)
    }

    fn picture_name(&self) -> Option<String> {
        Some(self.last.display().to_string())
    }

    fn remarks(&self) -> Vec<String> {
        self.remarks.clone()
    }

    fn time_ns(&self) -> Option<u64> {
        let playing = self.playing.as_ref()?;
        let seconds = playing.frames.saturating_sub(1) as f64 / playing.video.rate();
        let started_ns = playing.recording.started_ns?;
        Some(started_ns.saturating_add((seconds * 1e9) as u64))
    }

    fn next(&mut self) -> Result<Option<EncodedPicture>, EvalError> {
        loop {
            let Some(playing) = &mut self.playing else {
                self.playing = self.open_next()?;
                if self.playing.is_none() {
                    return Ok(None);
                }
                continue;
            };
            match playing.video.next() {
                Ok(None) => {
                    self.remarks.extend(playing.video.remarks());
                    self.playing = None;
                    if self.process.lock().is_stopped() {
                        return Ok(None);
                    }
                }
                Ok(Some(picture)) => {
                    playing.frames += 1;
                    return Ok(Some(picture));
                }
                Err(fault) => {
                    self.playing = None;
                    return Err(fault);
                }
            }
        }
    }

    fn rewind(&mut self) -> Result<(), EvalError> {
        self.playing = None;
        self.remarks.clear();
        self.drives = drives(&self.text, &self.programs)?;
        Ok(())
    }

    fn stopper(&self) -> Option<Stopper> {
        Some(stopper(&self.process))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;

    #[test]
    #[ignore = "needs ffmpeg"]
    fn each_file_is_probed_once() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a1.mp4", "a2.mp4"] {
            let mut film = Command::new("ffmpeg");
            film.args([
                "-v",
                "error",
                "-f",
                "lavfi",
                "-i",
                "testsrc=s=64x48:r=5:d=1",
            ]);
            let made = film.arg(folder.path().join(name)).status().unwrap();
            assert!(made.success());
        }
        let scripts = tempfile::tempdir().unwrap();
        let script = scripts.path().join("script");
        let ffprobe = scripts.path().join("ffprobe");
        let calls = scripts.path().join("calls");
        let counting = format!(
            "#!/bin/sh\necho >>{}\nexec ffprobe \"$@\"\n",
            calls.display()
        );
        std::fs::write(&script, counting).unwrap();
        // Copied by another program: a child that another test starts meanwhile would hold what this process writes open,
        // and a program that is open for writing cannot be started.
        let copied = Command::new("install").args(["-m", "700"]).args([&script, &ffprobe]).status();
        assert!(copied.unwrap().success());
        let programs = Ffmpeg {
            ffprobe,
            ..Ffmpeg::default()
        };
        let text = folder.path().to_str().unwrap();
        let mut files = VideoFiles::open(text, None, VideoEncoding::Jpeg, programs).unwrap();
        let mut pictures = 0;
        while files.next().unwrap().is_some() {
            pictures += 1;
        }
        assert_eq!(files.rate(), 5.0);
        assert_eq!(pictures, 10);
        let calls = std::fs::read_to_string(&calls).unwrap();
        assert_eq!(calls.lines().count(), 2, "one for each file");
    }
}
