//! Serves the node's values on Zenoh keys: a query reads a value, a put or a query with a payload changes it.

use crate::state::board::{Board, CameraBoard};
use albireo_service::rate_limit::RateLimit;
use albireo_wire::{SettingSource, TargetMessage, ThresholdMessage, VERSION, check_version};
use serde::de::DeserializeOwned;
use std::any::Any;
use std::io::Read;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
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

/// The value on a key.
pub(crate) enum KeyValue {
    /// A camera's threshold.
    Threshold(Arc<Board>, Arc<CameraBoard>),
    /// The node's target.
    Target(Arc<Board>),
}

impl KeyValue {
    /// Changes the value to the one in `payload`. Writes a file.
    fn change(&self, payload: &[u8]) -> Result<(), String> {
        let local = SettingSource::Local;
        match self {
            Self::Threshold(board, camera) => {
                let example = r#"{"threshold":{"name":"u","value":3e-4}}"#;
                let message: ThresholdMessage = read(payload, example)?;
                check_version(message.v).map_err(|error| error.to_string())?;
                let (cameras, threshold) = (std::slice::from_ref(camera), message.threshold);
                (board.settings)
                    .change(|kept| board.set_thresholds(cameras, threshold, local, kept))
                    .map_err(|error| error.to_string())
            }
            Self::Target(board) => {
                let message: TargetMessage = read(payload, r#"{"target":{"skip_rate":0.5}}"#)?;
                check_version(message.v).map_err(|error| error.to_string())?;
                (board.settings)
                    .change(|kept| board.set_target(message.target, local, kept))
                    .map_err(|error| error.to_string())
            }
        }
    }

    /// Returns the value in force, as JSON.
    fn in_force(&self) -> Result<Vec<u8>, String> {
        let json = match self {
            Self::Threshold(_, camera) => serde_json::to_vec(&ThresholdMessage {
                v: VERSION,
                threshold: (camera.threshold_in_force())
                    .ok_or("the policy in use has no threshold")?,
            }),
            Self::Target(board) => serde_json::to_vec(&board.target.report()),
        };
        json.map_err(|error| error.to_string())
    }
}

/// Answers a put or a query; may write a file.
type Request = Box<dyn FnOnce() + Send>;

/// The node's keys: requests are received until it is dropped, and are answered while [`run`](Self::run) runs, one at a
/// time, in the order of arrival.
pub(crate) struct NodeKeyValues {
    declared: Vec<Box<dyn Any + Send + Sync>>,
    requests: mpsc::Sender<Request>,
    waiting: mpsc::Receiver<Request>,
    refused: Arc<RateLimit>,
}

impl NodeKeyValues {
    pub(crate) fn new() -> Self {
        let (requests, waiting) = mpsc::channel(WAITING);
        Self {
            declared: Vec::new(),
            requests,
            waiting,
            refused: Arc::new(RateLimit::new(LOG_PERIOD)),
        }
    }

    /// Declares a key. Zenoh's threads only queue requests, because a change writes a file, which can take a while on
    /// a slow SD card.
    ///
    /// # Errors
    /// An error if Zenoh rejects the declaration.
    pub(crate) async fn add(
        &mut self,
        session: &Session,
        key: String,
        value: KeyValue,
    ) -> zenoh::Result<()> {
        let (requests, too_many) = (self.requests.clone(), RateLimit::new(LOG_PERIOD));
        let (served, value) = (Arc::<str>::from(&*key), Arc::new(value));
        let refused = Arc::clone(&self.refused);
        let take = Arc::new(move |payload: Option<Vec<u8>>, query: Option<Query>| {
            let (key, value) = (Arc::clone(&served), Arc::clone(&value));
            let refused = Arc::clone(&refused);
            let request = move || serve(&key, &value, payload.as_deref(), query, &refused);
            // A query without room goes unanswered, as if nobody served the key.
            if requests.try_send(Box::new(request)).is_err() {
                too_many.log(|held_back| {
                    tracing::warn!(
                        key = &*served,
                        held_back,
                        "request dropped: too many at once"
                    );
                });
            }
        });
        let take_put = Arc::clone(&take);
        let subscriber = session
            .declare_subscriber(key.clone())
            .callback(move |sample| take_put(Some(beginning(sample.payload())), None))
            .await?;
        let queryable = session
            .declare_queryable(key)
            .callback(move |query| {
                let payload = query.payload().filter(|payload| !payload.is_empty());
                take(payload.map(beginning), Some(query));
            })
            .await?;
        self.declared.push(Box::new((subscriber, queryable)));
        Ok(())
    }

    /// Answers requests until `shutdown`.
    pub(crate) async fn run(mut self, shutdown: CancellationToken) {
        while let Some(Some(request)) = shutdown.run_until_cancelled(self.waiting.recv()).await {
            if let Err(error) = tokio::task::spawn_blocking(request).await {
                tracing::error!(%error, "request failed");
            }
        }
    }
}

fn serve(
    key: &str,
    value: &KeyValue,
    payload: Option<&[u8]>,
    query: Option<Query>,
    refused: &RateLimit,
) {
    let changed = match payload {
        Some(payload) if payload.len() > MAX_MESSAGE_BYTES => Err(format!(
            "a message has at most {MAX_MESSAGE_BYTES} bytes; this one has more"
        )),
        Some(payload) => value.change(payload),
        None => Ok(()),
    };
    let result = changed.and_then(|()| value.in_force());
    let sent = match (query, result) {
        (None, Ok(_)) => return,
        (None, Err(reason)) => {
            return refused.log(|held_back| {
                tracing::warn!(key, held_back, "put rejected: {reason}");
            });
        }
        (Some(query), Ok(reply)) => query
            .reply(key, reply)
            .encoding(Encoding::APPLICATION_JSON)
            .wait(),
        (Some(query), Err(reason)) => query
            .reply_err(reason)
            .encoding(Encoding::TEXT_PLAIN)
            .wait(),
    };
    if let Err(error) = sent {
        tracing::warn!(key, %error, "query not answered");
    }
}

/// Copies a payload, or only enough of an oversized one to detect it.
fn beginning(payload: &ZBytes) -> Vec<u8> {
    let mut read = Vec::new();
    // Reading from memory cannot fail.
    let _ = payload
        .reader()
        .take(MAX_MESSAGE_BYTES as u64 + 1)
        .read_to_end(&mut read);
    read
}

/// Reads a message. `v` may be missing, as in a put typed by hand, so the versioned reader does not fit.
fn read<T: DeserializeOwned>(payload: &[u8], example: &str) -> Result<T, String> {
    serde_json::from_slice(payload)
        .map_err(|error| format!("expected JSON such as {example}: {error}"))
}
