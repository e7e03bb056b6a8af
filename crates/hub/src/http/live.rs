//! Serves the live counters and pictures of one node. A node sends them only while somebody holds a lease. The lease
//! expires by itself, so a closed page or a stopped hub costs the node nothing for long.

use super::nodes::unknown;
use crate::hub::{Hub, MOST_LIVE, attached};
use albireo_service::http::Problem;
use albireo_wire::{CountersMessage, NodeKeys};
use axum::extract::{Path, Query, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::http::{HeaderName, StatusCode};
use axum::response::sse::{self, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures_util::{Stream, StreamExt, stream};
use serde::Deserialize;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::OwnedSemaphorePermit;
use tokio::time::{Interval, MissedTickBehavior};
use utoipa::IntoParams;
use zenoh::Session;
use zenoh::handlers::{IntoHandler, RingChannel, RingChannelHandler};
use zenoh::pubsub::Subscriber;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::Reply;
use zenoh::sample::Sample;

/// The duration of a lease.
const LEASE: Duration = Duration::from_secs(30);
/// Time between two renewals of a lease.
const RENEW: Duration = Duration::from_secs(10);
/// Time limit of a picture: a node on a mobile link first has to learn of its lease.
const PICTURE_WITHIN: Duration = Duration::from_secs(8);
/// Messages that wait for a slow reader. The oldest ones are dropped: counters are cumulative.
const WAITING: usize = 64;
/// Largest message of counters, bytes, so that a node cannot fill the memory of a hub whose reader is slow.
const LARGEST: usize = 16 << 10;
/// The header with the sequence number of a picture's frame.
const FRAME: HeaderName = HeaderName::from_static("albireo-frame");

impl Hub {
    /// The session and the keys to reach a known node.
    fn way_to(&self, node: &str) -> Result<(&Session, NodeKeys), Problem> {
        let session = attached(&self.session, "the Zenoh session")?;
        self.fleet.view(node).ok_or_else(|| unknown(node))?;
        let keys = NodeKeys::new(&self.prefix, node).map_err(|_| unknown(node))?;
        Ok((session, keys))
    }
}

/// The counters of one node's cameras, once per second, as server-sent events
///
/// The node sends them only while this stream is read, and for 30 s after that. There is one event `counters` per
/// camera and second.
/// `curl -N http://127.0.0.1:8090/api/v1/nodes/car-7/live`
#[utoipa::path(
    get, operation_id = "watch_node", path = "/api/v1/nodes/{node}/live", tag = "nodes", params(("node" = String, Path, description = "Its name")),
    responses((status = 200, content_type = "text/event-stream", body = String))
)]
pub(super) async fn live(
    State(hub): State<Hub>,
    Path(node): Path<String>,
) -> Result<Sse<impl Stream<Item = Result<sse::Event, axum::Error>>>, Problem> {
    let (session, keys) = hub.way_to(&node)?;
    let place = Arc::clone(&hub.live_readers).try_acquire_owned().map_err(|_| {
        let detail = format!("{MOST_LIVE} nodes are being watched; close one and try again");
        Problem::new(StatusCode::SERVICE_UNAVAILABLE, detail)
    })?;
    let (ring, waiting) = RingChannel::new(WAITING).into_handler();
    let take = move |sample: Sample| {
        if sample.payload().len() <= LARGEST {
            ring.call(sample);
        }
    };
    let counters = session
        .declare_subscriber(keys.all_counters())
        .with((take, waiting))
        .await
        .map_err(unavailable)?;
    let mut renew = tokio::time::interval(RENEW);
    renew.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let shutdown = hub.shutdown.clone().cancelled_owned();
    let watching = Watching {
        hub,
        node,
        renew,
        counters,
        _place: place,
    };
    let events = stream::unfold(watching, |mut watching| async move {
        let message = watching.next().await?;
        let event = sse::Event::default().event("counters").json_data(message);
        Some((event, watching))
    });
    let keep_alive = KeepAlive::new().interval(Duration::from_secs(15));
    Ok(Sse::new(events.take_until(shutdown)).keep_alive(keep_alive))
}

/// A reader of the live counters of one node.
struct Watching {
    hub: Hub,
    node: String,
    renew: Interval,
    counters: Subscriber<RingChannelHandler<Sample>>,
    /// Its place among the readers of all nodes.
    _place: OwnedSemaphorePermit,
}

