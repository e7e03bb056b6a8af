//! A source that is reopened whenever it ends, fails or falls silent, with growing pauses, until it is stopped.

use super::address::{SourceKind, without_scheme};
use super::ffmpeg::{FFMPEG, Version, Way, ffmpeg, version};
use super::files::{Playlist, Recorded};
use super::gstreamer::{GSTREAMER, gstreamer};
use super::login::unknown_digest;
use super::messages::{Messages, Stage, is_refusal};
use super::program::{PictureProgram, RunningProgram, output_of};
use super::settings::SourceSettings;
use crate::input::arrivals::Arrivals;
use albireo_vision::picture::{
    EncodedPicture, FrameFault, FrameLimits, picture_of_file, read_part, read_ppm,
};
use albireo_vision::recordings::{PassedOver, Recording};
use bytes::Bytes;
use std::io::{self, BufReader};
use std::path::Path;
use std::sync::Arc;
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
/// After so many refusals in a row, a camera is left alone for so long: after five to seven, many lock an address for half
/// an hour.
const REFUSALS: u32 = 2;
const LOGIN_PAUSE: Duration = Duration::from_mins(10);
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
        /// True if the decoder has complained since the last whole key frame: what it shows is not to be trusted.
        broken: bool,
        /// When it was recorded, if the source is several video files.
        recorded: Option<Recorded>,
    },
    /// One of several video files cannot be played and is left out.
    PassedOver(PassedOver),
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
    /// The way in which ffmpeg reads it, which ffmpeg must know before it opens the source.
    way: Way,
    /// True once something that ffmpeg took for motion JPEG was something else.
    not_jpeg: bool,
    /// Why it could not be read as motion JPEG with parts, while it is tried without them.
    fault_as_jpeg: String,
    /// The files, if the source is several.
    files: Option<Playlist>,
    /// The refused logins in a row.
    refusals: u32,
    /// Counts what the source sends.
    arrivals: Arc<Arrivals>,
}

/// What follows when a source has been read to its end.
enum Ending {
    /// It is opened again as after a failure.
    Failed(String),
    /// It is read in another way.
    OtherWay,
    /// It is opened again, which is how it is read.
    GoesOn {
        /// The time between two beginnings.
        period: Duration,
    },
}

/// How long to wait before a source is opened again, and what is said of it.
struct Wait {
    time: Duration,
    /// Why it has to be opened again, if that is a failure.
    reason: Option<String>,
}

/// How a source was opened.
struct Opening<'a> {
    /// True if its pictures are PPM files.
    ppm: bool,
    /// True if it goes on where it was.
    continues: bool,
    /// The file, if it is one of several.
    recording: Option<&'a Recording>,
}

/// When a picture was recorded that came so long after the first of its file. A file is played at its own pace; a machine
/// that is late moves no picture into the next file.
fn recorded(recording: &Recording, since_first: Duration) -> Recorded {
    let since_first = since_first.min(recording.length);
    let since_first_ns = u64::try_from(since_first.as_nanos()).unwrap_or(u64::MAX);
    Recorded {
        time_ns: recording.started_ns.map(|started| started.saturating_add(since_first_ns)),
        drive: Arc::clone(&recording.drive),
    }
}

/// Counts a file that is left out, and tells of it.
fn pass_over(arrivals: &Arrivals, each: &mut dyn FnMut(SourceEvent), passed_over: PassedOver) {
    arrivals.passed_over(&passed_over);
    each(SourceEvent::PassedOver(passed_over));
}

/// The version of ffmpeg if it is to open the source, and `None` if GStreamer is.
fn find_program(name: &str, kind: &SourceKind) -> Result<Option<Version>, String> {
    let is_pipeline = *kind == SourceKind::Pipeline;
    if !is_pipeline && let Some(banner) = output_of(FFMPEG, "-version")? {
        return Ok(Some(version(&banner)));
    }
    if output_of(GSTREAMER, "--version")?.is_none() {
        return Err(if is_pipeline {
            format!("{name}: no `gst-launch-1.0` was found. {INSTALL_GSTREAMER}")
        } else {
            format!("{name}: neither `ffmpeg` nor `gst-launch-1.0` was found. {INSTALL_FFMPEG}")
        });
    }
    if *kind == SourceKind::Files {
        return Err(format!(
            "{name}: several files need ffmpeg, and none was found. {INSTALL_FFMPEG}"
        ));
    }
    Ok(None)
}

