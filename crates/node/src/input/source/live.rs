//! A source that is opened again whenever it ends, fails or falls silent, with growing pauses, until it is told to stop.

use super::address::{SourceAddress, SourceKind};
use super::ffmpeg::{Ffmpeg, FfmpegInput, Handover, RtspTransport};
use super::gstreamer;
use super::limit::RateSlots;
use super::program::{INSTALL_FFMPEG, Running, SourceError, Stop};
use albireo_vision::picture::{
    CutError, EncodedPicture, FrameFault, FrameLimits, picture_of_file, read_part, read_ppm,
};
use bytes::Bytes;
use parking_lot::Mutex;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;

/// Pause before a source is opened again; doubles up to the longest while it does not stay open.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
const LONGEST_PAUSE: Duration = Duration::from_secs(30);

/// A source that was open so long ends for another reason than the time before.
const STAYED: Duration = Duration::from_secs(10);

/// Ends of HTTP addresses behind which there is no motion JPEG.
const CONTAINERS: [&str; 8] = [
    ".m3u8", ".mpd", ".mp4", ".ts", ".mkv", ".webm", ".flv", ".mov",
];

/// What is to be opened, and how.
#[derive(Clone, Debug)]
pub struct SourceSettings {
    /// The source.
    pub address: SourceAddress,
    /// Frames per second at most.
    pub max_rate: Option<f64>,
    /// How RTSP packets come.
    pub transport: RtspTransport,
    /// Acceleration or decoder of ffmpeg.
    pub hardware: Option<String>,
    /// Options of ffmpeg, put before the source.
    pub options: Vec<String>,
    /// A source without a picture for so long is opened anew.
    pub silence: Duration,
    /// What pictures are handed over as where they must be decoded.
    pub decoded: Handover,
    /// Limits of the pictures.
    pub limits: FrameLimits,
}

/// Who takes the pictures. Called on the thread that reads: while it is at work the source waits.
pub trait SourceSink: Send + 'static {
    /// A picture, or one that cannot be used. `anew`: the first since the source was opened.
    fn picture(&mut self, picture: Result<EncodedPicture, FrameFault>, anew: bool);

    /// Pictures come.
    fn works(&mut self) {}

    /// The source ended, and will be opened again.
    fn fails(&mut self, _reason: &str) {}
}

/// Which program opens it.
#[derive(Clone, Debug)]
enum Opener {
    Ffmpeg(Ffmpeg),
    GStreamer,
}

/// A source that is kept open.
#[derive(Debug)]
pub struct LiveSource {
    settings: SourceSettings,
    opener: Opener,
    /// Whether it is believed to send motion JPEG, which need not be decoded: ffmpeg must be told before it sees.
    motion_jpeg: AtomicBool,
}

/// How one opening ended.
enum End {
    /// By itself.
    Ended,
    /// For this reason.
    Failed(String),
    /// It is to be read in the other way.
    Otherwise,
}

/// One opening as seen from outside.
#[derive(Debug)]
struct Watch {
    state: Mutex<WatchState>,
}

#[derive(Debug)]
struct WatchState {
    /// Since when a picture is waited for; none while one is being taken.
    waiting: Option<Instant>,
    pictures: u64,
    stop: Option<Stop>,
    given_up: Option<String>,
}

impl Watch {
    fn new() -> Self {
        Self {
            state: Mutex::new(WatchState {
                waiting: Some(Instant::now()),
                pictures: 0,
                stop: None,
                given_up: None,
            }),
        }
    }

    /// Ends the opening.
    fn give_up(&self, reason: impl Into<String>) {
        let mut state = self.state.lock();
        state.given_up.get_or_insert(reason.into());
        state.waiting = Some(Instant::now());
        if let Some(stop) = &state.stop {
            stop.stop();
        }
    }

    fn runs(&self, stop: Stop) {
        let mut state = self.state.lock();
        if state.given_up.is_some() {
            stop.stop();
        }
        state.stop = Some(stop);
    }

    fn taking(&self) {
        let mut state = self.state.lock();
        state.waiting = None;
        state.pictures += 1;
    }

    fn taken(&self) {
        self.state.lock().waiting = Some(Instant::now());
    }

    /// When the source counts as silent, unless a picture comes.
    fn silent_at(&self, silence: Duration) -> Instant {
        let state = self.state.lock();
        // Until the first one a connection is made and a whole picture waited for.
        let patience = if state.pictures == 0 {
            2 * silence
        } else {
            silence
        };
        state.waiting.unwrap_or_else(Instant::now) + patience
    }
}

