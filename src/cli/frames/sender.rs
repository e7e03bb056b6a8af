//! Sends frames to a node: as a camera does, or so that none is missed.

use super::shared::SharedFrames;
use albireo_vision::picture::{EncodedPicture, PictureFormat};
use albireo_wire::{FrameAnswer, FrameAttachment, read};
use anyhow::{Context, anyhow, bail};
use parking_lot::Mutex;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::time::Instant;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;
use zenoh::query::Querier;
use zenoh::session::Session;

/// How long a frame may wait for its turn. A node whose detector hangs goes on long before.
const TURN: Duration = Duration::from_secs(120);

/// Between two attempts to give a frame to a node that did not take it.
const AGAIN: Duration = Duration::from_millis(50);

/// What happens when frames come faster than they are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Haste {
    /// They are dropped, as a camera's should be.
    Drop,
    /// The sender waits for the network, and the node takes the newest.
    WaitForNetwork,
    /// The sender waits until the node has taken each: its camera has `delivery = "every"`.
    WaitForNode,
}

/// A frame to be sent.
#[derive(Clone, Debug, PartialEq)]
pub struct OutgoingFrame {
    /// The picture.
    pub picture: EncodedPicture,
    /// What is said beside it.
    pub attachment: FrameAttachment,
}

/// What became of a frame that was sent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum SentFrame {
    /// It went out, or was taken.
    Gone,
    /// The node does not process it, and says why.
    Refused(String),
}