impl LiveSource {
    /// Creates a source and checks that its program exists and its address is complete.
    ///
    /// # Errors
    /// What is missing.
    pub fn find(mut settings: SourceSettings) -> Result<Self, String> {
        if let Some(rate) = settings.max_rate {
            // Time for several frames at least.
            let frames = Duration::try_from_secs_f64(3.0 / rate).unwrap_or(LONGEST_SILENCE);
            settings.silence = settings.silence.max(frames);
        }
        settings.silence = settings.silence.min(LONGEST_SILENCE);
        let name = settings.address.to_string();
        let resolved = settings.address.resolved()?;
        let path = without_scheme(resolved.text());
        if resolved.kind == SourceKind::File && !Path::new(path).exists() {
            return Err(format!("{name}: no such file"));
        }
        let files = match resolved.kind {
            SourceKind::Files => Some(Playlist::find(path)?),
            _ => None,
        };
        let ffmpeg = find_program(&name, &resolved.kind)?;
        let way = match &resolved.kind {
            SourceKind::Files => Way::Paced,
            SourceKind::Device => Way::Jpeg,
            kind if kind.is_http() => Way::Jpeg,
            _ => Way::Decoded,
        };
        let source = Self {
            settings,
            ffmpeg,
            way,
            not_jpeg: false,
            fault_as_jpeg: String::new(),
            files,
            refusals: 0,
            arrivals: Arc::default(),
        };
        let program = source.program(None)?;
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

    /// Counts in `arrivals` what it sends.
    pub(crate) fn counting(mut self, arrivals: Arc<Arrivals>) -> Self {
        self.arrivals = arrivals;
        self
    }

    fn program(&self, recording: Option<&Recording>) -> Result<PictureProgram, String> {
        let file = recording.map(|recording| &*recording.path);
        match self.ffmpeg {
            Some(version) => ffmpeg(&self.settings, file, self.way, version),
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
        // A source that is opened again and again to be read goes on, if nothing fails.
        let mut continues = false;
        loop {
            let begun = Instant::now();
            let ending = self.read(&mut each, continues, shutdown.clone());
            if shutdown.is_cancelled() {
                return;
            }
            if begun.elapsed() > STAYED {
                pause = FIRST_PAUSE;
            }
            continues = matches!(ending, Ending::GoesOn { .. });
            let wait = match ending {
                Ending::GoesOn { period } => {
                    pause = FIRST_PAUSE;
                    Wait {
                        time: period.saturating_sub(begun.elapsed()),
                        reason: None,
                    }
                }
                Ending::Failed(reason) => self.after_failure(reason, pause),
                Ending::OtherWay => {
                    let reason = "it alternates between motion JPEG and another codec".to_owned();
                    // The first change of the way is how the right one is found.
                    let alternates = pause > FIRST_PAUSE && self.way != Way::BareJpeg;
                    Wait {
                        time: pause,
                        reason: if alternates { Some(reason) } else { None },
                    }
                }
            };
            if let Some(reason) = wait.reason {
                each(SourceEvent::Failed {
                    reason,
                    pause: wait.time,
                });
            }
            let waited = shutdown.run_until_cancelled(sleep(wait.time));
            if Handle::current().block_on(waited).is_none() {
                return;
            }
            if !continues {
                pause = (pause * 2).min(LONGEST_PAUSE);
            }
        }
    }

    /// The wait after a failure: the `pause`, but a camera that refuses the login is left alone for minutes after the second
    /// time.
    fn after_failure(&mut self, reason: String, pause: Duration) -> Wait {
        let is_login = ["401 ", "403 "].iter().any(|status| reason.starts_with(status));
        self.refusals = if is_login { self.refusals + 1 } else { 0 };
        let minutes = LOGIN_PAUSE.as_secs() / 60;
        if is_login && let Some(algorithm) = self.unknown_digest() {
            let reason = format!(
                "{reason}: it asks for a digest login by {algorithm}, and ffmpeg knows only MD5: let the camera accept MD5 \
                 digest or basic logins; it is tried again in {minutes} minutes"
            );
            return Wait {
                time: LOGIN_PAUSE,
                reason: Some(reason),
            };
        }
        if self.refusals < REFUSALS {
            return Wait {
                time: pause,
                reason: Some(reason),
            };
        }
        let reason = format!(
            "{reason}: refused {} times, so it is left alone for {minutes} minutes, because many cameras lock an address \
             after some wrong logins; check user and password, then restart",
            self.refusals
        );
        Wait {
            time: LOGIN_PAUSE,
            reason: Some(reason),
        }
    }

    /// The algorithm of the camera's login, if the node has one for it and ffmpeg does not know the algorithm.
    fn unknown_digest(&self) -> Option<String> {
        let resolved = self.settings.address.resolved().ok()?;
        if self.ffmpeg.is_none() || resolved.secrets.is_empty() {
            return None;
        }
        unknown_digest(resolved.text())
    }

    /// Opens the source, or the next of its files, once and reads to its end.
    fn read(
        &mut self,
        each: &mut dyn FnMut(SourceEvent),
        continues: bool,
        stop: CancellationToken,
    ) -> Ending {
        let mut recording = None;
        if let Some(files) = &mut self.files {
            let next = files.next(|passed_over| pass_over(&self.arrivals, each, passed_over));
            match next {
                Ok(next) => recording = Some(next),
                Err(reason) => return Ending::Failed(reason),
            }
        }
        let begins = recording.as_ref().is_some_and(|recording| recording.begins_drive);
        let program = match self.program(recording.as_ref()) {
            Ok(program) => program,
            Err(reason) => return Ending::Failed(reason),
        };
        let name = program.program;
        let ppm = program.ppm;
        let arrivals = Arc::clone(&self.arrivals);
        let started = program.start(self.settings.silence, arrivals, stop.clone());
        let running = match started {
            Ok(running) => running,
            Err(error) => return Ending::Failed(format!("`{name}` cannot be started: {error}")),
        };
        let mut output = BufReader::with_capacity(BUFFER, running);
        let mut pictures = 0;
        let opening = Opening {
            ppm,
            continues: continues && !begins,
            recording: recording.as_ref(),
        };
        let cut = self.pictures(&mut output, opening, each, &mut pictures);
        let running = output.get_mut();
        let ended = match &cut {
            None => running.end(),
            Some(cut) => Err(match running.abort() {
                Some(message) => format!("{cut}; {name} said: {message}"),
                None => cut.clone(),
            }),
        };
        if pictures > 0 {
            self.refusals = 0;
        }
        if let Some(recording) = recording {
            if stop.is_cancelled() {
                return Ending::Failed("it is stopped".to_owned());
            }
            return self.file_ended(recording, ended, pictures, each);
        }
        self.source_ended(ended, pictures, running.messages())
    }

    /// What follows once a source, of which so many pictures came, has ended.
    fn source_ended(
        &mut self,
        ended: Result<(), String>,
        pictures: u64,
        messages: &Messages,
    ) -> Ending {
        if pictures == 0
            && let Some(way) = self.other_way(messages)
        {
            self.way = way;
            return Ending::OtherWay;
        }
        let is_http = self.settings.address.kind().is_http();
        if ended.is_ok() && pictures > 0 && is_http {
            if self.way == Way::Paced {
                return Ending::GoesOn {
                    period: FIRST_PAUSE,
                };
            }
            // A camera that sends one picture for each request.
            if self.way == Way::Jpeg && pictures == 1 {
                let period = self.settings.max_rate.map_or(1.0, |rate| 1.0 / rate);
                let period = Duration::try_from_secs_f64(period).unwrap_or(LONGEST_SILENCE);
                return Ending::GoesOn { period };
            }
        }
        let answered = messages.stage() >= Stage::Connected;
        let reason = ended.err().unwrap_or_else(|| "it ended".to_owned());
        if pictures > 0 {
            return Ending::Failed(reason);
        }
        let is_device = self.settings.address.kind() == SourceKind::Device && self.ffmpeg.is_some();
        match self.way {
            // A device without motion JPEG cannot be opened for it.
            Way::Jpeg if is_device => self.way = Way::Decoded,
            Way::Decoded if is_device => self.way = Way::Jpeg,
            Way::Jpeg if is_http && answered && !is_refusal(&reason) => {
                self.way = Way::BareJpeg;
                self.fault_as_jpeg = reason;
                return Ending::OtherWay;
            }
            Way::BareJpeg => {
                self.way = Way::Jpeg;
                return Ending::Failed(std::mem::take(&mut self.fault_as_jpeg));
            }
            _ => {}
        }
        Ending::Failed(reason)
    }

    /// What follows once one of several files, of which so many pictures came, has ended.
    fn file_ended(
        &mut self,
        recording: Recording,
        ended: Result<(), String>,
        pictures: u64,
        each: &mut dyn FnMut(SourceEvent),
    ) -> Ending {
        let fault = match (ended, pictures) {
            (Ok(()), 0) => Some("it shows no picture".to_owned()),
            (Ok(()), _) => None,
            (Err(reason), 0) => Some(reason),
            (Err(reason), _) => Some(format!("played only to where it breaks off: {reason}")),
        };
        if pictures > 0
            && let Some(files) = &mut self.files
        {
            files.played();
        }
        if let Some(reason) = fault {
            let path = recording.path;
            pass_over(&self.arrivals, each, PassedOver { path, reason });
        }
        Ending::GoesOn {
            period: Duration::ZERO,
        }
    }

    /// Passes pictures on until there are no more, and counts them in `pictures`. Returns the reason the output is not read
    /// further, if it has not ended.
    fn pictures(
        &mut self,
        output: &mut BufReader<RunningProgram>,
        opening: Opening<'_>,
        each: &mut dyn FnMut(SourceEvent),
        pictures: &mut u64,
    ) -> Option<String> {
        let Opening {
            ppm,
            continues,
            recording,
        } = opening;
        let begun = Instant::now();
        let mut first_at = None;
        let limits = self.settings.limits;
        // ffmpeg counts and limits by itself what it decodes.
        let is_counted = !self.way.is_untouched() && self.ffmpeg.is_some();
        let max_rate = if is_counted {
            None
        } else {
            self.settings.max_rate
        };
        let mut last_slot = None;
        let mut bad_parts = 0;
        loop {
            let picture = match read_picture(output, ppm, &limits) {
                Ok(Some(picture)) => picture,
                Ok(None) => return None,
                Err(error) => return Some(error.to_string()),
            };
            let first = *pictures == 0;
            if first && picture.is_err() && self.way.is_untouched() {
                bad_parts += 1;
                self.not_jpeg |= bad_parts == FIRST_PARTS;
            }
            let running = output.get_mut();
            if first && self.other_way(running.messages()).is_some() {
                return Some("it is read the other way".to_owned());
            }
            // What stands before the first picture.
            if first && picture.is_err() && self.way == Way::BareJpeg {
                continue;
            }
            let broken = running.picture_is_broken();
            if !is_counted {
                self.arrivals.frame(picture.is_err());
            }
            // The first picture of each time slot: on average exactly the limit, at any rate of the camera.
            let now = Instant::now();
            let since_first = now - *first_at.get_or_insert(now);
            let slot = max_rate.map(|rate| (begun.elapsed().as_secs_f64() * rate) as u64);
            if slot.is_none() || last_slot != slot {
                last_slot = slot;
                if let Ok(picture) = &picture {
                    if first && !continues {
                        tracing::info!(
                            source = self.name(),
                            codec = running.messages().codec(),
                            size = picture.size.to_string(),
                            "the source is open"
                        );
                    }
                    *pictures += 1;
                }
                each(SourceEvent::Picture {
                    picture,
                    reopened: first && !continues,
                    broken,
                    recorded: recording.map(|recording| recorded(recording, since_first)),
                });
            }
            output.get_mut().picture_taken();
        }
    }

    /// The way in which the source must be read, if it is not the present one: something that was taken for motion JPEG
    /// is none, ffmpeg reports a codec for another way, or a recording that comes as fast as it is read.
    fn other_way(&self, messages: &Messages) -> Option<Way> {
        let is_file = self.settings.address.kind() == SourceKind::File;
        if self.ffmpeg.is_none() || is_file || self.files.is_some() {
            return None;
        }
        let is_jpeg = if self.not_jpeg {
            false
        } else {
            messages.codec()? == "mjpeg"
        };
        let is_paced = self.settings.address.kind().is_http() && messages.is_paced();
        let way = if is_paced {
            Way::Paced
        } else if !is_jpeg {
            Way::Decoded
        } else if self.way.is_untouched() {
            self.way
        } else {
            Way::Jpeg
        };
        if way == self.way { None } else { Some(way) }
    }
}

/// Reads the next picture of a program's output: a PPM file, or a part of a multipart stream. `None` at the end.
fn read_picture(
    output: &mut BufReader<RunningProgram>,
    ppm: bool,
    limits: &FrameLimits,
) -> io::Result<Option<Result<EncodedPicture, FrameFault>>> {
    if ppm {
        return read_ppm(output, limits);
    }
    let part = read_part(output, limits.max_payload_bytes as u64)?;
    Ok(part.map(|part| picture_of_file(Bytes::from(part), limits)))
}