impl LiveSource {
    /// A source that can be opened: its program is there, its address is whole.
    ///
    /// # Errors
    /// What is missing.
    pub fn find(settings: SourceSettings) -> Result<Self, SourceError> {
        let address = &settings.address;
        let resolved = address.resolved()?;
        let kind = &resolved.kind;
        if *kind == SourceKind::File
            && !Path::new(resolved.text().trim_start_matches("file://")).exists()
        {
            return Err(SourceError::NoFile(address.to_string()));
        }
        let ffmpeg = Ffmpeg::default();
        let opener = match kind {
            SourceKind::Pipeline if gstreamer::is_there() => Opener::GStreamer,
            SourceKind::Pipeline => return Err(gstreamer::missing(address)),
            _ => match ffmpeg.version(&address.to_string()) {
                Ok(_) => Opener::Ffmpeg(ffmpeg),
                Err(SourceError::Missing { .. }) if gstreamer::is_there() => {
                    if !resolved.secrets.is_empty() {
                        return Err(SourceError::WouldShow(address.to_string()));
                    }
                    Opener::GStreamer
                }
                Err(SourceError::Missing { source_name, .. }) => {
                    return Err(SourceError::Missing {
                        source_name,
                        programs: "neither `ffmpeg` nor `gst-launch-1.0`",
                        remedy: INSTALL_FFMPEG,
                    });
                }
                Err(error) => return Err(error),
            },
        };
        let motion_jpeg = match kind {
            SourceKind::Network(scheme) if scheme.starts_with("http") => {
                let path = resolved.text().split('?').next().unwrap_or_default();
                !CONTAINERS.iter().any(|end| path.ends_with(end))
            }
            SourceKind::Device => true,
            _ => false,
        };
        if *kind == SourceKind::Pipeline && !resolved.secrets.is_empty() {
            tracing::warn!(
                source = %address,
                "GStreamer takes credentials on its command line only, where every user of this machine can read them; \
                 ffmpeg does not"
            );
        }
        Ok(Self {
            settings,
            opener,
            motion_jpeg: AtomicBool::new(motion_jpeg),
        })
    }

    /// The source, without credentials.
    pub fn name(&self) -> String {
        self.settings.address.to_string()
    }

    /// Keeps the source open and hands its pictures to `sink` until `shutdown`.
    ///
    /// # Errors
    /// When the thread that reads fails.
    pub async fn run<S: SourceSink>(
        self: &Arc<Self>,
        mut sink: S,
        shutdown: CancellationToken,
    ) -> Result<(), String> {
        let mut pause = FIRST_PAUSE;
        loop {
            let begun = Instant::now();
            let end;
            (sink, end) = self.once(sink, &shutdown).await?;
            if shutdown.is_cancelled() {
                return Ok(());
            }
            if begun.elapsed() > STAYED {
                pause = FIRST_PAUSE;
            }
            let reason = match end {
                End::Otherwise => continue,
                End::Ended => "it ended".to_owned(),
                End::Failed(reason) => reason,
            };
            tracing::warn!(
                source = self.name(),
                again_in_s = pause.as_secs_f64(),
                "the source is opened again: {reason}"
            );
            sink.fails(&reason);
            tokio::select! {
                () = shutdown.cancelled() => return Ok(()),
                () = tokio::time::sleep(pause) => {}
            }
            pause = (pause * 2).min(LONGEST_PAUSE);
        }
    }

    /// How long it may be silent: several frames at least.
    fn silence(&self) -> Duration {
        let frames = self.settings.max_rate.map_or(0.0, |rate| 3.0 / rate);
        let frames = Duration::try_from_secs_f64(frames).unwrap_or_default();
        self.settings.silence.max(frames)
    }

    /// Opens it once and watches over it.
    async fn once<S: SourceSink>(
        self: &Arc<Self>,
        mut sink: S,
        shutdown: &CancellationToken,
    ) -> Result<(S, End), String> {
        let watch = Arc::new(Watch::new());
        let (source, watched) = (Arc::clone(self), Arc::clone(&watch));
        let mut reading = tokio::task::spawn_blocking(move || {
            let end = source.read(&watched, &mut sink);
            (sink, end)
        });
        let silence = self.silence();
        let mut stopping = false;
        loop {
            tokio::select! {
                done = &mut reading => return done.map_err(|error| error.to_string()),
                () = shutdown.cancelled(), if !stopping => {
                    stopping = true;
                    watch.give_up("told to stop");
                }
                () = sleep_until(watch.silent_at(silence)), if !stopping => {
                    if Instant::now() >= watch.silent_at(silence) {
                        let seconds = silence.as_secs_f64();
                        watch.give_up(format!("no picture for more than {seconds} s"));
                    }
                }
            }
        }
    }

