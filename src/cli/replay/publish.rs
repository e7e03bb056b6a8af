//! Plays a source on a frame key: decides when each frame is due, and its number, time and clip.

use crate::cli::frames::OutgoingFrame;
use crate::cli::terminal;
use crate::cli::values;
use albireo_eval::footage::FrameSource;
use albireo_service::clock::unix_nanoseconds;
use albireo_vision::picture::{EncodedPicture, PictureFormat};
use albireo_wire::{FrameAttachment, VERSION};
use anyhow::{Context, bail};
use clap::Args;
use std::collections::{HashMap, HashSet};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// The longest time between two frames, at the lowest rate that can be requested.
const MAX_PERIOD: Duration = Duration::from_secs(1000);

/// The rate of frames that are sent as fast as they are read and accepted. Their capture times follow the source's own
/// rate.
pub(crate) const UNPACED: f64 = f64::INFINITY;

/// Heading of the help.
const CLIPS: &str = "Clips";

/// What is sent from a source, and how.
#[derive(Args, Clone, Debug, Default, PartialEq)]
pub struct PublishOptions {
    /// Frames per second, or `max` for as fast as possible [default: the source's own]
    #[arg(long, value_name = "FPS", value_parser = parse_rate)]
    pub rate: Option<f64>,
    /// Begin again at the end, until stopped
    #[arg(long = "loop")]
    pub repeat: bool,
    /// Stop after this many frames
    #[arg(long, value_name = "COUNT")]
    pub frames: Option<u64>,
    /// Clip id; numbered when there is more than one clip [default: the source's name]
    #[arg(long = "clip-id", alias = "clip", help_heading = CLIPS, value_name = "ID")]
    pub clip: Option<String>,
    /// Begin a new clip after this many seconds [default: one clip per pass, or one per folder of an archive, drive of
    /// a dashcam or stretch of a recording without a jump in time]
    #[arg(long, help_heading = CLIPS, value_name = "SECONDS", value_parser = values::above_zero)]
    pub clip_seconds: Option<f64>,
    /// Name no clips: the node uses its own time windows
    #[arg(long, help_heading = CLIPS, conflicts_with_all = ["clip", "clip_seconds"])]
    pub no_clip: bool,
    /// Sequence number of the first frame.
    #[arg(skip)]
    pub first_sequence: u64,
}

impl PublishOptions {
    /// The rate that was asked for, unless frames are unpaced.
    pub(crate) fn paced_rate(&self) -> Option<f64> {
        self.rate.filter(|rate| *rate != UNPACED)
    }
}

fn parse_rate(text: &str) -> Result<f64, String> {
    if text == "max" {
        return Ok(UNPACED);
    }
    values::parse_rate(text).map_err(|_| {
        let least = values::MIN_RATE;
        let most = values::MAX_RATE;
        format!("must be `max` or a number from {least} to {most}")
    })
}

/// The totals so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sent {
    /// The number of frames.
    pub frames: u64,
    /// The bytes of their payloads.
    pub bytes: u64,
    /// The number of clips begun.
    pub clips: u64,
    /// The number of frames sent more than one period late: the source or the network was too slow.
    pub behind: u64,
    /// The number of frames that were sent while no node subscribed to them; a sender that waits for the node loses
    /// none.
    pub lost: u64,
    /// The number of frames that the node did not process; known only to a sender that waits for the node.
    pub refused: u64,
    /// The reason for the first of them.
    pub first_refusal: Option<String>,
    /// The number of pictures, or of several video files, that could not be used.
    pub left_out: u64,
    /// What is to be said of the source, such as what is missing of it.
    pub remarks: Vec<String>,
    /// The time from the first frame until now.
    pub elapsed: Duration,
}

/// The part of a source that a picture belongs to.
#[derive(PartialEq)]
struct Part {
    /// How many times the source was read before.
    pass: u64,
    /// The source's clip.
    clip: Option<String>,
}

struct ReadPicture {
    picture: EncodedPicture,
    part: Part,
    /// When it was recorded, if that is known.
    time_ns: Option<u64>,
}

/// What was read of a source.
enum ReadItem {
    Picture(ReadPicture),
    /// A picture, or one of several files, that cannot be used, and what is told of it.
    LeftOut(Option<String>),
    /// What is to be said of the source.
    Remark(String),
}

/// So many of those that are left out for one reason are named; the others are counted. As many remarks are told.
const NAMED: u64 = 5;

/// What was told of a source: each fault once, however often the source is read.
#[derive(Default)]
struct Told {
    faults: HashSet<String>,
    /// How many faults have a reason, which is the same for all pictures of a kind that is not read.
    reasons: HashMap<String, u64>,
    /// How many remarks there were.
    remarks: u64,
}

