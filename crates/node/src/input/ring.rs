//! The bounded queue between reception and a camera's loop: when it is full, the oldest frame is dropped, or the new
//! one is refused.

use super::Delivery;
use parking_lot::Mutex;
use std::collections::VecDeque;
use tokio::sync::Notify;

/// The number of frames that may wait if none may be missed. A sender that waits for answers has one here.
const EVERY_FRAMES: usize = 64;

/// The result of a push.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Pushed {
    /// The item waits for its turn.
    Queued,
    /// The item waits for its turn; the oldest one was dropped: an overrun.
    Replaced,
    /// The item was dropped: there is no room.
    Full,
    /// The item was dropped: the ring is closed.
    Closed,
}

/// Items on their way to a single consumer task.
#[derive(Debug)]
pub(crate) struct Ring<T> {
    /// The maximum number of items, at least 1.
    most_items: usize,
    /// The maximum bytes of all items; a single one may be larger.
    most_bytes: usize,
    /// True if a new item replaces the oldest when there is no room.
    newest_wins: bool,
    state: Mutex<State<T>>,
    came: Notify,
}

#[derive(Debug)]
struct State<T> {
    /// The items, each with its size.
    items: VecDeque<(usize, T)>,
    closed: bool,
}

impl<T> Ring<T> {
    /// Creates a camera's ring, open and empty, for `frames` waiting frames of at most `max_payload` bytes each.
    pub(crate) fn new(delivery: Delivery, frames: usize, max_payload: usize) -> Self {
        let (most_items, most_bytes) = match delivery {
            Delivery::Newest => (frames, usize::MAX),
            // Enough for a few frames of the largest size, or many of the usual size.
            Delivery::Every => (frames.max(EVERY_FRAMES), max_payload.saturating_mul(4)),
        };
        Self {
            most_items,
            most_bytes,
            newest_wins: delivery == Delivery::Newest,
            state: Mutex::new(State {
                items: VecDeque::new(),
                closed: false,
            }),
            came: Notify::new(),
        }
    }

    /// Pushes an item of that size. Never waits.
    pub(crate) fn push(&self, item: T, bytes: usize) -> Pushed {
        let mut state = self.state.lock();
        if state.closed {
            return Pushed::Closed;
        }
        let mut pushed = Pushed::Queued;
        if !self.fits(&state, bytes) {
            if !self.newest_wins {
                return Pushed::Full;
            }
            state.items.pop_front();
            pushed = Pushed::Replaced;
        }
        state.items.push_back((bytes, item));
        drop(state);
        self.came.notify_one();
        pushed
    }

    /// True if an item of that size would be queued.
    pub(crate) fn has_room(&self, bytes: usize) -> bool {
        let state = self.state.lock();
        state.closed || self.newest_wins || self.fits(&state, bytes)
    }

    fn fits(&self, state: &State<T>, bytes: usize) -> bool {
        let waiting: usize = state.items.iter().map(|(bytes, _)| bytes).sum();
        state.items.is_empty()
            || (state.items.len() < self.most_items
                && waiting.saturating_add(bytes) <= self.most_bytes)
    }

    /// Waits for an item and takes the oldest. Cancel safe.
    pub(crate) async fn next(&self) -> T {
        // A camera whose frames never run out must leave room for other tasks.
        tokio::task::consume_budget().await;
        loop {
            let oldest = self.state.lock().items.pop_front();
            if let Some((_, item)) = oldest {
                return item;
            }
            self.came.notified().await;
        }
    }

    /// Refuses further items, and returns the waiting ones.
    pub(crate) fn close(&self) -> impl Iterator<Item = T> + use<T> {
        let mut state = self.state.lock();
        state.closed = true;
        let items = std::mem::take(&mut state.items);
        items.into_iter().map(|(_, item)| item)
    }

    /// Accepts items again.
    pub(crate) fn open(&self) {
        self.state.lock().closed = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures_util::FutureExt;
    use proptest::prelude::*;
    use std::sync::Arc;
    use std::time::Duration;
    use tokio::time::timeout;

    /// In these tests numbers stand for frames, of as many bytes.
    fn ring(items: usize, newest_wins: bool) -> Ring<u32> {
        let mut ring = Ring::new(Delivery::Newest, items, 0);
        ring.most_bytes = 1000;
        ring.newest_wins = newest_wins;
        ring
    }

    impl<T> Ring<T> {
        /// The number of waiting items.
        pub(crate) fn waiting(&self) -> usize {
            self.state.lock().items.len()
        }
    }

    impl Ring<u32> {
        fn put(&self, item: u32) -> Pushed {
            self.push(item, item as usize)
        }
    }

    #[tokio::test]
    async fn a_waiter_is_woken_and_a_cancelled_wait_loses_nothing() {
        let ring = Arc::new(ring(2, true));
        let given_up = timeout(Duration::from_millis(1), ring.next()).await;
        assert!(given_up.is_err());
        let waits = Arc::clone(&ring);
        let waiting = tokio::spawn(async move { [waits.next().await, waits.next().await] });
        for item in [1, 2] {
            tokio::task::yield_now().await;
            ring.put(item);
        }
        assert_eq!(waiting.await.unwrap(), [1, 2]);
    }

    #[derive(Clone, Copy, Debug)]
    enum Act {
        Push(u32),
        Take,
        Close,
        Open,
    }

    fn act() -> impl Strategy<Value = Act> {
        prop_oneof![
            8 => (1..600_u32).prop_map(Act::Push),
            // A single item may be larger than the limit.
            1 => (900..5000_u32).prop_map(Act::Push),
            6 => Just(Act::Take),
            1 => Just(Act::Close),
            2 => Just(Act::Open),
        ]
    }

    proptest! {
        #[test]
        fn in_any_order_a_ring_is_a_bounded_queue_that_loses_no_item(
            acts in proptest::collection::vec(act(), 1..80),
            items in 0..4_usize,
            newest_wins: bool,
        ) {
            let ring = ring(items, newest_wins);
            let mut queue = VecDeque::new();
            let mut closed = false;
            for act in acts {
                match act {
                    Act::Push(item) => {
                        let bytes = queue.iter().sum::<u32>() + item;
                        let fits = queue.is_empty() || (queue.len() < items && bytes <= 1000);
                        let expected = if closed {
                            Pushed::Closed
                        } else if fits {
                            Pushed::Queued
                        } else if newest_wins {
                            Pushed::Replaced
                        } else {
                            Pushed::Full
                        };
                        if expected == Pushed::Replaced {
                            queue.pop_front();
                        }
                        if matches!(expected, Pushed::Queued | Pushed::Replaced) {
                            queue.push_back(item);
                        }
                        let has_room = closed || newest_wins || fits;
                        prop_assert_eq!(ring.has_room(item as usize), has_room);
                        prop_assert_eq!(ring.put(item), expected);
                    }
                    Act::Take => prop_assert_eq!(ring.next().now_or_never(), queue.pop_front()),
                    Act::Close => {
                        closed = true;
                        prop_assert!(ring.close().eq(queue.drain(..)));
                    }
                    Act::Open => {
                        closed = false;
                        ring.open();
                    }
                }
                prop_assert_eq!(ring.waiting(), queue.len());
            }
        }
    }
}
