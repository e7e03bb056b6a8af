//! What is to be done with a batch, by what is known of its instance. Pure: no database, no clock.

use super::decode::Batch;
use crate::store::{Instance, Known};
use std::collections::HashMap;

/// What a node is told, once it is committed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// Everything up to this number is stored.
    Stored(i64),
    /// The batch's first number belongs to another report.
    Conflict(String),
}

/// Numbers that did not come.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Gap {
    pub(crate) first: i64,
    pub(crate) last: i64,
    pub(crate) cause: &'static str,
}

/// What is to be done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Plan {
    /// Places in the batch of the reports to write.
    pub(crate) store: Vec<usize>,
    /// Reports that were there already.
    pub(crate) again: usize,
    /// Numbers that did not come.
    pub(crate) gaps: Vec<Gap>,
    /// Of these, how many nobody can account for otherwise: they count as missing.
    pub(crate) missing: i64,
    /// The cursor afterwards.
    pub(crate) next_report: i64,
    /// What a conflict is about; the answer may still be [`Outcome::Stored`] for what came before it.
    pub(crate) conflict: Option<String>,
    /// What the node is told.
    pub(crate) outcome: Outcome,
}

/// Numbers of a batch below the cursor: what is known of them must be looked up before [`plan`].
pub(crate) fn below<'b>(batch: &'b Batch, instance: &Instance) -> impl Iterator<Item = i64> + 'b {
    let cursor = instance.next_report;
    batch
        .reports
        .iter()
        .map(|report| report.number)
        .take_while(move |number| *number < cursor)
}

/// Decides. `kept_since_ms`: clips received before may have been deleted.
pub(crate) fn plan(
    batch: &Batch,
    instance: &Instance,
    known: &HashMap<(i64, i64), Known>,
    kept_since_ms: i64,
) -> Plan {
    let cursor = instance.next_report;
    let stranger = match (&instance.machine, &batch.machine) {
        (Some(first), Some(now)) => first != now,
        _ => false,
    };
    let mut store = Vec::new();
    let mut again = 0;
    let mut conflict = None;
    let mut stored = None;
    for (place, report) in batch.reports.iter().enumerate() {
        let number = report.number;
        let started = report
            .content
            .as_ref()
            .ok()
            .map(|report| i64::try_from(report.started_ns).unwrap_or(i64::MAX));
        let new = if number >= cursor {
            Ok(true)
        } else {
            match known.get(&(instance.id, number)) {
                Some(Known::SetAside) => Ok(false),
                Some(Known::Clip(there)) if started == Some(*there) => Ok(false),
                Some(Known::Clip(_)) => Err(format!(
                    "report {number} is another than the one stored under this number: the node's state went back in \
                     time, or was copied"
                )),
                // Nothing of this instance can have been deleted yet: the number was missing, and comes late.
                None if instance.first_ms > kept_since_ms => Ok(true),
                None if started.is_some_and(|started| started > instance.latest_started_ns) => {
                    Err(format!(
                        "report {number} is newer than everything stored, and its number lies below {cursor}: the \
                         node's state went back in time"
                    ))
                }
                None => Ok(false),
            }
        };
        match new {
            Ok(true) if stranger => {
                conflict = Some(format!(
                    "instance {} is bound to the machine {}, and this is {}: its state was copied",
                    batch.instance,
                    instance.machine.as_deref().unwrap_or("unknown"),
                    batch.machine.as_deref().unwrap_or("unknown"),
                ));
            }
            Ok(true) => store.push(place),
            Ok(false) => again += 1,
            Err(reason) => conflict = Some(reason),
        }
        if conflict.is_some() {
            break;
        }
        stored = Some(number);
    }
    let outcome = match (&conflict, stored) {
        (None, _) => Outcome::Stored(batch.last),
        (Some(_), Some(number)) => Outcome::Stored(number),
        (Some(reason), None) => Outcome::Conflict(reason.clone()),
    };
    let (gaps, missing) = if conflict.is_none() {
        gaps(batch, instance)
    } else {
        (Vec::new(), 0)
    };
    Plan {
        store,
        again,
        gaps,
        missing,
        next_report: match conflict {
            None => cursor.max(batch.last + 1),
            Some(_) => cursor,
        },
        conflict,
        outcome,
    }
}

/// The numbers from the cursor to the batch's last that are not in it.
fn gaps(batch: &Batch, instance: &Instance) -> (Vec<Gap>, i64) {
    let mut expected = instance.next_report;
    let mut ranges = Vec::new();
    let numbers = batch.reports.iter().map(|report| report.number);
    for number in numbers.chain([batch.last + 1]) {
        if number > expected {
            ranges.push((expected, number - 1));
        }
        expected = expected.max(number.saturating_add(1));
    }
    let unknown = instance.next_report <= 1 && instance.reports + instance.set_aside == 0;
    let total: i64 = ranges.iter().map(|(first, last)| last - first + 1).sum();
    let lost = batch.lost.saturating_sub(instance.lost).max(0);
    let cause = if lost >= total {
        "the node lost them before it could send them"
    } else if unknown {
        "sent before this database knew the instance"
    } else {
        "nobody says where they are"
    };
    let missing = if unknown && lost < total { 0 } else { total };
    let gaps = ranges
        .into_iter()
        .map(|(first, last)| Gap { first, last, cause })
        .collect();
    (gaps, missing)
}
