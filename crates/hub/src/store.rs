//! The connection to the database and its transactions: SQLite in one file, or PostgreSQL, behind one synchronous trait. What
//! is in the tables belongs to the rooms above.
//!
//! A commit survives a power loss: `synchronous=FULL` in write-ahead mode, `synchronous_commit=on`. Readers have their own
//! connections and never wait for the writer.

mod database;
mod error;
mod events;
mod file;
mod migrate;
mod partitions;
mod postgres;
pub(crate) mod row;
mod sqlite;
pub mod transfer;

pub(crate) use database::Database;
pub use error::StoreError;
pub(crate) use events::EventRow;
pub(crate) use partitions::{CLIPS, FIVE_MINUTE_SUMS, REPORT_IDS, keep_days};

use crate::config::DatabaseConfig;
use parking_lot::Mutex;
use row::{Param, Row};
pub(crate) use sqlite::Access;
use std::borrow::Cow;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::sync::Semaphore;

/// The statements of a file, without its comments: in those a semicolon ends no statement.
pub(crate) fn statements(file: &str) -> Vec<String> {
    let code: Vec<&str> =
        file.lines().filter(|line| !line.trim_start().starts_with("--")).collect();
    let code = code.join("\n");
    let parts = code.split(';').map(str::trim).filter(|part| !part.is_empty());
    parts.map(str::to_owned).collect()
}

/// The number of connections for reading.
const READERS: usize = 4;

/// The kind of database.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum DatabaseKind {
    /// One file.
    Sqlite,
    /// A server, which several hubs may share.
    Postgres,
}

impl DatabaseKind {
    /// The kind of database that a URL names.
    fn of(url: &str) -> Self {
        if url.starts_with("sqlite:") {
            Self::Sqlite
        } else {
            Self::Postgres
        }
    }
}

/// An open database.
#[derive(Clone)]
pub struct Store(Arc<Shared>);

struct Shared {
    kind: DatabaseKind,
    url: String,
    timeout_ms: u64,
    /// The file of SQLite.
    file: Option<file::DatabaseFile>,
    runtime: Handle,
    /// One permit per connection that reads.
    readers: Arc<Semaphore>,
    idle: Mutex<Vec<Box<dyn Database>>>,
    /// The connection for writes other than those of ingest.
    writer: Arc<tokio::sync::Mutex<Option<Box<dyn Database>>>>,
}

impl std::fmt::Debug for Store {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.kind())
    }
}

/// Checks that the database of SQLite can be used on this machine; a server is not asked.
///
/// # Errors
/// Why not: what the file or its folder lacks.
pub fn check_here(config: &DatabaseConfig) -> Result<(), StoreError> {
    match DatabaseKind::of(&config.url) {
        DatabaseKind::Sqlite => file::check_here(Path::new(sqlite::file(&config.url))),
        DatabaseKind::Postgres => Ok(()),
    }
}

impl Store {
    /// Connects, and creates the tables if there are none.
    ///
    /// # Errors
    /// [`StoreError::Refused`] when the database holds other data, or was written by another version of the program: a retry
    /// does not help. [`StoreError::Unavailable`] when it cannot be reached now.
    pub async fn open(config: &DatabaseConfig) -> Result<Self, StoreError> {
        let kind = DatabaseKind::of(&config.url);
        let file = match kind {
            DatabaseKind::Sqlite => {
                let path = sqlite::file(&config.url);
                Some(file::DatabaseFile::new(path))
            }
            DatabaseKind::Postgres => None,
        };
        let store = Self(Arc::new(Shared {
            kind,
            file,
            url: config.url.clone(),
            timeout_ms: config.timeout_ms,
            runtime: Handle::current(),
            readers: Arc::new(Semaphore::new(READERS)),
            idle: Mutex::default(),
            writer: Arc::default(),
        }));
        let opened = store.clone();
        blocking(move || {
            if let Some(file) = &opened.0.file {
                file.reserve()?;
            }
            let mut database = opened.connect(Access::Create, None)?;
            migrate::migrate(&mut *database)?;
            if let Some(file) = &opened.0.file {
                file.opened();
            }
            Ok(())
        })
        .await?;
        Ok(store)
    }

