//! What is decided of a batch, by table.

use super::decode::{Batch, Numbered, Unread};
use super::plan::{Outcome, plan};
use crate::store::{Instance, Known};
use std::collections::HashMap;

fn instance(next_report: i64) -> Instance {
    Instance {
        id: 7,
        machine: Some("m1".into()),
        next_report,
        first_ms: 1_000,
        last_ms: 2_000,
        latest_started_ns: 50,
        reports: next_report - 1,
        set_aside: 0,
        missing: 0,
        lost: 0,
        conflicts: 0,
    }
}

/// A batch of reports that cannot be read: what is decided does not depend on their content.
fn batch(numbers: &[i64], last: i64) -> Batch {
    let unread = || Unread {
        cause: "c".into(),
        body: "b".into(),
    };
    Batch {
        node: "n".into(),
        instance: "i".into(),
        machine: Some("m1".into()),
        last,
        lost: 0,
        reports: numbers
            .iter()
            .map(|number| Numbered {
                number: *number,
                content: Err(unread()),
            })
            .collect(),
    }
}

#[test]
fn what_follows_the_cursor_is_stored() {
    let plan = plan(&batch(&[5, 6], 6), &instance(5), &HashMap::new(), 0);
    assert_eq!((plan.store, plan.next_report), (vec![0, 1], 7));
    assert_eq!(plan.outcome, Outcome::Stored(6));
    assert!(plan.gaps.is_empty() && plan.missing == 0);
}

#[test]
fn numbers_that_are_left_out_are_counted_wherever_they_lie() {
    let plan = plan(&batch(&[7, 9], 11), &instance(5), &HashMap::new(), 0);
    let ranges: Vec<_> = plan.gaps.iter().map(|gap| (gap.first, gap.last)).collect();
    assert_eq!(ranges, [(5, 6), (8, 8), (10, 11)]);
    assert_eq!((plan.missing, plan.next_report), (5, 12));
}

#[test]
fn a_gap_that_the_node_accounts_for_says_so() {
    let mut lossy = batch(&[7], 7);
    lossy.lost = 2;
    let plan = plan(&lossy, &instance(5), &HashMap::new(), 0);
    assert_eq!(
        plan.gaps[0].cause,
        "the node lost them before it could send them"
    );
}

#[test]
fn an_instance_that_the_database_does_not_know_has_lost_nothing() {
    let mut new = instance(1);
    new.reports = 0;
    let plan = plan(&batch(&[400], 400), &new, &HashMap::new(), 0);
    assert_eq!((plan.gaps.len(), plan.missing), (1, 0));
}

#[test]
fn what_was_set_aside_is_known() {
    let known = HashMap::from([((7, 3), Known::SetAside)]);
    let plan = plan(&batch(&[3, 5], 5), &instance(5), &known, 0);
    assert_eq!((plan.store, plan.again), (vec![1], 1));
    assert_eq!(plan.outcome, Outcome::Stored(5));
}

#[test]
fn another_report_under_a_known_number_is_a_conflict_and_moves_no_cursor() {
    let known = HashMap::from([((7, 3), Known::SetAside), ((7, 4), Known::Clip(1))]);
    let first = plan(&batch(&[3, 4, 5], 5), &instance(5), &known, 0);
    assert_eq!((first.outcome, first.next_report), (Outcome::Stored(3), 5));
    let then = plan(&batch(&[4, 5], 5), &instance(5), &known, 0);
    assert!(matches!(then.outcome, Outcome::Conflict(_)));
    assert_eq!((then.store.len(), then.next_report), (0, 5));
}

#[test]
fn where_clips_may_have_been_deleted_an_old_report_counts_as_known() {
    let nothing = HashMap::new();
    // Nothing of the instance can have been deleted: the number was missing, and comes late.
    assert_eq!(
        plan(&batch(&[3], 3), &instance(5), &nothing, 500).store,
        [0]
    );
    let old = plan(&batch(&[3], 3), &instance(5), &nothing, 5_000);
    assert_eq!((old.store.len(), old.again), (0, 1));
}

#[test]
fn a_copy_on_another_machine_stores_nothing_of_its_own() {
    let mut copy = batch(&[5], 5);
    copy.machine = Some("m2".into());
    assert!(matches!(
        plan(&copy, &instance(5), &HashMap::new(), 0).outcome,
        Outcome::Conflict(_)
    ));
    copy.machine = None;
    assert_eq!(plan(&copy, &instance(5), &HashMap::new(), 0).store, [0]);
}
