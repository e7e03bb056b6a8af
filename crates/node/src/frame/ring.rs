//! The ring between the subscriber and a camera's loop.
//!
//! The subscriber's end is called on Zenoh's own threads and from tasks, so the ring can be pushed both
//! ways: a lock that is never held across a wait, a `Notify` for tasks and a `Condvar` for threads.

use super::Delivery;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
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
    delivery: Delivery,
    capacity: usize,
    state: Mutex<State<T>>,
    senders: AtomicUsize,
    /// Wakes the receiver.
    filled: Notify,
    /// Wakes tasks that wait for room.
    drained: Notify,
    /// Wakes threads that wait for room.
    drained_for_threads: Condvar,
}

#[derive(Debug)]
struct State<T> {
    items: VecDeque<T>,
    closed: bool,
    /// Whether an item was pushed out since the last one was taken, and before that.
    overrun: bool,
    overrun_before: bool,
}

/// A ring of `capacity` items (at least 1).
pub fn frame_ring<T>(delivery: Delivery, capacity: usize) -> (RingSender<T>, RingReceiver<T>) {
    let ring = Arc::new(Ring {
        delivery,
        capacity: capacity.max(1),
        state: Mutex::new(State {
            items: VecDeque::new(),
            closed: false,
            overrun: false,
            overrun_before: false,
        }),
        senders: AtomicUsize::new(1),
        filled: Notify::new(),
        drained: Notify::new(),
        drained_for_threads: Condvar::new(),
    });
    (RingSender(Arc::clone(&ring)), RingReceiver(ring))
}

impl<T> Ring<T> {
    fn state(&self) -> MutexGuard<'_, State<T>> {
        // No code that can panic runs under the lock, and a queue is whole at any point anyway.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Pushes if no waiting is needed; gives the item back if it is.
    fn try_push(&self, state: &mut State<T>, item: T) -> Result<Pushed<T>, T> {
        if state.closed {
            return Ok(Pushed::Closed(item));
        }
        let replaced = if state.items.len() < self.capacity {
            None
        } else if self.delivery == Delivery::Newest {
            state.items.pop_front()
        } else {
            return Err(item);
        };
        state.items.push_back(item);
        state.overrun |= replaced.is_some();
        self.filled.notify_one();
        Ok(replaced.map_or(Pushed::Queued, Pushed::Replaced))
    }

    fn close(&self) {
        self.state().closed = true;
        self.filled.notify_one();
        self.drained.notify_waiters();
        self.drained_for_threads.notify_all();
    }
}

impl<T> RingSender<T> {
    /// What happens when the ring is full.
    pub(crate) fn delivery(&self) -> Delivery {
        self.0.delivery
    }

