//! A value of the node on a Zenoh key: a query reads it, a put or a query with a payload changes it.

use crate::rate_limit::SharedLimit;
use std::io::Read;
use std::sync::Arc;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
use zenoh::Session;
use zenoh::Wait;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::pubsub::Subscriber;
use zenoh::query::{Query, Queryable};

/// Largest message read; a valid one has a few dozen bytes.
const MAX_MESSAGE_BYTES: usize = 4096;

/// Requests that may wait for the file to be written; a person or a hub sends a few a second at most.
const WAITING: usize = 64;

/// What came over Zenoh.
enum Request {
    Put(Vec<u8>),
    Query(Query),
}

/// The value of a key. Changing it may write a file, so it is called where blocking is allowed.
pub(crate) trait KeyValue: Send + Sync + 'static {
    /// What it is, for the log: `threshold`.
    fn what(&self) -> &'static str;

    /// Changes it to what the payload says; the answer, as JSON.
    ///
    /// # Errors
    /// Why not, as text for the sender.
    fn change(&self, payload: &[u8]) -> Result<Vec<u8>, String>;

    /// What is in force, as JSON.
    ///
    /// # Errors
    /// Why there is none, as text for the sender.
    fn in_force(&self) -> Result<Vec<u8>, String>;
}

/// One key: requests come in until it is dropped, and are answered while [`run`](Self::run) runs.
pub(crate) struct KeyService {
    _queryable: Queryable<()>,
    _subscriber: Subscriber<()>,
    value: Arc<dyn KeyValue>,
    key: String,
    waiting: mpsc::Receiver<Request>,
    refused: Arc<SharedLimit>,
}

impl KeyService {
    /// Declares the key of `value`. Zenoh's own threads only hand requests on: a change
    /// writes a file, which may take a moment on a slow card. They are answered one after the other, in the
    /// order in which they came.
    ///
    /// # Errors
    /// When Zenoh refuses the declaration.
    pub(crate) async fn declare(
        session: &Session,
        key: String,
        value: Arc<dyn KeyValue>,
    ) -> zenoh::Result<Self> {
        let what = value.what();
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
                    too_many.log(|held_back| {
                        tracing::warn!(held_back, "{what} put dropped: too many at once");
                    });
                }
            })
            .await?;
        let queryable = session
            .declare_queryable(key.clone())
            .callback(move |query| {
                // One that does not fit goes unanswered, as if the key were not served.
                if requests.try_send(Request::Query(query)).is_err() {
                    too_many_queries.log(|held_back| {
                        tracing::warn!(held_back, "{what} query dropped: too many at once");
                    });
                }
            })
            .await?;
        Ok(Self {
            _queryable: queryable,
            _subscriber: subscriber,
            value,
            key,
            waiting,
            refused: Arc::new(SharedLimit::new()),
        })
    }

    /// Answers requests until `shutdown`.
    pub(crate) async fn run(mut self, shutdown: CancellationToken) {
        loop {
            let request = tokio::select! {
                () = shutdown.cancelled() => return,
                request = self.waiting.recv() => request,
            };
            let Some(request) = request else { return };
            let (value, key) = (Arc::clone(&self.value), self.key.clone());
            let refused = Arc::clone(&self.refused);
            let served =
                tokio::task::spawn_blocking(move || serve(&*value, &key, request, &refused));
            if let Err(error) = served.await {
                tracing::error!(%error, key = self.key, "request failed");
            }
        }
    }
}

fn serve(value: &dyn KeyValue, key: &str, request: Request, refused: &SharedLimit) {
    match request {
        Request::Put(payload) => {
            if let Err(reason) = change(value, &payload) {
                refused.log(|held_back| {
                    let what = value.what();
                    tracing::warn!(key, held_back, "{what} put refused: {reason}");
                });
            }
        }
        Request::Query(query) => answer(value, key, &query),
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

fn change(value: &dyn KeyValue, payload: &[u8]) -> Result<Vec<u8>, String> {
    if payload.len() > MAX_MESSAGE_BYTES {
        return Err(format!(
            "a {} message has at most {MAX_MESSAGE_BYTES} bytes; this one has more",
            value.what()
        ));
    }
    value.change(payload)
}

fn answer(value: &dyn KeyValue, key: &str, query: &Query) {
    let result = match query.payload() {
        Some(payload) if !payload.is_empty() => change(value, &beginning(payload)),
        _ => value.in_force(),
    };
    let sent = match result {
        Ok(reply) => query
            .reply(key, reply)
            .encoding(Encoding::APPLICATION_JSON)
            .wait(),
        Err(reason) => query
            .reply_err(reason)
            .encoding(Encoding::TEXT_PLAIN)
            .wait(),
    };
    if let Err(error) = sent {
        tracing::warn!(key, %error, "{} query not answered", value.what());
    }
}
