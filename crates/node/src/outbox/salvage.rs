//! Reads what can be read of a damaged file of reports, row by row.

use super::table::{COLUMNS, StoredReport, Table, TableError, add_columns};
use rusqlite::{Connection, Row};
use std::path::Path;

/// The number of reports copied at a time.
const STEP: usize = 200;

/// The most rows that are looked for one by one between those before and those after a damaged page.
const MOST_TRIED: usize = 10_000;

/// The place of `rowid` behind [`COLUMNS`].
const ROWID: usize = 9;

/// Copies the intact reports of the file at `damaged` to `into`, and continues their counts there.
///
/// # Errors
/// [`TableError`] if `into` cannot be written, or if nothing can be read of the damaged file.
pub(super) fn salvage(damaged: &Path, into: &mut Table) -> Result<(), TableError> {
    let db = Connection::open(damaged)?;
    // Without them, an earlier version's rows cannot be read.
    add_columns(&db)?;
    let mut copy = Copy {
        into,
        read: Vec::new(),
    };
    let select =
        |rest: &str| format!("SELECT {COLUMNS}, rowid FROM report NOT INDEXED WHERE {rest}");
    // The rows before the first damaged page, those behind the last one, and those in between, without any index.
    let forwards = copy.rows(&db, &select("rowid > ? ORDER BY rowid"), 0)?;
    if !forwards.reached_the_end {
        let before = forwards.last;
        let backwards = copy.rows(&db, &select("rowid > ? ORDER BY rowid DESC"), before)?;
        let found_any = backwards.last > before;
        let behind = if found_any { backwards.last } else { i64::MAX };
        let mut one = db.prepare(&select("rowid = ?"))?;
        for rowid in (before + 1..behind).take(MOST_TRIED) {
            // A row that is damaged, or that is not there.
            if let Ok(report) = one.query_row([rowid], StoredReport::read) {
                copy.add(report)?;
            }
        }
    }
    copy.flush()
}

struct Copy<'a> {
    into: &'a mut Table,
    read: Vec<StoredReport>,
}

/// How far rows could be read.
struct ReadRows {
    /// The number of the last row; that before the first if there was none.
    last: i64,
    /// False if a damaged page was in the way.
    reached_the_end: bool,
}

impl Copy<'_> {
    /// Copies rows until the end or a damaged page.
    fn rows(&mut self, db: &Connection, text: &str, from: i64) -> Result<ReadRows, TableError> {
        let mut last = from;
        let mut select = db.prepare(text)?;
        let mut rows = select.query([from])?;
        while let Ok(next) = rows.next() {
            let Some(row) = next else {
                return Ok(ReadRows {
                    last,
                    reached_the_end: true,
                });
            };
            let Ok(rowid) = row.get(ROWID) else {
                break;
            };
            last = rowid;
            self.row(row)?;
        }
        Ok(ReadRows {
            last,
            reached_the_end: false,
        })
    }

    /// Copies a row, unless its values are damaged.
    fn row(&mut self, row: &Row<'_>) -> Result<(), TableError> {
        match StoredReport::read(row) {
            Ok(report) => self.add(report),
            Err(_) => Ok(()),
        }
    }

    fn add(&mut self, mut report: StoredReport) -> Result<(), TableError> {
        report.mend_state();
        if report.is_intact() {
            let made = &mut self.into.counters.made;
            *made = (*made).max(report.count);
            self.read.push(report);
        }
        if self.read.len() >= STEP {
            self.flush()?;
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), TableError> {
        let read = std::mem::take(&mut self.read);
        self.into.insert(&read)?;
        Ok(())
    }
}
