//! Carries out an order for selected nodes and reports the outcome at each.

use super::{HubView, body};
use crate::tuning::change::{Change, ChangeRequest};
use crate::tuning::tuner::OutcomeLine;
use albireo_service::clock::unix_milliseconds;
use albireo_service::http::{Caller, Problem};
use axum::Json;
use axum::body::Body;
use axum::http::header::{ACCEPT, CONTENT_TYPE};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::time::Instant;
use utoipa::ToSchema;

/// The media type of outcomes as they come, one JSON object a line.
const LINES: &str = "application/x-ndjson";
/// How long a plain answer waits for the nodes at most: an answer that begins too late is an error.
const LONGEST_WAIT_S: f64 = 8.0;
/// What of the time of a request is left for the order and the answer.
const ANSWER_S: f64 = 1.0;
/// How long a stream of outcomes lasts at most.
const LONGEST_STREAM_S: f64 = 3_600.0;

/// What an order came to.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct OrderAnswer {
    /// Revision of the order: `/api/v1/changes/{revision}` shows its progress. Absent in a dry run, and if no node would change.
    #[serde(skip_serializing_if = "Option::is_none")]
    revision: Option<u64>,
    /// Whether nothing was done.
    dry_run: bool,
    /// How many nodes have which outcome.
    counts: BTreeMap<String, usize>,
    /// Each node.
    nodes: Vec<OutcomeLine>,
}

/// The last line of a stream.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct LastLine {
    /// Revision of the order; absent in a dry run, and if no node would change.
    pub revision: Option<u64>,
    /// How many nodes have which outcome.
    pub counts: BTreeMap<String, usize>,
}

/// A line of a stream.
#[derive(Debug, Serialize, Deserialize)]
#[serde(untagged)]
pub enum OrderLine {
    /// What the order came to at one node.
    Outcome(OutcomeLine),
    /// Nothing follows.
    Last(LastLine),
}

/// Orders it, and answers with what became of it: as lines where the caller takes those, else at the end of the wait,
/// which lasts `wait_s` seconds.
pub(super) async fn carry_out(
    view: &HubView,
    caller: &Caller,
    headers: &HeaderMap,
    request: ChangeRequest,
    wait_s: Option<f64>,
) -> Result<Response, Problem> {
    if request.why.len() > 500 {
        return Err(body::unusable("why: must have at most 500 bytes"));
    }
    let streams = headers
        .get(ACCEPT)
        .and_then(|value| value.to_str().ok())
        .is_some_and(|accept| accept.contains(LINES));
    let most = if streams {
        LONGEST_STREAM_S
    } else {
        (view.timeout.as_secs_f64() - ANSWER_S).clamp(0.0, LONGEST_WAIT_S)
    };
    let wait = wait_s.unwrap_or(most.min(5.0));
    if !(0.0..=most).contains(&wait) {
        return Err(body::unusable(format!(
            "wait_s: must be from 0 to {most}, not {wait}"
        )));
    }
    let dry_run = request.dry_run;
    let change = view
        .tuner()?
        .change(request, &caller.name, unix_milliseconds())
        .await?;
    if change.lines.is_empty() && change.awaited.is_empty() {
        return Err(Problem::new(
            StatusCode::NOT_FOUND,
            "no node is selected; GET /api/v1/nodes lists all",
        ));
    }
    let until = Instant::now() + Duration::from_secs_f64(wait);
    let mut following = Following {
        change,
        until,
        last: BTreeMap::new(),
    };
    if streams {
        let stream = futures_util::stream::unfold(Some(following), |following| async move {
            let mut following = following?;
            let (line, next) = match following.next().await {
                Some(line) => (OrderLine::Outcome(line), Some(following)),
                None => {
                    let last = LastLine {
                        revision: following.change.revision,
                        counts: following.counts(),
                    };
                    (OrderLine::Last(last), None)
                }
            };
            let line = serde_json::to_string(&line)
                .map(|line| line + "\n")
                .map_err(std::io::Error::other);
            Some((line, next))
        });
        return Ok(([(CONTENT_TYPE, LINES)], Body::from_stream(stream)).into_response());
    }
    while following.next().await.is_some() {}
    let answer = OrderAnswer {
        revision: following.change.revision,
        dry_run,
        counts: following.counts(),
        nodes: following.last.into_values().collect(),
    };
    Ok(Json(answer).into_response())
}

/// Brings the outcomes until every node has one, or the time is over.
struct Following {
    change: Change,
    until: Instant,
    last: BTreeMap<String, OutcomeLine>,
}

impl Following {
    async fn next(&mut self) -> Option<OutcomeLine> {
        let line = match self.change.lines.pop() {
            Some(line) => line,
            None if self.change.awaited.is_empty() => return None,
            None => match tokio::time::timeout_at(self.until, self.change.follow.recv()).await {
                Ok(line) => line?,
                Err(_) => self.not_answered()?,
            },
        };
        if line.is_final() {
            self.change.awaited.remove(&line.node);
        }
        self.last.insert(line.node.clone(), line.clone());
        Some(line)
    }

    /// The time is over: answers that are still missing are reported, once.
    fn not_answered(&mut self) -> Option<OutcomeLine> {
        while let Some(node) = self.change.awaited.iter().next().cloned() {
            self.change.awaited.remove(&node);
            if !self.last.contains_key(&node) {
                return Some(OutcomeLine {
                    node,
                    outcome: "pending".to_owned(),
                    from: None,
                    to: self.change.setting,
                    detail: "not answered yet".to_owned(),
                });
            }
        }
        None
    }

    fn counts(&self) -> BTreeMap<String, usize> {
        let mut counts = BTreeMap::new();
        for line in self.last.values() {
            *counts.entry(line.outcome.clone()).or_insert(0) += 1;
        }
        counts
    }
}
