//! Decides which reports of a batch are stored. No clock, no database.

use crate::store::ReportKey;
use crate::store::row::json_text;
use albireo_wire::IDENTITY_DAYS;
use serde::{Deserialize, Serialize};
use uuid::Uuid;

const DAY_MS: i64 = 86_400_000;

/// The first day of 2026, milliseconds since the Unix epoch: no identity is older.
const FIRST_MS: i64 = 1_767_225_600_000;

/// How far the hub's clock may be behind that of a node for the node's to be believed.
const MOST_BEHIND_DAYS: i64 = 366;

/// Ranges of missing counts that are kept of a node; beyond it the oldest are forgotten.
const MOST_RANGES: usize = 32;

/// The largest count that is taken.
const LARGEST_COUNT: u64 = 1 << 53;

/// The present by the clocks of the hub and of the node that sent a batch, milliseconds since the Unix epoch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Present {
    pub(crate) hub_ms: i64,
    pub(crate) node_ms: i64,
}

impl Present {
    /// Whether both are right, as far as can be known.
    pub(crate) const fn clocks_agree(self) -> bool {
        self.hub_ms.saturating_sub(self.node_ms).saturating_abs() <= DAY_MS
    }
}

/// Where a report of that identity is kept. The day is that of the identity itself, unless its clock cannot be believed:
/// then it is the day of receipt by the later of both clocks. A hub whose clock was behind would forget the identity as soon
/// as its clock is right.
///
/// # Errors
/// When it is older than identities are known, in words: it may have been stored before.
pub(crate) fn key(id: Uuid, present: Present) -> Result<ReportKey, String> {
    let today = present.hub_ms.div_euclid(DAY_MS);
    // The first 48 bits of a UUID of version 7 are its time.
    let made_ms = i64::try_from(id.as_u128() >> 80).unwrap_or(i64::MAX);
    let own_day = made_ms.div_euclid(DAY_MS);
    let node_today = present.node_ms.div_euclid(DAY_MS);
    let latest = today.max(FIRST_MS / DAY_MS) + MOST_BEHIND_DAYS;
    let undated = ReportKey {
        day: -today.max(node_today.min(latest)),
        id,
        own_day,
    };
    let believable = FIRST_MS..=present.hub_ms.saturating_add(DAY_MS);
    if id.get_version_num() != 7 || !believable.contains(&made_ms) {
        return Ok(undated);
    }
    let age = today - own_day;
    if age <= i64::from(IDENTITY_DAYS) {
        return Ok(ReportKey {
            day: own_day,
            ..undated
        });
    }
    if present.clocks_agree() {
        return Err(format!(
            "made {age} days ago: whether a report older than {IDENTITY_DAYS} days was stored before is not known any more"
        ));
    }
    Ok(undated)
}

/// What a running count says of its node's reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Seen {
    /// It is the next, or one that was missing.
    Expected,
    /// These did not come, from the first to the last.
    Gap(u64, u64),
    /// It was seen before: the node's state is new, older or a copy. Missing ones are counted from here.
    Reset,
}

/// The running counts of a node's reports.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Counts {
    /// The first count that came; 0 before it. Whether reports with lower counts exist is not known.
    base: u64,
    /// The highest since then.
    highest: u64,
    /// Ranges that did not come, below `base` too: a database restored from a backup of before the node's first report
    /// does not know of them.
    #[serde(with = "json_text")]
    missing: Vec<(u64, u64)>,
}

impl Counts {
    /// How many never came of those since the first that came.
    pub(crate) fn missing(&self) -> u64 {
        let since = self.missing.iter().filter(|(first, _)| *first >= self.base);
        since.map(|(first, last)| last - first + 1).sum()
    }

    /// Counts that the node is asked for, in ranges from the first to the last: those that are missing, and those of
    /// before the first that came.
    pub(crate) fn wanted(&self) -> &[(u64, u64)] {
        &self.missing
    }

    /// Takes the count of a report, which was `new` or known before.
    pub(crate) fn see(&mut self, count: u64, new: bool) -> Seen {
        if count == 0 || count > LARGEST_COUNT {
            return Seen::Expected;
        }
        if self.base == 0 {
            (self.base, self.highest) = (count, count);
            if count > 1 {
                self.missing.push((1, count - 1));
            }
            return Seen::Expected;
        }
        if count > self.highest {
            let gap = (self.highest + 1, count - 1);
            self.highest = count;
            if gap.0 > gap.1 {
                return Seen::Expected;
            }
            if self.missing.len() == MOST_RANGES {
                self.missing.remove(0);
            }
            self.missing.push(gap);
            return Seen::Gap(gap.0, gap.1);
        }
        if let Some(place) = self
            .missing
            .iter()
            .position(|(first, last)| (*first..=*last).contains(&count))
        {
            let (first, last) = self.missing.remove(place);
            let rest = [(first, count - 1), (count + 1, last)];
            let rest = rest.into_iter().filter(|(first, last)| first <= last);
            self.missing.splice(place..place, rest);
            self.missing.truncate(MOST_RANGES);
            return Seen::Expected;
        }
        if !new || count < self.base {
            return Seen::Expected;
        }
        *self = Self {
            base: count,
            highest: count,
            missing: Vec::new(),
        };
        Seen::Reset
    }
}
