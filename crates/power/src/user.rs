//! The end by which a camera tells the account of the node's energy what it did.

use super::ledger::Spent;
use super::sampler::PowerHandle;
use std::time::Duration;
use tokio::time::Instant;

/// One of those between whom the node's energy is divided. Cheap to clone.
#[derive(Clone, Debug)]
pub struct EnergyUser {
    number: usize,
    power: PowerHandle,
}

impl EnergyUser {
    pub(super) const fn new(number: usize, power: PowerHandle) -> Self {
        Self { number, power }
    }

    /// Notes a frame.
    pub fn frame(&self, at: Instant) {
        self.power.ledger().frame(self.number, at);
    }

    /// Notes a run of the detector from `start` to `end`, of which this user used `used`.
    pub fn detector(&self, start: Instant, end: Instant, used: Duration) {
        self.power.ledger().detector(self.number, start, end, used);
    }

    /// Begins to add up the energy from `start` on, which may lie up to a minute back.
    pub fn open(&self, start: Instant) -> OpenSpan {
        let number = self.power.ledger().open(self.number, start);
        OpenSpan {
            number,
            power: self.power.clone(),
        }
    }
}

/// Energy that is being added up, in constant memory. Dropped, it is forgotten.
#[derive(Debug)]
pub struct OpenSpan {
    number: u64,
    power: PowerHandle,
}

impl OpenSpan {
    /// Says where the span ends if nothing more happens: that moment is kept exactly, however late it turns out
    /// that it was the end. It never moves back.
    pub fn until(&self, at: Instant) {
        self.power.ledger().until(self.number, at);
    }

    /// What was used up to `end`. Waits as [`PowerHandle::settled`] does.
    pub async fn close(self, end: Instant, patience: Duration) -> Option<Spent> {
        self.power.settled(end, patience).await;
        let mut ledger = self.power.ledger();
        let spent = ledger.close(self.number, end, self.power.meta());
        drop(ledger);
        spent
    }
}

impl Drop for OpenSpan {
    fn drop(&mut self) {
        self.power.ledger().drop_span(self.number);
    }
}
