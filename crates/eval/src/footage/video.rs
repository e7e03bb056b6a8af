//! A video file as a source of frames, decoded by the `ffmpeg` program.

use super::source::{FrameSource, Stopper, clip_name};
use albireo_node::frame::{EncodedPicture, FrameLimits, PayloadFormat, RawSample, read_frame};
use anyhow::{Context, anyhow, bail};
use bytes::Bytes;
use parking_lot::Mutex;
use serde::Deserialize;
use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::thread::JoinHandle;
use tokio::time::Instant;

/// How the frames of a video are encoded before they are sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum VideoEncoding {
    /// JPEG of the highest common quality (`-q:v 2`).
    #[default]
    Jpeg,
    /// PNG: nothing is lost, and it takes far more bytes and time.
    Png,
}

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

/// A video. Its `ffmpeg` ends with it.
#[derive(Debug)]
pub struct Video {
    input: String,
    name: String,
    encoding: VideoEncoding,
    programs: Ffmpeg,
    rate: f64,
    frames: Option<u64>,
    slot: Arc<Mutex<Slot>>,
    output: Option<BufReader<ChildStdout>>,
    complaints: Option<JoinHandle<String>>,
}

/// The running `ffmpeg`, shared with the stopper.
#[derive(Debug, Default)]
struct Slot {
    child: Option<Child>,
    stopped: bool,
}

