//! A source that is reopened whenever it ends, fails or falls silent, with growing pauses, until it is stopped.

use super::address::SourceKind;
use super::program::{PictureProgram, RunningProgram, output_of};
use super::templates::{FFMPEG, GSTREAMER, SourceSettings, Version, ffmpeg, gstreamer, version};
use albireo_vision::picture::{EncodedPicture, FrameFault, picture_of_file, read_part, read_ppm};
use bytes::Bytes;
use std::io::BufReader;
use std::path::Path;
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::task::JoinError;
use tokio::time::{Instant, sleep};
use tokio_util::sync::CancellationToken;

/// The pause before reopening a source; doubles up to the longest while the source does not stay open.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
const LONGEST_PAUSE: Duration = Duration::from_secs(30);
/// After a source was open for this long, its pauses start short again.
const STAYED: Duration = Duration::from_secs(10);
/// The longest silence that can be configured.
const LONGEST_SILENCE: Duration = Duration::from_secs(86_400);
/// Motion JPEG is given up once this many first parts are all something else.
const FIRST_PARTS: u32 = 3;
/// The size of a read from a program's output, bytes.
const BUFFER: usize = 1 << 18;

const INSTALL_FFMPEG: &str =
    "Install it with `apt-get install ffmpeg`, `dnf install ffmpeg` or `brew install ffmpeg`";
const INSTALL_GSTREAMER: &str =
    "Install it with `apt-get install gstreamer1.0-tools gstreamer1.0-plugins-good`";

/// An event of a source.
#[derive(Debug)]
pub enum SourceEvent {
    /// A picture arrived.
    Picture {
        /// The picture, or the fault of an unusable one.
        picture: Result<EncodedPicture, FrameFault>,
        /// True for the first since the source was opened.
        reopened: bool,
    },
    /// The source ended.
    Failed {
        /// Why it ended.
        reason: String,
        /// The time after which it is opened again.
        pause: Duration,
    },
}

/// A source that is kept open.
#[derive(Clone, Debug)]
pub struct LiveSource {
    settings: SourceSettings,
    /// The version of ffmpeg, which opens it; `None` with GStreamer.
    ffmpeg: Option<Version>,
    /// True while the source is assumed to send motion JPEG, which need not be decoded. ffmpeg must know before it
    /// opens the source.
    motion_jpeg: bool,
    /// True once something that ffmpeg took for motion JPEG was something else.
    not_jpeg: bool,
}

impl LiveSource {
    /// Creates a source and checks that its program exists and its address is complete.
    ///
    /// # Errors
    /// What is missing.
    pub fn find(mut settings: SourceSettings) -> Result<Self, String> {
        // Time for several frames at least.
        let frames = settings.max_rate.map_or(0.0, |rate| 3.0 / rate);
        let frames = Duration::try_from_secs_f64(frames).unwrap_or(LONGEST_SILENCE);
        settings.silence = settings.silence.max(frames).min(LONGEST_SILENCE);
        let name = settings.address.to_string();
        let resolved = settings.address.resolved()?;
        let path = resolved.text().trim_start_matches("file://");
        if resolved.kind == SourceKind::File && !Path::new(path).exists() {
            return Err(format!("{name}: no such file"));
        }
        let is_pipeline = resolved.kind == SourceKind::Pipeline;
        let found = match is_pipeline {
            true => None,
            false => output_of(FFMPEG, "-version")?,
        };
        if found.is_none() && output_of(GSTREAMER, "--version")?.is_none() {
            let (programs, remedy) = match is_pipeline {
                true => ("no `gst-launch-1.0`", INSTALL_GSTREAMER),
                false => ("neither `ffmpeg` nor `gst-launch-1.0`", INSTALL_FFMPEG),
            };
            return Err(format!("{name}: {programs} was found. {remedy}"));
        }
        let motion_jpeg = match &resolved.kind {
            SourceKind::Network(scheme) => scheme.starts_with("http"),
            kind => *kind == SourceKind::Device,
        };
        let source = Self {
            settings,
            ffmpeg: found.as_deref().map(version),
            motion_jpeg,
            not_jpeg: false,
        };
        let program = source.program()?;
        if program.input.is_none() && !program.secrets.is_empty() {
            tracing::warn!(
                source = name,
                program = program.program,
                "this program accepts credentials only on its command line, where every user of this machine can read \
                 them"
            );
        }
        Ok(source)
    }

    /// The source, without credentials.
    pub fn name(&self) -> String {
        self.settings.address.to_string()
    }

    fn program(&self) -> Result<PictureProgram, String> {
        match self.ffmpeg {
            Some(version) => ffmpeg(&self.settings, self.motion_jpeg, version),
            None => gstreamer(&self.settings),
        }
    }

    /// Keeps the source open until `shutdown`, and calls `each` for each of its events. That is on the reading thread,
    /// so the source waits while `each` works.
    ///
    /// # Errors
    /// An error if the reading thread fails.
    pub async fn run(
        self,
        each: impl FnMut(SourceEvent) + Send + 'static,
        shutdown: CancellationToken,
    ) -> Result<(), JoinError> {
        tokio::task::spawn_blocking(move || self.keep_open(each, &shutdown)).await
    }