    /// Returns `before` if it is still open, else a new connection. Must not be called on a thread of the runtime.
    ///
    /// # Errors
    /// Also when the file of SQLite was deleted or replaced.
    pub(crate) fn connect(
        &self,
        access: Access,
        before: Option<Box<dyn Database>>,
    ) -> Result<Box<dyn Database>, StoreError> {
        if let Some(file) = &self.0.file {
            file.check()?;
        }
        if let Some(mut before) = before
            && before.is_open()?
        {
            return Ok(before);
        }
        let url = &self.0.url;
        let timeout_ms = self.0.timeout_ms;
        let database: Box<dyn Database> = match self.0.kind {
            DatabaseKind::Sqlite => Box::new(sqlite::Sqlite::open(url, timeout_ms, access)?),
            DatabaseKind::Postgres => {
                let runtime = self.0.runtime.clone();
                Box::new(postgres::PostgresServer::open(url, timeout_ms, runtime)?)
            }
        };
        Ok(database)
    }

    /// Runs `work` in a transaction on a thread that may block, and commits the transaction.
    pub(crate) async fn write<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut dyn Database) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        let mut writer = Arc::clone(&self.0.writer).lock_owned().await;
        let store = self.clone();
        blocking(move || {
            let mut database = store.connect(Access::Write, writer.take())?;
            database.begin()?;
            let done = work(&mut *database)?;
            database.commit()?;
            *writer = Some(database);
            Ok(done)
        })
        .await
    }

    /// Runs a query and returns its rows. At most [`READERS`] queries run at a time; the others wait.
    pub(crate) async fn query(
        &self,
        text: impl Into<Cow<'static, str>>,
        values: Vec<Param>,
    ) -> Result<Vec<Row>, StoreError> {
        let text = text.into();
        let limit = Duration::from_millis(self.0.timeout_ms);
        let readers = Arc::clone(&self.0.readers);
        let Ok(Ok(permit)) = tokio::time::timeout(limit, readers.acquire_owned()).await else {
            return Err(StoreError::Unavailable(format!(
                "no connection to the database was free within {} ms",
                self.0.timeout_ms
            )));
        };
        let store = self.clone();
        blocking(move || {
            let idle = store.0.idle.lock().pop();
            let mut database = store.connect(Access::Read, idle)?;
            let rows = database.query(&text, &values)?;
            store.0.idle.lock().push(database);
            drop(permit);
            Ok(rows)
        })
        .await
    }

    /// The kind of database.
    pub(crate) fn database_kind(&self) -> DatabaseKind {
        self.0.kind
    }

    /// `sqlite` or `postgres`.
    pub fn kind(&self) -> &'static str {
        match self.0.kind {
            DatabaseKind::Sqlite => "sqlite",
            DatabaseKind::Postgres => "postgres",
        }
    }

    /// Closes the connections once nothing uses them.
    pub async fn close(&self) {
        let _all = self.0.readers.acquire_many(READERS as u32).await;
        let mut open = std::mem::take(&mut *self.0.idle.lock());
        if let Some(writer) = self.0.writer.lock().await.take() {
            open.push(writer);
        }
        // Closing a connection may block.
        let closed = blocking(move || {
            drop(open);
            Ok(())
        });
        let _ = closed.await;
        if let Some(file) = &self.0.file {
            file.release();
        }
    }
}

async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, StoreError> + Send + 'static,
) -> Result<T, StoreError> {
    match tokio::task::spawn_blocking(work).await {
        Ok(done) => done,
        Err(error) => Err(StoreError::Unavailable(format!(
            "the task that uses the database failed: {error}"
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_semicolon_in_a_comment_ends_no_statement() {
        let file = "-- All go; none stay.\nDELETE FROM a\n  -- old; new\n  WHERE b;\n\n-- And c.\nDELETE FROM c;\n";
        let found = statements(file);
        assert_eq!(found, ["DELETE FROM a\n  WHERE b", "DELETE FROM c"]);
    }
}
