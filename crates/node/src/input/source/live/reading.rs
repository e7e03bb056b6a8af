//! Reads a source once, to its end, and finds out in which way it must be read.

use super::{FIRST_PAUSE, LONGEST_SILENCE, LiveSource, SourceEvent, SourcePicture};
use crate::input::arrivals::Arrivals;
use crate::input::source::address::SourceKind;
use crate::input::source::ffmpeg::Way;
use crate::input::source::files::Recorded;
use crate::input::source::messages::{Messages, Stage, is_refusal};
use crate::input::source::program::RunningProgram;
use albireo_vision::picture::{
    EncodedPicture, FrameFault, FrameLimits, picture_of_file, read_part, read_ppm,
};
use albireo_vision::recordings::{PassedOver, Recording, check_is_video};
use bytes::Bytes;
use std::io::{self, BufReader};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// Motion JPEG is given up once this many first parts are all something else.
const FIRST_PARTS: u32 = 3;
/// The size of a read from a program's output, bytes.
const BUFFER: usize = 1 << 18;

/// What follows when a source has been read to its end.
pub(super) enum Ending {
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

/// How a source was opened.
struct Opening<'a> {
    /// True if its pictures are PPM files.
    writes_ppm: bool,
    /// True if it goes on where it was.
    continues: bool,
    /// The file, if it is one of several.
    recording: Option<&'a Recording>,
}

/// What was read of an open source.
struct PassedOn {
    /// The number of pictures.
    pictures: u64,
    /// Why it is not read further, if it has not ended.
    cut: Option<String>,
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

impl LiveSource {
    /// Opens the source, or the next of its files, once and reads to its end.
    pub(super) fn read(
        &mut self,
        each: &mut dyn FnMut(SourceEvent),
        continues: bool,
        stop: CancellationToken,
    ) -> Ending {
        if let Err(fault) = self.check_file() {
            return Ending::Failed(fault);
        }
        let mut recording = None;
        if let Some(files) = &mut self.files {
            let next = files.next(|passed_over| pass_over(&self.arrivals, each, passed_over));
            match next {
                Ok(next) => recording = Some(next),
                Err(reason) => return Ending::Failed(reason),
            }
        }
        let begins_drive = recording.as_ref().is_some_and(|recording| recording.begins_drive);
        let program = match self.program(recording.as_ref()) {
            Ok(program) => program,
            Err(reason) => return Ending::Failed(reason),
        };
        let name = program.program;
        let writes_ppm = program.writes_ppm;
        let arrivals = Arc::clone(&self.arrivals);
        let started = program.start(self.settings.silence, arrivals, stop.clone());
        let running = match started {
            Ok(running) => running,
            Err(error) => return Ending::Failed(format!("`{name}` cannot be started: {error}")),
        };
        let mut output = BufReader::with_capacity(BUFFER, running);
        let opening = Opening {
            writes_ppm,
            continues: continues && !begins_drive,
            recording: recording.as_ref(),
        };
        let came_before = self.arrivals.now().frames;
        let PassedOn { pictures, cut } = self.pass_on(&mut output, opening, each);
        let running = output.get_mut();
        let ended = match cut {
            None => running.end(),
            Some(cut) => match running.abort() {
                Some(message) => Err(format!("{cut}; {name} said: {message}")),
                None => Err(cut),
            },
        };
        if pictures > 0 {
            self.refusals = 0;
            self.fault_as_jpeg.clear();
        }
        if stop.is_cancelled() {
            return Ending::Failed("it is stopped".to_owned());
        }
        if let Some(recording) = recording {
            return self.file_ended(recording, ended, pictures, each);
        }
        let came = self.arrivals.now().frames - came_before;
        self.source_ended(ended, pictures, came, running.messages())
    }

    /// Checks that the file is a whole video, if the source is one. It may be in the middle of being copied, so it is
    /// looked at before each attempt.
    fn check_file(&self) -> Result<(), String> {
        let resolved = self.settings.address.resolved()?;
        let path = Path::new(resolved.text());
        // A pipe cannot be looked into.
        if resolved.kind != SourceKind::File || !path.is_file() {
            return Ok(());
        }
        check_is_video(path)
    }

