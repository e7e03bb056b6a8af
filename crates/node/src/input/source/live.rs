//! A source that is reopened whenever it ends, fails or falls silent, with growing pauses, until it is stopped.

use super::address::{SourceAddress, SourceKind};
use super::program::{PictureProgram, RunningProgram, output_of};
use super::templates::{FFMPEG, GSTREAMER, SourceSettings, Version, ffmpeg, gstreamer, version};
use albireo_vision::picture::{EncodedPicture, FrameFault, picture_of_file, read_part, read_ppm};
use bytes::Bytes;
use std::io::BufReader;
use std::path::Path;
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::task::JoinError;
use tokio::time::{Instant, timeout};
use tokio_util::sync::CancellationToken;
use url::Url;

/// The pause before reopening a source; doubles up to the longest while the source does not stay open.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
const LONGEST_PAUSE: Duration = Duration::from_secs(30);
/// After a source was open for this long, its pauses start short again.
const STAYED: Duration = Duration::from_secs(10);
/// The longest silence that can be configured.
const LONGEST_SILENCE: Duration = Duration::from_secs(86_400);
/// The time limit for reaching a silent camera, to report the cause.
const CONNECT_LIMIT: Duration = Duration::from_secs(3);
/// Motion JPEG is given up once this many first parts are all something else.
const FIRST_PARTS: u32 = 3;
/// The size of a read from a program's output, bytes.
const BUFFER: usize = 1 << 18;

/// Suffixes of HTTP addresses that do not serve motion JPEG.
const CONTAINERS: [&str; 8] = [
    ".m3u8", ".mpd", ".mp4", ".ts", ".mkv", ".webm", ".flv", ".mov",
];

const INSTALL_FFMPEG: &str =
    "Install it with `apt-get install ffmpeg`, `dnf install ffmpeg` or `brew install ffmpeg`";
const INSTALL_GSTREAMER: &str =
    "Install it with `apt-get install gstreamer1.0-tools gstreamer1.0-plugins-good`";

