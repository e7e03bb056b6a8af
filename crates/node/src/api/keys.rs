//! Serves the node's values on Zenoh keys: a query reads a value, a put or a query with a payload changes it.

use crate::error::NodeError;
use crate::state::board::{Board, CameraBoard};
use albireo_service::rate_limit::RateLimit;
use albireo_wire::{SettingSource, TargetMessage, ThresholdMessage, VERSION, check_version};
use serde::de::DeserializeOwned;
use std::error::Error;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;
use zenoh::Session;
use zenoh::Wait;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::query::Query;

/// The largest message that is read; a valid one has a few dozen bytes.
const MAX_MESSAGE_BYTES: usize = 4096;

/// The maximum number of requests that wait for the file; a person or a hub sends a few per second at most.
const WAITING: usize = 64;

/// The time between two log lines about requests that are not answered.
const LOG_PERIOD: Duration = Duration::from_secs(10);

/// A key, and its value.
struct Served {
    key: String,
    /// The camera whose threshold it is; without one, it is the node's target.
    camera: Option<Arc<CameraBoard>>,
}

/// A put or a query.
struct Request {
    served: Arc<Served>,
    payload: Option<Vec<u8>>,
    query: Option<Query>,
}

/// Declares the keys of the cameras' thresholds, and the key `target`. The returned future answers requests, one at a
/// time, in the order of arrival, for as long as it is polled.
///
/// # Errors
/// [`NodeError`] if Zenoh rejects a declaration.
pub(crate) async fn declare(
    session: &Session,
    board: &Arc<Board>,
    target: String,
) -> Result<impl Future<Output = ()> + use<>, NodeError> {
    let (requests, mut waiting) = mpsc::channel(WAITING);
    let mut declared = Vec::new();
    let cameras = board.cameras.iter();
    let thresholds = cameras.map(|camera| (camera.keys.threshold(), Some(Arc::clone(camera))));
    for (key, camera) in thresholds.chain([(target, None)]) {
        let served = Arc::new(Served {
            key: key.clone(),
            camera,
        });
        let (requests, too_many) = (requests.clone(), RateLimit::new(LOG_PERIOD));
        // Zenoh's threads only queue requests, because a change writes a file, which can take a while on a slow SD card.
        let take = Arc::new(move |payload: Option<Vec<u8>>, query: Option<Query>| {
            let request = Request {
                served: Arc::clone(&served),
                payload,
                query,
            };
            // A query without room goes unanswered, as if nobody served the key.
            if requests.try_send(request).is_err() {
                too_many.log(|held_back| {
                    let key = served.key.as_str();
                    tracing::warn!(key, held_back, "request dropped: too many at once");
                });
            }
        });
        let take_put = Arc::clone(&take);
        let refused = || NodeError::refused(format!("`{key}` cannot be served"));
        let subscriber = session
            .declare_subscriber(key.clone())
            .callback(move |sample| take_put(Some(beginning(sample.payload())), None))
            .await
            .map_err(refused())?;
        let queryable = session
            .declare_queryable(key.clone())
            .callback(move |query| {
                let payload = query.payload().filter(|payload| !payload.is_empty());
                take(payload.map(beginning), Some(query));
            })
            .await
            .map_err(refused())?;
        declared.push((subscriber, queryable));
    }
    let board = Arc::clone(board);
    Ok(async move {
        let _held = (requests, declared);
        let refused = Arc::new(RateLimit::new(LOG_PERIOD));
        while let Some(request) = waiting.recv().await {
            let (board, refused) = (Arc::clone(&board), Arc::clone(&refused));
            let answering = tokio::task::spawn_blocking(move || request.answer(&board, &refused));
            if let Err(error) = answering.await {
                tracing::error!(%error, "request failed");
            }
        }
    })
}

impl Request {
    /// Changes the value if there is a payload, and replies with the value in force. May write a file.
    fn answer(self, board: &Board, refused: &RateLimit) {
        let Served { key, camera } = &*self.served;
        let key = key.as_str();
        let changed = match self.payload {
            Some(payload) => change(board, camera.as_ref(), &payload),
            None => Ok(()),
        };
        let result = changed.and_then(|()| in_force(board, camera.as_deref()));
        let Some(query) = self.query else {
            if let Err(reason) = result {
                refused.log(|held_back| {
                    tracing::warn!(key, held_back, "put rejected: {reason}");
                });
            }
            return;
        };
        let sent = match result {
            Ok(reply) => {
                let reply = query.reply(key, reply);
                reply.encoding(Encoding::APPLICATION_JSON).wait()
            }
            Err(reason) => {
                let refusal = query.reply_err(reason.to_string());
                refusal.encoding(Encoding::TEXT_PLAIN).wait()
            }
        };
        if let Err(error) = sent {
            tracing::warn!(key, %error, "query not answered");
        }
    }
}

/// Changes a camera's threshold, or the node's target, to the one in `payload`. Writes a file.
fn change(
    board: &Board,
    camera: Option<&Arc<CameraBoard>>,
    payload: &[u8],
) -> Result<(), Box<dyn Error + Send + Sync>> {
    if payload.len() > MAX_MESSAGE_BYTES {
        let most = MAX_MESSAGE_BYTES;
        return Err(format!("a message has at most {most} bytes; this one has more").into());
    }
    let (settings, local) = (&board.settings, SettingSource::Local);
    if let Some(camera) = camera {
        let example = r#"{"threshold":{"name":"u","value":3e-4}}"#;
        let ThresholdMessage { v, threshold } = read(payload, example)?;
        check_version(v)?;
        let cameras = std::slice::from_ref(camera);
        settings.change(|kept| board.set_thresholds(cameras, threshold, local, kept))?;
    } else {
        let TargetMessage { v, target } = read(payload, r#"{"target":{"skip_rate":0.5}}"#)?;
        check_version(v)?;
        settings.change(|kept| board.set_target(target, local, kept))?;
    }
    Ok(())
}

/// Returns the camera's threshold in force, or the node's target, as JSON.
fn in_force(
    board: &Board,
    camera: Option<&CameraBoard>,
) -> Result<Vec<u8>, Box<dyn Error + Send + Sync>> {
    let Some(camera) = camera else {
        return Ok(serde_json::to_vec(&board.target.report())?);
    };
    let in_force = camera.threshold_in_force();
    let threshold = in_force.ok_or("the policy in use has no threshold")?;
    let v = VERSION;
    Ok(serde_json::to_vec(&ThresholdMessage { v, threshold })?)
}

/// Copies a payload, or only enough of an oversized one to detect it.
fn beginning(payload: &ZBytes) -> Vec<u8> {
    let bytes = payload.slices().flatten().copied();
    bytes.take(MAX_MESSAGE_BYTES + 1).collect()
}

/// Reads a message. `v` may be missing, as in a put typed by hand, so the versioned reader does not fit.
fn read<T: DeserializeOwned>(payload: &[u8], example: &str) -> Result<T, String> {
    serde_json::from_slice(payload)
        .map_err(|error| format!("expected JSON such as {example}: {error}"))
}