    fn keep_open(mut self, mut each: impl FnMut(SourceEvent), shutdown: &CancellationToken) {
        let mut pause = FIRST_PAUSE;
        loop {
            let begun = Instant::now();
            let read = self.read(&mut each, shutdown.clone());
            if shutdown.is_cancelled() {
                return;
            }
            if begun.elapsed() > STAYED {
                pause = FIRST_PAUSE;
            }
            let reason = match read {
                Err(reason) => Some(reason),
                Ok(()) => (pause > FIRST_PAUSE)
                    .then(|| "it alternates between motion JPEG and another codec".to_owned()),
            };
            if let Some(reason) = reason {
                each(SourceEvent::Failed { reason, pause });
            }
            let waited = shutdown.run_until_cancelled(sleep(pause));
            if Handle::current().block_on(waited).is_none() {
                return;
            }
            pause = (pause * 2).min(LONGEST_PAUSE);
        }
    }

    /// Opens the source once and reads to its end; returns without an error if it must be read the other way.
    ///
    /// # Errors
    /// The reason it failed.
    fn read(
        &mut self,
        each: &mut dyn FnMut(SourceEvent),
        stop: CancellationToken,
    ) -> Result<(), String> {
        let program = self.program()?;
        let (name, ppm) = (program.program, program.ppm);
        let running = (program.start(self.settings.silence, stop))
            .map_err(|error| format!("`{name}` cannot be started: {error}"))?;
        let mut output = BufReader::with_capacity(BUFFER, running);
        let mut pictures = 0;
        let cut = self.pictures(&mut output, ppm, each, &mut pictures);
        let running = output.get_mut();
        let reason = match cut {
            None => running.end().err().unwrap_or_else(|| "it ended".to_owned()),
            Some(cut) => match running.abort() {
                Some(message) => format!("{cut}; {name} said: {message}"),
                None => cut,
            },
        };
        let switches = pictures == 0 && self.switches(running.codec());
        // A device without motion JPEG cannot be opened for it.
        let is_device = self.settings.address.kind() == SourceKind::Device && self.ffmpeg.is_some();
        if switches || (is_device && pictures == 0) {
            self.motion_jpeg = !self.motion_jpeg;
        }
        match switches {
            true => Ok(()),
            false => Err(reason),
        }
    }

    /// Passes pictures on until there are no more. Returns the reason the output is not read further, if it has not
    /// ended.
    fn pictures(
        &mut self,
        output: &mut BufReader<RunningProgram>,
        ppm: bool,
        each: &mut dyn FnMut(SourceEvent),
        pictures: &mut u64,
    ) -> Option<String> {
        let begun = Instant::now();
        let limits = self.settings.limits;
        // ffmpeg applies the limit itself when it decodes.
        let limit = (self.settings.max_rate).filter(|_| self.motion_jpeg || self.ffmpeg.is_none());
        let mut last_slot = None;
        let mut bad_parts = 0;
        loop {
            let read = match ppm {
                true => read_ppm(output, &limits),
                false => read_part(output, limits.max_payload_bytes as u64)
                    .map(|part| part.map(|part| picture_of_file(Bytes::from(part), &limits))),
            };
            let picture = match read {
                Ok(picture) => picture?,
                Err(error) => return Some(error.to_string()),
            };
            let first = *pictures == 0;
            if first && picture.is_err() && self.motion_jpeg {
                bad_parts += 1;
                self.not_jpeg |= bad_parts == FIRST_PARTS;
            }
            if first && self.switches(output.get_ref().codec()) {
                return Some("it is read the other way".to_owned());
            }
            // The first picture of each time slot: on average exactly the limit, at any rate of the camera.
            let slot = limit.map(|rate| (begun.elapsed().as_secs_f64() * rate) as u64);
            if slot.is_none() || last_slot != slot {
                last_slot = slot;
                if let Ok(picture) = &picture {
                    if first {
                        tracing::info!(
                            source = self.name(),
                            codec = output.get_ref().codec(),
                            size = picture.size.to_string(),
                            "the source is open"
                        );
                    }
                    *pictures += 1;
                }
                each(SourceEvent::Picture {
                    picture,
                    reopened: first,
                });
            }
            output.get_mut().picture_taken();
        }
    }

    /// True if the source must be read the other way: something that was taken for motion JPEG is none, or ffmpeg
    /// reports a codec for the other way.
    fn switches(&self, codec: Option<&str>) -> bool {
        let is_jpeg = match self.not_jpeg {
            true => Some(false),
            false => codec.map(|codec| codec == "mjpeg"),
        };
        self.ffmpeg.is_some()
            && self.settings.address.kind() != SourceKind::File
            && is_jpeg.is_some_and(|is_jpeg| is_jpeg != self.motion_jpeg)
    }
}
