//! The ring between the subscriber and a camera's loop.
//!
//! What must not wait, as Zenoh's receiving threads, puts a new item in the place of the oldest; a task can wait for room.

use parking_lot::{Mutex, MutexGuard};
use std::collections::VecDeque;
use std::future::poll_fn;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::{Context, Poll, Waker};
use tokio::sync::Notify;

/// What became of a pushed item.
#[derive(Debug, PartialEq, Eq)]
pub enum Pushed<T> {
    /// It waits for its turn.
    Queued,
    /// It waits for its turn; the ring was full and this, the oldest item, had to go: an overrun.
    Replaced(T),
    /// The receiver is gone or the ring is closed; the item comes back.
    Closed(T),
}

/// The subscriber's end. Clones push into the same ring.
#[derive(Debug)]
pub struct RingSender<T>(Arc<Ring<T>>);

/// The camera loop's end.
#[derive(Debug)]
pub struct RingReceiver<T>(Arc<Ring<T>>);

#[derive(Debug)]
struct Ring<T> {
    capacity: usize,
    state: Mutex<State<T>>,
    senders: AtomicUsize,
    /// Wakes tasks that wait for room.
    drained: Notify,
}

#[derive(Debug)]
struct State<T> {
    items: VecDeque<T>,
    closed: bool,
    /// Whether an item was pushed out since the last one was taken, and before that.
    overrun: bool,
    overrun_before: bool,
    /// How the receiver is woken, while it waits.
    receiver: Option<Waker>,
    /// Whether it waits to take an item, and not only to look at one.
    taking: bool,
}

impl<T> State<T> {
    fn wait(&mut self, context: &Context<'_>, taking: bool) {
        match &mut self.receiver {
            Some(waker) => waker.clone_from(context.waker()),
            none => *none = Some(context.waker().clone()),
        }
        self.taking = taking;
    }
}

/// How a receiver is told of an item that was pushed quietly.
#[derive(Debug)]
pub(crate) struct Wake {
    /// Wakes it.
    pub(crate) waker: Waker,
    /// It waited to take an item, and there is only this one.
    pub(crate) only_this: bool,
}

/// A ring of `capacity` items (at least 1).
pub fn frame_ring<T>(capacity: usize) -> (RingSender<T>, RingReceiver<T>) {
    let ring = Arc::new(Ring {
        capacity: capacity.max(1),
        state: Mutex::new(State {
            items: VecDeque::new(),
            closed: false,
            overrun: false,
            overrun_before: false,
            receiver: None,
            taking: false,
        }),
        senders: AtomicUsize::new(1),
        drained: Notify::new(),
    });
    (RingSender(Arc::clone(&ring)), RingReceiver(ring))
}

impl<T> Ring<T> {
    fn state(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock()
    }

    fn close(&self) {
        let receiver = {
            let mut state = self.state();
            state.closed = true;
            state.receiver.take()
        };
        if let Some(receiver) = receiver {
            receiver.wake();
        }
        self.drained.notify_waiters();
    }
}

impl<T> RingSender<T> {
    /// Pushes at once: into a full ring in the place of the oldest item.
    pub fn push_newest(&self, item: T) -> Pushed<T> {
        let (pushed, wake) = self.push_newest_quietly(item);
        if let Some(wake) = wake {
            wake.waker.wake();
        }
        pushed
    }

    /// As [`push_newest`](Self::push_newest), but leaves it to the caller to wake the receiver, where it waits, or to
    /// take it further by other means.
    pub(crate) fn push_newest_quietly(&self, item: T) -> (Pushed<T>, Option<Wake>) {
        let mut state = self.0.state();
        if state.closed {
            return (Pushed::Closed(item), None);
        }
        let replaced = if state.items.len() < self.0.capacity {
            None
        } else {
            state.items.pop_front()
        };
        state.items.push_back(item);
        state.overrun |= replaced.is_some();
        let only_this = state.taking && state.items.len() == 1;
        let wake = state.receiver.take();
        drop(state);
        let wake = wake.map(|waker| Wake { waker, only_this });
        (replaced.map_or(Pushed::Queued, Pushed::Replaced), wake)
    }

