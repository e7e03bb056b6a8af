//! Frames of a camera that is to miss none (`delivery = "every"`): they wait here for their turn, off Zenoh's receiving
//! threads. One that came as a query is answered when the ring has taken it, which holds its sender back. One that was
//! put cannot be held back; when too many wait, it is counted as overrun.

use super::{DropKind, Intake};
use crate::input::{read_query, read_sample};
use albireo_wire::{FrameAnswer, VERSION};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
use zenoh::Wait;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::query::Query;
use zenoh::sample::Sample;

/// Frames that may wait. A sender that heeds the answers has one here.
const MOST_FRAMES: usize = 64;

/// A frame as it came.
#[derive(Debug)]
enum Offered {
    Put(Sample),
    Query(Query),
}

impl Offered {
    fn bytes(&self) -> usize {
        match self {
            Self::Put(sample) => sample.payload().len(),
            Self::Query(query) => query.payload().map_or(0, ZBytes::len),
        }
    }
}

/// Where frames come in; never waits.
#[derive(Clone, Debug)]
pub(crate) struct HeldSender {
    intake: Arc<Intake>,
    offers: mpsc::Sender<Offered>,
    bytes: Arc<AtomicUsize>,
    most_bytes: usize,
}

/// What waits for its turn.
#[derive(Debug)]
pub(crate) struct HeldFrames {
    intake: Arc<Intake>,
    offers: tokio::sync::Mutex<mpsc::Receiver<Offered>>,
    bytes: Arc<AtomicUsize>,
}

impl HeldFrames {
    /// Frames that wait for `intake`, and where they come in.
    pub(crate) fn new(intake: Intake) -> (HeldSender, Self) {
        let (sender, offers) = mpsc::channel(MOST_FRAMES);
        let (intake, bytes) = (Arc::new(intake), Arc::new(AtomicUsize::new(0)));
        let sender = HeldSender {
            intake: Arc::clone(&intake),
            offers: sender,
            bytes: Arc::clone(&bytes),
            // A few of the largest that are accepted, or many of the usual ones.
            most_bytes: intake.limits.max_payload_bytes.saturating_mul(4),
        };
        let held = Self {
            intake,
            offers: tokio::sync::Mutex::new(offers),
            bytes,
        };
        (sender, held)
    }

    /// Hands frames on in the order in which they came, each when there is room, until `shutdown`.
    pub(crate) async fn run(&self, shutdown: CancellationToken) {
        let mut offers = self.offers.lock().await;
        loop {
            let offered = tokio::select! {
                biased;
                () = shutdown.cancelled() => break,
                offered = offers.recv() => offered,
            };
            let Some(offered) = offered else { return };
            self.bytes.fetch_sub(offered.bytes(), Ordering::Relaxed);
            match offered {
                Offered::Put(sample) => {
                    let read = self.intake.place_in_turn(|arrival, format, limits| {
                        read_sample(&sample, arrival, format, limits)
                    });
                    // Why it is not processed was counted and logged.
                    let _ = read.await;
                }
                Offered::Query(query) => {
                    let read = self.intake.place_in_turn(|arrival, format, limits| {
                        read_query(&query, arrival, format, limits)
                    });
                    let refused = read.await.err();
                    answer(query, refused).await;
                }
            }
        }
        // A query that is dropped ends without an answer: its sender knows that the frame was not taken.
        offers.close();
        while let Some(offered) = offers.recv().await {
            if matches!(offered, Offered::Put(_)) {
                let reason = "the node stops".to_owned();
                self.intake.refuse(DropKind::Stopped, reason);
            }
        }
    }
}

/// Tells the sender that its frame's turn has come.
async fn answer(query: Query, refused: Option<String>) {
    let answer = FrameAnswer {
        v: VERSION,
        refused,
    };
    // The send may wait for the network, so it has a thread of its own.
    let answered = tokio::task::spawn_blocking(move || {
        let payload = serde_json::to_vec(&answer).map_err(|error| error.to_string())?;
        let reply = query.reply(query.key_expr().clone(), payload);
        let reply = reply.encoding(Encoding::APPLICATION_JSON);
        reply.wait().map_err(|error| error.to_string())
    });
    match answered.await {
        Ok(Ok(())) => {}
        // The sender is gone, or asks again: the frame's number then says that it came before.
        Ok(Err(error)) => tracing::debug!(%error, "a frame's sender was not answered"),
        Err(error) => tracing::debug!(%error, "a frame's sender was not answered"),
    }
}

impl HeldSender {
    /// Takes a frame that was put.
    pub(crate) fn put(&self, sample: Sample) {
        if self.offer(Offered::Put(sample)).is_err() {
            self.intake.drops.count(
                DropKind::Overrun,
                1,
                &"too many frames wait that were put: send them as queries to be held back (camera.delivery)",
            );
        }
    }

    /// Takes a frame that came as a query. When too many wait the query ends without an answer.
    pub(crate) fn ask(&self, query: Query) {
        if self.offer(Offered::Query(query)).is_err() {
            tracing::debug!("a frame's sender does not wait for answers: not taken");
        }
    }

    fn offer(&self, offered: Offered) -> Result<(), ()> {
        let bytes = offered.bytes();
        // Counted before it is sent, so that the other end never subtracts what was not added.
        let before = self.bytes.fetch_add(bytes, Ordering::Relaxed);
        // One frame is always let in: what it may hold at most is checked when it is read.
        let fits = before == 0 || before.saturating_add(bytes) <= self.most_bytes;
        if fits && self.offers.try_send(offered).is_ok() {
            return Ok(());
        }
        self.bytes.fetch_sub(bytes, Ordering::Relaxed);
        Err(())
    }
}
