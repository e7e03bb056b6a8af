//! Creates the tables, and adds what those of an earlier version lack. A database of another program or of any other version
//! is refused and not changed.

use super::{Database, DatabaseKind, StoreError};

/// The version of the tables, which the schemas store.
const VERSION: i64 = 15;

/// The statements that bring tables of a version to the next, in order.
const UPGRADES: [(i64, &str); 1] = [(14, include_str!("schema/from_14.sql"))];

/// Creates the tables if there are none, and upgrades those that can be upgraded.
pub(super) fn migrate(database: &mut dyn Database) -> Result<(), StoreError> {
    database.begin()?;
    if tables(database)?.is_empty() {
        database.script(match database.kind() {
            DatabaseKind::Sqlite => include_str!("schema/sqlite.sql"),
            DatabaseKind::Postgres => include_str!("schema/postgres.sql"),
        })?;
    }
    for (from, statements) in UPGRADES {
        if is_a_hub(database)? && version(database)? == Some(from) {
            tracing::info!(from, "adding what the tables of the database lack");
            database.script(statements)?;
        }
    }
    check(database)?;
    database.commit()
}

fn is_a_hub(database: &mut dyn Database) -> Result<bool, StoreError> {
    Ok(tables(database)?.iter().any(|name| name == "hub_meta"))
}

/// The version of a hub's tables; `None` if they are of another program.
fn version(database: &mut dyn Database) -> Result<Option<i64>, StoreError> {
    let text = "SELECT v.value FROM hub_meta p JOIN hub_meta v ON v.key = 'version' \
                WHERE p.key = 'program' AND p.value = 'albireo-hub'";
    let versions = database.texts(text)?;
    Ok(versions.first().and_then(|version| version.parse().ok()))
}

/// Checks that the database is that of a hub of this version.
///
/// # Errors
/// [`StoreError::Refused`] if it is not.
pub(super) fn check(database: &mut dyn Database) -> Result<(), StoreError> {
    let stranger = |what: String| {
        StoreError::Refused(format!(
            "the database is not a hub's ({what}) and was not changed: set an empty one in database.url"
        ))
    };
    if !is_a_hub(database)? {
        let names = tables(database)?.join(", ");
        return Err(stranger(format!("it has the table {names}")));
    }
    match version(database)? {
        Some(VERSION) => Ok(()),
        Some(found) => Err(StoreError::Refused(format!(
            "the tables of the database have version {found}, and this albireo reads only version {VERSION}: run the older \
             or newer one that wrote them, or set another database in database.url; of 0.1, `albireo hub move` keeps the history"
        ))),
        None => Err(stranger(
            "its table hub_meta is of another program".to_owned(),
        )),
    }
}

/// The names of its tables; in SQLite each follows the tables that it refers to.
pub(super) fn tables(database: &mut dyn Database) -> Result<Vec<String>, StoreError> {
    let text = match database.kind() {
        DatabaseKind::Sqlite => {
            "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%' \
             UNION ALL SELECT name FROM sqlite_temp_master WHERE name = 'sums_hour'"
        }
        DatabaseKind::Postgres => {
            "SELECT CAST(tablename AS TEXT) AS name FROM pg_tables WHERE schemaname = current_schema()"
        }
    };
    database.texts(text)
}
