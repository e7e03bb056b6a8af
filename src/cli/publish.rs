//! `albireo publish`: sends a live camera's frames to a node on another machine.

use super::frames::{
    FrameSender, FrameTarget, NOBODY, OutgoingFrame, Pacing, Receivers, close, open_session,
};
use super::values::counted;
use albireo_node::input::source::{
    LiveSource, RtspTransport, SourceAddress, SourceEvent, SourceOptions, SourcePicture,
    SourceSettings,
};
use albireo_service::clock::unix_nanoseconds;
use albireo_service::config::LogConfig;
use albireo_service::rate_limit::RateLimit;
use albireo_service::{logging, signals};
use albireo_vision::picture::FrameLimits;
use albireo_wire::{FrameAttachment, VERSION};
use anyhow::{anyhow, bail};
use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::watch;
use zenoh::session::Session;

/// Pause between two attempts to reach the node for the first time; later Zenoh reconnects by itself.
const RETRY: Duration = Duration::from_secs(2);

/// The time after which it is said again what keeps the node away.
const REMINDER: Duration = Duration::from_secs(300);

/// Arguments of `albireo publish`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  albireo publish rtsp://192.168.0.20/stream --node car-7 \\
      --connect tcp/192.168.0.5:7447
      a network camera, to the camera `front` of a node on another machine
  albireo publish 'rtsp://${CAMERA_USER}:${CAMERA_PASSWORD}@192.168.0.20/stream'
      credentials from the environment: the quotation marks stop the shell from
      inserting them
  albireo publish /dev/video0 --rate 10 --camera cabin
      a camera of this machine, at most ten frames per second
  albireo publish 'v4l2src device=/dev/video0 ! image/jpeg ! jpegparse'
      a GStreamer pipeline that makes JPEG files

A camera on the node's own machine needs no publisher: [[camera]] source in its
configuration. Runs until stopped, and reconnects to a camera or node that
comes back.")]
pub(super) struct PublishArguments {
    /// A camera (rtsp://, http://), a device, a video file, a folder or pattern of them, or a GStreamer pipeline;
    /// ${NAME} is an environment variable
    #[arg(value_parser = |text: &str| Ok::<_, Infallible>(SourceAddress::new(text)))]
    source: SourceAddress,
    /// Where the frames go.
    #[command(flatten)]
    target: FrameTarget,
    /// Frames per second, at most
    #[arg(long, value_name = "FPS", value_parser = super::values::parse_rate)]
    rate: Option<f64>,
    /// How an RTSP camera sends its packets
    #[arg(long, value_enum, default_value_t)]
    rtsp_transport: RtspTransport,
    /// Decode with this acceleration (`ffmpeg -hwaccels`: cuda, vaapi) or decoder (`ffmpeg -decoders`: h264_v4l2m2m)
    #[arg(long, value_name = "NAME")]
    hardware: Option<String>,
    /// An ffmpeg option, placed before the source; may be repeated: --source-option=-video_size
    /// --source-option=1280x720
    #[arg(long, value_name = "OPTION", allow_hyphen_values = true)]
    source_option: Vec<String>,
    /// Reconnect to the camera after this many seconds without a picture
    #[arg(long, value_name = "SECONDS", default_value_t = 15)]
    source_timeout: u64,
}

