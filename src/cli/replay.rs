//! `albireo replay`: publishes recorded footage as a camera would.

mod publish;

pub(super) use publish::UNPACED;
pub use publish::{PublishOptions, Sent, publish};

use super::frames::{
    FrameSender, FrameTarget, NOBODY, Pacing, Receivers, TURN, close, open_session,
};
use super::progress;
use super::terminal::{self, program};
use super::values::counted;
use albireo_eval::footage::{SourceName, VideoEncoding};
use anyhow::bail;
use clap::Args;
use indicatif::{HumanBytes, ProgressBar};
use std::convert::Infallible;
use std::time::{Duration, Instant};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;
use zenoh::Session;

/// Arguments of `albireo replay`.
#[derive(Args, Clone, Debug)]
#[command(
    about = "Publish videos, a folder of pictures, a recording or the demonstration's road as a camera",
    after_help = "Examples:
  albireo replay drive.mp4 --node car-7 --camera front
      a video at its own speed, to the node on this machine; needs ffmpeg
  albireo replay drive.mp4 --every --wait-for-subscriber
      every frame arrives: wait for the node, and wait when it is slow
  albireo replay '/media/sd/Movie/*F.MP4'
      a dashcam's minutes as one stream, front only, each drive a clip
  albireo replay pictures/ --rate 5 --loop --clip-seconds 40
      a folder, five pictures a second, for ever, in clips of 40 s
  albireo replay bag.mcap:/front/image_raw/compressed
      the pictures on one topic of an MCAP file, of a node or of ROS 2
  albireo replay demo --connect tcp/192.168.0.20:7447
      the demonstration's road, to another machine

A live camera is not replayed: the node opens it ([[camera]] source), or
`albireo publish` does."
)]
pub struct ReplayArguments {
    /// A video file, a folder or a pattern of them, a folder of JPEG and PNG files, a tar archive of such folders, an
    /// MCAP file with pictures of Foxglove or ROS 2 (FILE.mcap:/TOPIC if several topics have pictures), or `demo`,
    /// which is demo/road.tar
    pub source: SourceName,

    /// Where the frames go.
    #[command(flatten)]
    pub target: FrameTarget,
    /// Wait for a subscriber before the first frame, at most SECONDS (60 if not given)
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, require_equals = true, default_missing_value = "60")]
    pub wait_for_subscriber: Option<u64>,
    /// Lose no frame: send each frame after the node has taken the previous one, instead of dropping frames
    /// as a camera does. Needs delivery = "every" for the node's camera.
    #[arg(long)]
    pub every: bool,

    /// What is sent, and how.
    #[command(flatten)]
    pub options: PublishOptions,
    /// How a video's frames are encoded
    #[arg(long, value_enum, default_value_t)]
    pub encoding: VideoEncoding,
}

/// Longest time until a subscriber is known.
const LISTENERS: Duration = Duration::from_secs(2);
/// The patience of a single attempt to connect.
const ONE_ATTEMPT: Duration = Duration::ZERO;

