//! The connections of a listener: a bound on how many there are, on how long one may say nothing, and on how long one
//! may not take what is written to it.
//!
//! When all places are taken, the connection that has been idle longest is closed for a new one, so that clients who
//! only hold connections never shut out one who asks. Only when every connection is in the middle of a request is a
//! new one turned away, with an answer.

use super::problem::{MEDIA_TYPE, Problem};
use axum::Router;
use axum::body::{Body, HttpBody};
use axum::extract::Request;
use axum::http::StatusCode;
use http_body::{Frame, SizeHint};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tower_service::Service;

/// How long a connection that is turned away is held to be told so.
const TURNING_AWAY: Duration = Duration::from_millis(250);

/// What is answered when every connection is in the middle of a request.
fn turned_away() -> std::io::Result<Vec<u8>> {
    let detail = "all connections are in use; close one, or try again later";
    let body = serde_json::to_string(&Problem::new(StatusCode::SERVICE_UNAVAILABLE, detail))?;
    let answer = format!(
        "HTTP/1.1 503 Service Unavailable\r\ncontent-type: {MEDIA_TYPE}\r\nretry-after: 1\r\n\
         connection: close\r\ncontent-length: {}\r\n\r\n{body}",
        body.len()
    );
    Ok(answer.into_bytes())
}

/// Answers without looking at what is asked. It is read all the same: a client takes an answer before its request for
/// a fault, and a connection that is closed with something unread is reset, the answer with it.
async fn turn_away(mut stream: TcpStream) -> std::io::Result<()> {
    let mut asked = [0; 4096];
    if stream.read(&mut asked).await? > 0 {
        stream.write_all(&turned_away()?).await?;
        stream.shutdown().await?;
        while stream.read(&mut asked).await? > 0 {}
    }
    Ok(())
}

/// Bounds of a connection.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// Connections at a time.
    pub most: usize,
    /// How long a connection may take to send the head of a request, also its next one.
    pub head: Duration,
    /// How long a connection may take nothing of what is written to it.
    pub stalled: Duration,
}

/// One connection, as others see it.
struct Seen {
    /// Requests in hand; their responses' bodies count.
    busy: usize,
    /// Since when there is none.
    idle_since: Instant,
    close: CancellationToken,
}

#[derive(Default)]
struct State {
    next: u64,
    open: BTreeMap<u64, Seen>,
}

/// All connections of a listener.
#[derive(Clone)]
pub(super) struct Connections {
    limits: Limits,
    state: Arc<Mutex<State>>,
}

/// A place among the connections; given back when dropped.
struct Place {
    number: u64,
    state: Arc<Mutex<State>>,
    close: CancellationToken,
}

impl Drop for Place {
    fn drop(&mut self) {
        self.state.lock().open.remove(&self.number);
    }
}

/// A request, counted as in hand once all of it is there: one that is sent by halves holds no place.
struct Busy {
    number: u64,
    state: Arc<Mutex<State>>,
    begun: AtomicBool,
}

impl Busy {
    fn begin(&self) {
        if !self.begun.swap(true, Ordering::Relaxed)
            && let Some(seen) = self.state.lock().open.get_mut(&self.number)
        {
            seen.busy += 1;
        }
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        if *self.begun.get_mut()
            && let Some(seen) = self.state.lock().open.get_mut(&self.number)
        {
            seen.busy -= 1;
            seen.idle_since = Instant::now();
        }
    }
}

impl Connections {
    pub(super) fn new(limits: Limits) -> Self {
        Self {
            limits,
            state: Arc::default(),
        }
    }

    /// A place for a new connection; `None` when all are in the middle of a request.
    fn place(&self) -> Option<Place> {
        let mut state = self.state.lock();
        if state.open.len() >= self.limits.most {
            let longest = (state.open.iter())
                .filter(|(_, seen)| seen.busy == 0)
                .min_by_key(|(_, seen)| seen.idle_since)
                .map(|(number, _)| *number)?;
            // Its task ends soon; its place is free now.
            if let Some(seen) = state.open.remove(&longest) {
                seen.close.cancel();
            }
        }
        let number = state.next;
        state.next += 1;
        let close = CancellationToken::new();
        let seen = Seen {
            busy: 0,
            idle_since: Instant::now(),
            close: close.clone(),
        };
        state.open.insert(number, seen);
        drop(state);
        Some(Place {
            number,
            state: Arc::clone(&self.state),
            close,
        })
    }

    /// Serves `stream` with `router` until it ends, is given up, or the request in hand after `shutdown` has ended.
    pub(super) async fn serve(
        self,
        stream: TcpStream,
        router: Router,
        shutdown: CancellationToken,
    ) {
        let Some(place) = self.place() else {
            // Whoever does not even take that is not waited for.
            let _ = tokio::time::timeout(TURNING_AWAY, turn_away(stream)).await;
            return;
        };
        let (number, state) = (place.number, Arc::clone(&place.state));
        let service = service_fn(move |request: Request<hyper::body::Incoming>| {
            let busy = Arc::new(Busy {
                number,
                state: Arc::clone(&state),
                begun: AtomicBool::new(false),
            });
            let mut router = router.clone();
            async move {
                let request = request.map(|body| Body::new(Held::new(body, Arc::clone(&busy))));
                let response = match router.call(request).await {
                    Ok(response) => response,
                    Err(impossible) => match impossible {},
                };
                busy.begin();
                Ok::<_, Infallible>(response.map(|body| Held { body, busy }))
            }
        });
        give_up_when_stalled(&stream, self.limits.stalled);
        let io = TokioIo::new(stream);
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(self.limits.head)
            .serve_connection(io, service);
        tokio::pin!(connection);
        let ended = tokio::select! {
            ended = connection.as_mut() => ended,
            () = place.close.cancelled() => return,
            () = shutdown.cancelled() => {
                connection.as_mut().graceful_shutdown();
                connection.await
            }
        };
        if let Err(error) = ended {
            tracing::debug!(%error, "HTTP connection given up");
        }
    }
}

/// Has the system end a connection whose other side takes nothing of what is sent for so long.
fn give_up_when_stalled(stream: &TcpStream, limit: Duration) {
    let limit_ms = u32::try_from(limit.as_millis()).unwrap_or(u32::MAX);
    if let Err(error) = rustix::net::sockopt::set_tcp_user_timeout(stream, limit_ms) {
        tracing::debug!(%error, "an HTTP connection has no write limit");
    }
}

/// A body of a request, which is in hand when the body has ended, or of its response, until that is out.
struct Held<B> {
    body: B,
    busy: Arc<Busy>,
}

impl<B: HttpBody> Held<B> {
    fn new(body: B, busy: Arc<Busy>) -> Self {
        if body.is_end_stream() {
            busy.begin();
        }
        Self { body, busy }
    }
}

impl<B: HttpBody + Unpin> HttpBody for Held<B> {
    type Data = B::Data;
    type Error = B::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<B::Data>, B::Error>>> {
        let frame = ready!(Pin::new(&mut self.body).poll_frame(cx));
        if frame.is_none() || self.body.is_end_stream() {
            self.busy.begin();
        }
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
