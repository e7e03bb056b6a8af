//! Creates the tables. A database of another program or of another version is refused and not changed.

use super::row::{Row, read};
use super::{Database, Kind, StoreError};
use serde::Deserialize;
use uuid::Uuid;

/// The version of the tables. albireo 0.1.0 had version 5; 6 to 10 were never released.
const VERSION: i64 = 11;

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
        let (version, id) = (VERSION.to_string(), Uuid::now_v7().to_string());
        database.query(
            "INSERT INTO hub_meta (key, value) VALUES ('program', $1), ('version', $2), ('identity', $3)",
            &[MARK.into(), version.into(), id.into()],
        )?;
    }
    identity(database)?;
    database.commit()
}

/// The identity of the database, which a copy of it keeps.
///
/// # Errors
/// [`StoreError::Refused`] if the database is not a hub's, or has another version.
pub(crate) fn identity(database: &mut dyn Database) -> Result<Uuid, StoreError> {
    #[derive(Default, Deserialize)]
    struct Meta {
        program: Option<String>,
        version: Option<String>,
        identity: Option<Uuid>,
    }
    let stranger = |what: String| {
        StoreError::Refused(format!(
            "the database is not a hub's ({what}) and was not changed: set an empty one in database.url"
        ))
    };
    let names = tables(database)?;
    if !names.iter().any(|name| name == "hub_meta") {
        return Err(stranger(format!("it has the table {}", names.join(", "))));
    }
    let rows = database.query(
        "SELECT max(CASE key WHEN 'program' THEN value END) AS program, \
         max(CASE key WHEN 'version' THEN value END) AS version, \
         max(CASE key WHEN 'identity' THEN value END) AS identity FROM hub_meta",
        &[],
    )?;
    let meta: Meta = read(rows.into_iter().next().unwrap_or_default())?;
    if meta.program.as_deref() != Some(MARK) {
        let program = meta.program;
        return Err(stranger(format!(
            "its table hub_meta names the program {program:?}"
        )));
    }
    let version = meta.version.and_then(|version| version.parse::<i64>().ok());
    let found = version.ok_or_else(|| stranger("its table hub_meta has no version".to_owned()))?;
    match found {
        VERSION => meta
            .identity
            .ok_or_else(|| stranger("it has no id".to_owned())),
        ..VERSION => Err(StoreError::Refused(
            "the database was written by albireo 0.1.0, whose tables this version does not read: set another one in \
             database.url"
                .to_owned(),
        )),
        _ => Err(StoreError::Refused(format!(
            "the tables of the database have version {found}, written by a newer albireo; this version reads only \
             {VERSION}: run the newer program, or set another database in database.url"
        ))),
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
