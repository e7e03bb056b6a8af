//! The threshold over Zenoh: a query tells it, a put or a query with a payload changes it.

use super::board::CameraBoard;
use crate::wire::{self, KnobValue, ThresholdMessage, VERSION};
use std::sync::Arc;
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::pubsub::Subscriber;
use zenoh::query::{Query, Queryable};

/// Largest threshold message read; a valid one has a few dozen bytes.
const MAX_MESSAGE_BYTES: usize = 4096;

/// Serves one camera's threshold until dropped.
#[derive(Debug)]
pub struct ThresholdService {
    _queryable: Queryable<()>,
    _subscriber: Subscriber<()>,
}

impl ThresholdService {
    /// Declares the threshold key of `board`'s camera.
    ///
    /// # Errors
    /// When Zenoh refuses the declaration.
    pub async fn declare(
        session: &Session,
        key: String,
        board: Arc<CameraBoard>,
    ) -> zenoh::Result<Self> {
        let changed = Arc::clone(&board);
        let subscriber = session
            .declare_subscriber(key.clone())
            .callback(move |sample| {
                if let Err(reason) = change(&changed, &sample.payload().to_bytes()) {
                    tracing::warn!(camera = changed.name(), "threshold put refused: {reason}");
                }
            })
            .await?;
        let reply_key = key.clone();
        let queryable = session
            .declare_queryable(key)
            .callback(move |query| answer(&board, &reply_key, &query))
            .await?;
        Ok(Self {
            _queryable: queryable,
            _subscriber: subscriber,
        })
    }
}

/// Changes the threshold to what the payload says; the value now in force.
fn change(board: &CameraBoard, payload: &[u8]) -> Result<KnobValue, String> {
    if payload.len() > MAX_MESSAGE_BYTES {
        return Err(format!(
            "a threshold message has at most {MAX_MESSAGE_BYTES} bytes, not {}",
            payload.len()
        ));
    }
    // `v` may be left out here, as in a hand-typed put, so the versioned reader does not fit.
    let message: ThresholdMessage = serde_json::from_slice(payload)
        .map_err(|error| format!("expected JSON such as {{\"u\":3e-4}}: {error}"))?;
    if message.v != VERSION {
        return Err(wire::MessageError::Version { found: message.v }.to_string());
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
    use zenoh::Wait;
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
