//! Looks into a video file: its length and frame rate, when it was made, and whether it is whole.

use super::kind::FileKind;
use jiff::Timestamp;
use serde::Deserialize;
use std::fs::File;
use std::io::{self, ErrorKind, Read, Seek, SeekFrom};
use std::path::{Component, Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

/// Cameras without a clock write years before this one.
const FIRST_YEAR: &str = "2000-01-01T00:00:00Z";
/// The most boxes of an MP4 file that are looked at: a file of fragments has two a second.
const MOST_BOXES: usize = 100_000;

const NO_INDEX: &str = "it has no index (moov atom), as a power cut leaves a recording";

/// What is known of a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct VideoFacts {
    pub length: Duration,
    /// Its `creation_time`, nanoseconds since the Unix epoch.
    pub created_ns: Option<u64>,
    /// Its frames per second, if it says them.
    pub rate: Option<f64>,
}

#[derive(Deserialize)]
struct FfprobeAnswer {
    #[serde(default)]
    streams: Vec<ProbedStream>,
    #[serde(default)]
    format: ProbedFormat,
}

#[derive(Deserialize)]
struct ProbedStream {
    avg_frame_rate: Option<String>,
    r_frame_rate: Option<String>,
}

#[derive(Default, Deserialize)]
struct ProbedFormat {
    duration: Option<String>,
    #[serde(default)]
    tags: ProbedTags,
}

#[derive(Default, Deserialize)]
struct ProbedTags {
    creation_time: Option<String>,
}

/// Checks that a file is a video, and whole.
///
/// # Errors
/// What it is instead and what to do, or what it lacks.
pub fn check_is_video(path: &Path) -> Result<(), String> {
    match FileKind::of(path) {
        Some(other) => Err(other.remedy().to_owned()),
        None => check_is_whole(path),
    }
}

/// Looks into a file with the program `ffprobe`.
///
/// # Errors
/// Why it cannot be played.
pub(super) fn probe(path: &Path, ffprobe: &Path) -> Result<VideoFacts, String> {
    check_is_video(path)?;
    let mut command = Command::new(ffprobe);
    command.args(["-v", "error", "-select_streams", "v:0", "-of", "json"]);
    command.args([
        "-show_entries",
        "format=duration:format_tags=creation_time:stream=avg_frame_rate,r_frame_rate",
    ]);
    let file = for_ffmpeg(path);
    command.arg("-i").arg(&file).stdin(Stdio::null());
    let output = command.output().map_err(|error| match error.kind() {
        ErrorKind::NotFound => "no `ffprobe` was found; it comes with ffmpeg".to_owned(),
        _ => format!("`ffprobe` cannot be started: {error}"),
    })?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        if said.contains("moov atom not found") {
            return Err(NO_INDEX.to_owned());
        }
        let last_line = said.lines().last().unwrap_or("it cannot be read");
        let file = file.to_string_lossy();
        return Err(last_line.replace(&format!("{file}: "), ""));
    }
    let answer: FfprobeAnswer = serde_json::from_slice(&output.stdout)
        .map_err(|error| format!("ffprobe's answer cannot be read: {error}"))?;
    let Some(stream) = answer.streams.first() else {
        return Err("it has no video".to_owned());
    };
    let rates = [&stream.avg_frame_rate, &stream.r_frame_rate];
    let rate = rates.into_iter().flatten().find_map(|text| frame_rate(text));
    let seconds = answer.format.duration.and_then(|text| text.parse::<f64>().ok());
    let created = answer.format.tags.creation_time.and_then(|time| created_ns(&time));
    Ok(VideoFacts {
        length: Duration::try_from_secs_f64(seconds.unwrap_or(0.0)).unwrap_or_default(),
        created_ns: created,
        rate,
    })
}

