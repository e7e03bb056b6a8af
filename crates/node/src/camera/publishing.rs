//! Puts of detections, on a thread of their own where they might wait: a put runs where it is called and may wait, for
//! room or for a lock that another put holds. A camera's detections go out where they were made as long as that takes
//! no time, since waking a thread costs a third of all that a predicted frame needs; after a put that did take time the
//! camera leaves its messages to the thread for a while and goes on.
//!
//! Kinds have priorities of their own, as each priority has a queue and a lock in Zenoh: a report that waits for
//! a slow subscriber never stands before a detection.

use crate::rate_limit::SharedLimit;
use albireo_service::panics::{contain, message};
use parking_lot::{Condvar, Mutex, MutexGuard};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};
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
            Self::Panicked(said) => PANICKED.tell(|held_back| {
                tracing::error!(
                    key,
                    held_back,
                    "a put panicked, its message is lost: {said}"
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

/// A put that takes longer may have waited for something; Zenoh waits a millisecond for room. One that does not wait
/// takes some 10 µs, or a little more where the system gave the processor to somebody else meanwhile.
const LONG: Duration = Duration::from_micros(500);

/// After so many such puts in a row the thread does the waiting, for so long.
const CAUTIOUS_AFTER: u32 = 2;
const CAUTIOUS: Duration = Duration::from_secs(1);

struct Lane {
    outlet: Arc<Outlet>,
    waiting: VecDeque<Vec<u8>>,
    most: usize,
    warned: bool,
    /// A put is under way.
    busy: bool,
    /// Whether whoever brings a message may put it.
    at_once: bool,
    /// Puts in a row, by whoever brought the message, that took long.
    long_puts: u32,
    /// Until then the thread puts all the same.
    cautious_until: Option<Instant>,
}

impl Lane {
    /// Whether a message may go out here and now.
    fn is_clear(&self) -> bool {
        self.at_once
            && self.is_done()
            && self
                .cautious_until
                .is_none_or(|until| Instant::now() >= until)
    }

    /// A message was put by whoever brought it.
    fn took(&mut self, time: Duration) {
        self.long_puts = if time > LONG { self.long_puts + 1 } else { 0 };
        if self.long_puts >= CAUTIOUS_AFTER {
            self.long_puts = 0;
            self.cautious_until = Some(Instant::now() + CAUTIOUS);
        }
    }

    fn is_done(&self) -> bool {
        self.waiting.is_empty() && !self.busy
    }
}

#[derive(Default)]
struct State {
    lanes: Vec<Lane>,
    closed: bool,
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

    /// A lane to `outlet` in which at most `most` messages wait: beyond that the oldest goes.
    pub(crate) fn lane(&self, outlet: impl Into<Outlet>, most: usize) -> PublishLane {
        self.new_lane(outlet.into(), most, false)
    }

    /// Such a lane whose messages go out where they are made, as long as no put waits.
    pub(crate) fn lane_at_once(&self, outlet: impl Into<Outlet>, most: usize) -> PublishLane {
        self.new_lane(outlet.into(), most, true)
    }

    fn new_lane(&self, outlet: Outlet, most: usize, at_once: bool) -> PublishLane {
        let mut state = self.0.state.lock();
        state.lanes.push(Lane {
            outlet: Arc::new(outlet),
            waiting: VecDeque::new(),
            most: most.max(1),
            warned: false,
            busy: false,
            at_once,
            long_puts: 0,
            cautious_until: None,
        });
        PublishLane {
            shared: Arc::clone(&self.0),
            number: state.lanes.len() - 1,
        }
    }

    /// Waits until everything is out, at most until `until`.
    pub(crate) fn flush(&self, until: Instant) {
        let mut state = self.0.state.lock();
        while !state.lanes.iter().all(Lane::is_done) {
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
    /// Publishes a message here, or leaves it to the thread if that might wait.
    pub(crate) fn publish(&self, json: Vec<u8>) {
        let mut state = self.shared.state.lock();
        let Some(lane) = state.lanes.get_mut(self.number) else {
            return;
        };
        if lane.is_clear() {
            let took = self.shared.put(&mut state, self.number, json);
            if let Some(lane) = state.lanes.get_mut(self.number) {
                lane.took(took);
            }
            return;
        }
        if lane.waiting.len() >= lane.most {
            lane.waiting.pop_front();
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
                .find_map(|number| {
                    let lane = state.lanes.get_mut(number).filter(|lane| !lane.busy)?;
                    Some((number, lane.waiting.pop_front()?))
                });
            if let Some((number, json)) = found {
                next = number + 1;
                self.put(&mut state, number, json);
            } else if state.closed && state.lanes.iter().all(|lane| lane.waiting.is_empty()) {
                // Publishers are undeclared here, not under a lock.
                let lanes = std::mem::take(&mut state.lanes);
                drop(state);
                return drop(lanes);
            } else {
                self.filled.wait(&mut state);
            }
        }
    }

    /// Puts on a lane that nobody puts on, not under the lock; returns how long that took.
    fn put(&self, state: &mut MutexGuard<'_, State>, number: usize, json: Vec<u8>) -> Duration {
        let Some(lane) = state.lanes.get_mut(number) else {
            return Duration::ZERO;
        };
        lane.busy = true;
        let outlet = Arc::clone(&lane.outlet);
        let took = MutexGuard::unlocked(state, move || {
            let began = Instant::now();
            if let Err(error) = outlet.put(json) {
                error.log(&outlet.key(), false);
            }
            began.elapsed()
        });
        let Some(lane) = state.lanes.get_mut(number) else {
            return took;
        };
        lane.busy = false;
        if lane.waiting.is_empty() {
            self.drained.notify_all();
        } else {
            self.filled.notify_one();
        }
        took
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
    use std::thread::{self, ThreadId};

    const LIMIT: Duration = Duration::from_secs(20);

    #[test]
    fn a_put_that_panics_costs_its_own_message_and_no_other() {
        let thread = PublishingThread::start().unwrap();
        let (out, published) = channel();
        let (broken, sound) = (out.clone(), out);
        let broken = thread.lane(
            Outlet::Test(Box::new(move |json| {
                assert_ne!(json, b"bad", "a bug of the transport");
                broken.send(json).unwrap();
            })),
            4,
        );
        let sound = thread.lane(
            Outlet::Test(Box::new(move |json| sound.send(json).unwrap())),
            4,
        );
        broken.publish(b"bad".to_vec());
        thread.flush(Instant::now() + LIMIT);
        sound.publish(b"of another camera".to_vec());
        broken.publish(b"good".to_vec());
        let next = || published.recv_timeout(LIMIT).unwrap();
        let mut both = [next(), next()];
        both.sort();
        assert_eq!(both, [b"good".to_vec(), b"of another camera".to_vec()]);
    }

    /// A lane that tells what it published and on which thread; what begins with `slow` waits to be let go.
    struct Told {
        _thread: PublishingThread,
        lane: PublishLane,
        published: Receiver<(Vec<u8>, ThreadId)>,
        let_go: SyncSender<()>,
    }

    fn told() -> Told {
        let thread = PublishingThread::start().unwrap();
        let (out, published) = channel();
        let (let_go, held) = sync_channel::<()>(0);
        let held = Mutex::new(held);
        let put = move |json: Vec<u8>| {
            if json == b"slow" {
                held.lock().recv_timeout(LIMIT).unwrap();
            }
            out.send((json, thread::current().id())).unwrap();
        };
        Told {
            lane: thread.lane_at_once(Outlet::Test(Box::new(put)), 2),
            _thread: thread,
            published,
            let_go,
        }
    }

    /// Waits until a put is under way.
    fn wait_until_busy(lane: &PublishLane) {
        while !lane.shared.state.lock().lanes.iter().any(|lane| lane.busy) {
            thread::yield_now();
        }
    }

    impl Told {
        /// What is published next, and whether by this thread.
        fn next(&self) -> (Vec<u8>, bool) {
            let (json, by) = self.published.recv_timeout(LIMIT).unwrap();
            (json, by == thread::current().id())
        }

        /// As if puts by whoever brought the message had taken so long.
        fn took(&self, times: &[Duration]) {
            for lane in &mut self.lane.shared.state.lock().lanes {
                times.iter().for_each(|time| lane.took(*time));
            }
        }
    }

    #[test]
    fn a_message_goes_out_where_it_was_made_until_puts_have_waited() {
        let told = told();
        let (long, short) = (2 * LONG, LONG / 2);
        // The system may give the processor to somebody else now and then.
        told.took(&[long, short, long, short]);
        told.lane.publish(b"here".to_vec());
        assert_eq!(told.next(), (b"here".to_vec(), true));
        told.took(&[long, long]);
        told.lane.publish(b"by the thread".to_vec());
        assert_eq!(told.next(), (b"by the thread".to_vec(), false));
    }

    #[test]
    fn whoever_brings_a_message_while_another_waits_goes_on_and_the_newest_go_out_in_order() {
        let told = told();
        thread::scope(|scope| {
            scope.spawn(|| told.lane.publish(b"slow".to_vec()));
            wait_until_busy(&told.lane);
            for json in [b"a", b"b", b"c"] {
                told.lane.publish(json.to_vec());
            }
            told.let_go.send(()).unwrap();
        });
        assert_eq!(told.next().0, b"slow".to_vec());
        assert_eq!(told.next(), (b"b".to_vec(), false));
        assert_eq!(told.next(), (b"c".to_vec(), false));
    }

    #[test]
    fn what_waits_goes_out_before_the_thread_ends() {
        let Told {
            _thread: publishing,
            lane,
            published,
            let_go,
        } = told();
        thread::scope(|scope| {
            scope.spawn(|| lane.publish(b"slow".to_vec()));
            wait_until_busy(&lane);
            lane.publish(b"last".to_vec());
            drop(publishing);
            let_go.send(()).unwrap();
        });
        let next = || published.recv_timeout(LIMIT).unwrap().0;
        assert_eq!([next(), next()], [b"slow".to_vec(), b"last".to_vec()]);
    }
}
