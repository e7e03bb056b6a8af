//! The threshold over Zenoh: a query tells it, a put or a query with a payload changes it.

use super::board::CameraBoard;
use albireo_wire::{self, KnobValue, ThresholdMessage, VERSION};
use std::sync::Arc;
use tokio::sync::mpsc;
use zenoh::Session;
use zenoh::Wait;
use zenoh::bytes::Encoding;
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

/// Serves one camera's threshold until dropped.
#[derive(Debug)]
pub(crate) struct ThresholdService {
    _queryable: Queryable<()>,
    _subscriber: Subscriber<()>,
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
        let (requests, mut waiting) = mpsc::channel(WAITING);
        let puts = requests.clone();
        let subscriber = session
            .declare_subscriber(key.clone())
            .callback(move |sample| {
                // Of one that is too long no more than shows it.
                let payload = sample.payload().to_bytes();
                let read = payload.len().min(MAX_MESSAGE_BYTES + 1);
                let put = Request::Put(payload[..read].to_vec());
                if puts.try_send(put).is_err() {
                    tracing::warn!("threshold put dropped: too many at once");
                }
            })
            .await?;
        let queryable = session
            .declare_queryable(key.clone())
            .callback(move |query| {
                // One that does not fit goes unanswered, as if nobody were there.
                if requests.try_send(Request::Query(query)).is_err() {
                    tracing::warn!("threshold query dropped: too many at once");
                }
            })
            .await?;
        // Ends when both declarations are gone.
        tokio::spawn(async move {
            while let Some(request) = waiting.recv().await {
                let (board, key) = (Arc::clone(&board), key.clone());
                let served = tokio::task::spawn_blocking(move || serve(&board, &key, request));
                if let Err(error) = served.await {
                    tracing::error!(%error, "threshold request failed");
                }
            }
        });
        Ok(Self {
            _queryable: queryable,
            _subscriber: subscriber,
        })
    }
}

fn serve(board: &CameraBoard, key: &str, request: Request) {
    match request {
        Request::Put(payload) => {
            if let Err(reason) = change(board, &payload) {
                tracing::warn!(camera = board.name(), "threshold put refused: {reason}");
            }
        }
        Request::Query(query) => answer(board, key, &query),
    }
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
        Some(payload) if !payload.is_empty() => change(board, &payload.to_bytes()),
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