    /// Pushes from ordinary code, such as Zenoh's callback thread. [`Delivery::Newest`] never waits;
    /// [`Delivery::Every`] blocks the thread until there is room or the ring closes. Blocking Zenoh's
    /// thread is what holds the publisher back; within a task use [`push`](Self::push).
    pub fn push_blocking(&self, item: T) -> Pushed<T> {
        let mut item = item;
        let mut state = self.0.state();
        loop {
            match self.0.try_push(&mut state, item) {
                Ok(pushed) => return pushed,
                Err(back) => item = back,
            }
            state = self
                .0
                .drained_for_threads
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Pushes from a task. [`Delivery::Newest`] never waits; [`Delivery::Every`] waits until there is
    /// room or the ring closes.
    pub async fn push(&self, item: T) -> Pushed<T> {
        let mut item = item;
        loop {
            // Made before the look at the state, so that no wake-up between the two is missed.
            let drained = self.0.drained.notified();
            let tried = self.0.try_push(&mut self.0.state(), item);
            match tried {
                Ok(pushed) => return pushed,
                Err(back) => item = back,
            }
            drained.await;
        }
    }

    /// Closes the ring: nothing more goes in, what waits can still be taken.
    pub fn close(&self) {
        self.0.close();
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
        loop {
            {
                let mut state = self.0.state();
                if let Some(item) = state.items.pop_front() {
                    state.overrun_before = std::mem::take(&mut state.overrun);
                    drop(state);
                    self.0.drained.notify_waiters();
                    self.0.drained_for_threads.notify_all();
                    return Some(item);
                }
                if state.closed {
                    return None;
                }
            }
            // There is one receiver, so a permit kept from before is at worst one extra look.
            self.0.filled.notified().await;
        }
    }

    /// Looks at the item that will be taken next and leaves it where it is; waits for one. `None` once the
    /// ring is closed and empty; and when an item was pushed out lately, for what is seen now would then
    /// hardly be the one that is taken.
    pub(crate) async fn peek<R>(&self, look: impl Fn(&T) -> R) -> Option<R> {
        loop {
            {
                let state = self.0.state();
                if state.overrun || state.overrun_before {
                    return None;
                }
                if let Some(item) = state.items.front() {
                    return Some(look(item));
                }
                if state.closed {
                    return None;
                }
            }
            // A permit taken here is not missed: `next` looks before it waits.
            self.0.filled.notified().await;
        }
    }

    /// Items waiting now.
    pub fn waiting(&self) -> usize {
        self.0.state().items.len()
    }

    /// Closes the ring and wakes blocked senders; what waits can still be taken.
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
        let (sender, mut receiver) = frame_ring(Delivery::Newest, 2);
        assert_eq!(sender.push_blocking(1), Pushed::Queued);
        assert_eq!(sender.push(2).await, Pushed::Queued);
        assert_eq!(sender.push(3).await, Pushed::Replaced(1));
        assert_eq!(sender.push_blocking(4), Pushed::Replaced(2));
        assert_eq!(receiver.waiting(), 2);
        assert_eq!(receiver.next().await, Some(3));
        assert_eq!(receiver.next().await, Some(4));
    }

    #[tokio::test]
    async fn the_next_item_can_be_looked_at_and_is_still_taken() {
        let (sender, mut receiver) = frame_ring(Delivery::Newest, 2);
        let (seen, _) = tokio::join!(receiver.peek(|&item| item), sender.push(1));
        assert_eq!(seen, Some(1));
        assert_eq!(receiver.next().await, Some(1));
        sender.close();
        assert_eq!(receiver.peek(|&item| item).await, None);
    }

    #[tokio::test]
    async fn nothing_is_looked_at_while_items_are_pushed_out() {
        let (sender, mut receiver) = frame_ring(Delivery::Newest, 1);
        assert_eq!(sender.push(1).await, Pushed::Queued);
        assert_eq!(sender.push(2).await, Pushed::Replaced(1));
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
        let (sender, mut receiver) = frame_ring(Delivery::Newest, 0);
        assert_eq!(sender.push('a').await, Pushed::Queued);
        assert_eq!(sender.push('b').await, Pushed::Replaced('a'));
        assert_eq!(receiver.next().await, Some('b'));
    }

    #[tokio::test(start_paused = true)]
    async fn in_every_mode_the_sender_waits_and_nothing_is_lost() {
        let (sender, mut receiver) = frame_ring(Delivery::Every, 2);
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
    async fn a_blocked_thread_goes_on_when_there_is_room() {
        let (sender, mut receiver) = frame_ring(Delivery::Every, 1);
        let thread = std::thread::spawn(move || {
            (0..1000)
                .map(|number| sender.push_blocking(number))
                .filter(|pushed| *pushed == Pushed::Queued)
                .count()
        });
        for number in 0..1000 {
            assert_eq!(receiver.next().await, Some(number));
        }
        assert_eq!(receiver.next().await, None);
        assert_eq!(thread.join().unwrap(), 1000);
    }

    #[tokio::test]
    async fn closing_frees_a_blocked_thread_and_a_waiting_task() {
        let (sender, mut receiver) = frame_ring(Delivery::Every, 1);
        assert_eq!(sender.push(0).await, Pushed::Queued);
        let thread = std::thread::spawn({
            let sender = sender.clone();
            move || sender.push_blocking(1)
        });
        let task = tokio::spawn({
            let sender = sender.clone();
            async move { sender.push(2).await }
        });
        tokio::task::yield_now().await;
        receiver.close();
        assert_eq!(task.await.unwrap(), Pushed::Closed(2));
        assert_eq!(thread.join().unwrap(), Pushed::Closed(1));
        assert_eq!(sender.push_blocking(3), Pushed::Closed(3));
        assert_eq!(receiver.next().await, Some(0), "what waited is not lost");
        assert_eq!(receiver.next().await, None);
    }

    #[tokio::test]
    async fn a_receiver_that_is_gone_closes_the_ring() {
        let (sender, receiver) = frame_ring(Delivery::Every, 1);
        drop(receiver);
        assert_eq!(sender.push(1).await, Pushed::Closed(1));
    }

    #[tokio::test]
    async fn a_ring_whose_receiver_failed_is_closed_until_it_is_opened_anew() {
        let (sender, receiver) = frame_ring(Delivery::Newest, 4);
        sender.push(1).await;
        sender.push(2).await;
        assert_eq!(receiver.close_and_clear(), 2);
        drop(receiver);
        assert_eq!(sender.push_blocking(3), Pushed::Closed(3));
        let mut again = sender.reopen();
        assert_eq!(sender.push_blocking(4), Pushed::Queued);
        assert_eq!(again.next().await, Some(4));
    }

    #[tokio::test(start_paused = true)]
    async fn giving_up_a_wait_loses_nothing() {
        let (sender, mut receiver) = frame_ring(Delivery::Newest, 2);
        assert!(
            timeout(Duration::from_secs(1), receiver.next())
                .await
                .is_err()
        );
        sender.push(1).await;
        assert_eq!(receiver.next().await, Some(1));
    }
}
