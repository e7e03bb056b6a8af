//! Decides under which key a report is stored, and keeps the running counts of a node. It uses no clock and no
//! database.

use super::tables::ReportKey;
use crate::store::StoreError;
use crate::store::row::{Cell, Row};
use albireo_service::clock::DAY_MS;
use albireo_wire::{IDENTITY_DAYS, ReportAge};
use uuid::Uuid;

/// The first day of 2026, milliseconds since the Unix epoch: no identity is older.
const FIRST_MS: i64 = 1_767_225_600_000;

/// Most days that a node's clock may be ahead of the hub's and still be believed.
const MOST_BEHIND_DAYS: i64 = 366;

/// Most ranges of missing counts that are kept per node. One more displaces the oldest.
const MOST_RANGES: usize = 32;

/// Larger counts are ignored.
const LARGEST_COUNT: u64 = 1 << 53;

/// The present time by the clocks of the hub and of the node that sent a batch, milliseconds since the Unix epoch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Present {
    pub(crate) hub_ms: i64,
    pub(crate) node_ms: i64,
}

impl Present {
    /// True if the clocks differ by one day at most.
    pub(crate) const fn clocks_agree(self) -> bool {
        self.hub_ms.saturating_sub(self.node_ms).saturating_abs() <= DAY_MS
    }

    /// The present by the clock that the node had when it made a report, if that is known: the node may have set its clock
    /// since.
    pub(crate) fn when_made(self, id: Uuid, age: Option<ReportAge>) -> Self {
        Self {
            node_ms: present_when_made(id, age).unwrap_or(self.node_ms),
            ..self
        }
    }

    /// How far the clock that the node had when it made a report is behind, if that is known: behind its clock now, or
    /// behind the hub's if that of the node is still wrong.
    pub(crate) fn behind_when_made(self, id: Uuid, age: Option<ReportAge>) -> Option<i64> {
        let right_ms = if self.clocks_agree() {
            self.node_ms
        } else {
            self.hub_ms
        };
        Some(right_ms.saturating_sub(present_when_made(id, age)?))
    }
}

/// The present by the clock with which a report was made: its time, and what a clock that nobody sets has counted since.
fn present_when_made(id: Uuid, age: Option<ReportAge>) -> Option<i64> {
    let made_s = i64::try_from(age?.made_s?).ok()?;
    if id.get_version_num() != 7 {
        return None;
    }
    Some(made_ms(id).saturating_add(made_s.saturating_mul(1000)))
}

/// The time in an identity: the first 48 bits of a UUID of version 7.
fn made_ms(id: Uuid) -> i64 {
    i64::try_from(id.as_u128() >> 80).unwrap_or(i64::MAX)
}

/// The doubt whether a report whose identity is not known was stored before.
#[derive(Debug)]
pub(crate) struct Doubt {
    /// The reason to refuse it.
    pub(crate) reason: String,
    /// True if the node says that it never sent the report before.
    pub(crate) first: bool,
}

/// Returns the key under which a report is stored. Its day is the day of the identity, unless that cannot be believed:
/// then it is the day of receipt by the later of both clocks. With the earlier one, a hub whose clock was behind would
/// delete the identity as soon as its clock is right.
///
/// A report that claims to be older than the identities that the hub keeps may have been stored before, or its node's clock
/// was behind when it was made. What the node knows without its clock decides: a report made at most as many days ago was
/// never stored under its own day, and its identity is still known if it was stored at all. Otherwise there is a doubt, which
/// the node's running counts may clear ([`Counts::lack`]).
///
/// # Errors
/// The reason to refuse a report that claims to be too old, of a node that does not say what it knows and whose clock is
/// right now.
pub(crate) fn key(
    id: Uuid,
    present: Present,
    age: Option<ReportAge>,
) -> Result<(ReportKey, Option<Doubt>), String> {
    let today = present.hub_ms.div_euclid(DAY_MS);
    let made_ms = made_ms(id);
    let own_day = made_ms.div_euclid(DAY_MS);
    let node_today = present.node_ms.div_euclid(DAY_MS);
    let latest = today.max(FIRST_MS / DAY_MS) + MOST_BEHIND_DAYS;
    let received_day = today.max(node_today.min(latest));
    let undated = ReportKey {
        day: -received_day,
        id,
        own_day,
    };
    let believable = FIRST_MS..=present.hub_ms.saturating_add(DAY_MS);
    if id.get_version_num() != 7 || !believable.contains(&made_ms) {
        return Ok((undated, None));
    }
    let claimed = today - own_day;
    let kept = i64::from(IDENTITY_DAYS);
    if claimed <= kept {
        let dated = ReportKey {
            day: own_day,
            ..undated
        };
        return Ok((dated, None));
    }
    let reason = format!(
        "made {claimed} days ago: the hub no longer knows whether a report older than {IDENTITY_DAYS} days was stored before"
    );
    let clocks_agree = present.clocks_agree();
    let Some(ReportAge { made_s, first }) = age else {
        if clocks_agree {
            return Err(reason);
        }
        return Ok((undated, None));
    };
    let is_recent = match made_s {
        Some(made_s) => {
            let days = i64::try_from(made_s.div_ceil(86_400)).unwrap_or(i64::MAX);
            days <= kept && claimed - days > kept
        }
        None => false,
    };
    if is_recent || (first && !clocks_agree) {
        return Ok((undated, None));
    }
    Ok((undated, Some(Doubt { reason, first })))
}