/// Returns a file's name as ffmpeg and ffprobe take it for one: `-a.mp4` would be an option to them, and `12:30.mp4` an
/// address.
pub fn for_ffmpeg(file: &Path) -> PathBuf {
    let first = match file.components().next() {
        Some(Component::Normal(first)) => first.as_encoded_bytes(),
        _ => &[],
    };
    if first.starts_with(b"-") || first.contains(&b':') {
        Path::new(".").join(file)
    } else {
        file.to_owned()
    }
}

/// Reads a frame rate as ffprobe writes it, such as `30000/1001`; `None` if it says that there is none.
pub fn frame_rate(text: &str) -> Option<f64> {
    let (numerator, denominator) = text.split_once('/').unwrap_or((text, "1"));
    let rate = numerator.parse::<f64>().ok()? / denominator.parse::<f64>().ok()?;
    if rate > 0.0 && rate <= 1000.0 {
        Some(rate)
    } else {
        None
    }
}

fn created_ns(time: &str) -> Option<u64> {
    let time: Timestamp = time.parse().ok()?;
    let first: Timestamp = FIRST_YEAR.parse().ok()?;
    if time <= first {
        return None;
    }
    u64::try_from(time.as_nanosecond()).ok()
}

/// Checks that a file is not empty, and that an MP4 file has its index and all its pictures; of what else is in it nothing
/// is needed. One that is made of fragments plays to where it is cut.
///
/// # Errors
/// What is missing.
pub fn check_is_whole(path: &Path) -> Result<(), String> {
    let mut file = File::open(path).map_err(|error| error.to_string())?;
    let length = file.metadata().map_err(|error| error.to_string())?.len();
    if length == 0 {
        return Err("it is empty, as a power cut leaves a recording".to_owned());
    }
    let boxes = mp4_boxes(&mut file).map_err(|error| error.to_string())?;
    let has = |wanted: &[u8; 4]| boxes.iter().any(|found| found.kind == *wanted);
    if !has(b"ftyp") {
        return Ok(());
    }
    if !has(b"moov") {
        return Err(NO_INDEX.to_owned());
    }
    if has(b"moof") {
        return Ok(());
    }
    if !has(b"mdat") {
        return Err("it is cut short: its index is there, and no picture".to_owned());
    }
    let is_needed = |found: &&Mp4Box| matches!(&found.kind, b"moov" | b"mdat");
    let end = boxes.iter().filter(is_needed).map(|found| found.end).max().unwrap_or(0);
    if end > length {
        return Err(format!(
            "it is cut short: {length} of {end} bytes are there"
        ));
    }
    Ok(())
}

/// A box of an MP4 file (ISO 14496-12, 4.2).
struct Mp4Box {
    kind: [u8; 4],
    /// The place in the file behind its last byte.
    end: u64,
}

/// The outermost boxes of an MP4 file; nothing of another file.
fn mp4_boxes(file: &mut File) -> io::Result<Vec<Mp4Box>> {
    let length = file.metadata()?.len();
    let mut boxes = Vec::new();
    let mut at = 0;
    while boxes.len() < MOST_BOXES {
        file.seek(SeekFrom::Start(at))?;
        let mut head = Vec::with_capacity(16);
        file.by_ref().take(16).read_to_end(&mut head)?;
        let Some((size, behind)) = head.split_first_chunk::<4>() else {
            break;
        };
        let Some((kind, behind)) = behind.split_first_chunk::<4>() else {
            break;
        };
        let size = match u32::from_be_bytes(*size) {
            // To the end of the file.
            0 => length.saturating_sub(at),
            // The size follows in eight bytes.
            1 => {
                let Some(long) = behind.first_chunk::<8>() else {
                    break;
                };
                u64::from_be_bytes(*long)
            }
            short => u64::from(short),
        };
        let is_first = boxes.is_empty();
        if size < 8 || (is_first && kind != b"ftyp") {
            break;
        }
        at = at.saturating_add(size);
        boxes.push(Mp4Box {
            kind: *kind,
            end: at,
        });
    }
    Ok(boxes)
}