/// Replays until the source ends or `shutdown`, then prints what was sent.
///
/// # Errors
/// When the source cannot be read, the node cannot be reached, or no node subscribes in time.
pub async fn run(arguments: ReplayArguments, shutdown: CancellationToken) -> anyhow::Result<Sent> {
    let key = arguments.target.frame_key()?;
    let options = &arguments.options;
    let source = arguments.source.open(options.paced_rate(), arguments.encoding)?;
    let connecting = connect(&arguments, &key);
    let Some(connected) = shutdown.run_until_cancelled(connecting).await else {
        eprintln!("albireo: stopped before a node was found: no frame was sent");
        return Ok(Sent::default());
    };
    let (session, sender) = connected?;
    let receivers = sender.receivers();
    // A loop has no end of its own.
    let in_source = if options.repeat {
        None
    } else {
        source.frames()
    };
    let total = match (options.frames, in_source) {
        (Some(asked), Some(there)) => Some(asked.min(there)),
        (asked, there) => asked.or(there),
    };
    let bar = progress::bar(total, "frames  {msg}");
    let mut lost = 0;
    let after_each = |sent: &Sent| {
        if !arguments.every && *receivers.borrow() != Receivers::Present {
            lost += 1;
        }
        bar.set_position(sent.frames);
        bar.set_message(HumanBytes(sent.bytes).to_string());
    };
    let send = |frame| sender.send(frame);
    let telling = tell_of_receivers(receivers.clone(), &key, arguments.every, &bar);
    let ended = tokio::select! {
        sent = publish(source, send, options, after_each, &shutdown) => sent,
        never = telling => match never {},
    };
    bar.finish_and_clear();
    close(session).await?;
    let published = ended?;
    let sent = Sent { lost, ..published };
    println!("{}", summary(&sent, &key));
    if sent.frames == 0 && (sent.left_out > 0 || !sent.remarks.is_empty()) {
        bail!("{}: no picture in it can be sent", arguments.source);
    }
    if sent.frames > 0 && *receivers.borrow() == Receivers::NeverSeen {
        bail!("no node subscribed to `{key}`: {NOBODY}");
    }
    Ok(sent)
}

/// Opens a session and, if requested, waits until a node takes frames.
async fn connect(arguments: &ReplayArguments, key: &str) -> anyhow::Result<(Session, FrameSender)> {
    match arguments.wait_for_subscriber {
        Some(seconds) => open_and_wait(arguments, key, Duration::from_secs(seconds)).await,
        None => open_at_once(arguments, key).await,
    }
}

/// Opens a session. Says on standard error if no node takes frames yet.
async fn open_at_once(
    arguments: &ReplayArguments,
    key: &str,
) -> anyhow::Result<(Session, FrameSender)> {
    let answer = format!("for an answer from {}", arguments.target.endpoints());
    let opening = open(arguments, key, ONE_ATTEMPT);
    let (session, sender) = progress::waiting(&answer, opening).await?;
    // Subscribers are known a moment after the session is open.
    if sender.wait_for_receiver(LISTENERS).await.is_err() {
        let meanwhile = if arguments.every {
            format!("the first frame waits, {}", progress::at_most(TURN))
        } else {
            "frames are lost (--wait-for-subscriber waits for it)".to_owned()
        };
        let said = format!("albireo: no node subscribes to `{key}` yet, so {meanwhile}: {NOBODY}");
        eprintln!("{}", terminal::error(&said));
    }
    Ok((session, sender))
}

/// Opens a session and waits until a node takes frames, both together within `patience`.
async fn open_and_wait(
    arguments: &ReplayArguments,
    key: &str,
    patience: Duration,
) -> anyhow::Result<(Session, FrameSender)> {
    let subscribing = async {
        let begun = Instant::now();
        let (session, sender) = open(arguments, key, patience).await?;
        sender.wait_for_receiver(patience.saturating_sub(begun.elapsed())).await?;
        anyhow::Ok((session, sender))
    };
    let what = format!(
        "{}, for a node at {} that subscribes to `{key}` (start it with `{} node`)",
        progress::at_most(patience),
        arguments.target.endpoints(),
        program()
    );
    progress::waiting(&what, subscribing).await
}

/// Opens a session, with new attempts for `patience`, and a sender on it.
async fn open(
    arguments: &ReplayArguments,
    key: &str,
    patience: Duration,
) -> anyhow::Result<(Session, FrameSender)> {
    let target = &arguments.target;
    let session = open_session(&target.connect, &target.listen, patience).await?;
    let pacing = if arguments.every {
        Pacing::WaitForNode
    } else {
        Pacing::Drop
    };
    let sender = FrameSender::declare(&session, key, pacing).await?;
    Ok((session, sender))
}

