//! Plays a source on a frame key: when each frame is due, its number, its time and its clip.

use super::source::{FrameSource, Stopper};
use crate::frame::{EncodedPicture, PictureFormat};
use crate::wire::{FrameAttachment, VERSION};
use anyhow::{Context, anyhow, bail};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use zenoh::Wait;
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;
use zenoh::session::Session;

/// How fast frames are sent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Rate {
    /// At the source's own rate.
    #[default]
    Source,
    /// This many a second.
    PerSecond(f64),
    /// As fast as they are made and taken. Their capture times stay those of the source's own rate.
    Unpaced,
}

/// What is sent of a source, and how.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PublishOptions {
    /// How fast.
    pub rate: Rate,
    /// Begin again at the end, for ever.
    pub repeat: bool,
    /// Stop after this many frames.
    pub frames: Option<u64>,
    /// Clip id, numbered (`name-0001`) when there can be more than one clip; `None` names no clips.
    pub clip: Option<String>,
    /// Begin a new clip after this many seconds of the source's time.
    pub clip_seconds: Option<f64>,
    /// Sequence number of the first frame.
    pub first_sequence: u64,
}

/// What was sent so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sent {
    /// Frames.
    pub frames: u64,
    /// Bytes of their payloads.
    pub bytes: u64,
    /// Clips begun.
    pub clips: u64,
    /// Frames sent more than one period after they were due: the source or the network was too slow.
    pub behind: u64,
    /// From the first frame until now.
    pub elapsed: Duration,
}

/// A frame to be sent.
#[derive(Clone, Debug, PartialEq)]
pub struct OutgoingFrame {
    /// The picture.
    pub picture: EncodedPicture,
    /// What is said beside it.
    pub attachment: FrameAttachment,
}

/// Declares a publisher for frames. With `every` the sender waits when the network or the receiver is
/// slow; without, frames are dropped then, as a camera's should be.
///
/// # Errors
/// When the key is not a key expression, or the session is closed.
pub async fn declare_frame_publisher(
    session: &Session,
    key: &str,
    every: bool,
) -> anyhow::Result<Publisher<'static>> {
    session
        .declare_publisher(key.to_owned())
        .congestion_control(if every {
            CongestionControl::Block
        } else {
            CongestionControl::Drop
        })
        .await
        .map_err(|error| anyhow!("cannot publish on `{key}`: {error}"))
}

/// The Zenoh encoding of a picture.
fn encoding(format: PictureFormat) -> String {
    match format {
        PictureFormat::Jpeg => "image/jpeg".to_owned(),
        PictureFormat::Png => "image/png".to_owned(),
        raw => format!("image/raw;{}", raw.as_str()),
    }
}

/// Publishes `source` until it ends, the frames asked for are sent, or `shutdown`. `progress` is called
/// after each frame.
///
/// # Errors
/// When the source fails or Zenoh refuses a frame.
pub async fn publish(
    source: Box<dyn FrameSource>,
    publisher: Publisher<'static>,
    options: &PublishOptions,
    progress: impl FnMut(&Sent),
    shutdown: &CancellationToken,
) -> anyhow::Result<Sent> {
    let publisher = Arc::new(publisher);
    play(
        source,
        options,
        |frame: OutgoingFrame| {
            let publisher = Arc::clone(&publisher);
            async move {
                // A put that has to wait for room blocks its thread.
                tokio::task::spawn_blocking(move || put(&publisher, &frame))
                    .await
                    .context("publishing a frame")?
            }
        },
        progress,
        shutdown,
    )
    .await
}

fn put(publisher: &Publisher<'_>, frame: &OutgoingFrame) -> anyhow::Result<()> {
    publisher
        .put(frame.picture.bytes.as_ref())
        .encoding(encoding(frame.picture.format))
        .attachment(serde_json::to_vec(&frame.attachment)?)
        .wait()
        .map_err(|error| anyhow!("a frame cannot be published: {error}"))
}

/// Ends the source when the player goes, however it goes.
struct StopOnDrop(Option<Stopper>);

impl Drop for StopOnDrop {
    fn drop(&mut self) {
        if let Some(stop) = self.0.take() {
            stop();
        }
    }
}