    /// Opens it and reads to its end.
    fn read(&self, watch: &Watch, sink: &mut dyn SourceSink) -> End {
        let motion_jpeg = self.motion_jpeg.load(Ordering::Relaxed);
        let opened = match &self.opener {
            Opener::Ffmpeg(ffmpeg) => {
                let input = FfmpegInput {
                    transport: self.settings.transport,
                    hardware: self.settings.hardware.as_deref(),
                    options: &self.settings.options,
                    max_rate: self.settings.max_rate,
                    as_camera: true,
                    silence: 2 * self.silence(),
                    ..FfmpegInput::new(&self.settings.address)
                };
                let handover = if motion_jpeg {
                    Handover::Untouched
                } else {
                    self.settings.decoded
                };
                ffmpeg.open(&input, handover)
            }
            Opener::GStreamer => gstreamer::open(&self.settings.address, self.settings.transport),
        };
        let mut running = match opened {
            Ok(running) => running,
            Err(error) => return End::Failed(error.to_string()),
        };
        watch.runs(running.stop());
        let cut = self.pictures(&mut running, motion_jpeg, watch, sink);
        let given_up = watch.state.lock().given_up.clone();
        let pictures = watch.state.lock().pictures;
        let is_ffmpeg = matches!(self.opener, Opener::Ffmpeg(_));
        let codec = running.codec();
        let hint = running.last_complaint();
        if !matches!(cut, Ok(End::Ended)) {
            running.stop().stop();
        }
        let ended = running.ended();
        if let Some(reason) = given_up {
            return match hint {
                Some(hint) => End::Failed(format!("{reason}; it said: {hint}")),
                None => End::Failed(reason),
            };
        }
        let device = self.settings.address.kind() == SourceKind::Device;
        let is_file = self.settings.address.kind() == SourceKind::File;
        if is_ffmpeg
            && !is_file
            && pictures == 0
            && let Some(codec) = codec
            && (codec == "mjpeg") != motion_jpeg
        {
            self.motion_jpeg.store(!motion_jpeg, Ordering::Relaxed);
            return End::Otherwise;
        }
        if is_ffmpeg && device && pictures == 0 {
            // A device that has no motion JPEG refuses to be opened for it.
            self.motion_jpeg.store(!motion_jpeg, Ordering::Relaxed);
        }
        match (cut, ended) {
            (Ok(End::Otherwise), _) => End::Otherwise,
            (_, Err(reason)) => End::Failed(reason),
            (Err(error), Ok(())) => End::Failed(error.to_string()),
            (Ok(end), Ok(())) => end,
        }
    }

    /// Hands on pictures until there are no more.
    fn pictures(
        &self,
        running: &mut Running,
        motion_jpeg: bool,
        watch: &Watch,
        sink: &mut dyn SourceSink,
    ) -> Result<End, CutError> {
        let begun = Instant::now();
        let is_ffmpeg = matches!(self.opener, Opener::Ffmpeg(_));
        let limits = &self.settings.limits;
        let most = limits.max_payload_bytes as u64;
        let ppm = is_ffmpeg && !motion_jpeg && self.settings.decoded == Handover::Ppm;
        let mut slots = RateSlots::default();
        // ffmpeg keeps the limit itself where it decodes.
        let limit = (self.settings.max_rate).filter(|_| motion_jpeg || !is_ffmpeg);
        let mut codec_seen = !is_ffmpeg || motion_jpeg;
        let mut first = true;
        loop {
            let picture = if ppm {
                read_ppm(running.output(), limits)?
            } else {
                let part = read_part(running.output(), most)?;
                if motion_jpeg
                    && part
                        .as_ref()
                        .is_some_and(|part| !part.starts_with(&[0xFF, 0xD8]))
                {
                    self.motion_jpeg.store(false, Ordering::Relaxed);
                    return Ok(End::Otherwise);
                }
                part.map(|part| picture_of_file(Bytes::from(part), limits))
            };
            let Some(picture) = picture else {
                return Ok(End::Ended);
            };
            if !codec_seen && let Some(codec) = running.codec() {
                codec_seen = true;
                if codec == "mjpeg" && self.settings.address.kind() != SourceKind::File {
                    self.motion_jpeg.store(true, Ordering::Relaxed);
                    return Ok(End::Otherwise);
                }
            }
            watch.taking();
            if slots.admit(begun.elapsed(), limit) {
                if first {
                    tracing::info!(
                        source = self.name(),
                        codec = running.codec(),
                        size = picture
                            .as_ref()
                            .ok()
                            .map(|picture| picture.size.to_string()),
                        "the source is open"
                    );
                    sink.works();
                }
                sink.picture(picture, first);
                first = false;
            }
            watch.taken();
        }
    }
}
