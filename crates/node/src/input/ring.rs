//! The bounded queue between reception and a camera's loop. Pushing never waits: what does not fit pushes out the oldest
//! item, or is refused where none is to be missed.

use super::Delivery;
use parking_lot::Mutex;
use std::collections::VecDeque;
use std::future::poll_fn;
use std::sync::Arc;
use std::task::{Context, Poll, Waker};

/// Frames that may wait where none is to be missed. A sender that heeds the answers has one here.
const EVERY_FRAMES: usize = 64;

/// What waits in a ring.
pub(crate) trait RingItem {
    /// The memory it holds.
    fn bytes(&self) -> usize;

    /// It is taken out, to be processed.
    fn taken(&mut self);
}

/// How much a ring holds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RingLimits {
    /// Items, at least 1.
    pub items: usize,
    /// Bytes of all items; a single one may have more.
    pub bytes: usize,
    /// Whether a new item pushes out the oldest when there is no room.
    pub newest_wins: bool,
}

impl RingLimits {
    /// The limits of a camera's ring: `frames` that may wait, of at most `max_payload` bytes each.
    pub(crate) fn new(delivery: Delivery, frames: usize, max_payload: usize) -> Self {
        match delivery {
            Delivery::Newest => Self {
                items: frames,
                bytes: usize::MAX,
                newest_wins: true,
            },
            Delivery::Every => Self {
                items: frames.max(EVERY_FRAMES),
                // A few of the largest that are accepted, or many of the usual ones.
                bytes: max_payload.saturating_mul(4),
                newest_wins: false,
            },
        }
    }
}

/// What became of a pushed item.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Pushed<T> {
    /// It waits for its turn.
    Queued,
    /// It waits for its turn; this, the oldest item, was dropped: an overrun.
    Replaced(T),
    /// There is no room; the item comes back.
    Full(T),
    /// The receiver was dropped or the ring is closed; the item comes back.
    Closed(T),
}

/// The end that frames come in at.
#[derive(Debug)]
pub(crate) struct RingSender<T>(Arc<Ring<T>>);

/// The camera loop's end.
#[derive(Debug)]
pub(crate) struct RingReceiver<T>(Arc<Ring<T>>);

#[derive(Debug)]
struct Ring<T> {
    limits: RingLimits,
    state: Mutex<State<T>>,
}

#[derive(Debug)]
struct State<T> {
    items: VecDeque<T>,
    closed: bool,
    /// Items taken since one was pushed out.
    taken_since_overrun: u32,
    /// How the receiver is woken, while it waits.
    receiver: Option<Waker>,
}

impl<T> State<T> {
    fn empty() -> Self {
        Self {
            items: VecDeque::new(),
            closed: false,
            taken_since_overrun: u32::MAX,
            receiver: None,
        }
    }

    fn wait(&mut self, context: &Context<'_>) {
        self.receiver = Some(context.waker().clone());
    }
}

/// An empty ring.
pub(crate) fn frame_ring<T>(limits: RingLimits) -> (RingSender<T>, RingReceiver<T>) {
    let ring = Arc::new(Ring {
        limits,
        state: Mutex::new(State::empty()),
    });
    (RingSender(Arc::clone(&ring)), RingReceiver(ring))
}

impl<T> Ring<T> {
    fn close(&self) {
        let mut state = self.state.lock();
        state.closed = true;
        let receiver = state.receiver.take();
        drop(state);
        if let Some(receiver) = receiver {
            receiver.wake();
        }
    }
}

impl<T: RingItem> Ring<T> {
    fn has_room(&self, items: &VecDeque<T>, bytes: usize) -> bool {
        let waiting: usize = items.iter().map(RingItem::bytes).sum();
        items.is_empty()
            || (items.len() < self.limits.items
                && waiting.saturating_add(bytes) <= self.limits.bytes)
    }
}

