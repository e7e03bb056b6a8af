//! Creates the tables, and brings those of an older version to this one. A database of another program, or of a version that
//! is not known, is refused and not changed.

use super::{Database, DatabaseKind, StoreError};

/// The version of the tables, which the schemas store.
const VERSION: i64 = 17;

/// The statements, for both databases, that bring tables of a version to the next one, in order.
const STEPS: [(i64, &str); 3] = [
    (14, include_str!("schema/from_14.sql")),
    (15, include_str!("schema/from_15.sql")),
    (16, include_str!("schema/from_16.sql")),
];

/// Creates the tables if there are none, or brings them to this version, in one transaction.
pub(super) fn migrate(database: &mut dyn Database) -> Result<(), StoreError> {
    database.begin()?;
    check_encoding(database)?;
    if tables(database)?.is_empty() {
        let schema = match database.kind() {
            DatabaseKind::Sqlite => include_str!("schema/sqlite.sql"),
            DatabaseKind::Postgres => include_str!("schema/postgres.sql"),
        };
        database.script(schema)?;
    }
    upgrade(database)?;
    database.commit()
}

/// Checks that the database stores every text: nodes choose the names in their reports.
///
/// # Errors
/// [`StoreError::Refused`] if it does not.
fn check_encoding(database: &mut dyn Database) -> Result<(), StoreError> {
    // SQLite stores every text.
    if database.kind() == DatabaseKind::Sqlite {
        return Ok(());
    }
    for encoding in database.texts("SELECT current_setting('server_encoding')")? {
        // SQL_ASCII stores the bytes of a text as they are.
        if encoding != "UTF8" && encoding != "SQL_ASCII" {
            return Err(StoreError::Refused(format!(
                "the database has the encoding {encoding}, which lacks many characters, and was not changed: create it with \
                 ENCODING 'UTF8' TEMPLATE template0, or set another one in database.url"
            )));
        }
    }
    Ok(())
}

/// Brings the tables to this version, within a transaction, and checks that they are those of a hub.
///
/// # Errors
/// [`StoreError::Refused`] if they are not.
pub(super) fn upgrade(database: &mut dyn Database) -> Result<(), StoreError> {
    for (version, statements) in STEPS {
        if version_of(database)? == version {
            database.script(statements)?;
            tracing::info!(
                from = version,
                to = version + 1,
                "the tables were brought to a newer version"
            );
        }
    }
    match version_of(database)? {
        VERSION => Ok(()),
        found => Err(StoreError::Refused(format!(
            "the tables of the database have version {found}, and this albireo reads versions {} to {VERSION}: run the older \
             or newer one that wrote them, or set another database in database.url; of 0.1, `albireo hub move` keeps the history",
            STEPS[0].0
        ))),
    }
}

/// The version of the tables.
///
/// # Errors
/// [`StoreError::Refused`] if the database is not a hub's.
fn version_of(database: &mut dyn Database) -> Result<i64, StoreError> {
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
    versions
        .first()
        .and_then(|version| version.parse().ok())
        .ok_or_else(|| stranger("its table hub_meta is of another program".to_owned()))
}

/// The names of its tables; in SQLite each follows the tables that it refers to.
pub(super) fn tables(database: &mut dyn Database) -> Result<Vec<String>, StoreError> {
    let text = match database.kind() {
        DatabaseKind::Sqlite => {
            "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%' \
             UNION ALL SELECT name FROM sqlite_temp_master WHERE name IN ('sums_hour', 'revisions', 'revision_nodes')"
        }
        DatabaseKind::Postgres => {
            "SELECT CAST(tablename AS TEXT) AS name FROM pg_tables WHERE schemaname = current_schema()"
        }
    };
    database.texts(text)
}
