//! Deletes old rows: whole days in PostgreSQL, else a small range at a time, so that the thread that writes never waits
//! long.

use super::{Database, Kind, StoreError};
use crate::config::HistoryConfig;
use albireo_service::clock::DAY_MS;
use albireo_wire::IDENTITY_DAYS;

/// Most rows per step.
pub(crate) const STEP: usize = 2000;

/// Earlier than any day of a row.
const NO_DAY: i64 = -1_000_000;

/// The rows to delete: their table, its key, and the condition; `$1` is the bound. In PostgreSQL, tables kept by day lose
/// whole partitions, so that only rows of their default partition are deleted one by one; in SQLite `clips_other` is
/// `clips`. Ids grow in the order of receipt, and a clip's day is at most one day after its receipt, so that only the
/// lowest ids are looked at.
const OLD: [(&str, &str, &str); 8] = [
    (
        "clips_other",
        "id",
        "day < $1 AND id < (SELECT COALESCE(min(id), 0) FROM clips_other) + 2000",
    ),
    ("report_ids_other", "day, id", "day > 0 AND day < $1"),
    // Identities under their day of receipt.
    ("report_ids_other", "day, id", "day < 0 AND day > $1"),
    (
        "sums_5m_other",
        "camera_id, bucket_s, setup_id, quality",
        "camera_id IN (SELECT 0 UNION ALL SELECT id FROM cameras) AND bucket_s < $1",
    ),
    (
        "events",
        "id",
        "at_ms < $1 AND id < (SELECT COALESCE(min(id), 0) FROM events) + 2000",
    ),
    // Desired settings stay: a node that returns after years still gets its setting.
    (
        "order_nodes",
        "revision, node",
        "revision IN (SELECT revision FROM orders WHERE at_ms < $1)",
    ),
    (
        "orders",
        "revision",
        "at_ms < $1 AND NOT EXISTS (SELECT 1 FROM order_nodes n WHERE n.revision = orders.revision)",
    ),
    (
        "set_aside",
        "id",
        "received_ms < $1 AND id < (SELECT COALESCE(min(id), 0) FROM set_aside) + 2000",
    ),
];

/// Deletes at most [`STEP`] rows of each table that are too old at `now_ms`, and whole partitions. If the clock is not
/// believed (`is_believed`), it only creates the partitions of the next days. Returns true if there are more old rows.
pub(crate) fn retain(
    database: &mut dyn Database,
    history: &HistoryConfig,
    now_ms: i64,
    is_believed: bool,
) -> Result<bool, StoreError> {
    let today = now_ms.div_euclid(DAY_MS);
    let first = |days: u32| match is_believed {
        true => today - i64::from(days),
        false => NO_DAY,
    };
    // One day more, because a report of the day before is still accepted.
    let (clips, ids) = (first(history.clips_days), first(IDENTITY_DAYS + 1));
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
    database.begin()?;
    let mut most = 0;
    if is_believed {
        let before = |days: u32| now_ms.saturating_sub(i64::from(days) * DAY_MS);
        let events = before(history.events_days);
        let bounds = [
            clips,
            ids,
            -ids,
            sums * 86_400,
            events,
            events,
            events,
            before(history.set_aside_days),
        ];
        for ((table, key, condition), bound) in OLD.into_iter().zip(bounds) {
            // The limit is no parameter: SQLite parses a statement anew whenever its limit is bound.
            let mut text = format!(
                "DELETE FROM {table} WHERE ({key}) IN (SELECT {key} FROM {table} WHERE {condition} LIMIT {STEP}) \
                 RETURNING 1 AS gone"
            );
            if database.kind() == Kind::Sqlite {
                text = text.replace("_other", "");
            }
            most = most.max(database.query(&text, &[bound.into()])?.len());
        }
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
    database
        .query("SELECT keep_days($1, $2, $3, $4)", &values)
        .map(drop)
}