impl<T: RingItem> RingSender<T> {
    /// Pushes an item, and wakes the receiver if it waits.
    pub(crate) fn push(&self, item: T) -> Pushed<T> {
        let mut state = self.0.state.lock();
        if state.closed {
            return Pushed::Closed(item);
        }
        let mut pushed = Pushed::Queued;
        if !self.0.has_room(&state.items, item.bytes()) {
            if !self.0.limits.newest_wins {
                return Pushed::Full(item);
            }
            if let Some(oldest) = state.items.pop_front() {
                pushed = Pushed::Replaced(oldest);
                state.taken_since_overrun = 0;
            }
        }
        state.items.push_back(item);
        let receiver = state.receiver.take();
        drop(state);
        if let Some(receiver) = receiver {
            receiver.wake();
        }
        pushed
    }

    /// Whether an item of that size would be queued.
    pub(crate) fn has_room(&self, bytes: usize) -> bool {
        let state = self.0.state.lock();
        state.closed || self.0.limits.newest_wins || self.0.has_room(&state.items, bytes)
    }
}

impl<T> RingSender<T> {
    /// Closes the ring: nothing more goes in, what waits can still be taken.
    #[cfg(test)]
    pub(crate) fn close(&self) {
        self.0.close();
    }

    /// Items waiting now.
    #[cfg(test)]
    pub(crate) fn waiting(&self) -> usize {
        self.0.state.lock().items.len()
    }

    /// Opens the ring again, empty, for a new receiver.
    pub(crate) fn reopen(&self) -> RingReceiver<T> {
        *self.0.state.lock() = State::empty();
        RingReceiver(Arc::clone(&self.0))
    }
}

impl<T> Clone for RingSender<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<T: RingItem> RingReceiver<T> {
    /// The oldest waiting item; waits for one. `None` once the ring is closed and empty. Cancelling the future loses
    /// nothing.
    pub(crate) async fn next(&mut self) -> Option<T> {
        let mut item = poll_fn(|context| {
            let mut state = self.0.state.lock();
            match state.items.pop_front() {
                Some(item) => {
                    state.taken_since_overrun = state.taken_since_overrun.saturating_add(1);
                    Poll::Ready(Some(item))
                }
                None if state.closed => Poll::Ready(None),
                None => {
                    state.wait(context);
                    Poll::Pending
                }
            }
        })
        .await?;
        item.taken();
        Some(item)
    }
}

impl<T> RingReceiver<T> {
    /// Looks at the item that will be taken next and leaves it where it is; waits for one. `None` once the
    /// ring is closed and empty; and while items are pushed out, for what is seen now would then hardly be the one
    /// that is taken.
    pub(crate) async fn peek<R>(&self, look: impl Fn(&T) -> R) -> Option<R> {
        poll_fn(|context| {
            let mut state = self.0.state.lock();
            match state.items.front() {
                _ if state.taken_since_overrun < 2 => Poll::Ready(None),
                Some(item) => Poll::Ready(Some(look(item))),
                None if state.closed => Poll::Ready(None),
                None => {
                    state.wait(context);
                    Poll::Pending
                }
            }
        })
        .await
    }

    /// Closes the ring and gives back what waits.
    pub(crate) fn close_and_clear(&self) -> VecDeque<T> {
        self.0.close();
        std::mem::take(&mut self.0.state.lock().items)
    }
}

impl<T> Drop for RingReceiver<T> {
    fn drop(&mut self) {
        self.0.close();
    }
}

/// In tests numbers stand for frames, of as many bytes.
#[cfg(test)]
impl RingItem for u32 {
    fn bytes(&self) -> usize {
        *self as usize
    }

    fn taken(&mut self) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::pin::pin;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::task::Wake;
    use std::time::Duration;
    use tokio::time::timeout;

    fn ring(items: usize, newest_wins: bool) -> (RingSender<u32>, RingReceiver<u32>) {
        frame_ring(RingLimits {
            items,
            bytes: 1000,
            newest_wins,
        })
    }

