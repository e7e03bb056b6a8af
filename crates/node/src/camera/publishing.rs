//! Puts messages on Zenoh from a separate thread, because a put may wait for room and a camera must not.
//!
//! Each kind has its priority, as each priority has a queue and a lock in Zenoh: a report that waits for
//! a slow subscriber never delays a detection.

use crate::rate_limit::SharedLimit;
use albireo_service::panics::{contain, message};
use parking_lot::{Condvar, Mutex, MutexGuard};
use prometheus_client::metrics::counter::Counter;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;
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
/// Priority of clip reports for subscribers.
pub(crate) const CLIPS: Priority = Priority::DataLow;
/// Priority of counters and status.
pub(crate) const COUNTERS: Priority = Priority::Background;

/// Something to put on.
pub(crate) enum Outlet {
    /// A plain publisher.
    Plain(Publisher<'static>),
    /// One with a cache for clients that come late.
    Cached(AdvancedPublisher<'static>),
    /// A stand-in.
    #[cfg(test)]
    Test(Box<dyn Fn(Vec<u8>) + Send + Sync>),
}

impl Outlet {
    /// Puts, and survives a panic below: every camera's answers go through the thread that calls this.
    fn put(&self, json: Vec<u8>) -> Result<(), Unpublished> {
        match contain(|| self.put_through(json)) {
            Ok(put) => put.map_err(Unpublished::Refused),
            Err(panic) => Err(Unpublished::Panicked(message(&*panic).to_owned())),
        }
    }

    fn put_through(&self, json: Vec<u8>) -> zenoh::Result<()> {
        match self {
            Self::Plain(publisher) => publisher
                .put(json)
                .encoding(Encoding::APPLICATION_JSON)
                .wait(),
            Self::Cached(publisher) => publisher
                .put(json)
                .encoding(Encoding::APPLICATION_JSON)
                .wait(),
            #[cfg(test)]
            Self::Test(put) => {
                put(json);
                Ok(())
            }
        }
    }

    fn key(&self) -> String {
        match self {
            Self::Plain(publisher) => publisher.key_expr().to_string(),
            Self::Cached(publisher) => publisher.key_expr().to_string(),
            #[cfg(test)]
            Self::Test(_) => "test".to_owned(),
        }
    }
}

/// Why a message did not go out.
enum Unpublished {
    Refused(zenoh::Error),
    Panicked(String),
}

static PANICKED: SharedLimit = SharedLimit::new();

impl Unpublished {
    /// Logs it: what Zenoh refuses is `unusual` or not.
    fn log(&self, key: &str, unusual: bool) {
        match self {
            Self::Refused(error) if unusual => {
                tracing::warn!(key, %error, "detections not published");
            }
            Self::Refused(error) => tracing::debug!(key, %error, "not published"),
            Self::Panicked(message) => PANICKED.log(|held_back| {
                tracing::error!(
                    key,
                    held_back,
                    "a put panicked, its message is lost: {message}"
                );
            }),
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
    /// Messages that did not go out.
    unpublished: Counter,
    warned: bool,
}

#[derive(Default)]
struct State {
    lanes: Vec<Lane>,
    /// A put is under way.
    busy: bool,
    closed: bool,
}

impl State {
    fn is_drained(&self) -> bool {
        !self.busy && self.lanes.iter().all(|lane| lane.waiting.is_empty())
    }
}

#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    filled: Condvar,
    drained: Condvar,
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

    /// A lane to `outlet` in which at most `most` messages wait: beyond that the oldest goes. `unpublished` counts the
    /// messages that did not go out.
    pub(crate) fn lane(
        &self,
        outlet: impl Into<Outlet>,
        most: usize,
        unpublished: Counter,
    ) -> PublishLane {
        let mut state = self.0.state.lock();
        state.lanes.push(Lane {
            outlet: Arc::new(outlet.into()),
            waiting: VecDeque::new(),
            most: most.max(1),
            unpublished,
            warned: false,
        });
        PublishLane {
            shared: Arc::clone(&self.0),
            number: state.lanes.len() - 1,
        }
    }

    /// Waits until everything is out, at most until `until`.
    pub(crate) fn flush(&self, until: Instant) {
        let mut state = self.0.state.lock();
        while !state.is_drained() {
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
    /// Leaves a message to the thread.
    pub(crate) fn publish(&self, json: Vec<u8>) {
        let mut state = self.shared.state.lock();
        let Some(lane) = state.lanes.get_mut(self.number) else {
            return;
        };
        if lane.waiting.len() >= lane.most {
            lane.waiting.pop_front();
            lane.unpublished.inc();
            if !std::mem::replace(&mut lane.warned, true) {
                tracing::warn!(
                    key = lane.outlet.key(),
                    "messages are dropped: Zenoh takes them too slowly (logged once, counted in the metrics)"
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
                .find_map(|number| {
                    let lane = state.lanes.get_mut(number)?;
                    let json = lane.waiting.pop_front()?;
                    Some((
                        number,
                        Arc::clone(&lane.outlet),
                        lane.unpublished.clone(),
                        json,
                    ))
                });
            if let Some((number, outlet, unpublished, json)) = found {
                next = number + 1;
                state.busy = true;
                MutexGuard::unlocked(&mut state, || {
                    if let Err(error) = outlet.put(json) {
                        unpublished.inc();
                        error.log(&outlet.key(), false);
                    }
                });
                state.busy = false;
            } else if state.closed {
                // Publishers are undeclared here, not under a lock.
                let lanes = std::mem::take(&mut state.lanes);
                drop(state);
                return drop(lanes);
            } else {
                self.drained.notify_all();
                self.filled.wait(&mut state);
            }
        }
    }
}

/// Detections of one camera.
pub(crate) enum Detections {
    /// Newest win.
    Live(PublishLane),
    /// None is lost: a separate thread puts them, and the camera waits for room.
    Every(mpsc::Sender<Vec<u8>>),
}

impl Detections {
    /// Detections that wait for a slow subscriber; [`finished`](tokio::task::JoinHandle) after the last is out.
    /// `unpublished` counts those that Zenoh did not take.
    pub(crate) fn every(
        publisher: Publisher<'static>,
        unpublished: Counter,
    ) -> (Self, tokio::task::JoinHandle<()>) {
        let (sender, mut waiting) = mpsc::channel::<Vec<u8>>(2);
        let outlet = Outlet::from(publisher);
        let thread = tokio::task::spawn_blocking(move || {
            while let Some(json) = waiting.blocking_recv() {
                if let Err(error) = outlet.put(json) {
                    unpublished.inc();
                    error.log(&outlet.key(), true);
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
    use std::thread;
    use std::time::Duration;

    const LIMIT: Duration = Duration::from_secs(20);

    #[test]
    fn a_put_that_panics_costs_its_own_message_and_no_other() {
        let thread = PublishingThread::start().unwrap();
        let (out, published) = channel();
        let (broken, sound) = (out.clone(), out);
        let unpublished = Counter::default();
        let broken = thread.lane(
            Outlet::Test(Box::new(move |json| {
                assert_ne!(json, b"bad", "a bug of the transport");
                broken.send(json).unwrap();
            })),
            4,
            unpublished.clone(),
        );
        let sound = thread.lane(
            Outlet::Test(Box::new(move |json| sound.send(json).unwrap())),
            4,
            Counter::default(),
        );
        broken.publish(b"bad".to_vec());
        thread.flush(Instant::now() + LIMIT);
        sound.publish(b"of another camera".to_vec());
        broken.publish(b"good".to_vec());
        let next = || published.recv_timeout(LIMIT).unwrap();
        let mut both = [next(), next()];
        both.sort();
        assert_eq!(both, [b"good".to_vec(), b"of another camera".to_vec()]);
        assert_eq!(unpublished.get(), 1);
    }

    /// A lane that reports what it published; `slow` messages wait until they are let go.
    struct SlowLane {
        _thread: PublishingThread,
        lane: PublishLane,
        published: Receiver<Vec<u8>>,
        unpublished: Counter,
        let_go: SyncSender<()>,
    }

    fn slow_lane() -> SlowLane {
        let thread = PublishingThread::start().unwrap();
        let (out, published) = channel();
        let (let_go, gate) = sync_channel::<()>(0);
        let gate = Mutex::new(gate);
        let put = move |json: Vec<u8>| {
            if json == b"slow" {
                gate.lock().recv_timeout(LIMIT).unwrap();
            }
            out.send(json).unwrap();
        };
        let unpublished = Counter::default();
        SlowLane {
            lane: thread.lane(Outlet::Test(Box::new(put)), 2, unpublished.clone()),
            _thread: thread,
            published,
            unpublished,
            let_go,
        }
    }

    /// Waits until a put is under way.
    fn wait_until_busy(lane: &PublishLane) {
        while !lane.shared.state.lock().busy {
            thread::yield_now();
        }
    }

    #[test]
    fn a_camera_goes_on_while_a_put_waits_and_the_newest_go_out_in_order_the_others_counted() {
        let slow_lane = slow_lane();
        slow_lane.lane.publish(b"slow".to_vec());
        wait_until_busy(&slow_lane.lane);
        for json in [b"a", b"b", b"c"] {
            slow_lane.lane.publish(json.to_vec());
        }
        slow_lane.let_go.send(()).unwrap();
        let next = || slow_lane.published.recv_timeout(LIMIT).unwrap();
        assert_eq!(
            [next(), next(), next()],
            [b"slow".to_vec(), b"b".to_vec(), b"c".to_vec()]
        );
        assert_eq!(slow_lane.unpublished.get(), 1);
    }

    #[test]
    fn what_waits_goes_out_before_the_thread_ends() {
        let SlowLane {
            _thread: publishing,
            lane,
            published,
            let_go,
            ..
        } = slow_lane();
        lane.publish(b"slow".to_vec());
        wait_until_busy(&lane);
        lane.publish(b"last".to_vec());
        drop(publishing);
        let_go.send(()).unwrap();
        let next = || published.recv_timeout(LIMIT).unwrap();
        assert_eq!([next(), next()], [b"slow".to_vec(), b"last".to_vec()]);
    }
}
