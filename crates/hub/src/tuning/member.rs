//! The nodes of a rollout or trial: the value given to each, and its outcome.

use super::outcome::{Given, Outcome};
use albireo_wire::Threshold;
use rand_core::{RngCore, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Milliseconds since the Unix epoch, by the hub's clock.
pub(crate) type Millis = i64;

/// One node of a rollout or trial.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Member {
    /// Its name.
    pub node: String,
    /// Its stage or group, from 0.
    pub group: usize,
    /// Its value at the beginning.
    pub before: Threshold,
    /// The value that it was given last: first its new one, then its old one; absent if it was given none.
    pub value: Option<Threshold>,
    /// The revision of that, and what became of it.
    #[serde(flatten)]
    pub given: Given,
    /// True if it was in reach when the run was stored.
    pub reachable: bool,
    /// True if it was in reach when the present stage began.
    pub was_reachable: bool,
}

impl Member {
    /// Creates a member that was given no value.
    pub(crate) const fn new(node: String, before: Threshold, reachable: bool) -> Self {
        Self {
            node,
            group: 0,
            before,
            value: None,
            given: Given::new(0, 0, Outcome::Untouched),
            reachable,
            was_reachable: false,
        }
    }

    /// When it reported the value, if it did.
    pub(crate) fn applied_ms(&self) -> Option<Millis> {
        (self.given.outcome == Outcome::Applied).then_some(self.given.at_ms)
    }
}

/// Shuffles a list by the algorithm of Fisher and Yates, seeded with `seed`.
pub(crate) fn shuffle<T>(list: &mut [T], seed: u64) {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    for i in (1..list.len()).rev() {
        // The multiplication spreads 64 random bits over 0..=i; its bias is below 2^-40 for any fleet.
        let pick = (u128::from(random.next_u64()) * (i as u128 + 1)) >> 64;
        list.swap(i, pick as usize);
    }
}