impl Slot {
    fn kill(&mut self) {
        if let Some(mut child) = self.child.take() {
            // Errors mean that it has ended already.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Longest complaint of a program that is kept.
const COMPLAINT_BYTES: u64 = 4096;

fn start(command: &mut Command) -> anyhow::Result<Child> {
    let program = command.get_program().to_string_lossy().into_owned();
    command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|error| match error.kind() {
            ErrorKind::NotFound => anyhow!(
                "`{program}` was not found, and videos need it. Install it with `apt-get install \
                 ffmpeg`, `dnf install ffmpeg` or `brew install ffmpeg`, or replay a folder of \
                 pictures instead"
            ),
            _ => anyhow!("`{program}` cannot be started: {error}"),
        })
}

/// Reads what a program complains of, so that it never waits for a reader.
fn collect(stderr: ChildStderr) -> JoinHandle<String> {
    std::thread::spawn(move || {
        let mut reader = BufReader::new(stderr);
        let mut kept = Vec::new();
        // What cannot be read is not missed: it would only have explained a failure.
        let _ = reader.by_ref().take(COMPLAINT_BYTES).read_to_end(&mut kept);
        let _ = std::io::copy(&mut reader, &mut std::io::sink());
        String::from_utf8_lossy(&kept).trim().to_owned()
    })
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

/// The option that keeps `ffmpeg` from adding or leaving out frames; it was renamed in 5.1.
fn passthrough_option(version: &str) -> &'static str {
    let number = version
        .strip_prefix("ffmpeg version ")
        .unwrap_or_default()
        .trim_start_matches('n');
    let mut parts = number.split(|c: char| !c.is_ascii_digit());
    let major: Option<u32> = parts.next().and_then(|part| part.parse().ok());
    let minor: u32 = parts.next().and_then(|part| part.parse().ok()).unwrap_or(0);
    match major {
        // Builds between releases have no number; they are young.
        Some(major) if (major, minor) < (5, 1) => "-vsync",
        _ => "-fps_mode",
    }
}

impl Video {
    /// Probes and opens a video file, or an address that `ffmpeg` can open. `fallback_rate` is for streams
    /// that have no rate of their own.
    ///
    /// # Errors
    /// When a program is not installed or finds no video stream.
    pub fn open(
        input: &str,
        fallback_rate: Option<f64>,
        encoding: VideoEncoding,
        programs: Ffmpeg,
    ) -> anyhow::Result<Self> {
        let probe = start(Command::new(&programs.ffprobe).args([
            "-v",
            "error",
            "-select_streams",
            "v:0",
            "-show_entries",
            "stream=avg_frame_rate,r_frame_rate,nb_frames",
            "-of",
            "json",
            input,
        ]))?
        .wait_with_output()
        .context("ffprobe")?;
        let said = String::from_utf8_lossy(&probe.stderr);
        if !probe.status.success() {
            bail!("{input}: ffprobe cannot read it: {}", said.trim());
        }
        let probed: Probed = serde_json::from_slice(&probe.stdout)
            .with_context(|| format!("{input}: ffprobe's answer is not understood"))?;
        let Some(stream) = probed.streams.first() else {
            bail!("{input}: there is no video in it");
        };
        let rate = [&stream.avg_frame_rate, &stream.r_frame_rate]
            .into_iter()
            .flatten()
            .find_map(|text| rate(text))
            .or(fallback_rate)
            .with_context(|| {
                format!("{input}: ffprobe tells no frame rate; give one with --rate")
            })?;
        let mut video = Self {
            input: input.to_owned(),
            name: clip_name(Path::new(input)),
            encoding,
            programs,
            rate,
            frames: stream.nb_frames.as_ref().and_then(|text| text.parse().ok()),
            slot: Arc::default(),
            output: None,
            complaints: None,
        };
        video.rewind()?;
        Ok(video)
    }

    fn version(&self) -> anyhow::Result<String> {
        let answer = start(Command::new(&self.programs.ffmpeg).arg("-version"))?
            .wait_with_output()
            .context("ffmpeg -version")?;
        Ok(String::from_utf8_lossy(&answer.stdout)
            .lines()
            .next()
            .unwrap_or_default()
            .to_owned())
    }

    /// The pass is over: an error if `ffmpeg` failed.
    fn ended(&mut self) -> anyhow::Result<()> {
        self.output = None;
        let (status, stopped) = {
            let mut slot = self.slot.lock();
            let status = slot.child.take().map(|mut child| child.wait());
            (status, slot.stopped)
        };
        let complaints = self.complaints.take().and_then(|thread| thread.join().ok());
        match status {
            Some(Ok(status)) if !status.success() && !stopped => bail!(
                "{}: ffmpeg failed ({status}): {}",
                self.input,
                complaints.unwrap_or_default()
            ),
            Some(Err(error)) => bail!("{}: ffmpeg is lost: {error}", self.input),
            _ => Ok(()),
        }
    }
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

    fn next(&mut self) -> anyhow::Result<Option<EncodedPicture>> {
        let Some(output) = &mut self.output else {
            return Ok(None);
        };
        let file = match self.encoding {
            VideoEncoding::Jpeg => read_part(output),
            VideoEncoding::Png => read_png(output),
        };
        match file {
            Ok(Some(file)) => {
                let raw = RawSample {
                    payload: Bytes::from(file),
                    encoding: "",
                    attachment: None,
                    timestamp_ns: None,
                    arrival: 0,
                    received: Instant::now(),
                };
                read_frame(raw, PayloadFormat::Encoding, &FrameLimits::default())
                    .map(|frame| Some(frame.picture))
                    .with_context(|| format!("{}: a frame cannot be sent", self.input))
            }
            Ok(None) => self.ended().map(|()| None),
            Err(error) => {
                // A failed ffmpeg explains a cut stream better than the cut does.
                self.ended()?;
                if self.slot.lock().stopped {
                    return Ok(None);
                }
                Err(error).with_context(|| format!("{}: ffmpeg's output is cut", self.input))
            }
        }
    }

    fn rewind(&mut self) -> anyhow::Result<()> {
        let passthrough = passthrough_option(&self.version()?);
        let codec: &[&str] = match self.encoding {
            VideoEncoding::Jpeg => &["-c:v", "mjpeg", "-q:v", "2", "-f", "mpjpeg"],
            VideoEncoding::Png => &["-c:v", "png", "-f", "image2pipe"],
        };
        let mut slot = self.slot.lock();
        slot.kill();
        if slot.stopped {
            return Ok(());
        }
        let mut child = start(
            Command::new(&self.programs.ffmpeg)
                .args([
                    "-nostdin",
                    "-v",
                    "error",
                    "-i",
                    &self.input,
                    "-map",
                    "0:v:0",
                ])
                .args([passthrough, "passthrough"])
                .args(codec)
                .arg("pipe:1"),
        )?;
        self.output = child
            .stdout
            .take()
            .map(|stdout| BufReader::with_capacity(1 << 18, stdout));
        self.complaints = child.stderr.take().map(collect);
        slot.child = Some(child);
        Ok(())
    }

    fn stopper(&self) -> Option<Stopper> {
        let slot = Arc::clone(&self.slot);
        Some(Box::new(move || {
            let mut slot = slot.lock();
            slot.stopped = true;
            slot.kill();
        }))
    }
}

impl Drop for Video {
    fn drop(&mut self) {
        self.slot.lock().kill();
    }
}

/// The next part of ffmpeg's `mpjpeg` stream (multipart with a `Content-length` in every part's head);
/// `None` at its end.
fn read_part(stream: &mut impl BufRead) -> anyhow::Result<Option<Vec<u8>>> {
    let mut length = None;
    let mut line = String::new();
    loop {
        line.clear();
        if stream.by_ref().take(1024).read_line(&mut line)? == 0 {
            return if length.is_none() {
                Ok(None)
            } else {
                Err(anyhow!("it ends inside a head"))
            };
        }
        let text = line.trim();
        if let Some((name, value)) = text.split_once(':')
            && name.eq_ignore_ascii_case("content-length")
        {
            length = Some(value.trim().parse::<u64>().context("Content-length")?);
        }
        if text.is_empty()
            && let Some(length) = length
        {
            return read_exactly(stream, length).map(Some);
        }
    }
}

/// The next PNG file of a row of them; `None` at the end.
fn read_png(stream: &mut impl BufRead) -> anyhow::Result<Option<Vec<u8>>> {
    if stream.fill_buf()?.is_empty() {
        return Ok(None);
    }
    let mut file = read_exactly(stream, 8)?;
    loop {
        let head = read_exactly(stream, 8)?;
        let [a, b, c, d, kind @ ..] = head.as_slice() else {
            bail!("a PNG chunk has no head");
        };
        let length = u64::from(u32::from_be_bytes([*a, *b, *c, *d]));
        let last = kind == b"IEND";
        file.extend_from_slice(&head);
        // The content and its checksum.
        file.extend_from_slice(&read_exactly(stream, length + 4)?);
        if last {
            return Ok(Some(file));
        }
    }
}

fn read_exactly(stream: &mut impl BufRead, length: u64) -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    stream.by_ref().take(length).read_to_end(&mut bytes)?;
    if bytes.len() as u64 != length {
        bail!("it ends {} bytes early", length - bytes.len() as u64);
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_option_for_every_frame_fits_the_version() {
        for (version, option) in [
            ("ffmpeg version 4.4.2-0ubuntu0.22.04.1 Copyright", "-vsync"),
            ("ffmpeg version 5.0", "-vsync"),
            ("ffmpeg version 5.1.9-0+deb12u1 Copyright", "-fps_mode"),
            ("ffmpeg version n7.1", "-fps_mode"),
            ("ffmpeg version N-118000-gabc", "-fps_mode"),
        ] {
            assert_eq!(passthrough_option(version), option, "{version}");
        }
    }

    #[test]
    fn a_rate_is_a_fraction_that_makes_sense() {
        assert_eq!(rate("25/1"), Some(25.0));
        assert_eq!(rate("30000/1001"), Some(30000.0 / 1001.0));
        for text in ["0/0", "90000/1", "x", "-5/1", ""] {
            assert_eq!(rate(text), None, "{text}");
        }
    }

    #[test]
    fn parts_are_cut_where_their_heads_say() {
        let stream = b"--ffmpeg\r\nContent-type: image/jpeg\r\nContent-length: 5\r\n\r\nab\r\nc\r\n\
                       --ffmpeg\r\nContent-type: image/jpeg\r\nContent-length: 1\r\n\r\nd\r\n--ffmpeg\r\n";
        let mut reader = &stream[..];
        assert_eq!(read_part(&mut reader).unwrap().unwrap(), b"ab\r\nc");
        assert_eq!(read_part(&mut reader).unwrap().unwrap(), b"d");
        assert_eq!(read_part(&mut reader).unwrap(), None);
        let mut cut = &stream[..60];
        assert!(read_part(&mut cut).is_err());
    }
}
