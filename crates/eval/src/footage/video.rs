//! A video file as a source of frames, decoded by the `ffmpeg` program; or an address, which is opened once.

use super::error::FootageError;
use super::source::{FrameSource, Stopper, clip_name};
use albireo_node::input::source::{
    FfmpegInput, Handover, Running, SourceAddress, SourceKind, Stop, read_part, read_png,
};
use albireo_vision::picture::{EncodedPicture, FrameLimits, picture_of_file};
use bytes::Bytes;
use parking_lot::Mutex;
use serde::Deserialize;
use std::path::Path;
use std::sync::Arc;

pub use albireo_node::input::source::Ffmpeg;

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

/// Frames a second that are assumed of a live source, which tells its rate only by its frames.
const LIVE_RATE: f64 = 25.0;

/// A video. Its `ffmpeg` ends with it.
#[derive(Debug)]
pub struct Video {
    address: SourceAddress,
    name: String,
    encoding: VideoEncoding,
    programs: Ffmpeg,
    rate: f64,
    /// Frames per second at most, of a live source.
    most: Option<f64>,
    is_live: bool,
    frames: Option<u64>,
    running: Option<Running>,
    stopping: Arc<Mutex<Stopping>>,
}

/// How to end it from another thread.
#[derive(Debug, Default)]
struct Stopping {
    stop: Option<Stop>,
    stopped: bool,
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

impl Video {
    /// Probes and opens a video file; or opens an address or a device, which may have but one client, without probing it.
    /// `wanted_rate` is for files that have no rate of their own, and the most frames per second of a live source.
    ///
    /// # Errors
    /// When a program is not installed or finds no video stream.
    pub fn open(
        input: &str,
        wanted_rate: Option<f64>,
        encoding: VideoEncoding,
        programs: Ffmpeg,
    ) -> Result<Self, FootageError> {
        let address = SourceAddress::new(input);
        let is_live = match address.kind() {
            SourceKind::File => false,
            SourceKind::Network(_) | SourceKind::Device => true,
            SourceKind::Pipeline => return Err(FootageError::Pipeline),
        };
        let (rate, frames) = if is_live {
            (wanted_rate.unwrap_or(LIVE_RATE), None)
        } else {
            probed(input, wanted_rate, &programs)?
        };
        let name = if is_live {
            "live".to_owned()
        } else {
            clip_name(Path::new(input))
        };
        let mut video = Self {
            address,
            name,
            encoding,
            programs,
            rate,
            most: wanted_rate.filter(|_| is_live),
            is_live,
            frames,
            running: None,
            stopping: Arc::default(),
        };
        video.rewind()?;
        Ok(video)
    }

    /// The pass is over: an error if `ffmpeg` failed.
    fn ended(&mut self) -> Result<(), FootageError> {
        match self.running.take().map(Running::ended) {
            Some(Err(reason)) => Err(FootageError::Failed {
                input: self.address.to_string(),
                reason: reason.to_string(),
            }),
            _ => Ok(()),
        }
    }
}

/// Rate and number of the frames of a file.
fn probed(
    input: &str,
    fallback: Option<f64>,
    programs: &Ffmpeg,
) -> Result<(f64, Option<u64>), FootageError> {
    let said = programs.probe(&PROBE, input)?;
    let probed: Probed = serde_json::from_slice(&said).map_err(|source| FootageError::Probe {
        input: input.to_owned(),
        source,
    })?;
    let Some(stream) = probed.streams.first() else {
        return Err(FootageError::NoVideo(input.to_owned()));
    };
    let rate = [&stream.avg_frame_rate, &stream.r_frame_rate]
        .into_iter()
        .flatten()
        .find_map(|text| rate(text))
        .or(fallback)
        .ok_or_else(|| FootageError::NoRate(input.to_owned()))?;
    let frames = stream.nb_frames.as_ref().and_then(|text| text.parse().ok());
    Ok((rate, frames))
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

    fn is_live(&self) -> bool {
        self.is_live
    }

    fn next(&mut self) -> Result<Option<EncodedPicture>, FootageError> {
        let Some(running) = &mut self.running else {
            return Ok(None);
        };
        let file = match self.encoding {
            VideoEncoding::Jpeg => read_part(running.output(), MOST_BYTES),
            VideoEncoding::Png => read_png(running.output(), MOST_BYTES),
        };
        match file {
            Ok(Some(file)) => picture_of_file(Bytes::from(file), &FrameLimits::default())
                .map(Some)
                .map_err(|source| FootageError::Frame {
                    input: self.address.to_string(),
                    source,
                }),
            Ok(None) => self.ended().map(|()| None),
            Err(source) => {
                // A failed ffmpeg explains a cut stream better than the cut does.
                self.ended()?;
                if self.stopping.lock().stopped {
                    return Ok(None);
                }
                Err(FootageError::Cut {
                    input: self.address.to_string(),
                    source,
                })
            }
        }
    }

    fn rewind(&mut self) -> Result<(), FootageError> {
        self.running = None;
        let mut stopping = self.stopping.lock();
        if stopping.stopped {
            return Ok(());
        }
        let handover = match self.encoding {
            VideoEncoding::Jpeg => Handover::Jpeg(2),
            VideoEncoding::Png => Handover::Png,
        };
        let input = FfmpegInput {
            max_rate: self.most,
            ..FfmpegInput::new(&self.address)
        };
        let running = self.programs.open(&input, handover)?;
        stopping.stop = Some(running.stop());
        self.running = Some(running);
        Ok(())
    }

    fn stopper(&self) -> Option<Stopper> {
        let stopping = Arc::clone(&self.stopping);
        Some(Box::new(move || {
            let mut stopping = stopping.lock();
            stopping.stopped = true;
            if let Some(stop) = &stopping.stop {
                stop.stop();
            }
        }))
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
}