/// The meaning of a report's running count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Seen {
    /// It is the next count, or one that was missing.
    Expected,
    /// Reports with these counts are missing.
    Gap { first: u64, last: u64 },
    /// Another report has the same count: the node's state is new, older or a copy. Missing reports are counted from
    /// here.
    Reset,
}

/// The running counts of a node's reports.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Counts {
    /// The first count that was received; 0 before any report. The hub does not know whether it lacks reports with lower
    /// counts.
    base: u64,
    /// The highest count since then.
    highest: u64,
    /// Ranges of counts that were not received, also below `base`: a database that was restored from a backup made
    /// before the node's first report lacks those.
    ranges: Vec<(u64, u64)>,
    /// From the first count that was displaced to the last one; zeros without any. The hub does not know which of these it
    /// lacks.
    displaced: (u64, u64),
}

impl Counts {
    /// Reads `base`, `highest`, `ranges` and `displaced`.
    pub(crate) fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        Ok(Self {
            base: row.take()?,
            highest: row.take()?,
            ranges: row.take_json()?,
            displaced: row.take_json()?,
        })
    }

    /// The cells of `base`, `highest`, `ranges` and `displaced`.
    pub(crate) fn cells(&self) -> Result<[Cell; 4], StoreError> {
        // Both are at most `LARGEST_COUNT`.
        Ok([
            self.base.cast_signed().into(),
            self.highest.cast_signed().into(),
            Cell::json(&self.ranges)?,
            Cell::json(&self.displaced)?,
        ])
    }

    /// The number of missing counts since the first one that was received.
    pub(crate) fn missing(&self) -> u64 {
        self.ranges
            .iter()
            .filter(|(first, _)| *first >= self.base)
            .map(|(first, last)| last - first + 1)
            .sum()
    }

    /// The counts that the node should send again, as ranges (first, last): all missing ones, also before the first
    /// that was received.
    pub(crate) fn wanted(&self) -> &[(u64, u64)] {
        &self.ranges
    }

    /// True if no report with this count was received, as far as the hub can know; for a report without a count, and for a
    /// node's first reports, that is so if the node says that it never sent them (`first`).
    pub(crate) fn lack(&self, count: Option<u64>, first: bool) -> bool {
        match count {
            Some(count) if self.base > 0 => {
                count > self.highest
                    || self.ranges.iter().any(|(first, last)| (*first..=*last).contains(&count))
            }
            _ => first,
        }
    }

    /// Notes the count of a report, which is new or was stored already.
    pub(crate) fn see(&mut self, count: u64, is_new: bool) -> Seen {
        if count == 0 || count > LARGEST_COUNT {
            return Seen::Expected;
        }
        if self.base == 0 {
            self.base = count;
            self.highest = count;
            if count > 1 {
                self.ranges.push((1, count - 1));
            }
            return Seen::Expected;
        }
        if count > self.highest {
            let first = self.highest + 1;
            let last = count - 1;
            self.highest = count;
            if first > last {
                return Seen::Expected;
            }
            self.ranges.push((first, last));
            self.displace_oldest();
            return Seen::Gap { first, last };
        }
        let has_count = |(first, last): &(u64, u64)| (*first..=*last).contains(&count);
        if let Some(place) = self.ranges.iter().position(has_count) {
            let (first, last) = self.ranges.remove(place);
            let mut rest = vec![(first, count - 1), (count + 1, last)];
            rest.retain(|(first, last)| first <= last);
            self.ranges.splice(place..place, rest);
            self.displace_oldest();
            return Seen::Expected;
        }
        let (first, last) = self.displaced;
        let was_displaced = (first..=last).contains(&count);
        if !is_new || count < self.base || was_displaced {
            return Seen::Expected;
        }
        *self = Self {
            base: count,
            highest: count,
            ..Self::default()
        };
        Seen::Reset
    }

    /// Drops the oldest ranges beyond [`MOST_RANGES`]. Their reports may still come, and are no reset then.
    fn displace_oldest(&mut self) {
        while self.ranges.len() > MOST_RANGES {
            let (first, last) = self.ranges.remove(0);
            if self.displaced.0 == 0 {
                self.displaced.0 = first;
            }
            self.displaced.1 = last;
        }
    }
}
