//! The ring between the subscriber and a camera's loop.

use super::Delivery;
use std::marker::PhantomData;

/// What became of a pushed item.
#[derive(Debug, PartialEq, Eq)]
pub enum Pushed<T> {
    /// It waits for its turn.
    Queued,
    /// It waits for its turn; the ring was full and the oldest item had to go: an overrun.
    Replaced(T),
    /// The receiver is gone or the ring is closed; the item comes back.
    Closed(T),
}

/// The subscriber's end. Clones push into the same ring.
#[derive(Debug)]
pub struct RingSender<T>(PhantomData<T>);

/// The camera loop's end.
#[derive(Debug)]
pub struct RingReceiver<T>(PhantomData<T>);

/// A ring of `capacity` items (at least 1).
pub fn frame_ring<T>(delivery: Delivery, capacity: usize) -> (RingSender<T>, RingReceiver<T>) {
    let _ = (delivery, capacity);
    (RingSender(PhantomData), RingReceiver(PhantomData))
}

impl<T> RingSender<T> {
    /// Pushes from ordinary code, such as Zenoh's callback thread. [`Delivery::Newest`] never waits;
    /// [`Delivery::Every`] blocks the thread until there is room or the ring closes.
    pub fn push_blocking(&self, item: T) -> Pushed<T> {
        Pushed::Closed(item)
    }

    /// Pushes from a task. [`Delivery::Newest`] never waits; [`Delivery::Every`] waits until there is
    /// room or the ring closes.
    pub async fn push(&self, item: T) -> Pushed<T> {
        Pushed::Closed(item)
    }

    /// Closes the ring: nothing more goes in, what waits can still be taken.
    pub fn close(&self) {}
}

impl<T> RingReceiver<T> {
    /// The oldest waiting item; waits for one. `None` once the ring is closed and empty, or all
    /// senders are gone. Cancelling the future loses nothing.
    pub async fn next(&self) -> Option<T> {
        None
    }

    /// Items waiting now.
    pub fn waiting(&self) -> usize {
        0
    }

    /// Closes the ring and wakes blocked senders; what waits can still be taken.
    pub fn close(&self) {}
}
