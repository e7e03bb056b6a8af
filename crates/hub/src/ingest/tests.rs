mod hostile;

use super::clip::clip;
use super::plan::{Counts, Present, Seen};
use super::tables::ReportKey;
use crate::store::row::{Cell, Row};
use albireo_service::clock::DAY_MS;
use albireo_wire::{ClipReport, ReportAge};
use proptest::prelude::*;
use std::collections::BTreeSet;
use uuid::{Builder, Uuid};

/// Day 20,780 is the 23rd of November 2026.
const NOW_MS: i64 = 20_780 * DAY_MS + 1_000;

fn id(made_ms: i64) -> Uuid {
    Builder::from_unix_timestamp_millis(made_ms.unsigned_abs(), &[7; 10]).into_uuid()
}

/// The key of a report of a node that does not say what it knows.
fn key(id: Uuid, present: Present) -> Result<ReportKey, String> {
    super::plan::key(id, present, None).map(|(key, _)| key)
}

/// The present according to a hub, and to a node whose clock is that much ahead.
fn present(ahead_ms: i64) -> Present {
    Present {
        hub_ms: NOW_MS,
        node_ms: NOW_MS + ahead_ms,
    }
}

#[test]
fn the_day_of_a_report_is_that_of_its_id_unless_implausible() {
    let day = |made_ms: i64, ahead_ms: i64| key(id(made_ms), present(ahead_ms)).unwrap().day;
    for days in [0, 1, 30] {
        assert_eq!(day(NOW_MS - days * DAY_MS, 0), 20_780 - days);
    }
    // A clock that is slightly ahead.
    assert_eq!(day(NOW_MS + 3_600_000, 3_600_000), 20_780);
    // A board's clock at boot, one of another decade, two that ran ahead.
    for (made_ms, wanted) in [
        (0, 20_780),
        (1_600_000_000_000, 20_780),
        (NOW_MS + 2 * DAY_MS, 20_782),
        (NOW_MS * 2, 20_780 + 366),
    ] {
        assert_eq!(day(made_ms, made_ms - NOW_MS), -wanted);
    }
    // An id without a time.
    let random = Builder::from_random_bytes([9; 16]).into_uuid();
    assert_eq!(key(random, present(0)).unwrap().day, -20_780);
}

#[test]
fn a_report_is_too_old_only_if_the_clocks_agree_and_a_wrong_clock_of_the_hub_loses_no_id() {
    let old = id(NOW_MS - 31 * DAY_MS);
    let reason = key(old, present(0)).unwrap_err();
    assert!(reason.contains("made 31 days ago"), "{reason}");
    // A node whose clock is a month behind makes such ids today.
    assert_eq!(key(old, present(-31 * DAY_MS)).unwrap().day, -20_780);
    // A hub's clock a hundred days ahead, a hundred days behind and of 1970.
    for (hub_ms, day) in [
        (NOW_MS + 100 * DAY_MS, 20_880),
        (NOW_MS - 100 * DAY_MS, 20_780),
        (0, 20_780),
    ] {
        let node_ms = NOW_MS;
        let found = key(id(NOW_MS), Present { hub_ms, node_ms }).unwrap();
        assert_eq!(found.day, -day, "{hub_ms}");
    }
}

#[test]
fn a_clip_made_before_the_clock_was_set_is_stored_under_the_time_when_it_began() {
    const HOUR_MS: i64 = 3_600_000;
    // The stored clip that began an hour before it was sent, by a clock that was `then_ms` ahead and is `now_ms` ahead.
    let stored = |then_ms: i64, now_ms: i64, made_s: Option<u64>| {
        let by_its_clock = NOW_MS + then_ms - HOUR_MS;
        let id = id(by_its_clock + 40_000);
        let report = ClipReport {
            id,
            started_ns: u64::try_from(by_its_clock).unwrap() * 1_000_000,
            ..ClipReport::default()
        };
        let present = present(now_ms);
        let age = Some(ReportAge {
            made_s,
            first: true,
        });
        let behind_ms = present.behind_when_made(id, age);
        clip(&report, present.when_made(id, age), behind_ms).unwrap()
    };
    // It was made when its 40 seconds had passed.
    let made_s = Some(3_600 - 40);
    let year = 365 * DAY_MS;
    for then_ms in [
        -56 * year,
        -45 * DAY_MS,
        -2 * HOUR_MS,
        2 * HOUR_MS,
        3 * year,
    ] {
        let is_believed = then_ms.abs() <= DAY_MS;
        let set_since = stored(then_ms, 0, made_s);
        assert_eq!(set_since.row.at_ms, NOW_MS - HOUR_MS, "{then_ms}");
        assert_eq!(set_since.is_clock_believed, is_believed, "{then_ms}");
        let still_ahead = stored(then_ms, then_ms, made_s);
        let ahead_ms = if is_believed { then_ms } else { 0 };
        assert_eq!(
            still_ahead.row.at_ms,
            NOW_MS + ahead_ms - HOUR_MS,
            "{then_ms}"
        );
    }
    let right = stored(0, 0, made_s);
    assert_eq!(right.row.at_ms, NOW_MS - HOUR_MS);
    assert!(right.is_clock_believed);
    let slewed = stored(-20_000, 0, made_s);
    assert_eq!(slewed.row.at_ms, NOW_MS - HOUR_MS - 20_000);
    assert!(slewed.is_clock_believed);
    // The machine was started since: nothing but its clocks is known.
    let behind = stored(-45 * DAY_MS, -45 * DAY_MS, None);
    assert_eq!(behind.row.at_ms, NOW_MS);
    assert!(!behind.is_clock_believed);
    let right = stored(0, 0, None);
    assert_eq!(right.row.at_ms, NOW_MS - HOUR_MS);
    assert!(right.is_clock_believed);
}

