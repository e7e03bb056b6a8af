//! Several video files as one source: played one after the other, and again from the first after the last.

use albireo_vision::recordings::{Drives, PassedOver, Recording, video_files};
use std::path::PathBuf;
use std::sync::Arc;

/// The program that looks into files.
const FFPROBE: &str = "ffprobe";

/// When and on which drive a picture was recorded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recorded {
    /// Nanoseconds since the Unix epoch; `None` if neither name nor file says it.
    pub time_ns: Option<u64>,
    /// The drive, which is the picture's clip.
    pub drive: Arc<str>,
}

/// The files of a folder or of a pattern.
#[derive(Clone, Debug)]
pub(super) struct Playlist {
    /// The folder or pattern.
    text: String,
    drives: Drives,
    /// How often they have been played to the end.
    passes: u32,
    /// True once one of them has shown a picture in this pass.
    has_played: bool,
    /// The last file that was passed over in this pass.
    passed_over: Option<PassedOver>,
}

impl Playlist {
    /// Lists the files.
    ///
    /// # Errors
    /// In words, if there are none or they are of several cameras.
    pub(super) fn find(text: &str) -> Result<Self, String> {
        Ok(Self {
            text: text.to_owned(),
            drives: Drives::new(video_files(text)?, PathBuf::from(FFPROBE)),
            passes: 0,
            has_played: false,
            passed_over: None,
        })
    }

    /// The next file that can be played. After the last, the folder is read again: there may be new ones. Calls `each` with
    /// those that are passed over.
    ///
    /// # Errors
    /// If none could be played.
    pub(super) fn next(&mut self, mut each: impl FnMut(PassedOver)) -> Result<Recording, String> {
        loop {
            match self.drives.next() {
                Some(Ok(recording)) => {
                    // A drive that is played again is another clip.
                    let drive = match self.passes {
                        0 => recording.drive,
                        again => format!("{}-{}", recording.drive, again + 1).into(),
                    };
                    return Ok(Recording { drive, ..recording });
                }
                Some(Err(passed_over)) => {
                    self.passed_over = Some(passed_over.clone());
                    each(passed_over);
                }
                None => self.begin_again()?,
            }
        }
    }

    fn begin_again(&mut self) -> Result<(), String> {
        let has_played = std::mem::take(&mut self.has_played);
        let passed_over = self.passed_over.take();
        self.drives = Drives::new(video_files(&self.text)?, PathBuf::from(FFPROBE));
        if !has_played {
            let why = passed_over.map_or_else(String::new, |one| format!(": {one}"));
            return Err(format!("none of its files can be played{why}"));
        }
        self.passes += 1;
        Ok(())
    }

    /// Notes that a file has shown pictures.
    pub(super) fn played(&mut self) {
        self.has_played = true;
    }
}
