//! Says which value each member should have, and which are due.

use super::super::member::{Member, Millis};
use super::super::outcome::{Given, Outcome};
use super::{Kind, Phase, Run};
use albireo_wire::Threshold;

/// A value that is due for some nodes.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct DueValue {
    /// The value.
    pub(crate) threshold: Threshold,
    /// The nodes.
    pub(crate) nodes: Vec<String>,
}

impl Run {
    /// The value that a member should have now; `None` if it keeps the one that it has.
    pub(super) fn value_of(&self, member: &Member) -> Option<Threshold> {
        match self.phase {
            Phase::Stopped => return None,
            Phase::Returning | Phase::Returned => return value_to_return_to(member),
            _ => {}
        }
        match &self.kind {
            Kind::Trial { .. } if self.phase == Phase::Done => value_to_return_to(member),
            Kind::Trial { plan } => plan.values.get(member.group).copied(),
            Kind::Rollout { .. } if member.group >= self.stage => None,
            // It would not be judged if it got its value after its deadline.
            Kind::Rollout { .. } if member.given.outcome == Outcome::Missed => Some(member.before),
            Kind::Rollout { to, .. } => Some(*to),
        }
    }

    /// The value that is due for a member, if any.
    fn due_value(&self, member: &Member) -> Option<Threshold> {
        if self.paused_ms.is_some() {
            return None;
        }
        let value = self.value_of(member)?;
        if member.value == Some(value) {
            return None;
        }
        Some(value)
    }

    /// The values that are due, even after its end: nodes that missed their deadline get the old value. The caller calls
    /// [`Run::given`] once a revision with the value is in the database.
    pub(crate) fn due(&self) -> Vec<DueValue> {
        let mut values: Vec<DueValue> = Vec::new();
        for member in &self.members {
            let Some(threshold) = self.due_value(member) else {
                continue;
            };
            let node = member.node.clone();
            match values.iter_mut().find(|due| due.threshold == threshold) {
                Some(due) => due.nodes.push(node),
                None => values.push(DueValue {
                    threshold,
                    nodes: vec![node],
                }),
            }
        }
        values
    }

    /// Notes that the value was given, with that revision.
    pub(crate) fn given(&mut self, due: &DueValue, revision: u64, now: Millis) {
        self.unsaved = true;
        // The members are taken out of the run, because `due_value` reads the rest of it.
        let mut members = std::mem::take(&mut self.members);
        for member in &mut members {
            if self.due_value(member) == Some(due.threshold) {
                member.value = Some(due.threshold);
                // A node that missed its value remains listed as missed.
                let outcome = match member.given.outcome {
                    Outcome::Missed => Outcome::Missed,
                    _ => Outcome::Pending,
                };
                member.given = Given::new(revision, now, outcome);
            }
        }
        self.members = members;
    }
}

/// The value before the run; `None` for a node that was given no value, which has nothing to return from.
fn value_to_return_to(member: &Member) -> Option<Threshold> {
    if member.value.is_some() {
        Some(member.before)
    } else {
        None
    }
}
