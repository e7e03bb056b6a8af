//! What is done with a damaged file: it is set aside, and what can be read of it saved.

use super::Store;
use rusqlite::{Connection, params};
use std::fs;
use std::path::{Path, PathBuf};

impl Store {
    /// Copies what can be read of a damaged file; the number of reports.
    pub(super) fn salvage(&mut self, aside: &Path) -> u64 {
        let flags = rusqlite::OpenFlags::SQLITE_OPEN_READ_WRITE;
        let Ok(old) = Connection::open_with_flags(aside, flags) else {
            return 0;
        };
        let mut saved = 0;
        let mut copy = || -> rusqlite::Result<()> {
            let transaction = self.db.transaction()?;
            let mut instances =
                old.prepare("SELECT id, name, machine, last, lost FROM instance ORDER BY id")?;
            let mut rows = instances.query([])?;
            while let Some(row) = rows.next()? {
                transaction.execute(
                    "INSERT OR IGNORE INTO instance (id, name, machine, last, lost) VALUES (?, ?, ?, ?, ?)",
                    params![
                        row.get::<_, i64>(0)?,
                        row.get::<_, String>(1)?,
                        row.get::<_, Option<String>>(2)?,
                        row.get::<_, i64>(3)?,
                        row.get::<_, i64>(4)?
                    ],
                )?;
            }
            // From both ends, so that one broken page in the middle costs no more than it must.
            for order in ["ASC", "DESC"] {
                let Ok(mut reports) = old.prepare(&format!(
                    "SELECT instance, number, kept_ns, json FROM report ORDER BY instance {order}, number {order}"
                )) else {
                    continue;
                };
                let mut rows = reports.query([])?;
                while let Ok(Some(row)) = rows.next() {
                    let (Ok(instance), Ok(number), Ok(kept), Ok(json)) = (
                        row.get::<_, i64>(0),
                        row.get::<_, i64>(1),
                        row.get::<_, i64>(2),
                        row.get::<_, Vec<u8>>(3),
                    ) else {
                        continue;
                    };
                    saved += transaction.execute(
                        "INSERT OR IGNORE INTO report (instance, number, kept_ns, json) VALUES (?, ?, ?, ?)",
                        params![instance, number, kept, json],
                    )? as u64;
                }
            }
            if let Ok(mut settings) = old.prepare("SELECT name, json FROM setting") {
                let mut rows = settings.query([])?;
                while let Ok(Some(row)) = rows.next() {
                    transaction.execute(
                        "INSERT OR IGNORE INTO setting (name, json) VALUES (?, ?)",
                        params![row.get::<_, String>(0)?, row.get::<_, String>(1)?],
                    )?;
                }
            }
            transaction.commit()
        };
        if let Err(error) = copy() {
            tracing::warn!(%error, "the damaged state file could not be read to its end");
        }
        saved
    }
}

/// Moves a damaged file and what belongs to it out of the way, under a name that is free.
pub(super) fn set_aside(file: &Path) -> std::io::Result<PathBuf> {
    let named = |ending: &str| {
        let mut name = file.as_os_str().to_owned();
        name.push(ending);
        PathBuf::from(name)
    };
    let free = (0..1000)
        .map(|number| named(&format!(".damaged-{number}")))
        .find(|aside| !aside.exists())
        .ok_or_else(|| std::io::Error::other("too many damaged files were set aside already"))?;
    fs::rename(file, &free)?;
    for ending in ["-wal", "-shm"] {
        let mut beside = free.as_os_str().to_owned();
        beside.push(ending);
        let _ = fs::rename(named(ending), PathBuf::from(beside));
    }
    Ok(free)
}