    /// Pushes when there is room, or gives the item back when the ring closes before. Cancelling the future pushes
    /// nothing.
    pub async fn push(&self, item: T) -> Pushed<T> {
        loop {
            // Made before the look at the state, so that no wake-up between the two is missed.
            let drained = self.0.drained.notified();
            {
                let mut state = self.0.state();
                if state.closed {
                    return Pushed::Closed(item);
                }
                if state.items.len() < self.0.capacity {
                    state.items.push_back(item);
                    let receiver = state.receiver.take();
                    drop(state);
                    if let Some(receiver) = receiver {
                        receiver.wake();
                    }
                    return Pushed::Queued;
                }
            }
            drained.await;
        }
    }

    /// Closes the ring: nothing more goes in, what waits can still be taken.
    pub fn close(&self) {
        self.0.close();
    }

    /// Items waiting now.
    #[cfg(test)]
    pub(crate) fn waiting(&self) -> usize {
        self.0.state().items.len()
    }

    /// Opens the ring anew, empty, for another receiver in the place of one that is gone.
    pub(crate) fn reopen(&self) -> RingReceiver<T> {
        let mut state = self.0.state();
        state.items.clear();
        state.closed = false;
        state.overrun = false;
        state.overrun_before = false;
        drop(state);
        RingReceiver(Arc::clone(&self.0))
    }
}

impl<T> Clone for RingSender<T> {
    fn clone(&self) -> Self {
        self.0.senders.fetch_add(1, Ordering::Relaxed);
        Self(Arc::clone(&self.0))
    }
}

impl<T> Drop for RingSender<T> {
    fn drop(&mut self) {
        if self.0.senders.fetch_sub(1, Ordering::AcqRel) == 1 {
            self.0.close();
        }
    }
}

impl<T> RingReceiver<T> {
    /// The oldest waiting item; waits for one. `None` once the ring is closed and empty, or all
    /// senders are gone. Cancelling the future loses nothing.
    pub async fn next(&mut self) -> Option<T> {
        poll_fn(|context| {
            let mut state = self.0.state();
            if let Some(item) = state.items.pop_front() {
                state.overrun_before = std::mem::take(&mut state.overrun);
                state.taking = false;
                drop(state);
                self.0.drained.notify_waiters();
                return Poll::Ready(Some(item));
            }
            if state.closed {
                return Poll::Ready(None);
            }
            state.wait(context, true);
            Poll::Pending
        })
        .await
    }

    /// Looks at the item that will be taken next and leaves it where it is; waits for one. `None` once the
    /// ring is closed and empty; and when an item was pushed out lately, for what is seen now would then
    /// hardly be the one that is taken.
    pub(crate) async fn peek<R>(&self, look: impl Fn(&T) -> R) -> Option<R> {
        poll_fn(|context| {
            let mut state = self.0.state();
            if state.overrun || state.overrun_before {
                return Poll::Ready(None);
            }
            if let Some(item) = state.items.front() {
                return Poll::Ready(Some(look(item)));
            }
            if state.closed {
                return Poll::Ready(None);
            }
            state.wait(context, false);
            Poll::Pending
        })
        .await
    }

    /// Items waiting now.
    pub fn waiting(&self) -> usize {
        self.0.state().items.len()
    }

    /// Closes the ring and wakes waiting senders; what waits can still be taken.
    pub fn close(&self) {
        self.0.close();
    }

    /// Closes the ring and throws away what waits; how many items that were.
    pub(crate) fn close_and_clear(&self) -> usize {
        self.0.close();
        std::mem::take(&mut self.0.state().items).len()
    }
}

