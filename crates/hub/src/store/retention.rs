//! Deletes old rows: whole days in PostgreSQL, else a small range at a time, so that the thread that writes never waits
//! long.

use super::row::Row;
use super::{Database, Kind, StoreError};
use crate::config::HistoryConfig;
use albireo_service::clock::DAY_MS;
use albireo_wire::IDENTITY_DAYS;

/// Most rows per step.
pub(crate) const STEP: usize = 2000;

/// Earlier than any day of a row.
const NO_DAY: i64 = -1_000_000;

const EVENTS: &str = "DELETE FROM events WHERE id IN (SELECT id FROM events WHERE at_ms < $1 \
    AND id < (SELECT COALESCE(min(id), 0) FROM events) + $2) RETURNING 1 AS gone";
// Desired settings stay: a node that returns after years still gets its setting.
const ORDER_NODES: &str = "DELETE FROM order_nodes WHERE (revision, node) IN (SELECT n.revision, n.node \
    FROM order_nodes n JOIN orders o ON o.revision = n.revision WHERE o.at_ms < $1 ORDER BY 1, 2 LIMIT $2) \
    RETURNING 1 AS gone";
const ORDERS: &str = "DELETE FROM orders WHERE revision IN (SELECT o.revision FROM orders o WHERE o.at_ms < $1 \
    AND NOT EXISTS (SELECT 1 FROM order_nodes n WHERE n.revision = o.revision) LIMIT $2) RETURNING 1 AS gone";
const SET_ASIDE: &str = "DELETE FROM set_aside WHERE id IN (SELECT id FROM set_aside WHERE received_ms < $1 \
    AND id < (SELECT COALESCE(min(id), 0) FROM set_aside) + $2) RETURNING 1 AS gone";

/// The statements for clips, identities of reports, identities under their day of receipt, and five-minute sums. The
/// ids of clips grow in the order of receipt, and a clip's day is at most one day after its receipt.
const BY_DAY_SQLITE: [&str; 4] = [
    "DELETE FROM clips WHERE id IN (SELECT id FROM clips WHERE day < $1 \
     AND id < (SELECT COALESCE(min(id), 0) FROM clips) + $2) RETURNING 1 AS gone",
    "DELETE FROM report_ids WHERE (day, id) IN (SELECT day, id FROM report_ids WHERE day > 0 AND day < $1 \
     ORDER BY day LIMIT $2) RETURNING 1 AS gone",
    "DELETE FROM report_ids WHERE (day, id) IN (SELECT day, id FROM report_ids WHERE day < 0 AND day > $1 \
     ORDER BY day LIMIT $2) RETURNING 1 AS gone",
    "DELETE FROM sums_5m WHERE (camera_id, bucket_s, setup_id, quality) IN (SELECT camera_id, bucket_s, setup_id, \
     quality FROM sums_5m WHERE camera_id IN (SELECT 0 UNION ALL SELECT id FROM cameras) AND bucket_s < $1 LIMIT $2) \
     RETURNING 1 AS gone",
];
/// The same for PostgreSQL, where only rows of the default partitions are deleted one by one.
const BY_DAY_POSTGRES: [&str; 4] = [
    "DELETE FROM clips_other WHERE (day, id) IN (SELECT day, id FROM clips_other WHERE day < $1 LIMIT $2) \
     RETURNING 1 AS gone",
    "DELETE FROM report_ids_other WHERE (day, id) IN (SELECT day, id FROM report_ids_other WHERE day > 0 AND day < $1 \
     LIMIT $2) RETURNING 1 AS gone",
    "DELETE FROM report_ids_other WHERE (day, id) IN (SELECT day, id FROM report_ids_other WHERE day < 0 AND day > $1 \
     LIMIT $2) RETURNING 1 AS gone",
    "DELETE FROM sums_5m_other WHERE (camera_id, bucket_s, setup_id, quality) IN (SELECT camera_id, bucket_s, \
     setup_id, quality FROM sums_5m_other WHERE bucket_s < $1 LIMIT $2) RETURNING 1 AS gone",
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
        let by_day = match database.kind() {
            Kind::Sqlite => BY_DAY_SQLITE,
            Kind::Postgres => BY_DAY_POSTGRES,
        };
        let by_day = by_day.into_iter().zip([clips, ids, -ids, sums * 86_400]);
        for (text, bound) in by_day.chain([
            (EVENTS, before(history.events_days)),
            (ORDER_NODES, before(history.events_days)),
            (ORDERS, before(history.events_days)),
            (SET_ASIDE, before(history.set_aside_days)),
        ]) {
            // Not as a parameter: SQLite parses a statement anew whenever its limit is bound.
            let text = text.replace("$2", &STEP.to_string());
            let gone: Vec<Row> = database.query(&text, &[bound.into()])?;
            most = most.max(gone.len());
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
