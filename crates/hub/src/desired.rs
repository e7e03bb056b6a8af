//! What is desired of the nodes, in memory: answers to pulls and reports are read from here.

use albireo_wire::{Desired, KnobValue};
use parking_lot::RwLock;
use std::collections::HashMap;
use std::time::{Duration, Instant};

/// What is desired of each node.
#[derive(Debug, Default)]
pub struct Desires {
    nodes: RwLock<HashMap<String, Wish>>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Wish {
    generation: u64,
    knob: Option<KnobValue>,
    watched_until: Option<Instant>,
}

impl Desires {
    /// What is desired of `node`.
    pub fn of(&self, node: &str) -> Desired {
        let nodes = self.nodes.read();
        let Some(wish) = nodes.get(node) else {
            return Desired::nothing();
        };
        let watched = wish
            .watched_until
            .map(|until| until.saturating_duration_since(Instant::now()))
            .filter(|left| !left.is_zero());
        Desired {
            generation: wish.generation,
            knob: wish.knob,
            watched_for_s: watched
                .map(|left| u32::try_from(left.as_secs() + 1).unwrap_or(u32::MAX)),
            ..Desired::nothing()
        }
    }

    /// Desires a value of `node`'s knob, unless a later generation is desired already; whether it is desired now.
    pub fn set(&self, node: &str, generation: u64, knob: Option<KnobValue>) -> bool {
        let mut nodes = self.nodes.write();
        let wish = nodes.entry(node.to_owned()).or_default();
        if generation < wish.generation {
            return false;
        }
        wish.generation = generation;
        wish.knob = knob;
        true
    }

    /// Somebody watches `node` for so long: it then sends counters once a second.
    pub fn watch(&self, node: &str, time: Duration) {
        let mut nodes = self.nodes.write();
        let wish = nodes.entry(node.to_owned()).or_default();
        wish.watched_until = Some(Instant::now() + time);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lower_generation_never_replaces_a_higher() {
        let desires = Desires::default();
        let knob = |value| Some(KnobValue { name: "u", value });
        assert_eq!(desires.of("a"), Desired::nothing());
        assert!(desires.set("a", 5, knob(3e-4)));
        assert!(!desires.set("a", 4, knob(9e-4)));
        let desired = desires.of("a");
        assert_eq!((desired.generation, desired.knob), (5, knob(3e-4)));
        assert_eq!(desires.of("b").generation, 0);
    }
}
