//! A source that is reopened whenever it ends, fails or falls silent, with growing pauses, until it is stopped.

mod reading;

use super::address::SourceKind;
use super::ffmpeg::{FFMPEG, Version, Way, ffmpeg, version};
use super::files::{Playlist, Recorded};
use super::gstreamer::{GSTREAMER, gstreamer};
use super::login::{answer_without_pictures, unknown_digest};
use super::program::{PictureProgram, output_of};
use super::settings::SourceSettings;
use crate::input::arrivals::Arrivals;
use albireo_vision::picture::{EncodedPicture, FrameFault};
use albireo_vision::recordings::{FileKind, PassedOver, Recording};
use reading::Ending;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::task::JoinError;
use tokio::time::{Instant, sleep};
use tokio_util::sync::CancellationToken;

/// The pause before reopening a source; doubles while the source does not stay open.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
/// The longest of these pauses.
const LONGEST_PAUSE: Duration = Duration::from_secs(30);
/// After a source was open for this long, its pauses start short again.
const STAYED: Duration = Duration::from_secs(10);
/// After so many refusals in a row, a camera is left alone: after five to seven, many lock an address for half an hour.
const REFUSALS: u32 = 2;
/// The time for which it is left alone.
const LOGIN_PAUSE: Duration = Duration::from_mins(10);
/// The longest silence that can be configured.
const LONGEST_SILENCE: Duration = Duration::from_secs(86_400);

const INSTALL_FFMPEG: &str =
    "Install it with `apt-get install ffmpeg`, `dnf install ffmpeg` or `brew install ffmpeg`";
const INSTALL_GSTREAMER: &str =
    "Install it with `apt-get install gstreamer1.0-tools gstreamer1.0-plugins-good`";

/// An event of a source.
#[derive(Debug)]
pub enum SourceEvent {
    /// A picture arrived.
    Picture(SourcePicture),
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

/// A picture of a source.
#[derive(Debug)]
pub struct SourcePicture {
    /// The picture, or the fault of an unusable one.
    pub picture: Result<EncodedPicture, FrameFault>,
    /// True for the first since the source was opened: what happened in between is unknown.
    pub is_reopened: bool,
    /// True if the decoder has complained since the last whole key frame: what it shows is not to be trusted.
    pub is_broken: bool,
    /// When it was recorded, if the source is several video files.
    pub recorded: Option<Recorded>,
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
    /// Why it could not be read as motion JPEG with parts, until it has been read without them.
    fault_as_jpeg: String,
    /// The files, if the source is several.
    files: Option<Playlist>,
    /// The refused logins in a row.
    refusals: u32,
    /// Counts what the source sends.
    arrivals: Arc<Arrivals>,
}

/// How long to wait before a source is opened again, and what is said of it.
struct Wait {
    time: Duration,
    /// Why it has to be opened again, if that is a failure.
    reason: Option<String>,
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
        let path = resolved.text();
        if resolved.kind == SourceKind::File && !Path::new(path).exists() {
            return Err(format!("{name}: no such file"));
        }
        if resolved.kind == SourceKind::File
            && let Some(other) = FileKind::of(Path::new(path))
        {
            return Err(format!("{name}: {}", other.remedy()));
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
        if is_login {
            self.refusals += 1;
        } else {
            self.refusals = 0;
        }
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

    /// What the address answers, in words, if that is nothing that can be read.
    fn answer_without_pictures(&self) -> Option<String> {
        let resolved = self.settings.address.resolved().ok()?;
        answer_without_pictures(resolved.text())
    }
}
