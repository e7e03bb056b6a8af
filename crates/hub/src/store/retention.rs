//! Deletes old rows: whole days in PostgreSQL, else a small range at a time, so that the thread that writes never waits
//! long.

use super::{Database, Kind, StoreError};
use crate::config::HistoryConfig;
use albireo_service::clock::DAY_MS;
use albireo_wire::IDENTITY_DAYS;

/// Most rows that a statement deletes.
const STEP: usize = 1000;

/// Earlier than any day of a row.
const NO_DAY: i64 = -1_000_000;

/// Deletes at most [`STEP`] rows of each table that are too old at `now_ms`, and whole partitions. If the clock is not
/// believed (`is_believed`), it only creates the partitions of the next days. Returns true if there are more old rows.
pub(crate) fn retain(
    database: &mut dyn Database,
    history: &HistoryConfig,
    now_ms: i64,
    is_believed: bool,
) -> Result<bool, StoreError> {
    let today = now_ms.div_euclid(DAY_MS);
    let first = |days: u32| {
        if is_believed {
            today - i64::from(days)
        } else {
            NO_DAY
        }
    };
    // One day more, because a report of the day before is still accepted.
    let clips = first(history.clips_days);
    let ids = first(IDENTITY_DAYS + 1);
    let sums = first(history.five_minutes_days);
    if database.kind() == Kind::Postgres {
        // Creating or dropping a partition locks its table for a moment. Each table has its own transaction, so that
        // none waits for one table while holding another.
        for (table, first) in DAILY.into_iter().zip([clips, ids, sums]) {
            database.begin()?;
            // A long read delays the drop of a partition, and a waiting drop blocks everything else.
            database.query("SET LOCAL lock_timeout TO '1s'", &[])?;
            keep_days(database, table, first, today)?;
            database.commit()?;
        }
    }
    let events = first(history.events_days);
    let aside = first(history.set_aside_days);
    let bounds = [clips, ids, ids, sums, events, events, events, aside];
    let days = match database.kind() {
        Kind::Sqlite => include_str!("sql/delete_days_sqlite.sql"),
        Kind::Postgres => include_str!("sql/delete_days_postgres.sql"),
    };
    let texts = days.split(';').chain(include_str!("sql/delete_old.sql").split(';'));
    database.begin()?;
    let mut most = 0;
    for (text, bound) in texts.zip(bounds) {
        most = most.max(database.query(text, &[bound.into()])?.len());
    }
    database.commit()?;
    Ok(most >= STEP)
}

/// The tables that PostgreSQL partitions by day, and the units of their keys per day.
pub(super) const DAILY: [(&str, i64); 3] = [("clips", 1), ("report_ids", 1), ("sums_5m", 86_400)];

/// Creates and drops partitions of a table in PostgreSQL; days before `first` are dropped.
pub(super) fn keep_days(
    database: &mut dyn Database,
    (table, unit): (&str, i64),
    first: i64,
    today: i64,
) -> Result<(), StoreError> {
    let values = [table.into(), unit.into(), first.into(), today.into()];
    let kept = database.query("SELECT keep_days($1, $2, $3, $4)", &values);
    kept.map(drop)
}