impl Told {
    /// What becomes of the fault of a file of this name; `None` if it was told before.
    fn left_out(&mut self, name: &str, fault: &str) -> Option<ReadItem> {
        if !self.faults.insert(fault.to_owned()) {
            return None;
        }
        let known = self.reasons.entry(fault.replace(name, "")).or_default();
        *known += 1;
        let said = match *known {
            ..NAMED => Some(fault.to_owned()),
            NAMED => Some(format!("{fault} (more for this reason are counted only)")),
            _ => None,
        };
        Some(ReadItem::LeftOut(said))
    }

    /// What is to be said of a source; `None` if it was told before, and behind a few: a source that is read again and
    /// again can give another one each time.
    fn remark(&mut self, said: String) -> Option<ReadItem> {
        if self.remarks >= NAMED || !self.faults.insert(said.clone()) {
            return None;
        }
        self.remarks += 1;
        match self.remarks {
            NAMED => Some(ReadItem::Remark(format!(
                "{said} (more of this kind are not told)"
            ))),
            _ => Some(ReadItem::Remark(said)),
        }
    }
}

/// The number of frames that are read ahead, so that a slow frame does not delay the next.
const AHEAD: usize = 4;

/// Reads the source until it ends, fails, or nobody takes its pictures.
fn read_ahead(
    mut source: Box<dyn FrameSource>,
    repeat: bool,
    sender: &mpsc::Sender<anyhow::Result<ReadItem>>,
) -> anyhow::Result<()> {
    let mut told = Told::default();
    for pass in 0_u64.. {
        let mut is_empty = true;
        loop {
            let read = match source.next() {
                Ok(None) => break,
                Ok(Some(picture)) => {
                    is_empty = false;
                    let clip = source.clip().map(str::to_owned);
                    ReadItem::Picture(ReadPicture {
                        picture,
                        part: Part { pass, clip },
                        time_ns: source.time_ns(),
                    })
                }
                Err(fault) => {
                    let Some(name) = source.picture_name() else {
                        return Err(fault.into());
                    };
                    // The other files follow.
                    let Some(left_out) = told.left_out(&name, &fault.to_string()) else {
                        continue;
                    };
                    left_out
                }
            };
            if sender.blocking_send(Ok(read)).is_err() {
                return Ok(());
            }
        }
        for remark in source.remarks() {
            if let Some(remark) = told.remark(remark)
                && sender.blocking_send(Ok(remark)).is_err()
            {
                return Ok(());
            }
        }
        if !repeat {
            break;
        }
        if is_empty {
            bail!("{}: it has no frames", source.name());
        }
        source.rewind()?;
    }
    Ok(())
}

/// Reads the source on a thread of its own, because reading it blocks.
fn start_reading(
    source: Box<dyn FrameSource>,
    repeat: bool,
) -> mpsc::Receiver<anyhow::Result<ReadItem>> {
    let (sender, prepared) = mpsc::channel(AHEAD);
    std::thread::spawn(move || {
        if let Err(error) = read_ahead(source, repeat, &sender) {
            let _ = sender.blocking_send(Err(error));
        }
    });
    prepared
}

/// Returns the next picture, or `None` at the end of the source. Names what cannot be used before it on standard error,
/// and counts it in `sent`.
async fn next_picture(
    prepared: &mut mpsc::Receiver<anyhow::Result<ReadItem>>,
    sent: &mut Sent,
) -> anyhow::Result<Option<ReadPicture>> {
    while let Some(read) = prepared.recv().await {
        match read? {
            ReadItem::Picture(picture) => return Ok(Some(picture)),
            ReadItem::LeftOut(said) => {
                sent.left_out += 1;
                if let Some(said) = said {
                    let line = format!("albireo: left out: {said}");
                    eprintln!("{}", terminal::error(&line));
                }
            }
            ReadItem::Remark(said) => {
                eprintln!("{}", terminal::error(&format!("albireo: {said}")));
                sent.remarks.push(said);
            }
        }
    }
    Ok(None)
}

/// Names clips.
struct Clips<'a> {
    options: &'a PublishOptions,
    source: String,
    /// The number of clips begun.
    begun: u64,
    /// The part that the last frame belongs to.
    last: Option<Part>,
    /// When the clip that is being sent began, seconds after the first frame.
    since: f64,
}

impl Clips<'_> {
    /// Returns the clip of the next frame, which belongs to `part`, `seconds` after the first frame. Begins a new clip
    /// with it if the part changes or the last clip is long enough.
    fn next(&mut self, part: Part, seconds: f64) -> Option<String> {
        let options = self.options;
        if options.no_clip {
            return None;
        }
        let given = options.clip.as_ref();
        let name = given.or(part.clip.as_ref()).unwrap_or(&self.source).clone();
        // All clips of the source have the name that was given.
        let share_a_name = given.is_some() && part.clip.is_some();
        let is_numbered = options.repeat || options.clip_seconds.is_some() || share_a_name;
        let is_other_part = self.last.as_ref() != Some(&part);
        // Frame times have rounding errors, which are below half a millisecond.
        let reaches = |most: f64| seconds - self.since >= most - 0.0005;
        let is_over = options.clip_seconds.is_some_and(reaches);
        if is_other_part || is_over {
            self.last = Some(part);
            self.since = seconds;
            self.begun += 1;
        }
        if is_numbered {
            Some(format!("{name}-{:04}", self.begun))
        } else {
            Some(name)
        }
    }
}

