//! Bounds the entries of each node in a queue that all nodes share.

use parking_lot::Mutex;
use std::collections::HashMap;
use std::sync::Arc;

/// How much waits of each node.
#[derive(Debug)]
pub(crate) struct PerNode {
    most: u32,
    waiting: Mutex<HashMap<Arc<str>, u32>>,
}

/// The place of one thing of a node; free again when dropped.
#[derive(Debug)]
pub(crate) struct Place {
    of: Arc<PerNode>,
    node: Arc<str>,
}

impl PerNode {
    /// At most this many of a node may wait.
    pub(crate) fn new(most: u32) -> Arc<Self> {
        Arc::new(Self {
            most,
            waiting: Mutex::default(),
        })
    }

    /// A place for one more of `node`; none when too many wait.
    pub(crate) fn place(self: &Arc<Self>, node: &str) -> Option<Place> {
        let mut waiting = self.waiting.lock();
        let node = match waiting.get_key_value(node) {
            Some((_, count)) if *count >= self.most => return None,
            Some((name, _)) => Arc::clone(name),
            None => Arc::from(node),
        };
        *waiting.entry(Arc::clone(&node)).or_default() += 1;
        Some(Place {
            of: Arc::clone(self),
            node,
        })
    }
}

impl Place {
    /// The node.
    pub(crate) fn node(&self) -> &str {
        &self.node
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut waiting = self.of.waiting.lock();
        if let Some(count) = waiting.get_mut(&self.node) {
            *count = count.saturating_sub(1);
            if *count == 0 {
                waiting.remove(&self.node);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_that_has_too_much_waiting_takes_no_place_of_another() {
        let all = PerNode::new(2);
        let places = [all.place("a"), all.place("a")];
        assert!(places.iter().all(Option::is_some));
        assert!(all.place("a").is_none());
        assert!(all.place("b").is_some());
        drop(places);
        assert!(all.place("a").is_some());
        assert!(all.waiting.lock().is_empty());
    }
}
