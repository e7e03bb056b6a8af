//! Sends counters once per second, and pictures on request, over the uplink, but only while somebody watches the node
//! through the hub.

use super::UplinkSetup;
use crate::state::board::CameraBoard;
use albireo_service::clock::unix_nanoseconds;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use zenoh::bytes::Encoding;
use zenoh::qos::CongestionControl;
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

/// The longest time that one message of the hub can request, seconds.
const LONGEST: u32 = 3600;
/// The maximum number of pictures encoded at once; further queries are not answered.
const MOST_PICTURES: usize = 4;
/// The time between two counter messages of a camera, with some tolerance for early ones.
const PERIOD: Duration = Duration::from_millis(950);

/// The answer if pictures are disabled.
const REFUSED: &str = "the node sends no pictures: its configuration has uplink.pictures = false";

/// Tracks whether somebody watches, and sends counters and pictures while they do.
#[derive(Default)]
pub(super) struct Watched {
    until: Option<Instant>,
    counted_at: Option<Instant>,
    /// Declared while somebody watches; undeclared when dropped.
    pictures: Vec<Queryable<()>>,
}

impl Watched {
    /// Begins a session: nothing is declared on it yet.
    pub(super) fn begin(&mut self) {
        self.pictures.clear();
    }

    /// Extends the watching to `seconds` from now.
    pub(super) fn extend(&mut self, seconds: u32) {
        let until = Instant::now() + Duration::from_secs(seconds.min(LONGEST).into());
        self.until = Some(until);
    }

    /// True while somebody watches.
    pub(super) fn is_on(&self, now: Instant) -> bool {
        self.until.is_some_and(|until| now < until)
    }

    /// Sends what is due: nothing is declared or sent without a watcher.
    ///
    /// # Errors
    /// An error if Zenoh rejects an operation.
    pub(super) async fn serve(
        &mut self,
        session: &Session,
        setup: &Arc<UplinkSetup>,
    ) -> zenoh::Result<()> {
        let now = Instant::now();
        if !self.is_on(now) {
            self.pictures.clear();
            return Ok(());
        }
        if self.pictures.is_empty() {
            self.declare_pictures(session, setup).await?;
        }
        let is_early = self.counted_at.is_some_and(|at| now.duration_since(at) < PERIOD);
        // The local session publishes counters anyway.
        if setup.local.is_some() || is_early {
            return Ok(());
        }
        for camera in &setup.board.cameras {
            let message = setup.board.counters(camera, unix_nanoseconds());
            session
                .put(camera.keys.counters(), serde_json::to_vec(&message)?)
                .congestion_control(CongestionControl::Drop)
                .priority(crate::publishing::COUNTERS)
                .await?;
        }
        self.counted_at = Some(now);
        Ok(())
    }

    /// Declares the pictures of all cameras.
    async fn declare_pictures(
        &mut self,
        session: &Session,
        setup: &Arc<UplinkSetup>,
    ) -> zenoh::Result<()> {
        let places = Arc::new(Semaphore::new(MOST_PICTURES));
        for camera in &setup.board.cameras {
            let key = camera.keys.picture();
            let places = Arc::clone(&places);
            let runtime = Handle::current();
            let setup = Arc::clone(setup);
            let camera = Arc::clone(camera);
            let answer_query = move |query: Query| {
                // Excess queries end unanswered.
                let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
                    return;
                };
                let setup = Arc::clone(&setup);
                let camera = Arc::clone(&camera);
                // Zenoh's thread must not encode a picture.
                runtime.spawn_blocking(move || {
                    answer(&camera, &query, &setup);
                    drop(place);
                });
            };
            let queryable = session.declare_queryable(key).callback(answer_query).await?;
            self.pictures.push(queryable);
        }
        Ok(())
    }
}

/// Answers a picture query. Encodes the picture: call it outside async workers.
fn answer(camera: &CameraBoard, query: &Query, setup: &UplinkSetup) {
    if !setup.uplink.pictures {
        return note(camera, query.reply_err(REFUSED).wait());
    }
    let limits = &setup.limits;
    let found = if query.parameters().get("boxes") == Some("true") {
        let frame = camera.answered().borrow().clone();
        frame.map(|frame| (frame.seq(), frame.drawn(limits)))
    } else {
        let frame = camera.input.latest_frame();
        frame.map(|frame| (frame.seq, frame.jpeg(limits)))
    };
    let answered = match found {
        None => query.reply_err("no frame has arrived yet").wait(),
        Some((seq, Ok(file))) => query
            .reply(query.key_expr().clone(), file.to_vec())
            .encoding(Encoding::IMAGE_JPEG)
            .attachment(seq.to_string())
            .wait(),
        Some((_, Err(reason))) => query.reply_err(reason).wait(),
    };
    note(camera, answered);
}

/// Logs that an answer could not be sent.
fn note(camera: &CameraBoard, sent: zenoh::Result<()>) {
    if let Err(error) = sent {
        tracing::debug!(camera = camera.name(), %error, "a picture was not sent");
    }
}
