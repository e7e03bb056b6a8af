//! Sends frames to a node, as a camera does or without losing any.

use albireo_service::clock::unix_nanoseconds;
use albireo_vision::picture::{EncodedPicture, PictureFormat};
use albireo_wire::{FrameAnswer, FrameAttachment, read, stream_token};
use anyhow::{Context, anyhow, bail};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::watch;
use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;
use zenoh::matching::MatchingStatus;
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;
use zenoh::query::Querier;
use zenoh::session::Session;

/// The longest time until a node accepts a frame. A node whose detector hangs accepts the next one long before.
pub(crate) const TURN: Duration = Duration::from_secs(120);

/// The time between two attempts to send a frame to a node that did not accept it.
const RETRY: Duration = Duration::from_millis(50);

/// The handling of frames that are faster than the node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pacing {
    /// Frames are dropped, as a camera's should be.
    Drop,
    /// The sender waits for the network, and the node uses the newest frame.
    WaitForNetwork,
    /// The sender waits until the node has accepted each frame: its camera has `delivery = "every"`.
    WaitForNode,
}

/// A frame to be sent.
#[derive(Clone, Debug, PartialEq)]
pub struct OutgoingFrame {
    /// The picture.
    pub picture: EncodedPicture,
    /// The attachment. The sender adds its `stream`.
    pub attachment: FrameAttachment,
}

/// Whether a node subscribes to the frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Receivers {
    /// None has yet: Zenoh says nothing before the first one.
    NeverSeen,
    Present,
    /// All have left.
    Gone,
}