/// When the first frame was sent: times count from there, because opening the source may take long.
#[derive(Clone, Copy)]
struct Begun {
    instant: Instant,
    unix_ns: u64,
}

/// Says when each frame is due.
struct Pace {
    /// The time between two frames; `None` if frames go out as fast as possible.
    period: Option<Duration>,
    due: Instant,
    /// Frames that were more than one period late.
    behind: u64,
}

impl Pace {
    /// Waits until the next frame is due.
    async fn wait(&mut self) {
        let Some(period) = self.period else { return };
        tokio::time::sleep_until(self.due).await;
        if self.due.elapsed() > period {
            // Missed frames are not sent in a burst.
            self.behind += 1;
            self.due = Instant::now();
        }
        self.due += period;
    }
}

/// The time between two frames.
///
/// # Errors
/// When it is no rate: one that the source reports itself is not checked yet.
fn period(rate: f64) -> anyhow::Result<Duration> {
    Duration::try_from_secs_f64(1.0 / rate)
        .ok()
        .filter(|period| *period <= MAX_PERIOD)
        .with_context(|| format!("{rate} frames per second is not a rate: give one with --rate"))
}

/// What the node is told of the frame with the number `seq`, taken at `t_ns`.
fn attachment(
    seq: u64,
    t_ns: u64,
    clip: Option<String>,
    picture: &EncodedPicture,
) -> FrameAttachment {
    // Other pictures contain their size.
    let is_raw = !matches!(picture.format, PictureFormat::Jpeg | PictureFormat::Png);
    FrameAttachment {
        v: VERSION,
        seq: Some(seq),
        t_ns: Some(t_ns),
        clip,
        width: is_raw.then_some(picture.size.width),
        height: is_raw.then_some(picture.size.height),
        ..FrameAttachment::default()
    }
}

/// Passes the frames of `source` to `send`, which returns the reason if the node does not process one, until the source
/// ends, the requested frames are sent, or `shutdown`. Calls `progress` after each frame.
///
/// # Errors
/// When the source or `send` fails.
pub async fn publish<F: Future<Output = anyhow::Result<Option<String>>>>(
    source: Box<dyn FrameSource>,
    mut send: impl FnMut(OutgoingFrame) -> F,
    options: &PublishOptions,
    mut progress: impl FnMut(&Sent),
    shutdown: &CancellationToken,
) -> anyhow::Result<Sent> {
    let rate = options.paced_rate().unwrap_or_else(|| source.rate());
    let period = period(rate)?;
    // Dropped when this function ends for any reason, so that the source stops too.
    let _stopper = source.stopper();
    let mut clips = Clips {
        options,
        source: source.name().to_owned(),
        begun: 0,
        last: None,
        since: 0.0,
    };
    let mut prepared = start_reading(source, options.repeat);
    let mut sent = Sent::default();
    let mut started = None;
    let is_paced = options.rate != Some(UNPACED);
    let mut pace = Pace {
        period: is_paced.then_some(period),
        due: Instant::now(),
        behind: 0,
    };
    while options.frames.is_none_or(|most| sent.frames < most) {
        let next = tokio::select! {
            biased;
            () = shutdown.cancelled() => break,
            next = next_picture(&mut prepared, &mut sent) => next?,
        };
        let Some(read) = next else { break };
        let begun = match started {
            Some(begun) => begun,
            None => {
                let begun = Begun {
                    instant: Instant::now(),
                    unix_ns: unix_nanoseconds(),
                };
                pace.due = begun.instant;
                started = Some(begun);
                begun
            }
        };
        tokio::select! {
            biased;
            () = shutdown.cancelled() => break,
            () = pace.wait() => {}
        }
        let seconds = sent.frames as f64 / rate;
        let bytes = read.picture.bytes.len() as u64;
        let seq = options.first_sequence + sent.frames;
        let expected_ns = begun.unix_ns.saturating_add((seconds * 1e9) as u64);
        let t_ns = read.time_ns.unwrap_or(expected_ns);
        let clip = clips.next(read.part, seconds);
        let frame = OutgoingFrame {
            attachment: attachment(seq, t_ns, clip, &read.picture),
            picture: read.picture,
        };
        let refused = tokio::select! {
            biased;
            refused = send(frame) => refused?,
            () = shutdown.cancelled() => break,
        };
        if let Some(reason) = refused {
            sent.refused += 1;
            if sent.first_refusal.is_none() {
                sent.first_refusal = Some(reason);
            }
        }
        sent.frames += 1;
        sent.bytes += bytes;
        sent.clips = clips.begun;
        sent.behind = pace.behind;
        sent.elapsed = begun.instant.elapsed();
        progress(&sent);
    }
    Ok(sent)
}

#[cfg(test)]
mod tests;
