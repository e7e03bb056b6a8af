//! Events, from the database to their readers: each has a number that grows, so that a reader who comes back says
//! which came last.

use crate::store::{Store, StoredEvent};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Notify, broadcast};
use tokio_util::sync::CancellationToken;

/// Events a reader may lag behind.
const LAG: usize = 4096;
/// Most events of one look.
const STEP: i64 = 1000;
/// Interval of reading without a notice: other hubs write to the same database.
const LOOK: Duration = Duration::from_secs(2);

/// Hands out events as they happen.
#[derive(Clone, Debug)]
pub struct Events(broadcast::Sender<Arc<StoredEvent>>);

impl Events {
    /// Nobody listens yet.
    pub fn new() -> Self {
        Self(broadcast::channel(LAG).0)
    }

    /// Everything from now on.
    pub fn listen(&self) -> broadcast::Receiver<Arc<StoredEvent>> {
        self.0.subscribe()
    }

    /// Reads new events from the database until `shutdown`, when `changed` says that there are some or after a while.
    pub(crate) async fn follow(
        self,
        store: Store,
        changed: Arc<Notify>,
        shutdown: CancellationToken,
    ) {
        let mut last = None;
        while !shutdown.is_cancelled() {
            match Self::step(&store, &mut last, &self.0).await {
                Ok(true) => continue,
                Ok(false) => {}
                Err(error) => tracing::debug!(%error, "events cannot be read"),
            }
            tokio::select! {
                () = changed.notified() => {}
                () = tokio::time::sleep(LOOK) => {}
                () = shutdown.cancelled() => return,
            }
        }
    }

    async fn step(
        store: &Store,
        last: &mut Option<i64>,
        sender: &broadcast::Sender<Arc<StoredEvent>>,
    ) -> Result<bool, crate::store::StoreError> {
        let Some(after) = *last else {
            *last = Some(store.last_event().await?);
            return Ok(false);
        };
        let events = store.events_after(after, STEP).await?;
        let more = events.len() as i64 == STEP;
        for event in events {
            *last = Some(event.id);
            // Nobody may be listening.
            let _ = sender.send(Arc::new(event));
        }
        Ok(more)
    }
}

impl Default for Events {
    fn default() -> Self {
        Self::new()
    }
}