impl<T> Drop for RingReceiver<T> {
    fn drop(&mut self) {
        self.0.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;
    use tokio::time::timeout;

    #[tokio::test]
    async fn the_newest_win_and_every_overrun_is_told() {
        let (sender, mut receiver) = frame_ring(2);
        assert_eq!(sender.push_newest(1), Pushed::Queued);
        assert_eq!(sender.push_newest(2), Pushed::Queued);
        assert_eq!(sender.push_newest(3), Pushed::Replaced(1));
        assert_eq!(sender.push_newest(4), Pushed::Replaced(2));
        assert_eq!(receiver.waiting(), 2);
        assert_eq!(receiver.next().await, Some(3));
        assert_eq!(receiver.next().await, Some(4));
    }

    #[tokio::test]
    async fn the_next_item_can_be_looked_at_and_is_still_taken() {
        let (sender, mut receiver) = frame_ring(2);
        let (seen, _) = tokio::join!(receiver.peek(|&item| item), sender.push(1));
        assert_eq!(seen, Some(1));
        assert_eq!(receiver.next().await, Some(1));
        sender.close();
        assert_eq!(receiver.peek(|&item| item).await, None);
    }

    #[tokio::test]
    async fn nothing_is_looked_at_while_items_are_pushed_out() {
        let (sender, mut receiver) = frame_ring(1);
        assert_eq!(sender.push(1).await, Pushed::Queued);
        assert_eq!(sender.push_newest(2), Pushed::Replaced(1));
        assert_eq!(receiver.peek(|&item| item).await, None);
        assert_eq!(receiver.next().await, Some(2));
        assert_eq!(sender.push(3).await, Pushed::Queued);
        // The receiver was too slow for item 1, and may be for this one.
        assert_eq!(receiver.peek(|&item| item).await, None);
        assert_eq!(receiver.next().await, Some(3));
        assert_eq!(sender.push(4).await, Pushed::Queued);
        assert_eq!(receiver.peek(|&item| item).await, Some(4));
    }

    #[tokio::test]
    async fn a_ring_without_room_has_room_for_one() {
        let (sender, mut receiver) = frame_ring(0);
        assert_eq!(sender.push('a').await, Pushed::Queued);
        assert_eq!(sender.push_newest('b'), Pushed::Replaced('a'));
        assert_eq!(receiver.next().await, Some('b'));
    }

    #[tokio::test(start_paused = true)]
    async fn a_sender_that_waits_for_room_loses_nothing() {
        let (sender, mut receiver) = frame_ring(2);
        let sending = tokio::spawn(async move {
            for number in 0..100 {
                assert_eq!(sender.push(number).await, Pushed::Queued);
            }
        });
        // Paused time only moves when every task waits: the sender is held back, not slow.
        assert!(
            timeout(Duration::from_secs(3600), async {
                while !sending.is_finished() {
                    tokio::time::sleep(Duration::from_secs(1)).await;
                }
            })
            .await
            .is_err()
        );
        assert_eq!(receiver.waiting(), 2);
        for number in 0..100 {
            assert_eq!(receiver.next().await, Some(number));
        }
        assert_eq!(receiver.next().await, None, "the sender is gone");
        sending.await.unwrap();
    }

    #[tokio::test]
    async fn closing_frees_a_waiting_task() {
        let (sender, mut receiver) = frame_ring(1);
        assert_eq!(sender.push(0).await, Pushed::Queued);
        let task = tokio::spawn({
            let sender = sender.clone();
            async move { sender.push(2).await }
        });
        tokio::task::yield_now().await;
        receiver.close();
        assert_eq!(task.await.unwrap(), Pushed::Closed(2));
        assert_eq!(sender.push_newest(3), Pushed::Closed(3));
        assert_eq!(receiver.next().await, Some(0), "what waited is not lost");
        assert_eq!(receiver.next().await, None);
    }

    #[tokio::test]
    async fn a_receiver_that_is_gone_closes_the_ring() {
        let (sender, receiver) = frame_ring(1);
        drop(receiver);
        assert_eq!(sender.push(1).await, Pushed::Closed(1));
    }

    #[tokio::test]
    async fn a_ring_whose_receiver_failed_is_closed_until_it_is_opened_anew() {
        let (sender, receiver) = frame_ring(4);
        sender.push(1).await;
        sender.push(2).await;
        assert_eq!(receiver.close_and_clear(), 2);
        drop(receiver);
        assert_eq!(sender.push_newest(3), Pushed::Closed(3));
        let mut again = sender.reopen();
        assert_eq!(sender.push_newest(4), Pushed::Queued);
        assert_eq!(again.next().await, Some(4));
    }

    #[tokio::test(start_paused = true)]
    async fn giving_up_a_wait_loses_nothing() {
        let (sender, mut receiver) = frame_ring(2);
        assert!(
            timeout(Duration::from_secs(1), receiver.next())
                .await
                .is_err()
        );
        sender.push(1).await;
        assert_eq!(receiver.next().await, Some(1));
    }
}
