//! Receives status messages and liveliness tokens, answers pulls, and notifies nodes.
//!
//! Zenoh's threads apply a status to the fleet themselves, which takes microseconds. What may block, such as an answer
//! or a notice, is left to other threads.

use crate::HubError;
use crate::http::HubView;
use crate::ingest::Replies;
use albireo_service::clock::Now;
use albireo_wire::{
    ConfigChanged, Heartbeat, NodeKeys, PullRequest, RefusalReason, StatusMessage, VERSION,
};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Subscriber;
use zenoh::qos::CongestionControl;
use zenoh::query::Queryable;
use zenoh::sample::SampleKind;
use zenoh::{Session, Wait};

/// Largest status, bytes: twice the size of a status with as many cameras as a node may have.
const LARGEST_STATUS: usize = 64 << 10;
/// Interval at which the nodes are checked.
const SWEEP: Duration = Duration::from_secs(1);
/// The number of notices after which there is a pause: thousands of nodes must not pull at the same time.
const NOTICES_AT_ONCE: usize = 50;
const NOTICE_PAUSE: Duration = Duration::from_millis(10);

/// Receives the statuses and tokens of the nodes with these keys, and answers their pulls, until the returned
/// declarations are dropped.
pub(crate) async fn listen(
    keys: &NodeKeys,
    view: &HubView,
    session: &Session,
    replies: Replies,
) -> Result<(Subscriber<()>, Subscriber<()>, Queryable<()>), HubError> {
    let hub = view.clone();
    let statuses = session
        .declare_subscriber(keys.status())
        .callback(move |sample| {
            if let Some(node) = NodeKeys::node_of(sample.key_expr().as_str()) {
                hear(&hub, node, sample.payload());
            }
        })
        .await
        .map_err(HubError::at("status messages cannot be subscribed to"))?;
    let hub = view.clone();
    let tokens = session
        .liveliness()
        .declare_subscriber(keys.alive())
        .history(true)
        .callback(move |sample| {
            if let Some(node) = NodeKeys::node_of(sample.key_expr().as_str()) {
                hub.fleet.token(node, sample.kind() == SampleKind::Put);
            }
        })
        .await;
    let tokens = tokens.map_err(HubError::at("liveliness tokens cannot be watched"))?;
    let hub = view.clone();
    let pulls = session
        .declare_queryable(keys.pull())
        .complete(true)
        .callback(move |mut query| {
            hub.ingest.count(|counts| counts.pulls += 1);
            // The query waits for its answer without it.
            let payload = query.payload_mut().map(std::mem::take);
            match albireo_wire::read::<PullRequest>(&payload.unwrap_or_default().to_bytes()) {
                Ok(_) => {
                    let node = NodeKeys::node_of(query.key_expr().as_str());
                    let desired = hub.desired(node.unwrap_or_default());
                    replies.answer(query, &desired);
                }
                Err(error) => {
                    let reason = RefusalReason::Unreadable;
                    replies.refuse(query, reason, &error.to_string(), None);
                }
            }
        })
        .await;
    let pulls = pulls.map_err(HubError::at("pulls cannot be answered"))?;
    Ok((statuses, tokens, pulls))
}

/// Applies the status or heartbeat of a node, and notifies the node if its full status is missing.
fn hear(hub: &HubView, node: &str, payload: &ZBytes) {
    let now = Now::system();
    let heard = match &*payload.to_bytes() {
        large if large.len() > LARGEST_STATUS => Err(format!("it has {} bytes", large.len())),
        heartbeat if Heartbeat::is_one(heartbeat) => Heartbeat::read(heartbeat)
            .map(|heartbeat| hub.fleet.alive(node, heartbeat, now))
            .map_err(|error| error.to_string()),
        status => albireo_wire::read::<StatusMessage>(status)
            .map(|status| hub.fleet.apply_status(node, status, now))
            .map_err(|error| error.to_string()),
    };
    match heard {
        Ok(is_full_due) => {
            hub.ingest.count(|counts| counts.statuses += 1);
            if is_full_due {
                hub.desires.notify(node);
            }
        }
        Err(error) => {
            hub.ingest.count(|counts| counts.statuses_unreadable += 1);
            tracing::debug!(node, error, "a status cannot be read");
        }
    }
}

/// Finds the nodes that have become silent or offline. `router` is the session if all nodes are reached through one
/// router: while that is lost, no node becomes silent.
pub(crate) async fn watch(hub: HubView, router: Option<Session>) {
    let connection = hub.readiness.part_of("zenoh", "router");
    let mut before = Instant::now();
    loop {
        tokio::time::sleep(SWEEP).await;
        let is_lost = match &router {
            Some(session) => session.info().transports().await.next().is_none(),
            None => false,
        };
        let now = Now::system();
        if is_lost {
            connection.not_ready("it is not connected, so no node can be reached");
            hub.fleet.pass_over(now.at - before);
        } else {
            connection.works();
            hub.fleet.sweep(now);
        }
        before = now.at;
    }
}

/// Sends notices until the last sender is dropped. Runs on a thread of its own, because a put may block.
pub(crate) fn send_notices(session: &Session, prefix: &str, notices: &Receiver<(String, u64)>) {
    for (sent, (node, revision)) in (1_usize..).zip(notices) {
        let Ok(keys) = NodeKeys::new(prefix, &node) else {
            continue;
        };
        let notice = ConfigChanged {
            v: VERSION,
            revision,
        };
        let payload = serde_json::to_vec(&notice).unwrap_or_default();
        let put = session
            .put(keys.changed(), payload)
            .congestion_control(CongestionControl::Drop)
            .wait();
        if let Err(error) = put {
            tracing::debug!(%error, node, "a notice was not sent");
        }
        if sent.is_multiple_of(NOTICES_AT_ONCE) {
            std::thread::sleep(NOTICE_PAUSE);
        }
    }
}
