//! Posts sightings to an address, one after the other, and each again until it is taken or refused for good.

use super::address::Target;
use super::config::HookConfig;
use super::{FIRST_PAUSE_MS, LONGEST_PAUSE_MS};
use crate::backoff::Backoff;
use crate::state::board::{Board, Forwarded};
use crate::state::readiness;
use albireo_service::connection::Connector;
use albireo_service::readiness::Part;
use albireo_wire::Sighting;
use bytes::Bytes;
use http_body_util::Full;
use hyper::client::conn::http1;
use hyper::header::{AUTHORIZATION, CONNECTION, CONTENT_TYPE, HOST, HeaderValue, USER_AGENT};
use hyper::{Request, StatusCode};
use hyper_util::rt::TokioIo;
use std::collections::VecDeque;
use std::fmt::Display;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::broadcast;
use tokio::sync::broadcast::error::{RecvError, TryRecvError};
use tokio::time::{sleep, timeout};
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;

/// The time within which an address must have answered.
const ANSWERED_WITHIN: Duration = Duration::from_secs(10);

/// The most sightings that wait; then the oldest is given up.
pub(super) const MOST_WAITING: usize = 64;

/// One hook.
pub(crate) struct Hook {
    config: HookConfig,
    target: Target,
    connector: Connector,
    sightings: broadcast::Receiver<Arc<Sighting>>,
    waiting: VecDeque<Arc<Sighting>>,
    counts: Arc<Forwarded>,
    part: Part,
    backoff: Backoff,
}

/// A post that was not taken.
struct RefusedPost {
    reason: String,
    /// True if it never will be.
    is_final: bool,
}

impl RefusedPost {
    fn for_now(reason: impl Display) -> Self {
        Self {
            reason: reason.to_string(),
            is_final: false,
        }
    }
}

impl Hook {
    /// Prepares a hook, which hears of sightings from now on.
    ///
    /// # Errors
    /// Why its address or its certificate cannot be used.
    pub(crate) fn new(config: HookConfig, board: &Board, random: u64) -> Result<Self, String> {
        let target = config.target()?;
        let authority = config.root_ca_certificate.as_deref();
        let connector = target.place.connector(authority)?;
        let counts = board.forward_to(target.to_string());
        let part = board.readiness.part_of(readiness::HOOKS, &counts.to);
        Ok(Self {
            config,
            target,
            connector,
            sightings: board.sightings(),
            waiting: VecDeque::new(),
            counts,
            part,
            backoff: Backoff::new(FIRST_PAUSE_MS, LONGEST_PAUSE_MS, random),
        })
    }

    /// Posts until `shutdown`; what waits then is lost, and counted.
    pub(crate) async fn run(mut self, shutdown: CancellationToken) {
        while let Some(next) = self.next(&shutdown).await {
            let posting = timeout(ANSWERED_WITHIN, self.post(&next));
            let posted = match shutdown.run_until_cancelled(posting).await {
                None => break,
                Some(Ok(posted)) => posted,
                Some(Err(_)) => {
                    let within_s = ANSWERED_WITHIN.as_secs();
                    let reason = format!("did not answer within {within_s} s");
                    Err(RefusedPost::for_now(reason))
                }
            };
            match posted {
                Ok(()) => {
                    self.waiting.pop_front();
                    self.counts.sent();
                    self.backoff.reset();
                    self.part.works();
                }
                Err(RefusedPost { reason, is_final }) => {
                    self.counts.failed();
                    self.part.degraded(reason);
                    if is_final {
                        self.waiting.pop_front();
                        self.counts.dropped(1);
                    } else if !self.pause(&shutdown).await {
                        break;
                    }
                }
            }
        }
        let lost = self.waiting.len();
        if lost > 0 {
            self.counts.dropped(lost as u64);
            tracing::warn!(
                to = self.counts.to,
                lost,
                "sightings were not posted before the stop"
            );
        }
    }

    /// The oldest sighting that waits, or the next one; `None` at the shutdown.
    async fn next(&mut self, shutdown: &CancellationToken) -> Option<Arc<Sighting>> {
        loop {
            self.take_all();
            if let Some(next) = self.waiting.front() {
                return Some(Arc::clone(next));
            }
            let heard = shutdown.run_until_cancelled(self.sightings.recv()).await?;
            if !self.hear(heard) {
                return None;
            }
        }
    }