#[derive(Clone, Debug)]
enum SendMode {
    Put(Arc<Publisher<'static>>),
    Ask(Arc<Querier<'static>>),
}

/// Sends frames on one key. While it exists, it holds the token of its stream, from which the node knows when the next
/// sender may take over.
#[derive(Clone, Debug)]
pub struct FrameSender {
    session: Session,
    key: String,
    mode: SendMode,
    receivers: watch::Receiver<Receivers>,
    stream: u64,
    _token: Arc<LivelinessToken>,
}

impl FrameSender {
    /// Declares a sender of frames on `key`.
    ///
    /// # Errors
    /// When the key is not a key expression, or the session is closed.
    pub async fn declare(session: &Session, key: &str, pacing: Pacing) -> anyhow::Result<Self> {
        let refused = |error| anyhow!("cannot publish on `{key}`: {error}");
        let (changed, receivers) = watch::channel(Receivers::NeverSeen);
        let congestion = match pacing {
            Pacing::Drop => CongestionControl::Drop,
            Pacing::WaitForNetwork | Pacing::WaitForNode => CongestionControl::Block,
        };
        let mode = if pacing == Pacing::WaitForNode {
            let querier = session
                .declare_querier(key.to_owned())
                .congestion_control(congestion)
                .timeout(TURN)
                .await
                .map_err(refused)?;
            SendMode::Ask(Arc::new(querier))
        } else {
            let publisher = session
                .declare_publisher(key.to_owned())
                .congestion_control(congestion)
                .await
                .map_err(refused)?;
            SendMode::Put(Arc::new(publisher))
        };
        let listener = match &mode {
            SendMode::Put(publisher) => publisher.matching_listener(),
            SendMode::Ask(querier) => querier.matching_listener(),
        };
        let note = move |status: MatchingStatus| {
            let now = if status.matching() {
                Receivers::Present
            } else {
                Receivers::Gone
            };
            changed.send_replace(now);
        };
        listener.callback(note).background().await.map_err(refused)?;
        let (stream, token) = new_stream(session, key)?;
        Ok(Self {
            session: session.clone(),
            key: key.to_owned(),
            mode,
            receivers,
            stream,
            _token: Arc::new(token),
        })
    }

    /// Begins a new stream: frames may have been missed since the last one.
    ///
    /// # Errors
    /// When the session is closed.
    pub(crate) fn begin_stream(&mut self) -> anyhow::Result<()> {
        let (stream, token) = new_stream(&self.session, &self.key)?;
        self.stream = stream;
        self._token = Arc::new(token);
        Ok(())
    }

    /// Whether a node subscribes to the frames.
    pub(crate) fn receivers(&self) -> watch::Receiver<Receivers> {
        self.receivers.clone()
    }

    /// Waits until a node subscribes to the frames.
    ///
    /// # Errors
    /// When no node subscribes within `patience`.
    pub async fn wait_for_receiver(&self, patience: Duration) -> anyhow::Result<()> {
        let mut receivers = self.receivers();
        let taken = receivers.wait_for(|now| *now == Receivers::Present);
        tokio::time::timeout(patience, taken)
            .await
            .with_context(|| self.nobody())?
            .context("the Zenoh session is closed")?;
        Ok(())
    }

    /// The error if no node takes frames.
    fn nobody(&self) -> String {
        let question = match &self.mode {
            SendMode::Put(_) => "is it configured for this camera",
            SendMode::Ask(_) => "has its camera delivery = \"every\"",
        };
        format!(
            "no node takes frames on `{}`: is the node running, and {question}?",
            self.key
        )
    }

    /// Puts one frame; blocks while the network has no room.
    ///
    /// # Errors
    /// When Zenoh refuses it, or this sender waits for the node.
    pub fn put(&self, frame: &OutgoingFrame) -> anyhow::Result<()> {
        let SendMode::Put(publisher) = &self.mode else {
            bail!("this sender waits for the node to accept each frame");
        };
        publisher
            .put(frame.picture.bytes.as_ref())
            .encoding(encoding(frame.picture.format))
            .attachment(self.attachment(frame)?)
            .wait()
            .map_err(|error| anyhow!("a frame cannot be published: {error}"))
    }

    /// Sends one frame; returns the reason if the node reports that it does not process it.
    ///
    /// # Errors
    /// When Zenoh refuses it, or no node accepts it.
    #[cfg_attr(not(feature = "eval"), allow(dead_code))]
    pub(crate) async fn send(&self, frame: OutgoingFrame) -> anyhow::Result<Option<String>> {
        let sender = self.clone();
        // Zenoh blocks the thread while the network has no room.
        let sent = tokio::task::spawn_blocking(move || match &sender.mode {
            SendMode::Put(_) => sender.put(&frame).map(|()| None),
            SendMode::Ask(querier) => sender.ask(querier, &frame),
        });
        sent.await.context("sending a frame")?
    }

    /// Sends a frame again and again until the node has accepted it.
    fn ask(&self, querier: &Querier, frame: &OutgoingFrame) -> anyhow::Result<Option<String>> {
        let until = Instant::now() + TURN;
        while Instant::now() < until {
            let replies = querier
                .get()
                .payload(frame.picture.bytes.as_ref())
                .encoding(encoding(frame.picture.format))
                .attachment(self.attachment(frame)?)
                .wait()
                .map_err(|error| anyhow!("a frame cannot be sent: {error}"))?;
            while let Ok(Some(reply)) = replies.recv_deadline(until) {
                if let Ok(sample) = reply.result() {
                    let answer: FrameAnswer = read(&sample.payload().to_bytes())
                        .context("the node's answer to a frame")?;
                    return Ok(answer.refused);
                }
            }
            std::thread::sleep(RETRY);
        }
        bail!("{} Waited for {} s.", self.nobody(), TURN.as_secs());
    }

    fn attachment(&self, frame: &OutgoingFrame) -> serde_json::Result<Vec<u8>> {
        serde_json::to_vec(&FrameAttachment {
            stream: Some(self.stream),
            ..frame.attachment.clone()
        })
    }
}

/// Begins a stream: returns its number, and the token that shows that it is active.
fn new_stream(session: &Session, key: &str) -> anyhow::Result<(u64, LivelinessToken)> {
    let stream = unix_nanoseconds();
    let token = session
        .liveliness()
        .declare_token(stream_token(key, stream))
        .wait()
        .map_err(|error| anyhow!("cannot publish on `{key}`: {error}"))?;
    Ok((stream, token))
}

/// Returns the Zenoh encoding of a picture.
fn encoding(format: PictureFormat) -> String {
    match format {
        PictureFormat::Jpeg => "image/jpeg".to_owned(),
        PictureFormat::Png => "image/png".to_owned(),
        raw => format!("image/raw;{}", raw.as_str()),
    }
}
