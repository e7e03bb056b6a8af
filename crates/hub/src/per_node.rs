//! Limits how many entries each node may have in a queue that all nodes share.

use parking_lot::Mutex;
use std::collections::HashMap;
use std::sync::Arc;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// The places of each node in the queue.
#[derive(Debug)]
pub(crate) struct PerNode {
    most: usize,
    places: Mutex<HashMap<String, Arc<Semaphore>>>,
}

/// The place of one entry; dropping it frees the place.
pub(crate) type Place = OwnedSemaphorePermit;

impl PerNode {
    /// Allows each node at most `most` waiting entries.
    pub(crate) fn new(most: usize) -> Self {
        Self {
            most,
            places: Mutex::default(),
        }
    }

    /// Takes a place for one more entry of `node`; `None` if too many are waiting.
    pub(crate) fn place(&self, node: &str) -> Option<Place> {
        let mut all = self.places.lock();
        if !all.contains_key(node) {
            // Nodes with nothing waiting are removed, because a sender can invent any number of names.
            all.retain(|_, places| places.available_permits() < self.most);
        }
        let places = all
            .entry(node.to_owned())
            .or_insert_with(|| Arc::new(Semaphore::new(self.most)));
        Arc::clone(places).try_acquire_owned().ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_with_an_empty_queue_is_not_remembered() {
        let all = PerNode::new(2);
        let _waiting = all.place("a");
        for invented in 0..100 {
            drop(all.place(&format!("n{invented}")));
        }
        assert!(all.places.lock().len() <= 2);
    }
}
