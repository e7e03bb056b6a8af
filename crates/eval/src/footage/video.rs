//! A video file as a source of frames, decoded by the `ffmpeg` program.

use super::source::{FrameSource, Stopper, clip_name};
use crate::error::EvalError;
use albireo_vision::picture::{EncodedPicture, FrameLimits, picture_of_file, read_part, read_png};
use bytes::Bytes;
use parking_lot::Mutex;
use serde::Deserialize;
use std::fmt::Display;
use std::io::{BufReader, ErrorKind, Read};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::thread::JoinHandle;

/// The two programs.
#[derive(Clone, Debug)]
pub struct Ffmpeg {
    /// The decoder.
    pub ffmpeg: PathBuf,
    /// The prober, of the same package.
    pub ffprobe: PathBuf,
}

impl Default for Ffmpeg {
    fn default() -> Self {
        Self {
            ffmpeg: PathBuf::from("ffmpeg"),
            ffprobe: PathBuf::from("ffprobe"),
        }
    }
}

/// How the frames of a video are encoded before they are sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum VideoEncoding {
    /// JPEG of the highest common quality (`-q:v 2`).
    #[default]
    Jpeg,
    /// PNG: nothing is lost, and it takes far more bytes and time.
    Png,
}

/// Most bytes of one picture.
const MOST_BYTES: u64 = 256 << 20;

/// Bytes that are read from ffmpeg at once: a picture is far more than a pipe holds.
const BUFFER: usize = 1 << 18;

/// Most bytes that are kept of what ffmpeg says.
const LONGEST_COMPLAINT: u64 = 16 << 10;

/// A video. Its `ffmpeg` ends with it.
#[derive(Debug)]
pub struct Video {
    file: String,
    name: String,
    encoding: VideoEncoding,
    programs: Ffmpeg,
    rate: f64,
    frames: Option<u64>,
    pass: Option<Pass>,
    process: Arc<Mutex<Process>>,
}

/// One run of ffmpeg through the file.
#[derive(Debug)]
struct Pass {
    output: BufReader<ChildStdout>,
    complaints: JoinHandle<String>,
}

/// The running ffmpeg, shared with the thread that may stop it.
#[derive(Debug, Default)]
struct Process {
    child: Option<Child>,
    stopped: bool,
}

