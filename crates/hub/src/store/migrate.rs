//! Creates the tables. A database that is not a hub's, or of another version, is refused and left as it is.

use super::row::{read, read_all};
use super::{Database, Kind, StoreError};
use serde::Deserialize;
use uuid::Uuid;

/// The version of the tables that this program creates. Up to 5 were those of 0.1.0; 6 to 8 were never released.
pub(super) const VERSION: i64 = 9;
/// The versions that are not read.
const BEFORE: i64 = 8;

/// The program's name in the table `hub_meta` of a hub's database.
pub(super) const MARK: &str = "albireo-hub";

/// What a hub's database says of itself.
#[derive(Deserialize)]
pub(super) struct Meta {
    pub(super) program: Option<String>,
    pub(super) version: Option<String>,
    /// Its id, which a copy of it keeps.
    pub(super) identity: Option<Uuid>,
}

pub(super) fn meta(database: &mut dyn Database) -> Result<Meta, StoreError> {
    let rows = database.query(
        "SELECT max(CASE key WHEN 'program' THEN value END) AS program, \
         max(CASE key WHEN 'version' THEN value END) AS version, \
         max(CASE key WHEN 'identity' THEN value END) AS identity FROM hub_meta",
        &[],
    )?;
    read(rows.into_iter().next().unwrap_or_default())
}

pub(super) fn migrate(database: &mut dyn Database) -> Result<(), StoreError> {
    database.begin()?;
    let found = version(database)?;
    if found > VERSION {
        return Err(StoreError::Refused(format!(
            "the database has version {found} of the tables, written by a newer albireo; this one knows version \
             {VERSION}: run the newer program, or give this one another database.url"
        )));
    }
    if (1..=BEFORE).contains(&found) {
        return Err(StoreError::Refused(
            "the database was written by albireo 0.1.0, whose tables this one does not read: give the hub another \
             database.url"
                .to_owned(),
        ));
    }
    if found < VERSION {
        database.script(match database.kind() {
            Kind::Sqlite => include_str!("schema/sqlite.sql"),
            Kind::Postgres => include_str!("schema/postgres.sql"),
        })?;
        database.query(
            "INSERT INTO hub_meta (key, value) VALUES ('version', $1) \
             ON CONFLICT (key) DO UPDATE SET value = excluded.value",
            &[VERSION.to_string().into()],
        )?;
    }
    database.commit()
}

/// The version found; 0 for an empty database, which gets its mark.
fn version(database: &mut dyn Database) -> Result<i64, StoreError> {
    #[derive(Deserialize)]
    struct Table {
        name: String,
    }
    let tables = match database.kind() {
        Kind::Sqlite => {
            "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%'"
        }
        Kind::Postgres => {
            "SELECT CAST(tablename AS TEXT) AS name FROM pg_tables WHERE schemaname = current_schema()"
        }
    };
    let tables: Vec<Table> = read_all(database.query(tables, &[])?)?;
    let names: Vec<String> = tables.into_iter().map(|table| table.name).collect();
    if names.is_empty() {
        database
            .script("CREATE TABLE hub_meta (key TEXT NOT NULL PRIMARY KEY, value TEXT NOT NULL)")?;
        database.query(
            "INSERT INTO hub_meta (key, value) VALUES ('program', $1), ('identity', $2)",
            &[MARK.into(), Uuid::now_v7().to_string().into()],
        )?;
        return Ok(0);
    }
    let stranger = |what: String| {
        StoreError::Refused(format!(
            "the database is not a hub's ({what}); nothing of it was changed: give the hub an empty one in \
             database.url"
        ))
    };
    if !names.iter().any(|name| name == "hub_meta") {
        return Err(stranger(format!("it has the table {}", names.join(", "))));
    }
    let meta = meta(database)?;
    if meta.program.as_deref() != Some(MARK) {
        return Err(stranger(format!(
            "its table hub_meta names the program {:?}",
            meta.program
        )));
    }
    (meta.version.and_then(|version| version.parse().ok()))
        .ok_or_else(|| stranger("its table hub_meta has no version".to_owned()))
}
