//! Serves connections, and bounds how many there are, how long one may be silent, and how long one may refuse what is
//! written to it.
//!
//! When all places are taken, the oldest connection is closed for a new one. So clients that only hold connections never
//! keep others out, and a page whose event stream is cut opens it again.

use axum::Router;
use axum::body::Body;
use axum::extract::Request;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpStream;
use tokio_util::sync::CancellationToken;
use tower_service::Service;

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

/// Open connections by number, oldest first, each with what closes it.
type Open = Mutex<BTreeMap<u64, CancellationToken>>;

/// All connections of a listener.
pub(super) struct Connections {
    limits: Limits,
    next: u64,
    open: Arc<Open>,
}

/// A place among the connections; given back when dropped.
struct Place {
    number: u64,
    open: Arc<Open>,
}

impl Drop for Place {
    fn drop(&mut self) {
        self.open.lock().remove(&self.number);
    }
}

impl Connections {
    pub(super) fn new(limits: Limits) -> Self {
        Self {
            limits,
            next: 0,
            open: Arc::default(),
        }
    }

    /// A place for a new connection, and a token that is cancelled when it is taken away.
    fn place(&mut self) -> (Place, CancellationToken) {
        let number = self.next;
        self.next += 1;
        let close = CancellationToken::new();
        let mut open = self.open.lock();
        if open.len() >= self.limits.most
            && let Some((_, oldest)) = open.pop_first()
        {
            oldest.cancel();
        }
        open.insert(number, close.clone());
        let open = Arc::clone(&self.open);
        (Place { number, open }, close)
    }

    /// Serves `stream` with `router` until it ends, is given up, or the request in progress after `shutdown` has ended.
    pub(super) fn serve(
        &mut self,
        stream: TcpStream,
        router: Router,
        shutdown: CancellationToken,
    ) -> impl Future<Output = ()> + use<> {
        let (place, close) = self.place();
        let head = self.limits.head;
        give_up_when_stalled(&stream, self.limits.stalled);
        async move {
            let _place = place;
            let service = service_fn(move |request: Request<hyper::body::Incoming>| {
                router.clone().call(request.map(Body::new))
            });
            let connection = http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(head)
                .serve_connection(TokioIo::new(stream), service);
            tokio::pin!(connection);
            let ended = tokio::select! {
                ended = connection.as_mut() => ended,
                () = close.cancelled() => return,
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
}

/// Has the system end a connection whose other side takes nothing of what is sent for so long.
fn give_up_when_stalled(stream: &TcpStream, limit: Duration) {
    let limit_ms = u32::try_from(limit.as_millis()).unwrap_or(u32::MAX);
    if let Err(error) = rustix::net::sockopt::set_tcp_user_timeout(stream, limit_ms) {
        tracing::debug!(%error, "an HTTP connection has no write limit");
    }
}
