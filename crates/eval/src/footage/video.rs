//! Reads the frames of a video file, which the `ffmpeg` program decodes.

use super::riff::missing_of_riff;
use super::source::{FrameSource, Stopper, clip_name};
use crate::error::EvalError;
use albireo_vision::picture::{EncodedPicture, FrameLimits, picture_of_file, read_part, read_png};
use albireo_vision::recordings::{check_is_whole, for_ffmpeg, frame_rate};
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

/// The paths of the two programs.
#[derive(Clone, Debug)]
pub struct Ffmpeg {
    /// The decoder.
    pub ffmpeg: PathBuf,
    /// The program that reads a video's properties, from the same package.
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

/// The encoding of a video's frames before they are sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum VideoEncoding {
    /// JPEG of the highest common quality (`-q:v 2`).
    #[default]
    Jpeg,
    /// PNG: nothing is lost, and it takes far more bytes and time.
    Png,
}

/// The most bytes of one picture.
const MAX_PICTURE_BYTES: u64 = 256 << 20;

/// Bytes that are read from ffmpeg at once: a picture is far larger than a pipe's buffer.
const BUFFER: usize = 1 << 18;

/// The most bytes of ffmpeg's error output that are kept.
const MAX_ERROR_OUTPUT_BYTES: u64 = 16 << 10;

/// A video file. Dropping it ends its `ffmpeg`.
#[derive(Debug)]
pub struct Video {
    file: String,
    name: String,
    encoding: VideoEncoding,
    programs: Ffmpeg,
    rate: f64,
    frames: Option<u64>,
    /// True if the file may leave out frames that it counts.
    may_leave_out: bool,
    /// True if its frames do not follow each other evenly.
    is_uneven: bool,
    /// The frames of this pass that were read.
    passed: u64,
    /// What is missing of the pass that has ended, in words.
    missing: Option<String>,
    output: Option<FfmpegOutput>,
    process: Arc<Mutex<Process>>,
}

/// The output of a running ffmpeg.
#[derive(Debug)]
struct FfmpegOutput {
    pictures: BufReader<ChildStdout>,
    errors: JoinHandle<String>,
}

/// The running ffmpeg, shared with the thread that may stop it.
#[derive(Debug, Default)]
pub(super) struct Process {
    child: Option<Child>,
    stopped: bool,
}

impl Process {
    pub(super) fn is_stopped(&self) -> bool {
        self.stopped
    }