/// A report by its age.
#[derive(Clone, Copy)]
struct Aged {
    /// Days since the time in its identity.
    days: i64,
    /// Days since it was made, as the node knows without its clock.
    made_days: Option<u64>,
    /// How far the node's clock is behind now, days.
    behind_days: i64,
}

impl Aged {
    /// Of a node whose clock is right now.
    fn new(days: i64, made_days: Option<u64>) -> Self {
        Self {
            days,
            made_days,
            behind_days: 0,
        }
    }

    /// True if the hub doubts whether it was stored before, where the node may have sent it before.
    fn is_doubted(self) -> bool {
        let first = false;
        self.has_doubt(first)
    }

    /// True if the hub doubts that even where the node says that it never sent it.
    fn is_doubted_if_first(self) -> bool {
        let first = true;
        self.has_doubt(first)
    }

    fn has_doubt(self, first: bool) -> bool {
        let id = id(NOW_MS - self.days * DAY_MS);
        let made_s = self.made_days.map(|days| days * 86_400);
        let age = Some(ReportAge { made_s, first });
        let present = present(-self.behind_days * DAY_MS).when_made(id, age);
        let (key, doubt) = super::plan::key(id, present, age).unwrap();
        let own_or_received_day = if self.days <= 30 {
            20_780 - self.days
        } else {
            -20_780
        };
        assert_eq!(key.day, own_or_received_day);
        if let Some(doubt) = &doubt {
            assert_eq!(doubt.first, first);
        }
        doubt.is_some()
    }
}

#[test]
fn what_a_node_knows_without_its_clock_decides_whether_a_report_is_too_old() {
    // Made an hour ago, by a clock that was behind and is right now.
    for days in [31, 45, 100, 331] {
        assert!(!Aged::new(days, Some(0)).is_doubted(), "{days}");
    }
    // Made a week ago, by such a clock.
    assert!(!Aged::new(45, Some(7)).is_doubted());
    // Really old, or perhaps stored under its own day, which was deleted since.
    for made_days in [None, Some(45)] {
        assert!(Aged::new(45, made_days).is_doubted());
        assert!(Aged::new(45, made_days).is_doubted_if_first());
    }
    assert!(!Aged::new(30, None).is_doubted());
    // Of that age it may have been stored under its own day, which was deleted since; but not if it was never sent.
    let perhaps_stored = Aged::new(45, Some(20));
    assert!(perhaps_stored.is_doubted());
    assert!(!perhaps_stored.is_doubted_if_first());
    // A clock that is behind still: a report that was sent before may have been stored.
    let behind = Aged {
        behind_days: 45,
        ..Aged::new(45, None)
    };
    assert!(behind.is_doubted());
    assert!(!behind.is_doubted_if_first());
}

#[test]
fn running_counts_know_which_reports_never_arrived() {
    let mut counts = Counts::default();
    for is_first in [true, false] {
        assert_eq!(
            counts.lack(Some(7), is_first),
            is_first,
            "the node's first reports"
        );
        assert_eq!(
            counts.lack(None, is_first),
            is_first,
            "a report without a count"
        );
    }
    see(&mut counts, &[5, 9]);
    for arrived in [5, 9] {
        assert!(!counts.lack(Some(arrived), true), "{arrived}");
    }
    for absent in [4, 6, 8, 10] {
        assert!(counts.lack(Some(absent), true), "{absent}");
    }
}

/// The results for counts of new reports.
fn see(counts: &mut Counts, given: &[u64]) -> Vec<Seen> {
    given.iter().map(|count| see_new(counts, *count)).collect()
}

fn see_new(counts: &mut Counts, count: u64) -> Seen {
    let is_new = true;
    counts.see(count, is_new)
}

/// The result for the count of a report that was stored already.
fn see_again(counts: &mut Counts, count: u64) -> Seen {
    let is_new = false;
    counts.see(count, is_new)
}

#[test]
fn a_known_count_under_a_new_id_is_a_reset_and_misses_nothing_earlier() {
    let mut counts = Counts::default();
    let seen = see(&mut counts, &[1, 2, 3, 9]);
    assert_eq!(seen[2..], [Seen::Expected, Seen::Gap { first: 4, last: 8 }]);
    // The same report again is not another report.
    assert_eq!(see_again(&mut counts, 2), Seen::Expected);
    assert_eq!(counts.wanted(), [(4, 8)]);
    assert_eq!(see(&mut counts, &[2, 2]), [Seen::Reset; 2]);
    // 1 is of the time before the reset.
    assert_eq!(see(&mut counts, &[1, 3, 4]), [Seen::Expected; 3]);
    assert!(counts.wanted().is_empty());
    assert_eq!(see_new(&mut counts, 6), Seen::Gap { first: 5, last: 5 });
}

