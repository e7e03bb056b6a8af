//! Creates the tables. A database of another program or of another version is refused and not changed.

use super::row::Row;
use super::{Database, Kind, StoreError};

/// The version of the tables. albireo 0.1.0 had version 5; 6 to 11 were never released.
const VERSION: i64 = 12;

/// The program's name in the table `hub_meta` of a hub's database.
const MARK: &str = "albireo-hub";

/// Creates the tables if there are none.
pub(super) fn migrate(database: &mut dyn Database) -> Result<(), StoreError> {
    database.begin()?;
    if tables(database)?.is_empty() {
        database
            .script("CREATE TABLE hub_meta (key TEXT NOT NULL PRIMARY KEY, value TEXT NOT NULL)")?;
        database.script(match database.kind() {
            Kind::Sqlite => include_str!("schema/sqlite.sql"),
            Kind::Postgres => include_str!("schema/postgres.sql"),
        })?;
        database.query(
            "INSERT INTO hub_meta (key, value) VALUES ('program', $1), ('version', $2)",
            &[MARK.into(), VERSION.to_string().into()],
        )?;
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
    let mut value = |key: &str| {
        let text = "SELECT value FROM hub_meta WHERE key = $1";
        let rows = database.query(text, &[key.into()])?;
        let value = rows.first().and_then(|row| row.get("value")?.as_str());
        Ok::<_, StoreError>(value.unwrap_or_default().to_owned())
    };
    let (program, version) = (value("program")?, value("version")?);
    if program != MARK {
        return Err(stranger(format!(
            "its table hub_meta names the program `{program}`"
        )));
    }
    match version.parse::<i64>() {
        Ok(VERSION) => Ok(()),
        Ok(..VERSION) => Err(StoreError::Refused(
            "the database was written by albireo 0.1.0, whose tables this version does not read: set another one in \
             database.url"
                .to_owned(),
        )),
        Ok(found) => Err(StoreError::Refused(format!(
            "the tables of the database have version {found}, written by a newer albireo; this version reads only \
             {VERSION}: run the newer program, or set another database in database.url"
        ))),
        Err(_) => Err(stranger("its table hub_meta has no version".to_owned())),
    }
}

fn tables(database: &mut dyn Database) -> Result<Vec<String>, StoreError> {
    let text = match database.kind() {
        Kind::Sqlite => {
            "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%'"
        }
        Kind::Postgres => {
            "SELECT CAST(tablename AS TEXT) AS name FROM pg_tables WHERE schemaname = current_schema()"
        }
    };
    let tables = database.query(text, &[])?;
    let name = |table: &Row| Some(table.get("name")?.as_str()?.to_owned());
    Ok(tables.iter().filter_map(name).collect())
}