#[derive(Clone, Debug)]
enum Way {
    Put(Arc<Publisher<'static>>),
    Ask(Arc<Querier<'static>>),
}

/// Sends frames on one key.
#[derive(Clone, Debug)]
pub struct FrameSender {
    way: Way,
    shared: Option<Arc<SharedFrames>>,
}

impl FrameSender {
    /// A sender for frames on `key`.
    ///
    /// # Errors
    /// When the key is not a key expression, or the session is closed.
    pub async fn declare(session: &Session, key: &str, haste: Haste) -> anyhow::Result<Self> {
        let refused = |error| anyhow!("cannot publish on `{key}`: {error}");
        let congestion = match haste {
            Haste::Drop => CongestionControl::Drop,
            Haste::WaitForNetwork => CongestionControl::Block,
            Haste::WaitForNode => {
                let querier = session
                    .declare_querier(key.to_owned())
                    .congestion_control(CongestionControl::Block)
                    .timeout(TURN)
                    .await
                    .map_err(refused)?;
                return Ok(Self::by(Way::Ask(Arc::new(querier))));
            }
        };
        let publisher = session
            .declare_publisher(key.to_owned())
            .congestion_control(congestion)
            .await
            .map_err(refused)?;
        Ok(Self::by(Way::Put(Arc::new(publisher))))
    }

    const fn by(way: Way) -> Self {
        Self { way, shared: None }
    }

    /// Places frames in shared memory, for a node on this machine to read in place. A node that cannot gets them as
    /// bytes.
    #[must_use]
    pub fn sharing_memory(mut self, yes: bool) -> Self {
        self.shared = yes.then(Arc::default);
        self
    }

    /// Waits until somebody takes what is sent.
    ///
    /// # Errors
    /// When nobody does within `patience`.
    pub async fn wait_for_receiver(&self, patience: Duration) -> anyhow::Result<()> {
        let zenoh = |error: zenoh::Error| anyhow!("waiting for a receiver: {error}");
        // Listening comes before looking, so that none is missed in between.
        let (key, listener, matching) = match &self.way {
            Way::Put(publisher) => (
                publisher.key_expr(),
                publisher.matching_listener().await.map_err(zenoh)?,
                publisher.matching_status().await.map_err(zenoh)?,
            ),
            Way::Ask(querier) => (
                querier.key_expr(),
                querier.matching_listener().await.map_err(zenoh)?,
                querier.matching_status().await.map_err(zenoh)?,
            ),
        };
        if matching.matching() {
            return Ok(());
        }
        let matched = tokio::time::timeout(patience, async {
            loop {
                match listener.recv_async().await {
                    Ok(status) if status.matching() => return Ok(()),
                    Ok(_) => {}
                    Err(error) => bail!("waiting for a receiver: {error}"),
                }
            }
        });
        let want = match &self.way {
            Way::Put(_) => "is it configured for this camera",
            Way::Ask(_) => "has its camera delivery = \"every\"",
        };
        matched.await.with_context(|| {
            format!(
                "nobody took frames on `{key}` within {} s: is the node running, and {want}?",
                patience.as_secs()
            )
        })?
    }

    /// Tells `changed` whether somebody takes what is sent: now, and at every change as long as the session is open.
    ///
    /// # Errors
    /// When the session is closed.
    pub(crate) async fn watch_receivers(
        &self,
        changed: impl FnMut(bool) + Send + 'static,
    ) -> anyhow::Result<()> {
        let zenoh = |error: zenoh::Error| anyhow!("looking for a receiver: {error}");
        let Way::Put(publisher) = &self.way else {
            bail!("only who puts frames does not hear whether they are taken");
        };
        let told = Arc::new(Mutex::new((changed, None)));
        let tell = move |taken: bool| {
            let (changed, last) = &mut *told.lock();
            if last.replace(taken) != Some(taken) {
                changed(taken);
            }
        };
        // Listening comes before looking, so that none is missed in between.
        let heard = tell.clone();
        publisher
            .matching_listener()
            .callback(move |status| heard(status.matching()))
            .background()
            .await
            .map_err(zenoh)?;
        tell(publisher.matching_status().await.map_err(zenoh)?.matching());
        Ok(())
    }

    /// Whether somebody takes, or has taken since this call, what is sent.
    ///
    /// # Errors
    /// When the session is closed.
    #[cfg_attr(not(feature = "eval"), allow(dead_code))]
    pub(crate) async fn heard(&self) -> anyhow::Result<Arc<AtomicBool>> {
        let heard = Arc::new(AtomicBool::new(false));
        if let Way::Ask(_) = &self.way {
            // Each frame is answered.
            heard.store(true, Ordering::Relaxed);
            return Ok(heard);
        }
        let noted = Arc::clone(&heard);
        self.watch_receivers(move |taken| {
            noted.fetch_or(taken, Ordering::Relaxed);
        })
        .await?;
        Ok(heard)
    }

    /// Puts one frame; blocks where the network does.
    ///
    /// # Errors
    /// When Zenoh refuses it, or the frames of this sender are asked for.
    pub fn put(&self, frame: &OutgoingFrame) -> anyhow::Result<()> {
        self.put_placed(frame, self.place(&frame.picture))
    }

    /// The picture's bytes as they travel: in shared memory where this sender places them there and there is some.
    pub fn place(&self, picture: &EncodedPicture) -> ZBytes {
        payload(self.shared.as_deref(), picture.bytes.as_ref())
    }

    /// Puts one frame whose picture was [placed](Self::place) before; blocks where the network does.
    ///
    /// # Errors
    /// As of [`put`](Self::put).
    pub fn put_placed(&self, frame: &OutgoingFrame, placed: ZBytes) -> anyhow::Result<()> {
        match &self.way {
            Way::Put(publisher) => put(publisher, placed, frame),
            Way::Ask(_) => bail!("this sender's frames wait to be taken"),
        }
    }

    /// Sends one frame.
    ///
    /// # Errors
    /// When Zenoh refuses it, or no node takes it.
    #[cfg_attr(not(feature = "eval"), allow(dead_code))]
    pub(crate) async fn send(&self, frame: OutgoingFrame) -> anyhow::Result<SentFrame> {
        match &self.way {
            Way::Put(publisher) => {
                let (publisher, shared) = (Arc::clone(publisher), self.shared.clone());
                // A put that has to wait for room blocks its thread.
                tokio::task::spawn_blocking(move || {
                    let placed = payload(shared.as_deref(), frame.picture.bytes.as_ref());
                    put(&publisher, placed, &frame)
                })
                .await
                .context("publishing a frame")??;
                Ok(SentFrame::Gone)
            }
            Way::Ask(querier) => ask(querier, self.shared.clone(), frame).await,
        }
    }
}

/// The Zenoh encoding of a picture.
fn encoding(format: PictureFormat) -> String {
    match format {
        PictureFormat::Jpeg => "image/jpeg".to_owned(),
        PictureFormat::Png => "image/png".to_owned(),
        raw => format!("image/raw;{}", raw.as_str()),
    }
}

/// A picture's bytes, in shared memory where there is some.
fn payload(shared: Option<&SharedFrames>, picture: &[u8]) -> ZBytes {
    shared
        .and_then(|shared| shared.place(picture))
        .unwrap_or_else(|| ZBytes::from(picture))
}

fn put(publisher: &Publisher<'_>, placed: ZBytes, frame: &OutgoingFrame) -> anyhow::Result<()> {
    publisher
        .put(placed)
        .encoding(encoding(frame.picture.format))
        .attachment(serde_json::to_vec(&frame.attachment)?)
        .wait()
        .map_err(|error| anyhow!("a frame cannot be published: {error}"))
}

/// Gives a frame to the node and waits until it is taken; again where it was not.
async fn ask(
    querier: &Arc<Querier<'static>>,
    shared: Option<Arc<SharedFrames>>,
    frame: OutgoingFrame,
) -> anyhow::Result<SentFrame> {
    let until = Instant::now() + TURN;
    let attachment = serde_json::to_vec(&frame.attachment)?;
    loop {
        let (asking, attachment) = (Arc::clone(querier), attachment.clone());
        let (bytes, format) = (frame.picture.bytes.clone(), frame.picture.format);
        let shared = shared.clone();
        // What has to wait for room in the network blocks its thread.
        let asked = tokio::task::spawn_blocking(move || {
            asking
                .get()
                .payload(payload(shared.as_deref(), bytes.as_ref()))
                .encoding(encoding(format))
                .attachment(attachment)
                .wait()
        });
        let replies = asked
            .await
            .context("sending a frame")?
            .map_err(|error| anyhow!("a frame cannot be sent: {error}"))?;
        while let Ok(reply) = replies.recv_async().await {
            if let Ok(sample) = reply.result() {
                let answer: FrameAnswer = read(&sample.payload().to_bytes())
                    .context("what the node answered to a frame")?;
                return Ok(answer.refused.map_or(SentFrame::Gone, SentFrame::Refused));
            }
        }
        if Instant::now() >= until {
            bail!(
                "nobody took a frame on `{}` within {} s: is the node running, and has its camera delivery = \
                 \"every\"?",
                querier.key_expr(),
                TURN.as_secs()
            );
        }
        tokio::time::sleep(AGAIN).await;
    }
}