#[test]
fn a_late_report_is_no_reset_however_many_gaps_there_are() {
    // As many gaps as are kept, and more.
    for gaps in [32, 40] {
        let mut counts = Counts::default();
        for gap in 0..=gaps {
            see_new(&mut counts, gap * 4 + 1);
        }
        // The middle of each gap splits it.
        for place in [3, 2, 4] {
            for gap in 0..gaps {
                let late = gap * 4 + place;
                assert_eq!(see_new(&mut counts, late), Seen::Expected, "{late}");
            }
        }
    }
}

#[test]
fn a_reset_is_noticed_although_gaps_were_displaced() {
    let mut counts = Counts::default();
    see(&mut counts, &[1, 2, 3, 4, 5]);
    for gap in 0..=40 {
        see_new(&mut counts, 1000 + 2 * gap);
    }
    // A late report of a gap that was displaced is none.
    assert_eq!(see(&mut counts, &[7, 1001]), [Seen::Expected; 2]);
    // Nor is one of a gap that is kept.
    assert_eq!(see_new(&mut counts, 1079), Seen::Expected);
    assert_eq!(see_new(&mut counts, 1), Seen::Reset);
    for count in 2..20 {
        assert_eq!(see_new(&mut counts, count), Seen::Expected, "{count}");
    }
    let gap = Seen::Gap {
        first: 20,
        last: 29,
    };
    assert_eq!(see_new(&mut counts, 30), gap);
    assert_eq!(counts.wanted(), [(20, 29)]);
    assert!(counts.lack(Some(25), true));
    // A known count above all that were displaced.
    let mut counts = Counts::default();
    for gap in 0..=40 {
        see_new(&mut counts, 1 + 2 * gap);
    }
    assert_eq!(see_new(&mut counts, 79), Seen::Reset);
}

#[test]
fn a_gap_that_is_split_displaces_the_oldest_one() {
    let mut counts = Counts::default();
    for gap in 0..=32 {
        see_new(&mut counts, gap * 4 + 1);
    }
    see_new(&mut counts, 127);
    assert_eq!(counts.wanted().len(), 32);
    assert_eq!(counts.wanted()[0], (6, 8));
    assert_eq!(counts.wanted()[30..], [(126, 126), (128, 128)]);
    assert_eq!(counts.missing(), 30 * 3 + 2);
}

#[test]
fn counts_are_read_back_from_their_row_unchanged() {
    let mut counts = Counts::default();
    see(&mut counts, &[3, 4, 9]);
    let cells = counts.cells().unwrap();
    assert_eq!(cells[2..], ["[[1,2],[5,8]]", "[0,0]"].map(Cell::from));
    // More gaps than are kept.
    for gap in 0..=50 {
        see_new(&mut counts, 20 + 2 * gap);
    }
    let cells = counts.cells().unwrap();
    assert_eq!(cells[3], Cell::from("[1,55]"));
    let mut row = Row::new(cells.to_vec());
    assert_eq!(Counts::from_row(&mut row).unwrap(), counts);
}

#[test]
fn two_boards_with_copies_of_one_state_cause_no_missing_reports() {
    let mut counts = Counts::default();
    see(&mut counts, &[100]);
    for more in 1..50 {
        // Both boards send a report with this count, and one of them sends it once more.
        see(&mut counts, &[100 + more, 100 + more]);
        see_again(&mut counts, 100 + more);
        assert_eq!(counts.missing(), 0);
    }
}

#[test]
fn invented_counts_fill_no_memory() {
    let mut counts = Counts::default();
    for count in 1..10_000 {
        see_new(&mut counts, count * 3);
    }
    assert!(counts.wanted().len() <= 32);
    for count in [0, u64::MAX] {
        assert_eq!(see_new(&mut counts, count), Seen::Expected);
    }
}

proptest! {
    #[test]
    fn exactly_the_reports_that_never_arrived_are_missing(came in prop::collection::vec(1_u64..60, 1..80)) {
        let mut counts = Counts::default();
        let mut known = BTreeSet::new();
        let base = came[0];
        for count in came {
            // No count has two ids, so a known count is of the same report.
            let is_new = known.insert(count);
            let seen = counts.see(count, is_new);
            prop_assert!(seen != Seen::Reset);
        }
        let highest = known.last().copied().unwrap_or(0);
        let never: Vec<u64> = (1..=highest).filter(|count| !known.contains(count)).collect();
        let wanted: Vec<u64> = counts.wanted().iter().flat_map(|(first, last)| *first..=*last).collect();
        let missing = never.iter().filter(|count| **count > base).count();
        prop_assert_eq!(counts.missing(), missing as u64);
        prop_assert_eq!(wanted, never);
    }
}