    /// What follows once a source has ended, of which so many frames `came` and so many `pictures` were taken.
    fn source_ended(
        &mut self,
        ended: Result<(), String>,
        pictures: u64,
        came: u64,
        messages: &Messages,
    ) -> Ending {
        if pictures == 0
            && let Some(way) = self.other_way(messages)
        {
            self.way = way;
            return Ending::OtherWay;
        }
        let is_http = self.settings.address.kind().is_http();
        // A stream whose pictures have something else between them is read past it.
        if self.way == Way::Jpeg && pictures > 0 && messages.other_part().is_some() {
            self.way = Way::BareJpeg;
            return Ending::OtherWay;
        }
        if ended.is_ok() && pictures > 0 && is_http {
            if self.way == Way::Paced && messages.is_partial() {
                let reason = "it is cut short, and was played to where it breaks off";
                return Ending::Failed(reason.to_owned());
            }
            if self.way == Way::Paced {
                return Ending::GoesOn {
                    period: FIRST_PAUSE,
                };
            }
            // A camera that sends one picture for each request.
            if came == 1 {
                let seconds = self.settings.max_rate.map_or(1.0, |rate| 1.0 / rate);
                let period = Duration::try_from_secs_f64(seconds).unwrap_or(LONGEST_SILENCE);
                return Ending::GoesOn { period };
            }
        }
        let reason = ended.err().unwrap_or_else(|| "it ended".to_owned());
        if pictures > 0 {
            return Ending::Failed(reason);
        }
        let has_answered = is_http && messages.stage() >= Stage::Connected && !is_refusal(&reason);
        self.without_pictures(reason, has_answered)
    }

    /// What follows once a source has shown no picture. `has_answered` is true if it has answered over HTTP, and not with
    /// a refusal.
    fn without_pictures(&mut self, mut reason: String, has_answered: bool) -> Ending {
        let is_device = self.settings.address.kind() == SourceKind::Device && self.ffmpeg.is_some();
        match self.way {
            // A device without motion JPEG cannot be opened for it.
            Way::Jpeg if is_device => self.way = Way::Decoded,
            Way::Decoded if is_device => self.way = Way::Jpeg,
            Way::Jpeg if has_answered => {
                self.way = Way::BareJpeg;
                self.fault_as_jpeg = reason;
                return Ending::OtherWay;
            }
            Way::BareJpeg => {
                self.way = Way::Jpeg;
                let as_jpeg = std::mem::take(&mut self.fault_as_jpeg);
                if !as_jpeg.is_empty() {
                    reason = as_jpeg;
                }
            }
            _ => {}
        }
        if has_answered && let Some(answer) = self.answer_without_pictures() {
            reason = format!("{answer} ({reason})");
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

    /// Passes pictures on until there are no more.
    fn pass_on(
        &mut self,
        output: &mut BufReader<RunningProgram>,
        opening: Opening<'_>,
        each: &mut dyn FnMut(SourceEvent),
    ) -> PassedOn {
        let Opening {
            writes_ppm,
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
        let mut pictures = 0;
        let cut = loop {
            let picture = match read_picture(output, writes_ppm, &limits) {
                Ok(Some(picture)) => picture,
                Ok(None) => break None,
                Err(error) => break Some(error.to_string()),
            };
            let is_first = pictures == 0;
            if is_first && picture.is_err() && self.way.is_untouched() {
                bad_parts += 1;
                self.not_jpeg |= bad_parts == FIRST_PARTS;
            }
            let running = output.get_mut();
            if is_first && self.other_way(running.messages()).is_some() {
                break Some("it is read the other way".to_owned());
            }
            // What stands before the first picture.
            if is_first && picture.is_err() && self.way == Way::BareJpeg {
                continue;
            }
            let is_broken = running.picture_is_broken();
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
                    if is_first && !continues {
                        tracing::info!(
                            source = self.name(),
                            codec = running.messages().codec(),
                            size = picture.size.to_string(),
                            "the source is open"
                        );
                    }
                    pictures += 1;
                }
                each(SourceEvent::Picture(SourcePicture {
                    picture,
                    is_reopened: is_first && !continues,
                    is_broken,
                    recorded: recording.map(|recording| recorded(recording, since_first)),
                }));
            }
            output.get_mut().picture_taken();
        };
        PassedOn { pictures, cut }
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
    writes_ppm: bool,
    limits: &FrameLimits,
) -> io::Result<Option<Result<EncodedPicture, FrameFault>>> {
    if writes_ppm {
        return read_ppm(output, limits);
    }
    let part = read_part(output, limits.max_payload_bytes as u64)?;
    Ok(part.map(|part| picture_of_file(Bytes::from(part), limits)))
}