impl Process {
    fn end(&mut self) {
        if let Some(mut child) = self.child.take() {
            // It fails only when the program has ended already.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

#[derive(Deserialize)]
struct Probed {
    #[serde(default)]
    streams: Vec<ProbedStream>,
}

#[derive(Deserialize)]
struct ProbedStream {
    avg_frame_rate: Option<String>,
    r_frame_rate: Option<String>,
    nb_frames: Option<String>,
}

/// `30000/1001` as a number, if it is a rate.
fn rate(text: &str) -> Option<f64> {
    let (numerator, denominator) = text.split_once('/').unwrap_or((text, "1"));
    let rate = numerator.parse::<f64>().ok()? / denominator.parse::<f64>().ok()?;
    (rate.is_finite() && rate > 0.0 && rate <= 1000.0).then_some(rate)
}

/// What ffprobe is asked about a file.
const PROBE: [&str; 8] = [
    "-v",
    "error",
    "-select_streams",
    "v:0",
    "-show_entries",
    "stream=avg_frame_rate,r_frame_rate,nb_frames",
    "-of",
    "json",
];

/// Every frame of the file exactly once, whatever its time stamp: frames get numbers for time stamps, which a constant
/// output rate then neither repeats nor drops. (`-fps_mode passthrough` is unknown before ffmpeg 5.1, `-vsync` after 7.)
const EACH_FRAME: [&str; 6] = ["-map", "0:v:0", "-vf", "settb=1/25,setpts=N", "-r", "25"];

impl Video {
    /// Probes and opens a video file. `wanted_rate` is for files that have no rate of their own.
    ///
    /// # Errors
    /// When a program is not installed or finds no video stream.
    pub fn open(
        file: &str,
        wanted_rate: Option<f64>,
        encoding: VideoEncoding,
        programs: Ffmpeg,
    ) -> Result<Self, EvalError> {
        if file.contains("://") {
            // It may hold a password and is not repeated.
            return Err(EvalError::new(
                "a live camera is not footage: a node opens it as the `source` of a [[camera]], or `albireo publish` sends \
                 it to one",
            ));
        }
        // A name that begins with a dash is no option.
        let file = match file.strip_prefix('-') {
            Some(rest) => format!("./-{rest}"),
            None => file.to_owned(),
        };
        let (rate, frames) = probe(&file, wanted_rate, &programs)?;
        let mut video = Self {
            name: clip_name(Path::new(&file)),
            file,
            encoding,
            programs,
            rate,
            frames,
            pass: None,
            process: Arc::default(),
        };
        video.rewind()?;
        Ok(video)
    }

    /// The output is over: an error if `ffmpeg` failed.
    fn ended(&mut self) -> Result<(), EvalError> {
        let Some(pass) = self.pass.take() else {
            return Ok(());
        };
        let complaints = pass.complaints.join().unwrap_or_default();
        let mut process = self.process.lock();
        let status = process.child.take().map(|mut child| child.wait());
        let reason = match status {
            Some(Ok(status)) if !status.success() && !process.stopped => {
                if complaints.is_empty() {
                    format!("it ended with {status}")
                } else {
                    complaints
                }
            }
            Some(Err(error)) => error.to_string(),
            _ => return Ok(()),
        };
        Err(unreadable(&self.file, reason))
    }
}

/// Rate and number of the frames of a file.
fn probe(
    file: &str,
    fallback: Option<f64>,
    programs: &Ffmpeg,
) -> Result<(f64, Option<u64>), EvalError> {
    let mut command = Command::new(&programs.ffprobe);
    let probed = (command.args(PROBE).arg(file).stdin(Stdio::null()).output())
        .map_err(|error| not_started(&programs.ffprobe, error))?;
    if !probed.status.success() {
        let said = String::from_utf8_lossy(&probed.stderr);
        return Err(unreadable(file, said.trim()));
    }
    let wrong = |what: String| EvalError::new(format!("{file}: {what}"));
    let probed: Probed = serde_json::from_slice(&probed.stdout)
        .map_err(|error| wrong(format!("ffprobe's answer is not understood: {error}")))?;
    let Some(stream) = probed.streams.first() else {
        return Err(wrong("there is no video in it".to_owned()));
    };
    let rate = [&stream.avg_frame_rate, &stream.r_frame_rate]
        .into_iter()
        .flatten()
        .find_map(|text| rate(text))
        .or(fallback)
        .ok_or_else(|| wrong("ffprobe reports no frame rate; give one with --rate".to_owned()))?;
    let frames = stream.nb_frames.as_ref().and_then(|text| text.parse().ok());
    Ok((rate, frames))
}

fn not_started(program: &Path, error: std::io::Error) -> EvalError {
    let program = program.display();
    EvalError::new(match error.kind() {
        ErrorKind::NotFound => format!(
            "no `{program}` was found; install it with `apt-get install ffmpeg`, `dnf install ffmpeg` or `brew install ffmpeg`"
        ),
        _ => format!("`{program}` cannot be started: {error}"),
    })
}

fn unreadable(file: &str, reason: impl Display) -> EvalError {
    EvalError::new(format!("{file}: ffmpeg cannot read it: {reason}"))
}

/// Reads what a program says to its end, so that it never waits for a reader, and keeps the beginning.
fn listen(mut errors: ChildStderr) -> String {
    let mut said = Vec::new();
    // What cannot be read is not there.
    let _ = errors
        .by_ref()
        .take(LONGEST_COMPLAINT)
        .read_to_end(&mut said);
    let _ = std::io::copy(&mut errors, &mut std::io::sink());
    String::from_utf8_lossy(&said).trim().replace('\n', "; ")
}

impl FrameSource for Video {
    fn name(&self) -> &str {
        &self.name
    }

    fn rate(&self) -> f64 {
        self.rate
    }

    fn frames(&self) -> Option<u64> {
        self.frames
    }

    fn next(&mut self) -> Result<Option<EncodedPicture>, EvalError> {
        let Some(pass) = &mut self.pass else {
            return Ok(None);
        };
        let picture = match self.encoding {
            VideoEncoding::Jpeg => read_part(&mut pass.output, MOST_BYTES),
            VideoEncoding::Png => read_png(&mut pass.output, MOST_BYTES),
        };
        match picture {
            Ok(Some(picture)) => picture_of_file(Bytes::from(picture), &FrameLimits::default())
                .map(Some)
                .map_err(|fault| {
                    EvalError::new(format!("{}: a frame cannot be sent: {fault}", self.file))
                }),
            Ok(None) => self.ended().map(|()| None),
            Err(cut) => {
                if self.process.lock().stopped {
                    return Ok(None);
                }
                // A failed ffmpeg explains a cut stream better than the cut does.
                self.ended()?;
                Err(EvalError::new(format!(
                    "{}: ffmpeg's output is cut: {cut}",
                    self.file
                )))
            }
        }
    }

    fn rewind(&mut self) -> Result<(), EvalError> {
        self.pass = None;
        let mut process = self.process.lock();
        process.end();
        if process.stopped {
            return Ok(());
        }
        let encoder: &[&str] = match self.encoding {
            VideoEncoding::Jpeg => &["-c:v", "mjpeg", "-q:v", "2", "-f", "mpjpeg"],
            VideoEncoding::Png => &["-c:v", "png", "-f", "image2pipe"],
        };
        let mut child = Command::new(&self.programs.ffmpeg)
            .args(["-v", "error", "-nostdin", "-i", &self.file])
            .args(EACH_FRAME)
            .args(encoder)
            .arg("pipe:1")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // Ctrl-C in a terminal is for the owner, who ends it.
            .process_group(0)
            .spawn()
            .map_err(|error| not_started(&self.programs.ffmpeg, error))?;
        if let (Some(output), Some(errors)) = (child.stdout.take(), child.stderr.take()) {
            self.pass = Some(Pass {
                output: BufReader::with_capacity(BUFFER, output),
                complaints: std::thread::spawn(move || listen(errors)),
            });
        }
        process.child = Some(child);
        Ok(())
    }

    fn stopper(&self) -> Option<Stopper> {
        let process = Arc::clone(&self.process);
        Some(Box::new(move || {
            let mut process = process.lock();
            process.stopped = true;
            process.end();
        }))
    }
}

impl Drop for Video {
    fn drop(&mut self) {
        self.process.lock().end();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_is_a_fraction_that_makes_sense() {
        assert_eq!(rate("25/1"), Some(25.0));
        assert_eq!(rate("30000/1001"), Some(30000.0 / 1001.0));
        for text in ["0/0", "90000/1", "x", "-5/1", ""] {
            assert_eq!(rate(text), None, "{text}");
        }
    }

    #[test]
    fn a_camera_s_address_is_refused_with_what_to_do() {
        let address = "rtsp://user:hidden@camera/1";
        let error = Video::open(address, None, VideoEncoding::Jpeg, Ffmpeg::default());
        let text = error.unwrap_err().to_string();
        assert!(text.contains("albireo publish"), "{text}");
        assert!(!text.contains("hidden"), "{text}");
    }
}