/// Says on standard error when the last node that took frames stops, and when one takes them again. Never ends by
/// itself.
async fn tell_of_receivers(
    mut receivers: watch::Receiver<Receivers>,
    key: &str,
    every: bool,
    bar: &ProgressBar,
) -> Infallible {
    let mut had_left = false;
    while receivers.changed().await.is_ok() {
        let said = match *receivers.borrow_and_update() {
            Receivers::Gone => {
                had_left = true;
                let meanwhile = if every {
                    format!("the next frame waits at most {} s", TURN.as_secs())
                } else {
                    "frames are lost".to_owned()
                };
                format!("albireo: no node subscribes to `{key}` any more, so {meanwhile}")
            }
            Receivers::Present if had_left => {
                format!("albireo: a node subscribes to `{key}` again")
            }
            Receivers::Present | Receivers::NeverSeen => continue,
        };
        bar.suspend(|| eprintln!("{}", terminal::error(&said)));
    }
    // The session has been closed, which ends the sending, too.
    std::future::pending().await
}

/// Formats the totals as one line.
fn summary(sent: &Sent, key: &str) -> String {
    let seconds = sent.elapsed.as_secs_f64();
    let mut line = format!(
        "sent {} ({}) on {key} in {seconds:.1} s",
        counted(sent.frames, "frame", "frames"),
        HumanBytes(sent.bytes)
    );
    if sent.frames > 1 && seconds > 0.0 {
        // The time starts with the first frame, so that frame does not count for the rate.
        line += &format!(", {:.1} frames/s", (sent.frames - 1) as f64 / seconds);
    }
    if sent.clips > 0 {
        line += &format!(", clips: {}", sent.clips);
    }
    if sent.behind > 0 {
        line += &format!("; frames that went out late: {}", sent.behind);
    }
    if sent.lost > 0 {
        line += &format!("; frames that no node subscribed to: {}", sent.lost);
    }
    if sent.left_out > 0 {
        line += &format!("; files that were left out: {}", sent.left_out);
    }
    for remark in &sent.remarks {
        line += &format!("; {remark}");
    }
    if sent.refused > 0 {
        let first = sent.first_refusal.as_deref().unwrap_or_default();
        line += &format!(
            "; frames that the node refused: {} (first: {first})",
            sent.refused
        );
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        replay: ReplayArguments,
    }

    pub(super) fn parse(arguments: &str) -> Result<ReplayArguments, clap::Error> {
        let program = ["replay", "demo"].into_iter();
        let command = Command::try_parse_from(program.chain(arguments.split_whitespace()));
        command.map(|command| command.replay)
    }

    #[test]
    fn the_key_is_the_camera_s_or_the_one_given() {
        let key = |arguments| parse(arguments).unwrap().target.frame_key();
        assert_eq!(key("").unwrap(), "albireo/node/front/frame");
        let named = "--prefix f --node n --camera c";
        assert_eq!(key(named).unwrap(), "f/n/c/frame");
        assert_eq!(key("--key a/b").unwrap(), "a/b");
    }

    #[test]
    fn a_camera_whose_name_is_not_valid_in_a_key_is_refused() {
        let arguments = parse("--camera a/b").unwrap();
        assert!(arguments.target.frame_key().is_err());
    }

    #[test]
    fn arguments_that_contradict_each_other_or_cannot_be_met_are_refused() {
        for wrong in ["--key a --node n", "--rate 0", "--clip-seconds 0"] {
            assert!(parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn the_summary_has_one_line_and_the_true_rate() {
        let sent = Sent {
            frames: 251,
            bytes: 3 << 20,
            clips: 2,
            behind: 1,
            lost: 4,
            left_out: 2,
            remarks: vec!["a.mp4: 14 of 30 frames could be read".to_owned()],
            refused: 1,
            first_refusal: Some("cut off".to_owned()),
            elapsed: Duration::from_secs(10),
        };
        let expected = "sent 251 frames (3.00 MiB) on a/b in 10.0 s, 25.0 frames/s, clips: 2; \
                        frames that went out late: 1; frames that no node subscribed to: 4; \
                        files that were left out: 2; a.mp4: 14 of 30 frames could be read; \
                        frames that the node refused: 1 (first: cut off)";
        assert_eq!(summary(&sent, "a/b"), expected);
    }
}
