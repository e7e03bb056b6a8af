//! Creates the tables. A database that is not a hub's, or of another version, is refused and left as it is.

use super::{Database, Kind, StoreError, Transaction};
use uuid::Uuid;

/// The version of the tables that this program creates. Up to 5 were those of 0.1.0; 6 and 7 were never released.
pub(super) const VERSION: i64 = 8;
/// The versions that are not read.
const BEFORE: i64 = 7;

/// The program's name in the table `hub_meta` of a hub's database.
pub(super) const MARK: &str = "albireo-hub";

/// Number of the lock that hubs on one PostgreSQL take while they create the tables.
pub(super) const LOCK: i64 = 0x0a1b_14e0;

pub(super) fn migrate(kind: Kind, database: &mut dyn Database) -> Result<(), StoreError> {
    let mut transaction = database.begin()?;
    transaction.lock(LOCK)?;
    let found = version(kind, &mut *transaction)?;
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
        transaction.script(match kind {
            Kind::Sqlite => include_str!("schema/sqlite.sql"),
            Kind::Postgres => include_str!("schema/postgres.sql"),
        })?;
        transaction.execute(
            "INSERT INTO hub_meta (key, value) VALUES ('version', $1) \
             ON CONFLICT (key) DO UPDATE SET value = excluded.value",
            &[VERSION.to_string().into()],
        )?;
    }
    transaction.commit()
}

/// The version found; 0 for an empty database, which gets its mark.
fn version(kind: Kind, transaction: &mut dyn Transaction) -> Result<i64, StoreError> {
    let tables = transaction.query(
        match kind {
            Kind::Sqlite => {
                "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%'"
            }
            Kind::Postgres => {
                "SELECT CAST(tablename AS TEXT) AS name FROM pg_tables WHERE schemaname = current_schema()"
            }
        },
        &[],
    )?;
    let names: Result<Vec<String>, _> = tables.iter().map(|row| row.get("name")).collect();
    let names = names?;
    if names.is_empty() {
        transaction
            .script("CREATE TABLE hub_meta (key TEXT NOT NULL PRIMARY KEY, value TEXT NOT NULL)")?;
        transaction.execute(
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
    let (mut program, mut version) = (None, None);
    for row in transaction.query("SELECT key, value FROM hub_meta", &[])? {
        let (key, value): (String, String) = (row.get("key")?, row.get("value")?);
        match key.as_str() {
            "program" => program = Some(value),
            "version" => version = value.parse().ok(),
            _ => {}
        }
    }
    if program.as_deref() != Some(MARK) {
        return Err(stranger(format!(
            "its table hub_meta names the program {program:?}"
        )));
    }
    version.ok_or_else(|| stranger("its table hub_meta has no version".to_owned()))
}
