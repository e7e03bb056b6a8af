//! The threshold over Zenoh: a query tells it, a put or a query with a payload changes it.

use super::board::CameraBoard;
use super::rate_limit::SharedLimit;
use albireo_wire::{self, KnobValue, ThresholdMessage, VERSION};
use std::io::Read;
use std::sync::Arc;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
use zenoh::Session;
use zenoh::Wait;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::pubsub::Subscriber;
use zenoh::query::{Query, Queryable};

/// Largest threshold message read; a valid one has a few dozen bytes.
const MAX_MESSAGE_BYTES: usize = 4096;

/// Requests that may wait for the file to be written; a person or a hub sends a few a second at most.
const WAITING: usize = 64;

/// What came over Zenoh.
enum Request {
    Put(Vec<u8>),
    Query(Query),
}

/// One camera's threshold: requests come in until it is dropped, and are answered while [`run`](Self::run) runs.
pub(crate) struct ThresholdService {
    _queryable: Queryable<()>,
    _subscriber: Subscriber<()>,
    board: Arc<CameraBoard>,
    key: String,
    waiting: tokio::sync::Mutex<mpsc::Receiver<Request>>,
    refused: Arc<SharedLimit>,
}

impl ThresholdService {
    /// Declares the threshold key of `board`'s camera. Zenoh's own threads only hand requests on: a change
    /// writes a file, which may take a moment on a slow card. They are answered one after the other, in the
    /// order in which they came.
    ///
    /// # Errors
    /// When Zenoh refuses the declaration.
    pub(crate) async fn declare(
        session: &Session,
        key: String,
        board: Arc<CameraBoard>,
    ) -> zenoh::Result<Self> {
        let (requests, waiting) = mpsc::channel(WAITING);
        let puts = requests.clone();
        let (too_many, too_many_queries) = (SharedLimit::new(), SharedLimit::new());
        let subscriber = session
            .declare_subscriber(key.clone())
            .callback(move |sample| {
                if puts
                    .try_send(Request::Put(beginning(sample.payload())))
                    .is_err()
                {
                    too_many.tell(|held_back| {
                        tracing::warn!(held_back, "threshold put dropped: too many at once");
                    });
                }
            })
            .await?;
        let queryable = session
            .declare_queryable(key.clone())
            .callback(move |query| {
                // One that does not fit goes unanswered, as if nobody were there.
                if requests.try_send(Request::Query(query)).is_err() {
                    too_many_queries.tell(|held_back| {
                        tracing::warn!(held_back, "threshold query dropped: too many at once");
                    });
                }
            })
            .await?;
        Ok(Self {
            _queryable: queryable,
            _subscriber: subscriber,
            board,
            key,
            waiting: tokio::sync::Mutex::new(waiting),
            refused: Arc::new(SharedLimit::new()),
        })
    }

    /// Answers requests until `shutdown`. Those that came while nobody answered are not lost.
    pub(crate) async fn run(&self, shutdown: CancellationToken) {
        let mut waiting = self.waiting.lock().await;
        loop {
            let request = tokio::select! {
                () = shutdown.cancelled() => return,
                request = waiting.recv() => request,
            };
            let Some(request) = request else { return };
            let (board, key) = (Arc::clone(&self.board), self.key.clone());
            let refused = Arc::clone(&self.refused);
            let served =
                tokio::task::spawn_blocking(move || serve(&board, &key, request, &refused));
            if let Err(error) = served.await {
                tracing::error!(%error, "threshold request failed");
            }
        }
    }
}

fn serve(board: &CameraBoard, key: &str, request: Request, refused: &SharedLimit) {
    match request {
        Request::Put(payload) => {
            if let Err(reason) = change(board, &payload) {
                refused.tell(|held_back| {
                    let camera = board.name();
                    tracing::warn!(camera, held_back, "threshold put refused: {reason}");
                });
            }
        }
        Request::Query(query) => answer(board, key, &query),
    }
}

/// A payload, of one that is too long no more than shows it: a large one is never copied whole.
fn beginning(payload: &ZBytes) -> Vec<u8> {
    let mut read = Vec::new();
    // Reading from memory does not fail.
    let _ = payload
        .reader()
        .take(MAX_MESSAGE_BYTES as u64 + 1)
        .read_to_end(&mut read);
    read
}

/// Changes the threshold to what the payload says; the value now in force.
fn change(board: &CameraBoard, payload: &[u8]) -> Result<KnobValue, String> {
    if payload.len() > MAX_MESSAGE_BYTES {
        return Err(format!(
            "a threshold message has at most {MAX_MESSAGE_BYTES} bytes; this one has more"
        ));
    }
    // `v` may be left out here, as in a hand-typed put, so the versioned reader does not fit.
    let message: ThresholdMessage = serde_json::from_slice(payload)
        .map_err(|error| format!("expected JSON such as {{\"u\":3e-4}}: {error}"))?;
    if message.v != VERSION {
        return Err(albireo_wire::MessageError::Version { found: message.v }.to_string());
    }
    if let Some(knob) = board.knob() {
        message.value_of(&knob).map_err(|error| error.to_string())?;
    }
    (board.set_threshold(message.knob.value)).map_err(|error| error.to_string())?;
    in_force(board)
}

fn in_force(board: &CameraBoard) -> Result<KnobValue, String> {
    (board.knob_value()).ok_or_else(|| "the policy in use has no threshold".to_owned())
}

fn answer(board: &CameraBoard, key: &str, query: &Query) {
    let result = match query.payload() {
        Some(payload) if !payload.is_empty() => change(board, &beginning(payload)),
        _ => in_force(board),
    };
    let sent = match result {
        Ok(knob) => match serde_json::to_vec(&ThresholdMessage { v: VERSION, knob }) {
            Ok(reply) => query
                .reply(key, reply)
                .encoding(Encoding::APPLICATION_JSON)
                .wait(),
            Err(error) => query.reply_err(error.to_string()).wait(),
        },
        Err(reason) => query
            .reply_err(reason)
            .encoding(Encoding::TEXT_PLAIN)
            .wait(),
    };
    if let Err(error) = sent {
        tracing::warn!(camera = board.name(), %error, "threshold query not answered");
    }
}