/// A picture and the pass through the source it belongs to.
type Prepared = anyhow::Result<(u64, EncodedPicture)>;

/// Frames made ahead of their time, so that a slow frame does not delay the next.
const AHEAD: usize = 4;

/// Runs the source on a thread of its own.
fn prepare(mut source: Box<dyn FrameSource>, repeat: bool) -> mpsc::Receiver<Prepared> {
    let (sender, receiver) = mpsc::channel(AHEAD);
    std::thread::spawn(move || {
        for pass in 0_u64.. {
            let mut frames = 0_u64;
            loop {
                match source.next() {
                    Ok(Some(picture)) => {
                        frames += 1;
                        if sender.blocking_send(Ok((pass, picture))).is_err() {
                            return;
                        }
                    }
                    Ok(None) => break,
                    Err(error) => {
                        let _ = sender.blocking_send(Err(error));
                        return;
                    }
                }
            }
            if !repeat {
                return;
            }
            let again = if frames == 0 {
                Err(anyhow!("{}: there are no frames in it", source.name()))
            } else {
                source.rewind()
            };
            if let Err(error) = again {
                let _ = sender.blocking_send(Err(error));
                return;
            }
        }
    });
    receiver
}

/// Names clips.
struct Clips {
    name: Option<String>,
    numbered: bool,
    seconds: Option<f64>,
    begun: u64,
    /// Pass and time of the present clip's first frame.
    present: Option<(u64, f64)>,
}

impl Clips {
    fn new(options: &PublishOptions) -> Self {
        Self {
            name: options.clip.clone(),
            numbered: options.repeat || options.clip_seconds.is_some(),
            seconds: options.clip_seconds,
            begun: 0,
            present: None,
        }
    }

    /// The clip of the next frame, of pass `pass` and source time `seconds`.
    fn next(&mut self, pass: u64, seconds: f64) -> Option<String> {
        let name = self.name.as_ref()?;
        let same = self.present.is_some_and(|(first_pass, first)| {
            // Frame times are computed: half a millisecond is no frame.
            first_pass == pass
                && self
                    .seconds
                    .is_none_or(|most| seconds - first < most - 0.0005)
        });
        if !same {
            self.present = Some((pass, seconds));
            self.begun += 1;
        }
        Some(if self.numbered {
            format!("{name}-{:04}", self.begun)
        } else {
            name.clone()
        })
    }
}

/// Plays `source` into `send`, as [`publish`] does.
async fn play<F: Future<Output = anyhow::Result<()>>>(
    source: Box<dyn FrameSource>,
    options: &PublishOptions,
    mut send: impl FnMut(OutgoingFrame) -> F,
    mut progress: impl FnMut(&Sent),
    shutdown: &CancellationToken,
) -> anyhow::Result<Sent> {
    let rate = match options.rate {
        Rate::PerSecond(rate) => rate,
        Rate::Source | Rate::Unpaced => source.rate(),
    };
    if !(rate.is_finite() && rate > 0.0) {
        bail!("{rate} frames per second is not a rate");
    }
    let _stop = StopOnDrop(source.stopper());
    let mut prepared = prepare(source, options.repeat);
    let mut clips = Clips::new(options);
    let mut sent = Sent::default();
    let mut begun = None;
    let period = Duration::from_secs_f64(1.0 / rate);
    let mut due = Instant::now();
    while options.frames.is_none_or(|most| sent.frames < most) {
        let next = tokio::select! {
            biased;
            () = shutdown.cancelled() => break,
            next = prepared.recv() => next,
        };
        let Some(next) = next else { break };
        let (pass, picture) = next?;
        let (began, clock) = *begun.get_or_insert_with(|| {
            due = Instant::now();
            (due, SystemTime::now())
        });
        if options.rate != Rate::Unpaced {
            tokio::select! {
                biased;
                () = shutdown.cancelled() => break,
                () = tokio::time::sleep_until(due) => {}
            }
            if due.elapsed() > period {
                // What was missed is not made up for in a burst.
                sent.behind += 1;
                due = Instant::now();
            }
            due += period;
        }
        let seconds = sent.frames as f64 / rate;
        let bytes = picture.bytes.len() as u64;
        let frame = OutgoingFrame {
            attachment: FrameAttachment {
                v: VERSION,
                seq: Some(options.first_sequence + sent.frames),
                t_ns: Some(nanoseconds(clock, seconds)),
                clip: clips.next(pass, seconds),
                ..raw_size(&picture)
            },
            picture,
        };
        tokio::select! {
            biased;
            result = send(frame) => result?,
            () = shutdown.cancelled() => break,
        }
        sent.frames += 1;
        sent.bytes += bytes;
        sent.clips = clips.begun;
        sent.elapsed = began.elapsed();
        progress(&sent);
    }
    Ok(sent)
}

