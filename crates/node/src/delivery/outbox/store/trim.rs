//! The bounds of what waits: size and age.

use super::{Store, StoreError, Waiting, signed, unsigned};
use albireo_service::clock::unix_nanoseconds;
use rusqlite::params;

/// A wall clock before 2020 is one that was never set: no age is told by it.
const SANE_CLOCK_NS: u64 = 1_577_836_800_000_000_000;

/// Whether anything is too old: one look into the index `report_kept`.
const OLDEST: &str =
    "SELECT kept_ns FROM report WHERE kept_ns BETWEEN ? AND ? ORDER BY kept_ns LIMIT 1";

/// What is too old, by the same index.
const AGED: &str =
    "SELECT instance, number, length(json) FROM report WHERE kept_ns BETWEEN ? AND ?";

/// What went: of which instance, and how many.
pub(in crate::delivery::outbox) type Gone = Vec<(i64, u64)>;

impl Store {
    /// Lets the oldest go until the bounds are kept; how many of each instance went. Costs no more than what goes.
    pub(in crate::delivery::outbox) fn trim(
        &mut self,
        most_bytes: u64,
        most_age_ns: u64,
    ) -> Result<Gone, StoreError> {
        let ages = [
            signed(SANE_CLOCK_NS),
            signed(unix_nanoseconds().saturating_sub(most_age_ns)),
        ];
        let aged = self.db.prepare(OLDEST)?.exists(ages)?;
        if !aged && self.waiting.bytes <= most_bytes {
            return Ok(Vec::new());
        }
        let transaction = self.db.transaction()?;
        let mut left = self.waiting;
        let mut gone = Vec::new();
        if aged {
            let chosen = {
                let mut aged = transaction.prepare(AGED)?;
                let rows = aged.query_map(ages, row)?;
                rows.collect::<Result<Vec<_>, _>>()?
            };
            remove(&transaction, &chosen, &mut left, &mut gone)?;
        }
        if left.bytes > most_bytes {
            let mut chosen = Vec::new();
            let mut bytes = left.bytes;
            {
                let mut oldest_first = transaction.prepare(
                    "SELECT instance, number, length(json) FROM report ORDER BY instance, number",
                )?;
                let mut rows = oldest_first.query([])?;
                while bytes > most_bytes
                    && let Some(found) = rows.next()?
                {
                    let found = row(found)?;
                    bytes = bytes.saturating_sub(found.2);
                    chosen.push(found);
                }
            }
            remove(&transaction, &chosen, &mut left, &mut gone)?;
        }
        for (instance, count) in &gone {
            transaction.execute(
                "UPDATE instance SET lost = lost + ? WHERE id = ?",
                params![signed(*count), instance],
            )?;
        }
        transaction.commit()?;
        self.waiting = left;
        Ok(gone)
    }
}

/// Instance, number and size.
type Row = (i64, i64, u64);

fn row(row: &rusqlite::Row<'_>) -> rusqlite::Result<Row> {
    Ok((row.get(0)?, row.get(1)?, unsigned(row, 2)?))
}

fn remove(
    transaction: &rusqlite::Transaction<'_>,
    chosen: &[Row],
    left: &mut Waiting,
    gone: &mut Gone,
) -> rusqlite::Result<()> {
    let mut delete = transaction.prepare("DELETE FROM report WHERE instance = ? AND number = ?")?;
    for (instance, number, bytes) in chosen {
        delete.execute(params![instance, number])?;
        left.reports = left.reports.saturating_sub(1);
        left.bytes = left.bytes.saturating_sub(*bytes);
        match gone.iter_mut().find(|(of, _)| of == instance) {
            Some((_, count)) => *count += 1,
            None => gone.push((*instance, 1)),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::{Instance, Store};
    use super::*;

    /// How SQLite goes about a query.
    fn plan(store: &Store, query: &str) -> String {
        let mut explained = (store.db)
            .prepare(&format!("EXPLAIN QUERY PLAN {query}"))
            .unwrap();
        let steps = explained.query_map([0, 0], |row| row.get::<_, String>(3));
        steps.unwrap().map(Result::unwrap).collect()
    }

    #[test]
    fn a_kept_report_does_not_make_the_file_be_read_through() {
        let folder = tempfile::tempdir().unwrap();
        let opened = Store::open(&folder.path().join("node.db"), None, None).unwrap();
        let plan = plan(&opened.store, OLDEST);
        assert!(
            plan.contains("SEARCH report USING COVERING INDEX report_kept"),
            "{plan}"
        );
    }

    #[test]
    fn what_is_left_is_counted_rightly_after_age_and_size_took_their_share() {
        let folder = tempfile::tempdir().unwrap();
        let mut opened = Store::open(&folder.path().join("node.db"), None, None).unwrap();
        let store = &mut opened.store;
        let instance = Instance {
            last: 20,
            ..opened.current
        };
        let rows: Vec<_> = (1..=20).map(|n| (n, vec![b'x'; 100])).collect();
        store.keep(&instance, &rows).unwrap();
        let old = signed(SANE_CLOCK_NS + 1);
        store
            .db
            .execute(
                "UPDATE report SET kept_ns = ? WHERE number IN (3, 9)",
                [old],
            )
            .unwrap();
        let gone = store.trim(1000, 1_000_000_000_000).unwrap();
        assert_eq!(gone, [(instance.id, 10)]);
        let counted = store.waiting();
        assert_eq!((counted.reports, counted.bytes), (10, 1000));
        store.recount().unwrap();
        assert_eq!(store.waiting(), counted);
        let first: i64 = (store.db)
            .query_row("SELECT min(number) FROM report", [], |row| row.get(0))
            .unwrap();
        // Two went by their age, and the eight oldest of the others by their size.
        assert_eq!(first, 11);
    }
}