    /// Takes what was told meanwhile.
    fn take_all(&mut self) {
        loop {
            match self.sightings.try_recv() {
                Ok(sighting) => self.take(sighting),
                Err(TryRecvError::Lagged(lost)) => self.counts.dropped(lost),
                Err(TryRecvError::Empty | TryRecvError::Closed) => return,
            }
        }
    }

    /// Takes a sighting, or counts those that came too fast. Returns false if no more will come.
    fn hear(&mut self, heard: Result<Arc<Sighting>, RecvError>) -> bool {
        match heard {
            Ok(sighting) => self.take(sighting),
            Err(RecvError::Lagged(lost)) => self.counts.dropped(lost),
            Err(RecvError::Closed) => return false,
        }
        true
    }

    fn take(&mut self, sighting: Arc<Sighting>) {
        if self.config.hears(&sighting) {
            self.waiting.push_back(sighting);
        }
        if self.waiting.len() > MOST_WAITING {
            self.waiting.pop_front();
            self.counts.dropped(1);
        }
    }

    /// Waits before the next attempt, and takes sightings meanwhile. Returns false at the shutdown.
    async fn pause(&mut self, shutdown: &CancellationToken) -> bool {
        let over = sleep(self.backoff.next());
        tokio::pin!(over);
        loop {
            tokio::select! {
                () = shutdown.cancelled() => return false,
                () = &mut over => return true,
                heard = self.sightings.recv() => if !self.hear(heard) {
                    return false;
                },
            }
        }
    }

    /// Opens a connection, as long as it takes, for `check --online`.
    pub(crate) async fn connects(config: &HookConfig) -> Result<String, String> {
        let target = config.target()?;
        let authority = config.root_ca_certificate.as_deref();
        let connector = target.place.connector(authority)?;
        connector.open().await.map_err(|error| format!("{target} {error}"))?;
        Ok(format!("{target} can be reached; nothing was posted"))
    }

    /// Posts one sighting. A connection for each: they are seldom, and a kept one would be closed in between.
    async fn post(&self, sighting: &Sighting) -> Result<(), RefusedPost> {
        let stream = self.connector.open().await.map_err(RefusedPost::for_now)?;
        let (mut sender, connection) =
            http1::handshake(TokioIo::new(stream)).await.map_err(RefusedPost::for_now)?;
        let _connection = AbortOnDropHandle::new(tokio::spawn(connection));
        let status = match sender.send_request(self.request(sighting)?).await {
            Ok(response) => response.status(),
            Err(error) => return Err(RefusedPost::for_now(format!("did not answer: {error}"))),
        };
        if status.is_success() {
            return Ok(());
        }
        Err(RefusedPost {
            reason: format!("answered {status}{}", advice(status)),
            is_final: is_final(status),
        })
    }

    fn request(&self, sighting: &Sighting) -> Result<Request<Full<Bytes>>, RefusedPost> {
        let body = serde_json::to_vec(sighting).map_err(RefusedPost::for_now)?;
        let mut request = Request::post(&self.target.path)
            .header(HOST, &self.target.host)
            .header(CONTENT_TYPE, "application/json")
            .header(CONNECTION, "close")
            .header(USER_AGENT, concat!("albireo/", env!("CARGO_PKG_VERSION")));
        if let Some(login) = &self.target.login
            && let Ok(mut login) = HeaderValue::from_str(login)
        {
            login.set_sensitive(true);
            request = request.header(AUTHORIZATION, login);
        }
        request.body(Full::new(body.into())).map_err(RefusedPost::for_now)
    }
}

/// True if the same post will get the same answer: redirects and faults of the request, but not "timed out", "too
/// early" or "too many".
fn is_final(status: StatusCode) -> bool {
    let passing = [
        StatusCode::REQUEST_TIMEOUT,
        StatusCode::TOO_EARLY,
        StatusCode::TOO_MANY_REQUESTS,
    ];
    (status.is_client_error() || status.is_redirection()) && !passing.contains(&status)
}

fn advice(status: StatusCode) -> &'static str {
    match status {
        StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN => {
            ": are user and password in the address right?"
        }
        StatusCode::NOT_FOUND | StatusCode::METHOD_NOT_ALLOWED => {
            ": is the path of the address right?"
        }
        status if status.is_redirection() => {
            ": redirects are not followed; set the address that it leads to"
        }
        _ => "",
    }
}

#[cfg(test)]
pub(crate) mod tests;