    #[tokio::test]
    async fn the_newest_win_and_every_overrun_is_told() {
        let (sender, mut receiver) = ring(2, true);
        assert_eq!(sender.push(1), Pushed::Queued);
        assert_eq!(sender.push(2), Pushed::Queued);
        assert_eq!(sender.push(3), Pushed::Replaced(1));
        assert_eq!(sender.push(4), Pushed::Replaced(2));
        assert_eq!(sender.waiting(), 2);
        assert_eq!(receiver.next().await, Some(3));
        assert_eq!(receiver.next().await, Some(4));
    }

    #[tokio::test]
    async fn where_none_is_to_be_missed_the_newest_is_refused() {
        let (sender, mut receiver) = ring(2, false);
        assert_eq!(sender.push(1), Pushed::Queued);
        assert!(sender.has_room(2));
        assert_eq!(sender.push(2), Pushed::Queued);
        assert!(!sender.has_room(3));
        assert_eq!(sender.push(3), Pushed::Full(3));
        assert_eq!(receiver.next().await, Some(1));
        assert_eq!(sender.push(3), Pushed::Queued);
    }

    #[tokio::test]
    async fn the_memory_of_what_waits_is_bounded_and_one_item_always_fits() {
        let (sender, mut receiver) = ring(8, false);
        assert_eq!(sender.push(5000), Pushed::Queued);
        assert_eq!(sender.push(1), Pushed::Full(1));
        assert_eq!(receiver.next().await, Some(5000));
        assert_eq!(sender.push(600), Pushed::Queued);
        assert_eq!(sender.push(400), Pushed::Queued);
        assert_eq!(sender.push(1), Pushed::Full(1));
    }

    #[tokio::test]
    async fn the_next_item_can_be_looked_at_and_is_still_taken() {
        let (sender, mut receiver) = ring(2, true);
        let (peeked, _) = tokio::join!(receiver.peek(|&item| item), async { sender.push(1) });
        assert_eq!(peeked, Some(1));
        assert_eq!(receiver.next().await, Some(1));
        sender.close();
        assert_eq!(receiver.peek(|&item| item).await, None);
    }

    #[tokio::test]
    async fn nothing_is_looked_at_while_items_are_pushed_out() {
        let (sender, mut receiver) = ring(1, true);
        assert_eq!(sender.push(1), Pushed::Queued);
        assert_eq!(sender.push(2), Pushed::Replaced(1));
        assert_eq!(receiver.peek(|&item| item).await, None);
        assert_eq!(receiver.next().await, Some(2));
        assert_eq!(sender.push(3), Pushed::Queued);
        // The receiver was too slow for item 1, and may be for this one.
        assert_eq!(receiver.peek(|&item| item).await, None);
        assert_eq!(receiver.next().await, Some(3));
        assert_eq!(sender.push(4), Pushed::Queued);
        assert_eq!(receiver.peek(|&item| item).await, Some(4));
    }

    #[tokio::test]
    async fn a_ring_without_room_has_room_for_one() {
        let (sender, mut receiver) = ring(0, true);
        assert_eq!(sender.push(1), Pushed::Queued);
        assert_eq!(sender.push(2), Pushed::Replaced(1));
        assert_eq!(receiver.next().await, Some(2));
    }

    #[tokio::test]
    async fn what_waited_when_a_ring_was_closed_is_not_lost() {
        let (sender, mut receiver) = ring(1, true);
        assert_eq!(sender.push(1), Pushed::Queued);
        sender.close();
        assert_eq!(sender.push(3), Pushed::Closed(3));
        assert_eq!(receiver.next().await, Some(1));
        assert_eq!(receiver.next().await, None);
    }

    #[tokio::test]
    async fn a_ring_whose_receiver_failed_is_closed_until_it_is_opened_again() {
        let (sender, receiver) = ring(4, true);
        sender.push(1);
        sender.push(2);
        assert_eq!(receiver.close_and_clear().len(), 2);
        drop(receiver);
        assert_eq!(sender.push(3), Pushed::Closed(3));
        let mut again = sender.reopen();
        assert_eq!(sender.push(4), Pushed::Queued);
        assert_eq!(again.next().await, Some(4));
    }

