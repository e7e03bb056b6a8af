//! Creates the tables. A database of another program or of another version is refused and not changed.

use super::{Database, DatabaseKind, StoreError};

/// The version of the tables, which the schemas store.
const VERSION: i64 = 14;

/// Creates the tables if there are none.
pub(super) fn migrate(database: &mut dyn Database) -> Result<(), StoreError> {
    database.begin()?;
    if tables(database)?.is_empty() {
        database.script(match database.kind() {
            DatabaseKind::Sqlite => include_str!("schema/sqlite.sql"),
            DatabaseKind::Postgres => include_str!("schema/postgres.sql"),
        })?;
    }
    check(database)?;
    database.commit()
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
    let names = tables(database)?;
    if !names.iter().any(|name| name == "hub_meta") {
        return Err(stranger(format!("it has the table {}", names.join(", "))));
    }
    let text = "SELECT v.value FROM hub_meta p JOIN hub_meta v ON v.key = 'version' \
                WHERE p.key = 'program' AND p.value = 'albireo-hub'";
    let versions = database.texts(text)?;
    match versions.first().and_then(|version| version.parse::<i64>().ok()) {
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
