//! Puts on threads of their own. A put runs where it is called and may wait: for room, for a lock that another
//! put holds. So no task puts by itself: it leaves what is to go here and goes on.
//!
//! Kinds have priorities of their own, as each priority has a queue and a lock in Zenoh: a report that waits for
//! a slow subscriber never stands before a detection.

use parking_lot::{Condvar, Mutex};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tokio::sync::mpsc;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::pubsub::Publisher;
use zenoh::qos::Priority;
use zenoh_ext::AdvancedPublisher;

/// Priority of a live camera's detections.
pub(crate) const LIVE: Priority = Priority::InteractiveHigh;
/// Priority of the detections of a camera that loses none: such a put may wait for its subscriber.
pub(crate) const EVERY: Priority = Priority::InteractiveLow;
/// Priority of clip reports for whoever listens.
pub(crate) const CLIPS: Priority = Priority::DataLow;
/// Priority of counters and status.
pub(crate) const COUNTERS: Priority = Priority::Background;

/// Something to put on.
pub(crate) enum Outlet {
    /// A plain publisher.
    Plain(Publisher<'static>),
    /// One with a cache for clients that come late.
    Cached(AdvancedPublisher<'static>),
}

impl Outlet {
    fn put(&self, json: Vec<u8>) -> zenoh::Result<()> {
        match self {
            Self::Plain(publisher) => publisher
                .put(json)
                .encoding(Encoding::APPLICATION_JSON)
                .wait(),
            Self::Cached(publisher) => publisher
                .put(json)
                .encoding(Encoding::APPLICATION_JSON)
                .wait(),
        }
    }

    fn key(&self) -> String {
        match self {
            Self::Plain(publisher) => publisher.key_expr().to_string(),
            Self::Cached(publisher) => publisher.key_expr().to_string(),
        }
    }
}

impl From<Publisher<'static>> for Outlet {
    fn from(publisher: Publisher<'static>) -> Self {
        Self::Plain(publisher)
    }
}

impl From<AdvancedPublisher<'static>> for Outlet {
    fn from(publisher: AdvancedPublisher<'static>) -> Self {
        Self::Cached(publisher)
    }
}

struct Lane {
    outlet: Arc<Outlet>,
    waiting: VecDeque<Vec<u8>>,
    most: usize,
    warned: bool,
}

#[derive(Default)]
struct State {
    lanes: Vec<Lane>,
    /// A put is under way.
    busy: bool,
    closed: bool,
}

#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    filled: Condvar,
    drained: Condvar,
    dropped: AtomicU64,
}

/// The publishing thread. Ends when dropped, after what waits is out.
pub(crate) struct PublishingThread(Arc<Shared>);

/// A place in the thread's round: messages of one key, in order, the newest of which win.
pub(crate) struct PublishLane {
    shared: Arc<Shared>,
    number: usize,
}

impl PublishingThread {
    /// Starts the thread.
    ///
    /// # Errors
    /// When the system has no thread left.
    pub(crate) fn start() -> std::io::Result<Self> {
        let shared = Arc::new(Shared::default());
        let of_thread = Arc::clone(&shared);
        std::thread::Builder::new()
            .name("publishing".to_owned())
            .spawn(move || of_thread.run())?;
        Ok(Self(shared))
    }

    /// A lane to `outlet` in which at most `most` messages wait: beyond that the oldest goes, counted.
    pub(crate) fn lane(&self, outlet: impl Into<Outlet>, most: usize) -> PublishLane {
        let mut state = self.0.state.lock();
        state.lanes.push(Lane {
            outlet: Arc::new(outlet.into()),
            waiting: VecDeque::new(),
            most: most.max(1),
            warned: false,
        });
        PublishLane {
            shared: Arc::clone(&self.0),
            number: state.lanes.len() - 1,
        }
    }

    /// Waits until everything is out, at most until `until`.
    pub(crate) fn flush(&self, until: std::time::Instant) {
        let mut state = self.0.state.lock();
        while state.busy || state.lanes.iter().any(|lane| !lane.waiting.is_empty()) {
            if self.0.drained.wait_until(&mut state, until).timed_out() {
                return;
            }
        }
    }
}

impl Drop for PublishingThread {
    fn drop(&mut self) {
        self.0.state.lock().closed = true;
        self.0.filled.notify_all();
    }
}

impl PublishLane {
    /// Leaves a message to be published; never waits.
    pub(crate) fn publish(&self, json: Vec<u8>) {
        let mut state = self.shared.state.lock();
        let Some(lane) = state.lanes.get_mut(self.number) else {
            return;
        };
        if lane.waiting.len() >= lane.most {
            lane.waiting.pop_front();
            self.shared.dropped.fetch_add(1, Ordering::Relaxed);
            if !std::mem::replace(&mut lane.warned, true) {
                tracing::warn!(
                    key = lane.outlet.key(),
                    "messages are dropped: Zenoh takes them too slowly (told once)"
                );
            }
        }
        lane.waiting.push_back(json);
        drop(state);
        self.shared.filled.notify_one();
    }
}

impl Shared {
    fn run(&self) {
        let mut next = 0;
        let mut state = self.state.lock();
        loop {
            // In turn, so that no camera starves another.
            let lanes = state.lanes.len();
            let found = (0..lanes)
                .map(|step| (next + step) % lanes)
                .find(|&number| {
                    state
                        .lanes
                        .get(number)
                        .is_some_and(|l| !l.waiting.is_empty())
                });
            let taken = found.and_then(|number| {
                next = number + 1;
                let lane = state.lanes.get_mut(number)?;
                Some((Arc::clone(&lane.outlet), lane.waiting.pop_front()?))
            });
            match taken {
                Some((outlet, json)) => {
                    state.busy = true;
                    parking_lot::MutexGuard::unlocked(&mut state, || {
                        if let Err(error) = outlet.put(json) {
                            tracing::debug!(key = outlet.key(), %error, "not published");
                        }
                    });
                    state.busy = false;
                }
                None => {
                    self.drained.notify_all();
                    if state.closed {
                        // Publishers are undeclared here, not under a lock.
                        let lanes = std::mem::take(&mut state.lanes);
                        drop(state);
                        return drop(lanes);
                    }
                    self.filled.wait(&mut state);
                }
            }
        }
    }
}

/// Detections of one camera.
pub(crate) enum Detections {
    /// Newest win.
    Live(PublishLane),
    /// None is lost: a thread of its own puts them, and whoever brings one waits for room.
    Every(mpsc::Sender<Vec<u8>>),
}

impl Detections {
    /// Detections that wait for a slow subscriber; [`finished`](tokio::task::JoinHandle) after the last is out.
    pub(crate) fn every(publisher: Publisher<'static>) -> (Self, tokio::task::JoinHandle<()>) {
        let (sender, mut waiting) = mpsc::channel::<Vec<u8>>(2);
        let outlet = Outlet::from(publisher);
        let thread = tokio::task::spawn_blocking(move || {
            while let Some(json) = waiting.blocking_recv() {
                if let Err(error) = outlet.put(json) {
                    tracing::warn!(key = outlet.key(), %error, "detections not published");
                }
            }
        });
        (Self::Every(sender), thread)
    }

    /// Publishes, or waits for room where nothing may be lost.
    pub(crate) async fn publish(&self, json: Vec<u8>) {
        match self {
            Self::Live(lane) => lane.publish(json),
            Self::Every(sender) => {
                if sender.send(json).await.is_err() {
                    tracing::error!("detections cannot be published any more");
                }
            }
        }
    }
}