    #[tokio::test(start_paused = true)]
    async fn giving_up_a_wait_loses_nothing() {
        let (sender, mut receiver) = ring(2, true);
        assert!(
            timeout(Duration::from_secs(1), receiver.next())
                .await
                .is_err()
        );
        sender.push(1);
        assert_eq!(receiver.next().await, Some(1));
    }

    /// Whether the receiver has been woken since it last found nothing.
    #[derive(Default)]
    struct Woken(AtomicBool);

    impl Wake for Woken {
        fn wake(self: Arc<Self>) {
            self.0.store(true, Ordering::Relaxed);
        }
    }

    /// What the two ends of a ring do.
    #[derive(Clone, Copy, Debug)]
    enum Act {
        Push(u32),
        Take,
        Peek,
        Close,
    }

    fn act() -> impl Strategy<Value = Act> {
        prop_oneof![
            8 => (1..600_u32).prop_map(Act::Push),
            6 => Just(Act::Take),
            3 => Just(Act::Peek),
            1 => Just(Act::Close),
        ]
    }

    proptest! {
        #[test]
        fn in_any_order_a_ring_is_a_bounded_queue_that_loses_no_item_and_no_wake_up(
            acts in proptest::collection::vec(act(), 1..80),
            items in 1..4_usize,
            newest_wins: bool,
        ) {
            let (sender, mut receiver) = ring(items, newest_wins);
            let woken = Arc::new(Woken::default());
            let waker = Waker::from(Arc::clone(&woken));
            let mut context = Context::from_waker(&waker);
            let (mut queue, mut closed, mut waits) = (VecDeque::new(), false, false);
            let mut taken_since_overrun = u32::MAX;
            for act in acts {
                match act {
                    Act::Push(item) => {
                        let bytes = queue.iter().sum::<u32>() + item;
                        let fits = queue.is_empty() || (queue.len() < items && bytes <= 1000);
                        let expected = match (closed, fits, newest_wins) {
                            (true, _, _) => Pushed::Closed(item),
                            (_, true, _) => Pushed::Queued,
                            (_, false, false) => Pushed::Full(item),
                            (_, false, true) => {
                                taken_since_overrun = 0;
                                Pushed::Replaced(queue.pop_front().unwrap())
                            }
                        };
                        if matches!(expected, Pushed::Queued | Pushed::Replaced(_)) {
                            queue.push_back(item);
                        }
                        prop_assert_eq!(sender.push(item), expected);
                    }
                    Act::Take => {
                        let taken = pin!(receiver.next()).poll(&mut context);
                        waits = taken.is_pending();
                        prop_assert_eq!(waits, queue.is_empty() && !closed);
                        if let Poll::Ready(item) = taken {
                            prop_assert_eq!(item, queue.pop_front());
                            let one = u32::from(item.is_some());
                            taken_since_overrun = taken_since_overrun.saturating_add(one);
                        }
                    }
                    Act::Peek => {
                        let peeked = pin!(receiver.peek(|&item| item)).poll(&mut context);
                        let overrun = taken_since_overrun < 2;
                        waits = peeked.is_pending();
                        prop_assert_eq!(waits, queue.is_empty() && !closed && !overrun);
                        if let Poll::Ready(item) = peeked {
                            prop_assert_eq!(item, queue.front().copied().filter(|_| !overrun));
                        }
                    }
                    Act::Close => {
                        sender.close();
                        closed = true;
                    }
                }
                if waits && queue.is_empty() && !closed {
                    woken.0.store(false, Ordering::Relaxed);
                } else if waits {
                    prop_assert!(woken.0.load(Ordering::Relaxed), "the receiver sleeps on");
                }
            }
        }
    }
}
