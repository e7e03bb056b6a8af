//! Names the phases of a rollout or a trial.

use crate::named::named;

named! {
    /// The phase of a rollout or a trial.
    pub enum Phase {
        /// Its nodes, or those of the stage, were given the new value; it waits for their reports.
        Applying = "applying",
        /// The stage's nodes have the new value, and are measured.
        Soaking = "soaking",
        /// Every node of a trial has its value, and is measured.
        Running = "running",
        /// It waits for a person to decide; after the plan's `held_for_s` the old value returns.
        Held = "held",
        /// All stages have passed; it waits for nodes out of reach until their deadline.
        Finishing = "finishing",
        /// All nodes get their old values back.
        Returning = "returning",
        /// Every stage has passed, or the trial is over.
        Done = "done",
        /// Every node in reach has its old value back; the others get it when they return.
        Returned = "returned",
        /// A person ended it; every node kept its value.
        Stopped = "stopped",
    }
}

impl Phase {
    /// True if it is over: only a return is still possible.
    pub(crate) const fn has_ended(self) -> bool {
        matches!(self, Self::Done | Self::Returned | Self::Stopped)
    }
}
