//! Serves values of the node on Zenoh keys: a query reads one, a put or a query with a payload changes it.

use crate::state::board::{Board, CameraBoard, set_thresholds};
use albireo_service::rate_limit::SharedLimit;
use albireo_wire::{SettingSource, TargetMessage, ThresholdMessage, VERSION, check_version};
use serde::de::DeserializeOwned;
use std::any::Any;
use std::io::Read;
use std::sync::Arc;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
use zenoh::Session;
use zenoh::Wait;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::query::Query;

/// Largest message read; a valid one has a few dozen bytes.
const MAX_MESSAGE_BYTES: usize = 4096;

/// Requests that may wait for the file to be written; a person or a hub sends a few a second at most.
const WAITING: usize = 64;

/// The value that a key holds.
pub(crate) enum KeyValue {
    /// The threshold of a camera.
    Threshold(Arc<CameraBoard>),
    /// The target of the node.
    Target(Arc<Board>),
}

impl KeyValue {
    /// Changes it to what `payload` says. Writes a file.
    fn change(&self, payload: &[u8]) -> Result<(), String> {
        match self {
            Self::Threshold(camera) => {
                let example = r#"{"threshold":{"name":"u","value":3e-4}}"#;
                let message: ThresholdMessage = read(payload, example)?;
                check_version(message.v).map_err(|error| error.to_string())?;
                let camera = std::slice::from_ref(camera);
                set_thresholds(camera, message.threshold, SettingSource::Local)
                    .map_err(|error| error.to_string())
            }
            Self::Target(board) => {
                let message: TargetMessage = read(payload, r#"{"target":{"skip_rate":0.5}}"#)?;
                check_version(message.v).map_err(|error| error.to_string())?;
                (board.set_target(message.target, SettingSource::Local))
                    .map_err(|error| error.to_string())
            }
        }
    }

    /// Returns what is in force, as JSON.
    fn in_force(&self) -> Result<Vec<u8>, String> {
        let json = match self {
            Self::Threshold(camera) => serde_json::to_vec(&ThresholdMessage {
                v: VERSION,
                threshold: (camera.threshold_in_force())
                    .ok_or("the policy in use has no threshold")?,
            }),
            Self::Target(board) => serde_json::to_vec(&board.target.report()),
        };
        json.map_err(|error| error.to_string())
    }
}

/// A put or a query that came over Zenoh.
struct Request {
    key: Arc<str>,
    value: Arc<KeyValue>,
    payload: Option<Vec<u8>>,
    query: Option<Query>,
}

/// The keys of a node: requests come in until it is dropped, and are answered while [`run`](Self::run) runs, one after
/// the other, in the order in which they came.
pub(crate) struct NodeKeyValues {
    declared: Vec<Box<dyn Any + Send + Sync>>,
    requests: mpsc::Sender<Request>,
    waiting: mpsc::Receiver<Request>,
    refused: Arc<SharedLimit>,
}

impl NodeKeyValues {
    pub(crate) fn new() -> Self {
        let (requests, waiting) = mpsc::channel(WAITING);
        Self {
            declared: Vec::new(),
            requests,
            waiting,
            refused: Arc::default(),
        }
    }

    /// Declares a key. Zenoh's own threads only hand requests on: a change writes a file, which may take a moment on a slow
    /// card.
    ///
    /// # Errors
    /// When Zenoh refuses the declaration.
    pub(crate) async fn add(
        &mut self,
        session: &Session,
        key: String,
        value: KeyValue,
    ) -> zenoh::Result<()> {
        let (requests, too_many) = (self.requests.clone(), SharedLimit::new());
        let (served, value) = (Arc::<str>::from(&*key), Arc::new(value));
        let take = Arc::new(move |payload: Option<Vec<u8>>, query: Option<Query>| {
            let request = Request {
                key: Arc::clone(&served),
                value: Arc::clone(&value),
                payload,
                query,
            };
            // A query that does not fit goes unanswered, as if the key were not served.
            if requests.try_send(request).is_err() {
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
            let refused = Arc::clone(&self.refused);
            let served = tokio::task::spawn_blocking(move || serve(request, &refused));
            if let Err(error) = served.await {
                tracing::error!(%error, "request failed");
            }
        }
    }
}

fn serve(request: Request, refused: &SharedLimit) {
    let Request {
        key,
        value,
        payload,
        query,
    } = request;
    let key = &*key;
    let changed = match &payload {
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
                tracing::warn!(key, held_back, "put refused: {reason}");
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

/// Reads a message. `v` may be left out, as in a hand-typed put, so the versioned reader does not fit.
fn read<T: DeserializeOwned>(payload: &[u8], example: &str) -> Result<T, String> {
    serde_json::from_slice(payload)
        .map_err(|error| format!("expected JSON such as {example}: {error}"))
}