/// Nanoseconds since the Unix epoch at `seconds` after `clock`.
fn nanoseconds(clock: SystemTime, seconds: f64) -> u64 {
    clock
        .duration_since(UNIX_EPOCH)
        .ok()
        .and_then(|since| since.checked_add(Duration::try_from_secs_f64(seconds).ok()?))
        .and_then(|since| u64::try_from(since.as_nanos()).ok())
        .unwrap_or(0)
}

/// The size, which only raw pictures need to be told.
fn raw_size(picture: &EncodedPicture) -> FrameAttachment {
    let raw = !matches!(picture.format, PictureFormat::Jpeg | PictureFormat::Png);
    FrameAttachment {
        width: raw.then_some(picture.size.width),
        height: raw.then_some(picture.size.height),
        ..FrameAttachment::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::PictureSize;
    use bytes::Bytes;
    use std::sync::Mutex;

    /// Pictures of one byte, numbered.
    struct Numbers {
        length: u8,
        at: u8,
    }

    impl FrameSource for Numbers {
        fn name(&self) -> &str {
            "numbers"
        }
        fn rate(&self) -> f64 {
            10.0
        }
        fn frames(&self) -> Option<u64> {
            Some(u64::from(self.length))
        }
        fn next(&mut self) -> anyhow::Result<Option<EncodedPicture>> {
            if self.at == self.length {
                return Ok(None);
            }
            self.at += 1;
            Ok(Some(EncodedPicture {
                format: PictureFormat::Gray8,
                bytes: Bytes::from(vec![self.at - 1]),
                size: PictureSize::new(1, 1),
            }))
        }
        fn rewind(&mut self) -> anyhow::Result<()> {
            self.at = 0;
            Ok(())
        }
    }

    fn numbers(length: u8) -> Box<dyn FrameSource> {
        Box::new(Numbers { length, at: 0 })
    }

    /// Everything sent, with the time since the start.
    async fn played(
        length: u8,
        options: PublishOptions,
        slow: impl Fn(u64) -> Duration,
    ) -> (Vec<(Duration, OutgoingFrame)>, Sent) {
        let frames = Mutex::new(Vec::new());
        let start = Instant::now();
        let sent = play(
            numbers(length),
            &options,
            |frame: OutgoingFrame| {
                let (frames, wait) = (&frames, slow(frame.attachment.seq.unwrap()));
                async move {
                    tokio::time::sleep(wait).await;
                    frames.lock().unwrap().push((start.elapsed(), frame));
                    Ok(())
                }
            },
            |_| {},
            &CancellationToken::new(),
        )
        .await
        .unwrap();
        (frames.into_inner().unwrap(), sent)
    }

    fn at_once(_: u64) -> Duration {
        Duration::ZERO
    }

    #[tokio::test(start_paused = true)]
    async fn frames_go_out_at_the_source_s_rate_or_a_given_one() {
        for (rate, period) in [(Rate::Source, 100), (Rate::PerSecond(4.0), 250)] {
            let options = PublishOptions {
                rate,
                first_sequence: 7,
                ..PublishOptions::default()
            };
            let (frames, sent) = played(5, options, at_once).await;
            assert_eq!((sent.frames, sent.bytes, sent.behind), (5, 5, 0));
            let first_time = frames[0].1.attachment.t_ns.unwrap();
            for (number, (when, frame)) in frames.iter().enumerate() {
                let expected = Duration::from_millis(period) * number as u32;
                assert!(
                    when.abs_diff(expected) < Duration::from_millis(5),
                    "{when:?}"
                );
                assert_eq!(frame.picture.bytes[0] as usize, number);
                assert_eq!(frame.attachment.seq, Some(7 + number as u64));
                let after = frame.attachment.t_ns.unwrap() - first_time;
                assert!(after.abs_diff(expected.as_nanos() as u64) < 1000);
                assert_eq!(frame.attachment.clip, None);
                assert_eq!(
                    frame.attachment.width,
                    Some(1),
                    "a raw picture tells its size"
                );
            }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn what_was_missed_is_not_made_up_for_in_a_burst() {
        // Frame 2 takes 450 ms at ten frames a second.
        let slow = |number| Duration::from_millis(if number == 2 { 450 } else { 0 });
        let (frames, sent) = played(6, PublishOptions::default(), slow).await;
        let when: Vec<u128> = frames
            .iter()
            .map(|(when, _)| (when.as_millis() + 5) / 10 * 10)
            .collect();
        assert_eq!(when, [0, 100, 650, 650, 750, 850]);
        assert_eq!(sent.behind, 1);
    }

    #[tokio::test(start_paused = true)]
    async fn a_loop_begins_a_clip_with_each_pass_and_stops_when_enough_is_sent() {
        let options = PublishOptions {
            repeat: true,
            frames: Some(7),
            clip: Some("drive".to_owned()),
            ..PublishOptions::default()
        };
        let (frames, sent) = played(3, options, at_once).await;
        let clips: Vec<_> = frames
            .iter()
            .map(|(_, frame)| frame.attachment.clip.as_deref().unwrap())
            .collect();
        let [one, two, three] = ["drive-0001", "drive-0002", "drive-0003"];
        assert_eq!(clips, [one, one, one, two, two, two, three]);
        assert_eq!(sent.clips, 3);
        let sequence: Vec<_> = frames.iter().map(|(_, f)| f.attachment.seq).collect();
        assert_eq!(sequence, (0..7).map(Some).collect::<Vec<_>>());
    }

    #[tokio::test(start_paused = true)]
    async fn a_clip_has_the_seconds_asked_for_at_any_speed() {
        for rate in [Rate::Source, Rate::Unpaced] {
            let options = PublishOptions {
                rate,
                clip: Some("c".to_owned()),
                clip_seconds: Some(0.3),
                ..PublishOptions::default()
            };
            let (frames, sent) = played(7, options, at_once).await;
            let lengths: Vec<usize> = frames
                .chunk_by(|a, b| a.1.attachment.clip == b.1.attachment.clip)
                .map(<[_]>::len)
                .collect();
            assert_eq!(lengths, [3, 3, 1]);
            assert_eq!(sent.clips, 3);
        }
        let one = PublishOptions {
            clip: Some("c".to_owned()),
            ..PublishOptions::default()
        };
        let (frames, _) = played(2, one, at_once).await;
        assert_eq!(frames[1].1.attachment.clip.as_deref(), Some("c"));
    }

    #[tokio::test(start_paused = true)]
    async fn shutdown_ends_a_play_that_would_never_end() {
        let shutdown = CancellationToken::new();
        let options = PublishOptions {
            repeat: true,
            ..PublishOptions::default()
        };
        let sent = play(
            numbers(3),
            &options,
            |_| async { Ok(()) },
            |sent| {
                if sent.frames == 20 {
                    shutdown.cancel();
                }
            },
            &shutdown,
        )
        .await
        .unwrap();
        assert_eq!(sent.frames, 20);
    }

    #[tokio::test(start_paused = true)]
    async fn an_empty_source_is_no_endless_loop() {
        let options = PublishOptions {
            repeat: true,
            ..PublishOptions::default()
        };
        let shutdown = CancellationToken::new();
        let error = play(
            numbers(0),
            &options,
            |_| async { Ok(()) },
            |_| {},
            &shutdown,
        )
        .await
        .unwrap_err();
        assert!(error.to_string().contains("no frames"));
    }
}