    fn end(&mut self) {
        if let Some(mut child) = self.child.take() {
            // This fails only if the program has already ended.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

#[derive(Deserialize)]
struct Probed {
    #[serde(default)]
    streams: Vec<ProbedStream>,
    #[serde(default)]
    format: ProbedFormat,
}

#[derive(Default, Deserialize)]
struct ProbedFormat {
    #[serde(default)]
    format_name: String,
}

#[derive(Deserialize)]
struct ProbedStream {
    avg_frame_rate: Option<String>,
    r_frame_rate: Option<String>,
    nb_frames: Option<String>,
}

/// The arguments of ffprobe, without the file.
const PROBE: [&str; 8] = [
    "-v",
    "error",
    "-select_streams",
    "v:0",
    "-show_entries",
    "format=format_name:stream=avg_frame_rate,r_frame_rate,nb_frames",
    "-of",
    "json",
];

/// Filters that a frame of another size makes anew would count from 0 again.
const ONE_COUNT: [&str; 2] = ["-reinit_filter", "0"];

/// Arguments that output every frame exactly once, whatever its time stamp: frames get consecutive time stamps, so that
/// a constant output rate neither repeats nor drops any. All have the size of the first. (`-fps_mode passthrough` is
/// unknown before ffmpeg 5.1, `-vsync` after 7.)
const EACH_FRAME: [&str; 6] = [
    "-map",
    "0:v:0",
    "-vf",
    "scale,settb=1/25,setpts=N",
    "-r",
    "25",
];

/// As many of the lines that ffmpeg says of a file are told: one broken frame gives many.
const TOLD_LINES: usize = 2;

/// Frames whose rate by the finest of their intervals is so many times the mean are not even.
const UNEVEN: f64 = 1.5;

impl Video {
    /// Probes and opens a video file. `default_rate` is for files that have no rate of their own.
    ///
    /// # Errors
    /// When a program is not installed or finds no video stream.
    pub fn open(
        file: &str,
        default_rate: Option<f64>,
        encoding: VideoEncoding,
        programs: Ffmpeg,
    ) -> Result<Self, EvalError> {
        if file.contains("://") {
            // The address may contain a password, so it is not repeated.
            return Err(EvalError::new(
                "a live camera is not footage: a node opens it as the `source` of a [[camera]], or `albireo publish` sends \
                 it to one",
            ));
        }
        let found = probe(file, default_rate, &programs)?;
        let mut video = Self::open_probed(Arc::default(), file, found.rate, encoding, programs)?;
        video.frames = found.frames;
        video.may_leave_out = found.may_leave_out;
        video.is_uneven = found.is_uneven;
        Ok(video)
    }

    /// Opens a file of which the frame rate is known, with a process that others may stop.
    pub(super) fn open_probed(
        process: Arc<Mutex<Process>>,
        file: &str,
        rate: f64,
        encoding: VideoEncoding,
        programs: Ffmpeg,
    ) -> Result<Self, EvalError> {
        let mut video = Self {
            name: clip_name(Path::new(file)),
            file: file.to_owned(),
            encoding,
            programs,
            rate,
            frames: None,
            may_leave_out: false,
            is_uneven: false,
            passed: 0,
            missing: None,
            output: None,
            process,
        };
        // Starts ffmpeg.
        video.rewind()?;
        Ok(video)
    }

    /// Waits for `ffmpeg` at the end of its output, and returns what it said of the file; an error if it failed.
    fn wait(&mut self) -> Result<String, EvalError> {
        let Some(output) = self.output.take() else {
            return Ok(String::new());
        };
        let errors = output.errors.join().unwrap_or_default();
        let mut process = self.process.lock();
        let Some(mut child) = process.child.take() else {
            return Ok(String::new());
        };
        let reason = match child.wait() {
            Ok(_) if process.stopped => return Ok(String::new()),
            Ok(status) if status.success() => return Ok(errors),
            Ok(status) if errors.is_empty() => format!("it ended with {status}"),
            Ok(_) => errors,
            Err(error) => error.to_string(),
        };
        Err(unreadable(&self.file, reason))
    }

    /// What is missing of a file that was read to its end, of which ffmpeg `said` something or nothing.
    fn missing(&self, said: &str) -> Option<String> {
        let has_all = self.may_leave_out || self.frames.is_none_or(|all| self.passed >= all);
        let cut = missing_of_riff(Path::new(&self.file));
        if said.is_empty() && has_all && cut.is_none() {
            return None;
        }
        let mut what = match self.frames {
            Some(all) => format!("{} of {all} frames could be read", self.passed),
            None => format!("{} frames could be read", self.passed),
        };
        if let Err(reason) = check_is_whole(Path::new(&self.file)) {
            what += &format!("; {reason}");
        }
        if let Some(cut) = cut {
            what += &format!("; {cut}");
        }
        if !said.is_empty() {
            let lines: Vec<&str> = said.split("; ").take(TOLD_LINES).collect();
            what += &format!("; ffmpeg said: {}", lines.join("; "));
        }
        Some(format!("{}: {what}", self.file))
    }
}

/// What a file without a frame rate needs.
pub(super) fn no_rate(file: &str) -> EvalError {
    EvalError::new(format!(
        "{file}: ffprobe reports no frame rate; give one with --rate"
    ))
}

/// What ffprobe says about a file.
struct Properties {
    /// Frames per second.
    rate: f64,
    /// The number of frames, if the file says it.
    frames: Option<u64>,
    /// True for a file that may leave out frames that it counts.
    may_leave_out: bool,
    /// True if its frames do not follow each other evenly.
    is_uneven: bool,
}

/// Asks ffprobe about a file.
fn probe(
    file: &str,
    default_rate: Option<f64>,
    programs: &Ffmpeg,
) -> Result<Properties, EvalError> {
    let output = Command::new(&programs.ffprobe)
        .args(PROBE)
        .arg(for_ffmpeg(Path::new(file)))
        .stdin(Stdio::null())
        .output()
        .map_err(|error| not_started(&programs.ffprobe, error))?;
    if !output.status.success() {
        let path = Path::new(file);
        check_is_whole(path).map_err(|reason| EvalError::content(path, reason))?;
        let said = String::from_utf8_lossy(&output.stderr);
        return Err(unreadable(file, said.trim()));
    }
    let wrong = |what: String| EvalError::new(format!("{file}: {what}"));
    let probed: Probed = serde_json::from_slice(&output.stdout)
        .map_err(|error| wrong(format!("ffprobe's output cannot be read: {error}")))?;
    let Some(stream) = probed.streams.first() else {
        return Err(wrong("it has no video".to_owned()));
    };
    let mean = stream.avg_frame_rate.as_deref().and_then(frame_rate);
    let finest = stream.r_frame_rate.as_deref().and_then(frame_rate);
    let rate = mean.or(finest).or(default_rate).ok_or_else(|| no_rate(file))?;
    Ok(Properties {
        rate,
        frames: stream.nb_frames.as_ref().and_then(|text| text.parse().ok()),
        may_leave_out: may_leave_out(&probed.format.format_name),
        is_uneven: finest.is_some_and(|finest| are_uneven(rate, finest)),
    })
}

/// True if a file of this format may leave out frames that it counts: the edit list of an MP4 file says which ones, as
/// when it was cut without encoding it again, and an AVI file has an empty piece in the place of a frame that was
/// dropped.
fn may_leave_out(format: &str) -> bool {
    format.starts_with("mov,") || format == "avi"
}

/// True if some frames of this mean rate follow each other much faster.
fn are_uneven(mean: f64, finest: f64) -> bool {
    let ratio = finest / mean;
    // Frames of two fields each have half the rate of the fields.
    ratio > UNEVEN && (ratio - 2.0).abs() > 0.02
}

fn not_started(program: &Path, error: std::io::Error) -> EvalError {
    let program = program.display();
    let text = match error.kind() {
        ErrorKind::NotFound => format!(
            "no `{program}` was found; install it with `apt-get install ffmpeg`, `dnf install ffmpeg` or `brew install ffmpeg`"
        ),
        _ => format!("`{program}` cannot be started: {error}"),
    };
    EvalError::new(text)
}

fn unreadable(file: &str, reason: impl Display) -> EvalError {
    EvalError::new(format!("{file}: ffmpeg cannot read it: {reason}"))
}

/// Reads a program's error output to the end, so that the program never blocks, and keeps the beginning.
fn read_errors(mut errors: ChildStderr) -> String {
    let mut text = Vec::new();
    // An error message is not worth an error of its own.
    let _ = errors.by_ref().take(MAX_ERROR_OUTPUT_BYTES).read_to_end(&mut text);
    let _ = std::io::copy(&mut errors, &mut std::io::sink());
    without_addresses(&String::from_utf8_lossy(&text).trim().replace('\n', "; "))
}

/// What ffmpeg said without the addresses of its parts, which differ each time: `[h264 @ 0x55e1a8fa07c0]`.
fn without_addresses(said: &str) -> String {
    let mut parts = said.split(" @ 0x");
    let mut plain = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        plain += part.trim_start_matches(|c: char| c.is_ascii_hexdigit());
    }
    plain
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

    fn remarks(&self) -> Vec<String> {
        let mut remarks: Vec<String> = self.missing.iter().cloned().collect();
        if self.is_uneven {
            remarks.push(format!(
                "{}: its frames do not follow each other evenly; they are taken at their mean rate of {:.2}/s",
                self.file, self.rate
            ));
        }
        remarks
    }

    fn next(&mut self) -> Result<Option<EncodedPicture>, EvalError> {
        let Some(output) = &mut self.output else {
            return Ok(None);
        };
        let read = match self.encoding {
            VideoEncoding::Jpeg => read_part(&mut output.pictures, MAX_PICTURE_BYTES),
            VideoEncoding::Png => read_png(&mut output.pictures, MAX_PICTURE_BYTES),
        };
        match read {
            Ok(Some(file)) => match picture_of_file(Bytes::from(file), &FrameLimits::default()) {
                Ok(picture) => {
                    self.passed += 1;
                    Ok(Some(picture))
                }
                Err(fault) => Err(EvalError::new(format!(
                    "{}: a frame cannot be sent: {fault}",
                    self.file
                ))),
            },
            Ok(None) => {
                let said = self.wait()?;
                if !self.process.lock().stopped {
                    self.missing = self.missing(&said);
                }
                Ok(None)
            }
            Err(cut) => {
                if self.process.lock().stopped {
                    return Ok(None);
                }
                // A failed ffmpeg explains a cut stream better than the cut does.
                self.wait()?;
                Err(EvalError::new(format!(
                    "{}: ffmpeg's output is incomplete: {cut}",
                    self.file
                )))
            }
        }
    }

    fn rewind(&mut self) -> Result<(), EvalError> {
        self.output = None;
        self.passed = 0;
        self.missing = None;
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
            .args(["-v", "error", "-nostdin"])
            .args(ONE_COUNT)
            .arg("-i")
            .arg(for_ffmpeg(Path::new(&self.file)))
            .args(EACH_FRAME)
            .args(encoder)
            .arg("pipe:1")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // Ctrl-C in a terminal must not reach ffmpeg: this program ends it.
            .process_group(0)
            .spawn()
            .map_err(|error| not_started(&self.programs.ffmpeg, error))?;
        if let (Some(output), Some(errors)) = (child.stdout.take(), child.stderr.take()) {
            self.output = Some(FfmpegOutput {
                pictures: BufReader::with_capacity(BUFFER, output),
                errors: std::thread::spawn(move || read_errors(errors)),
            });
        }
        process.child = Some(child);
        Ok(())
    }

    fn stopper(&self) -> Option<Stopper> {
        Some(stopper(&self.process))
    }
}

/// What stops a process.
pub(super) fn stopper(process: &Arc<Mutex<Process>>) -> Stopper {
    let process = Arc::clone(process);
    Stopper(Box::new(move || {
        let mut process = process.lock();
        process.stopped = true;
        process.end();
    }))
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
    fn a_camera_address_is_rejected_with_a_remedy() {
        let address = "rtsp://user:hidden@camera/1";
        let no_default_rate = None;
        let programs = Ffmpeg::default();
        let text = Video::open(address, no_default_rate, VideoEncoding::Jpeg, programs)
            .unwrap_err()
            .to_string();
        assert!(text.contains("albireo publish"), "{text}");
        assert!(!text.contains("hidden"), "{text}");
    }

    #[test]
    fn ffmpeg_says_the_same_of_a_file_each_time() {
        let said = "[h264 @ 0x55e1a8fa07c0] no frame!; [mov @ 0x7f] partial file";
        let plain = "[h264] no frame!; [mov] partial file";
        assert_eq!(without_addresses(said), plain);
        assert_eq!(without_addresses(plain), plain);
    }
}
