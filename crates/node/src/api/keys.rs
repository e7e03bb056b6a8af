//! Serves the node's values on Zenoh keys: a query reads a value, a put or a query with a payload changes it.

use crate::error::NodeError;
use crate::settings::{MAX_MESSAGE_BYTES, Place, Setting, Settings};
use crate::state::board::Board;
use albireo_core::policy::EmptyRoad;
use albireo_service::rate_limit::RateLimit;
use albireo_wire::{
    NodeKeys, Pauses, PolicyChoice, PolicyMessage, ScreenMessage, ThresholdMessage, VERSION,
};
use std::error::Error;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;
use zenoh::Session;
use zenoh::Wait;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::pubsub::Subscriber;
use zenoh::query::{Query, Queryable};

/// The maximum number of queries that wait for the file; a person or a hub sends a few per second at most.
const WAITING: usize = 64;

/// The time between two log lines about queries that are not answered.
const LOG_PERIOD: Duration = Duration::from_secs(10);

/// A key, and its value.
struct Served {
    key: String,
    setting: Setting,
}

/// What there is to do.
enum Work {
    /// Puts have arrived.
    ApplyPuts,
    Answer(Request),
}

/// A query, with its place among the settings that arrived.
struct Request {
    served: Arc<Served>,
    place: Place,
    payload: Option<Vec<u8>>,
    query: Query,
}

/// Declares the keys of the cameras' thresholds, and the keys `policy`, `target` and `screen`. The returned future applies
/// puts and answers queries, in the order of arrival, for as long as it is polled.
///
/// # Errors
/// [`NodeError`] if Zenoh rejects a declaration.
pub(crate) async fn declare(
    session: &Session,
    board: &Arc<Board>,
    settings: &Arc<Settings>,
    node: &NodeKeys,
) -> Result<impl Future<Output = ()> + use<>, NodeError> {
    let mut served = vec![
        Served {
            key: node.policy(),
            setting: Setting::Policy,
        },
        Served {
            key: node.target(),
            setting: Setting::Target,
        },
        Served {
            key: node.screen(),
            setting: Setting::Screen,
        },
    ];
    for camera in &board.cameras {
        served.push(Served {
            key: camera.keys.threshold(),
            setting: Setting::Threshold(Arc::clone(camera)),
        });
    }
    let (requests, mut waiting) = mpsc::channel(WAITING);
    let mut declared = Vec::new();
    for served in served {
        let served = Arc::new(served);
        let puts = take_puts(session, Arc::clone(&served), Arc::clone(settings)).await?;
        let queries = take_queries(session, served, Arc::clone(settings), requests.clone()).await?;
        declared.push((puts, queries));
    }
    let board = Arc::clone(board);
    let settings = Arc::clone(settings);
    Ok(async move {
        // Dropped, it would undeclare the keys.
        let _declared = declared;
        loop {
            let work = tokio::select! {
                () = settings.turns.changed.notified() => Work::ApplyPuts,
                Some(request) = waiting.recv() => Work::Answer(request),
            };
            let board = Arc::clone(&board);
            let settings = Arc::clone(&settings);
            let working = tokio::task::spawn_blocking(move || match work {
                Work::ApplyPuts => settings.apply_puts(),
                Work::Answer(request) => request.answer(&board, &settings),
            });
            if let Err(error) = working.await {
                tracing::error!(%error, "request failed");
            }
        }
    })
}

/// Keeps what is put on a key until its turn. Zenoh's threads only keep settings, because setting them writes a file, which
/// can take a while on a slow SD card.
async fn take_puts(
    session: &Session,
    served: Arc<Served>,
    settings: Arc<Settings>,
) -> Result<Subscriber<()>, NodeError> {
    let key = served.key.clone();
    let refused = NodeError::refused(format!("`{key}` cannot be served"));
    session
        .declare_subscriber(key)
        .callback(move |sample| {
            let Served { key, setting } = &*served;
            let stamp = sample.timestamp().map(|stamp| stamp.get_time().to_system_time());
            settings.turns.put(key, setting, stamp, beginning(sample.payload()));
        })
        .await
        .map_err(refused)
}

/// Gives the queries on a key their places, and sends them to who answers them.
async fn take_queries(
    session: &Session,
    served: Arc<Served>,
    settings: Arc<Settings>,
    requests: mpsc::Sender<Request>,
) -> Result<Queryable<()>, NodeError> {
    let key = served.key.clone();
    let refused = NodeError::refused(format!("`{key}` cannot be served"));
    let too_many = RateLimit::new(LOG_PERIOD);
    session
        .declare_queryable(key)
        .callback(move |query| {
            let payload = query.payload().filter(|payload| !payload.is_empty());
            let request = Request {
                served: Arc::clone(&served),
                place: settings.turns.place(),
                payload: payload.map(beginning),
                query,
            };
            // A query without room goes unanswered, as if nobody served the key.
            if requests.try_send(request).is_err() {
                too_many.log(|held_back| {
                    let key = served.key.as_str();
                    tracing::warn!(key, held_back, "query dropped: too many at once");
                });
            }
        })
        .await
        .map_err(refused)
}

impl Request {
    /// Changes the value if there is a payload, and replies with the value in force. May write a file.
    fn answer(self, board: &Board, settings: &Settings) {
        let Served { key, setting } = &*self.served;
        let query = self.query;
        let result = settings.in_turn(self.place, || {
            if let Some(payload) = self.payload {
                settings.apply(setting, &payload)?;
            }
            in_force(board, setting)
        });
        let sent = match result {
            Ok(reply) => query.reply(key, reply).encoding(Encoding::APPLICATION_JSON).wait(),
            Err(reason) => {
                query.reply_err(reason.to_string()).encoding(Encoding::TEXT_PLAIN).wait()
            }
        };
        if let Err(error) = sent {
            tracing::warn!(key, %error, "query not answered");
        }
    }
}

/// Returns the value in force, as JSON.
fn in_force(board: &Board, setting: &Setting) -> Result<Vec<u8>, Box<dyn Error + Send + Sync>> {
    let v = VERSION;
    let value = match setting {
        Setting::Policy => {
            let name = board.policy().name.to_owned();
            let policy = PolicyChoice { name };
            serde_json::to_vec(&PolicyMessage { v, policy })
        }
        Setting::Target => serde_json::to_vec(&board.target.report()),
        Setting::Screen => {
            let EmptyRoad {
                pause_s,
                after_s,
                still_s,
            } = board.empty_road();
            let screen = Pauses {
                pause_s: Some(pause_s),
                after_s: Some(after_s),
                still_s: Some(still_s),
            };
            serde_json::to_vec(&ScreenMessage { v, screen })
        }
        Setting::Threshold(camera) => {
            let threshold =
                camera.threshold_in_force().ok_or("the policy in use has no threshold")?;
            serde_json::to_vec(&ThresholdMessage { v, threshold })
        }
    };
    Ok(value?)
}

/// Copies a payload, or only enough of an oversized one to detect it.
fn beginning(payload: &ZBytes) -> Vec<u8> {
    payload.slices().flatten().copied().take(MAX_MESSAGE_BYTES + 1).collect()
}