impl Watching {
    /// The next counters that can be read; renews the lease meanwhile. `None` once the session is closed.
    async fn next(&mut self) -> Option<CountersMessage> {
        loop {
            let sample = tokio::select! {
                _ = self.renew.tick() => {
                    self.hub.desired.watch(&self.node, LEASE);
                    continue;
                }
                sample = self.counters.recv_async() => sample.ok()?,
            };
            if let Ok(message) = albireo_wire::read(&sample.payload().to_bytes()) {
                return Some(message);
            }
        }
    }
}

/// The problem document of a Zenoh error.
fn unavailable(error: zenoh::Error) -> Problem {
    Problem::new(StatusCode::SERVICE_UNAVAILABLE, error.to_string())
}

/// Returns true if Zenoh itself ended the query because it got no reply in time.
fn timed_out(reply: &Reply) -> bool {
    match reply.result() {
        Ok(_) => false,
        Err(error) => &*error.payload().to_bytes() == b"Timeout",
    }
}

/// What is drawn on a picture.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Drawing {
    /// True for the newest answered picture with its boxes: solid where detected, dashed where predicted. A node of an older
    /// version sends it without.
    #[serde(default)]
    boxes: bool,
}

/// The newest picture of a node's camera
///
/// The node sends pictures only on request. The header `albireo-frame` has the sequence number of the frame.
/// `curl -o frame.jpg 'http://127.0.0.1:8090/api/v1/nodes/car-7/cameras/front/frame.jpg?boxes=true'`
#[utoipa::path(
    get, operation_id = "node_camera_picture", path = "/api/v1/nodes/{node}/cameras/{camera}/frame.jpg", tag = "nodes",
    params(
        ("node" = String, Path, description = "Its name"),
        ("camera" = String, Path, description = "The camera's name"),
        Drawing
    ),
    responses(
        (status = 200, body = Vec<u8>, content_type = "image/jpeg",
         headers(("albireo-frame" = u64, description = "Sequence number of the frame."))),
    )
)]
pub(super) async fn picture(
    State(hub): State<Hub>,
    Path((node, camera)): Path<(String, String)>,
    Query(Drawing { boxes }): Query<Drawing>,
) -> Result<Response, Problem> {
    let (session, keys) = hub.way_to(&node)?;
    let mut key = keys
        .camera(&camera)
        .map_err(|error| Problem::new(StatusCode::NOT_FOUND, error.to_string()))?
        .picture();
    if boxes {
        key += "?boxes=true";
    }
    hub.desired.watch(&node, LEASE);
    let asking = async {
        loop {
            let replies = session
                .get(&key)
                // Under congestion the query or its reply may be dropped, so there is time for a second attempt. Reports
                // have priority.
                .timeout(PICTURE_WITHIN / 2)
                .priority(Priority::DataLow)
                .congestion_control(CongestionControl::Drop)
                .await
                .map_err(unavailable)?;
            if let Ok(reply) = replies.recv_async().await
                && !timed_out(&reply)
            {
                return Ok::<_, Problem>(reply);
            }
            // Nobody answers this key yet: the node declares it once it knows that it is watched.
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
    };
    let Ok(asked) = tokio::time::timeout(PICTURE_WITHIN, asking).await else {
        let detail = format!(
            "`{node}` sent no picture of `{camera}` within {} s: it is out of reach, or has no such camera",
            PICTURE_WITHIN.as_secs()
        );
        return Err(Problem::new(StatusCode::GATEWAY_TIMEOUT, detail));
    };
    let reply = asked?;
    match reply.result() {
        Ok(sample) => {
            let seq = sample
                .attachment()
                .and_then(|frame| frame.try_to_string().ok())
                .filter(|text| text.parse::<u64>().is_ok())
                .map_or_else(String::new, Into::into);
            let headers = [
                (CONTENT_TYPE, "image/jpeg".to_owned()),
                (CACHE_CONTROL, "no-store".to_owned()),
                (FRAME, seq),
            ];
            Ok((headers, sample.payload().to_bytes().into_owned()).into_response())
        }
        Err(refused) => {
            let reason = refused.payload().try_to_string();
            let detail = reason.map_or_else(|_| "the node has no picture".to_owned(), Into::into);
            Err(Problem::new(StatusCode::NOT_FOUND, detail))
        }
    }
}