/// Receives the pictures. It is called on the reading thread, so the source waits while it works.
pub trait SourceSink: Send + 'static {
    /// Called with a picture, or the fault of an unusable one. `reopened` is true for the first since the source was
    /// opened.
    fn picture(&mut self, picture: Result<EncodedPicture, FrameFault>, reopened: bool);

    /// Called when the source ended for this reason; it is reopened after the pause.
    fn fails(&mut self, _reason: &str, _pause: Duration) {}
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
            SourceKind::Network(scheme) if scheme.starts_with("http") => {
                let path = path.split('?').next().unwrap_or_default();
                !CONTAINERS.iter().any(|end| path.ends_with(end))
            }
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

    /// Keeps the source open and passes its pictures to `sink` until `shutdown`.
    ///
    /// # Errors
    /// An error if the reading thread fails.
    pub async fn run<S: SourceSink>(
        mut self,
        mut sink: S,
        shutdown: CancellationToken,
    ) -> Result<(), JoinError> {
        let mut pause = FIRST_PAUSE;
        loop {
            let begun = Instant::now();
            let stop = shutdown.clone();
            let reading = tokio::task::spawn_blocking(move || {
                let failed = self.read(&mut sink, stop);
                (self, sink, failed)
            });
            let failed;
            (self, sink, failed) = reading.await?;
            if shutdown.is_cancelled() {
                return Ok(());
            }
            if begun.elapsed() > STAYED {
                pause = FIRST_PAUSE;
            }
            let reason = match failed {
                Some(reason) => tokio::select! {
                    () = shutdown.cancelled() => return Ok(()),
                    unreachable = self.unreachable() => Some(unreachable.unwrap_or(reason)),
                },
                None => (pause > FIRST_PAUSE)
                    .then(|| "it alternates between motion JPEG and another codec".to_owned()),
            };
            if let Some(reason) = reason {
                sink.fails(&reason, pause);
            }
            tokio::select! {
                () = shutdown.cancelled() => return Ok(()),
                () = tokio::time::sleep(pause) => {}
            }
            pause = (pause * 2).min(LONGEST_PAUSE);
        }
    }

    /// Returns the reason a network camera cannot be reached, which is clearer than the program's own message.
    async fn unreachable(&self) -> Option<String> {
        let resolved = self.settings.address.resolved().ok()?;
        let SourceKind::Network(scheme) = &resolved.kind else {
            return None;
        };
        // Shown without the login, which need not be encoded as in an address.
        let shown = SourceAddress::new(resolved.text()).to_string();
        let url = Url::parse(&shown).ok()?;
        let host = url.host_str()?.trim_matches(['[', ']']);
        let port = url.port_or_known_default().or(match scheme.as_str() {
            "rtsp" => Some(554),
            "rtsps" => Some(322),
            "rtmp" => Some(1935),
            _ => None,
        })?;
        if ["srt", "udp", "rtp"].contains(&scheme.as_str()) {
            return None; // These do not connect by TCP.
        }
        let reason = match timeout(CONNECT_LIMIT, TcpStream::connect((host, port))).await {
            Ok(Ok(_)) => return None,
            Ok(Err(error)) => error.to_string(),
            Err(_) => format!("no answer in {} s", CONNECT_LIMIT.as_secs()),
        };
        Some(format!("{host}:{port} cannot be reached: {reason}"))
    }

    /// Opens the source once and reads to its end. Returns the reason it failed; `None` if it must be read the other
    /// way.
    fn read(&mut self, sink: &mut dyn SourceSink, stop: CancellationToken) -> Option<String> {
        let program = match self.program() {
            Ok(program) => program,
            Err(error) => return Some(error),
        };
        let (name, ppm) = (program.program, program.ppm);
        let running = match program.start(self.settings.silence, stop) {
            Ok(running) => running,
            Err(error) => return Some(format!("`{name}` cannot be started: {error}")),
        };
        let mut output = BufReader::with_capacity(BUFFER, running);
        let mut pictures = 0;
        let cut = self.pictures(&mut output, ppm, sink, &mut pictures);
        let running = output.get_mut();
        let mut reason = match cut {
            Ok(true) => None,
            Ok(false) => Some(running.end().err().unwrap_or_else(|| "it ended".to_owned())),
            Err(error) => Some(match running.abort() {
                Some(message) => format!("{error}; {name} said: {message}"),
                None => error,
            }),
        };
        if pictures == 0 && self.switches(running.codec()) {
            reason = None;
        }
        // A device without motion JPEG cannot be opened for it.
        let is_device = self.settings.address.kind() == SourceKind::Device && self.ffmpeg.is_some();
        if reason.is_none() || (is_device && pictures == 0) {
            self.motion_jpeg = !self.motion_jpeg;
        }
        reason
    }

    /// Passes pictures on until there are no more. Returns true if the source turns out to need the other way of reading.
    ///
    /// # Errors
    /// The reason the output cannot be read further.
    fn pictures(
        &mut self,
        output: &mut BufReader<RunningProgram>,
        ppm: bool,
        sink: &mut dyn SourceSink,
        pictures: &mut u64,
    ) -> Result<bool, String> {
        let begun = Instant::now();
        let limits = self.settings.limits;
        // ffmpeg applies the limit itself when it decodes.
        let limit = (self.settings.max_rate).filter(|_| self.motion_jpeg || self.ffmpeg.is_none());
        let mut last_slot = None;
        let mut bad_parts = 0;
        loop {
            let picture = if ppm {
                read_ppm(output, &limits).map_err(|error| error.to_string())?
            } else {
                let part = read_part(output, limits.max_payload_bytes as u64);
                let part = part.map_err(|error| error.to_string())?;
                part.map(|part| picture_of_file(Bytes::from(part), &limits))
            };
            let Some(picture) = picture else {
                return Ok(false);
            };
            if *pictures == 0 && self.switches(output.get_ref().codec()) {
                return Ok(true);
            }
            if self.motion_jpeg && *pictures == 0 && picture.is_err() {
                bad_parts += 1;
                if bad_parts == FIRST_PARTS {
                    self.not_jpeg = true;
                    return Ok(true);
                }
            }
            // The first picture of each time slot: on average exactly the limit, at any rate of the camera.
            let slot = limit.map(|rate| (begun.elapsed().as_secs_f64() * rate) as u64);
            if slot.is_none() || last_slot != slot {
                last_slot = slot;
                let first = *pictures == 0;
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
                sink.picture(picture, first);
            }
            output.get_mut().picture_taken();
        }
    }

    /// True if the codec that ffmpeg reports requires the other way of reading.
    fn switches(&self, codec: Option<&str>) -> bool {
        let is_jpeg = codec.map(|codec| codec == "mjpeg");
        self.ffmpeg.is_some()
            && self.settings.address.kind() != SourceKind::File
            && is_jpeg.is_some_and(|is_jpeg| is_jpeg != self.motion_jpeg)
            && (self.motion_jpeg || !self.not_jpeg)
    }
}
