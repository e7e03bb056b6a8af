//! Sends counters once a second, and pictures on request, over the uplink: only while somebody watches the node through
//! the hub.

use super::UplinkSetup;
use crate::state::board::CameraBoard;
use albireo_service::clock::unix_nanoseconds;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::mpsc::{Receiver, Sender, channel};
use zenoh::bytes::Encoding;
use zenoh::qos::CongestionControl;
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

/// Longest time for which one message of the hub turns this on, seconds.
const LONGEST: u32 = 3600;
/// Questions for pictures that may wait; one more is not answered.
const WAITING: usize = 4;
/// Time between two counters of a camera, with room for one that comes a little early.
const PERIOD: Duration = Duration::from_millis(950);

/// The answer where pictures are not sent.
const REFUSED: &str = "the node sends no pictures: its configuration has uplink.pictures = false";

/// A question for the picture of a camera.
pub(super) type PictureQuery = (Arc<CameraBoard>, Query);

/// Knows whether somebody watches, and sends counters and pictures then.
pub(super) struct Watched {
    until: Option<Instant>,
    counted_at: Option<Instant>,
    queries: Sender<PictureQuery>,
    waiting_queries: Receiver<PictureQuery>,
    /// Declared while somebody watches; undeclared when dropped.
    pictures: Vec<Queryable<()>>,
}

impl Watched {
    /// Nobody watches yet.
    pub(super) fn new() -> Self {
        let (queries, waiting_queries) = channel(WAITING);
        Self {
            until: None,
            counted_at: None,
            queries,
            waiting_queries,
            pictures: Vec::new(),
        }
    }

    /// A session begins: nothing is declared on it.
    pub(super) fn begin(&mut self) {
        self.pictures.clear();
    }

    /// Somebody watches for that many seconds from now on.
    pub(super) fn extend(&mut self, seconds: u32) {
        let until = Instant::now() + Duration::from_secs(seconds.min(LONGEST).into());
        self.until = Some(until);
    }

    /// Says whether somebody watches.
    pub(super) fn is_on(&self, now: Instant) -> bool {
        self.until.is_some_and(|until| now < until)
    }

    /// Sends what is due: nothing is declared or sent without a watcher.
    ///
    /// # Errors
    /// When Zenoh refuses something.
    pub(super) async fn serve(
        &mut self,
        session: &Session,
        setup: &UplinkSetup,
    ) -> zenoh::Result<()> {
        let now = Instant::now();
        if !self.is_on(now) {
            self.pictures.clear();
            return Ok(());
        }
        let early = |at: Instant| now.duration_since(at) < PERIOD;
        // The local session carries counters anyway.
        let counts = setup.local.is_none() && !self.counted_at.is_some_and(early);
        let declares = self.pictures.is_empty();
        for camera in &setup.board.cameras {
            let keys = &camera.keys;
            if declares {
                let (queries, asked) = (self.queries.clone(), Arc::clone(camera));
                let queryable = session
                    .declare_queryable(keys.picture())
                    .callback(move |query| {
                        // Zenoh's thread must not encode a picture; a question too many ends unanswered.
                        let _ = queries.try_send((Arc::clone(&asked), query));
                    })
                    .await?;
                self.pictures.push(queryable);
            }
            if counts {
                let message = setup.board.counters(camera, unix_nanoseconds());
                session
                    .put(keys.counters(), serde_json::to_vec(&message)?)
                    .congestion_control(CongestionControl::Drop)
                    .priority(crate::camera::publishing::COUNTERS)
                    .await?;
            }
        }
        if counts {
            self.counted_at = Some(now);
        }
        Ok(())
    }

    /// The next question for a picture.
    pub(super) async fn question(&mut self) -> Option<PictureQuery> {
        self.waiting_queries.recv().await
    }
}

/// Answers a question for a picture. Encodes one: to be called away from async workers.
pub(super) fn answer(camera: &CameraBoard, query: &Query, setup: &UplinkSetup) {
    let answered = match camera.latest_frame() {
        _ if !setup.config.uplink.pictures => query.reply_err(REFUSED).wait(),
        None => query.reply_err("no frame has come yet").wait(),
        Some(frame) => match frame.jpeg(&setup.config.frame) {
            Ok(file) => query
                .reply(query.key_expr().clone(), file.to_vec())
                .encoding(Encoding::IMAGE_JPEG)
                .attachment(frame.seq.to_string())
                .wait(),
            Err(reason) => query.reply_err(reason).wait(),
        },
    };
    if let Err(error) = answered {
        tracing::debug!(camera = camera.name(), %error, "a picture was not sent");
    }
}