pub(super) async fn run(arguments: PublishArguments) -> anyhow::Result<()> {
    logging::start(&LogConfig {
        // An unreachable node is reported here, once.
        level: "info,zenoh=error".to_owned(),
        ..LogConfig::default()
    })?;
    if arguments.source.holds_password() {
        tracing::warn!(
            "every user of this machine can read the password in the list of processes: write ${{NAME}} instead, and \
             set that environment variable"
        );
    }
    let shutdown = signals::shutdown()?;
    let key = arguments.target.frame_key()?;
    let options = SourceOptions(arguments.source_option);
    options.check().map_err(|error| anyhow!("--source-option {error}"))?;
    let settings = SourceSettings {
        address: arguments.source,
        max_rate: arguments.rate,
        transport: arguments.rtsp_transport,
        hardware: arguments.hardware,
        options,
        silence: Duration::from_secs(arguments.source_timeout.max(1)),
        // JPEG saves more on the network than encoding costs.
        as_jpeg: true,
        limits: FrameLimits::default(),
    };
    let found = tokio::task::spawn_blocking(move || LiveSource::find(settings)).await?;
    let source = found.map_err(anyhow::Error::msg)?;
    let connecting = connected(&arguments.target);
    let Some(session) = shutdown.run_until_cancelled(connecting).await else {
        return Ok(());
    };
    let sender = FrameSender::declare(&session, &key, Pacing::Drop).await?;
    tracing::info!(source = source.name(), key, "publishing");
    let receivers = sender.receivers();
    tokio::spawn(log_receivers(receivers.clone(), key.clone()));
    let sent = Arc::new(AtomicU64::new(0));
    let name = source.name();
    let sending = Arc::clone(&sent);
    let mut outlet = Outlet { sender, seq: 0 };
    let mut failed = false;
    let each = move |event| match event {
        SourceEvent::Failed { reason, pause } => {
            let seconds = pause.as_secs_f64();
            tracing::warn!(
                source = name,
                "failed: {reason}; next attempt in {seconds} s"
            );
        }
        SourceEvent::PassedOver(file) => {
            tracing::warn!(source = name, "passed over {file}");
        }
        SourceEvent::Picture(taken) => match outlet.send(taken) {
            Ok(()) => {
                sending.fetch_add(1, Ordering::Relaxed);
                failed = false;
            }
            Err(error) => {
                // Logged once for a series of failures.
                if !failed {
                    tracing::warn!("a frame was not sent: {error:#}");
                }
                failed = true;
            }
        },
    };
    let ended = source.run(each, shutdown).await;
    close(session).await?;
    let frames = counted(sent.load(Ordering::Relaxed), "frame", "frames");
    println!("sent {frames} on {key}");
    ended.map_err(|reason| anyhow!("reading the camera failed: {reason}"))?;
    if *receivers.borrow() == Receivers::NeverSeen {
        bail!("no node subscribed to `{key}`: {NOBODY}");
    }
    Ok(())
}

/// Waits for a session with the node. Logs what keeps it away: at once when that begins or changes, and then rarely.
async fn connected(target: &FrameTarget) -> Session {
    let mut said = String::new();
    let mut again = RateLimit::new(REMINDER);
    loop {
        match open_session(&target.connect, &target.listen, Duration::ZERO).await {
            Ok(session) => return session,
            Err(error) => {
                let error = format!("{error:#}");
                if error != said {
                    again = RateLimit::new(REMINDER);
                    said.clone_from(&error);
                }
                again.log(|_| tracing::warn!("{error}; next attempts every {RETRY:?}"));
            }
        }
        tokio::time::sleep(RETRY).await;
    }
}

/// Logs whether a node subscribes to the frames, now and at every change.
async fn log_receivers(mut receivers: watch::Receiver<Receivers>, key: String) {
    loop {
        if *receivers.borrow_and_update() == Receivers::Present {
            tracing::info!(key, "a node subscribes to the frames");
        } else {
            tracing::warn!(
                key,
                "no node subscribes to this key, so frames are lost: {NOBODY}"
            );
        }
        if receivers.changed().await.is_err() {
            return;
        }
    }
}

/// Sends a source's pictures.
struct Outlet {
    sender: FrameSender,
    /// The sequence number of the next picture.
    seq: u64,
}

impl Outlet {
    fn send(&mut self, taken: SourcePicture) -> anyhow::Result<()> {
        if taken.is_reopened {
            self.seq = 0;
            self.sender.begin_stream()?;
        }
        let mut time_ns = None;
        let mut clip = None;
        if let Some(recorded) = taken.recorded {
            time_ns = recorded.time_ns;
            clip = Some(recorded.drive.to_string());
        }
        let seq = self.seq;
        self.seq += 1;
        let unusable = |fault| anyhow!("a picture cannot be sent: {fault}");
        let picture = taken.picture.map_err(unusable)?;
        self.sender.put(&OutgoingFrame {
            picture,
            attachment: FrameAttachment {
                v: VERSION,
                seq: Some(seq),
                t_ns: Some(time_ns.unwrap_or_else(unix_nanoseconds)),
                clip,
                ..FrameAttachment::default()
            },
        })
    }
}
