//! Makes the tables. What is not a hub's database, or is of another version of the tables, is refused and left as it is.

use super::{Dialect, StoreError};
use sqlx::{AnyConnection, Connection as _, Executor as _, Row as _};
use uuid::Uuid;

/// The version of the tables that this program makes. Up to 5 were those of 0.1.0.
pub(super) const VERSION: i64 = 6;
/// The versions of 0.1.0.
const BEFORE: i64 = 5;

/// What stands in the table `hub_meta` of a hub's database.
pub(super) const MARK: &str = "albireo-hub";

/// Number of the lock that hubs on one PostgreSQL take while they migrate.
pub(super) const LOCK: i64 = 0x0a1b_14e0;

pub(super) async fn migrate(
    dialect: Dialect,
    connection: &mut AnyConnection,
) -> Result<(), StoreError> {
    let mut transaction = match dialect {
        Dialect::Sqlite => connection.begin_with("BEGIN IMMEDIATE").await,
        Dialect::Postgres => connection.begin().await,
    }
    .map_err(|error| foreign(dialect, error))?;
    if dialect == Dialect::Postgres {
        sqlx::query("SELECT pg_advisory_xact_lock($1)")
            .bind(LOCK)
            .execute(&mut *transaction)
            .await?;
    }
    let found = version(dialect, &mut transaction)
        .await
        .map_err(|error| match error {
            Ok(refused) => refused,
            Err(error) => foreign(dialect, error),
        })?;
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
        let tables = match dialect {
            Dialect::Sqlite => include_str!("schema/sqlite.sql"),
            Dialect::Postgres => include_str!("schema/postgres.sql"),
        };
        transaction.execute(sqlx::raw_sql(tables)).await?;
        sqlx::query(
            "INSERT INTO hub_meta (key, value) VALUES ('version', $1) \
             ON CONFLICT (key) DO UPDATE SET value = excluded.value",
        )
        .bind(VERSION.to_string())
        .execute(&mut *transaction)
        .await?;
    }
    transaction.commit().await?;
    Ok(())
}

/// The version found; 0 for an empty database, which gets its mark.
async fn version(
    dialect: Dialect,
    connection: &mut AnyConnection,
) -> Result<i64, Result<StoreError, sqlx::Error>> {
    let tables = match dialect {
        Dialect::Sqlite => {
            "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%'"
        }
        Dialect::Postgres => {
            "SELECT CAST(tablename AS TEXT) AS name FROM pg_tables WHERE schemaname = current_schema()"
        }
    };
    let tables: Vec<String> = sqlx::query(tables)
        .fetch_all(&mut *connection)
        .await
        .map_err(Err)?
        .iter()
        .map(|row| row.try_get("name"))
        .collect::<Result<_, _>>()
        .map_err(Err)?;
    if tables.is_empty() {
        let made = async {
            connection
                .execute(
                    "CREATE TABLE hub_meta (key TEXT NOT NULL PRIMARY KEY, value TEXT NOT NULL)",
                )
                .await?;
            sqlx::query(
                "INSERT INTO hub_meta (key, value) VALUES ('program', $1), ('identity', $2)",
            )
            .bind(MARK)
            .bind(Uuid::now_v7().to_string())
            .execute(&mut *connection)
            .await
        };
        made.await.map_err(Err)?;
        return Ok(0);
    }
    let stranger = |what: String| {
        Err(Ok(StoreError::Refused(format!(
            "the database is not a hub's ({what}); nothing of it was changed: give the hub an empty one in \
             database.url"
        ))))
    };
    if !tables.iter().any(|name| name == "hub_meta") {
        return stranger(format!("it has the table {}", tables.join(", ")));
    }
    let rows = sqlx::query("SELECT key, value FROM hub_meta")
        .fetch_all(&mut *connection)
        .await
        .map_err(Err)?;
    let (mut program, mut version) = (None, None);
    for row in &rows {
        let key: String = row.try_get("key").map_err(Err)?;
        let value: String = row.try_get("value").map_err(Err)?;
        match key.as_str() {
            "program" => program = Some(value),
            "version" => version = value.parse().ok(),
            _ => {}
        }
    }
    if program.as_deref() != Some(MARK) {
        return stranger(format!("its table hub_meta names the program {program:?}"));
    }
    match version {
        Some(version) => Ok(version),
        None => stranger("its table hub_meta has no version".to_owned()),
    }
}

/// A file that is no SQLite database at all is found at the first statement.
pub(super) fn foreign(dialect: Dialect, error: sqlx::Error) -> StoreError {
    /// SQLITE_NOTADB.
    const NOT_A_DATABASE: &str = "26";
    let code = error
        .as_database_error()
        .and_then(|error| error.code().map(std::borrow::Cow::into_owned));
    if dialect == Dialect::Sqlite && code.as_deref() == Some(NOT_A_DATABASE) {
        return StoreError::Refused(
            "the file is no SQLite database; nothing of it was changed: give the hub another file in database.url"
                .to_owned(),
        );
    }
    error.into()
}
