//! The database: SQLite in one file, or PostgreSQL, with the same tables and the same statements.
//!
//! One connection writes, so that a commit holds whatever came in the meantime; others read. What was committed
//! survives a power loss: `synchronous=FULL` in write-ahead mode, `synchronous_commit=on`.

mod database;
mod dialect;
mod error;
mod migrate;
mod postgres;
mod read;
mod record;
pub(crate) mod retention;
pub(crate) mod rows;
mod sqlite;
pub(crate) mod tables;
#[cfg(test)]
pub(crate) mod testing;
pub mod transfer;
mod write;

pub(crate) use database::{Database, ReportKey, Transaction};
pub(crate) use dialect::Dialect;
pub use error::StoreError;
pub use read::{
    AuditCounts, ClipQuery, EnergyBy, EnergyGroup, EnergyQuery, ReportCounts, Resolution,
    StoredClip, StoredEvent, StoredSetAside,
};
pub(crate) use rows::Key;
pub(crate) use write::{CampaignRow, ClipSums, ClipWindow, OrderNodeRow, OrderRow, columns};
pub(crate) use write::{Writer, Writing};

use crate::config::DatabaseConfig;
use sqlx::any::AnyPoolOptions;
use sqlx::{AnyConnection, AnyPool, AssertSqlSafe, Connection as _, Executor as _};
use std::path::Path;
use std::sync::{Arc, Once};
use std::time::Duration;
use uuid::Uuid;

/// The database, opened.
#[derive(Clone, Debug)]
pub struct Store {
    dialect: Dialect,
    url: Arc<str>,
    timeout_ms: u64,
    readers: AnyPool,
}

/// What a connection is told first: what is committed is on the disk, and a lock is waited for.
fn greeting(dialect: Dialect, timeout_ms: u64, reads: bool) -> Vec<String> {
    match dialect {
        Dialect::Sqlite => {
            let mut pragmas = vec![
                format!("PRAGMA busy_timeout={timeout_ms}"),
                "PRAGMA synchronous=FULL".to_owned(),
                "PRAGMA foreign_keys=ON".to_owned(),
                "PRAGMA temp_store=MEMORY".to_owned(),
            ];
            if reads {
                pragmas.push("PRAGMA cache_size=-4096".to_owned());
                pragmas.push("PRAGMA query_only=ON".to_owned());
            } else {
                pragmas.push("PRAGMA journal_mode=WAL".to_owned());
                pragmas.push("PRAGMA cache_size=-32768".to_owned());
                pragmas.push("PRAGMA wal_autocheckpoint=4000".to_owned());
            }
            pragmas
        }
        Dialect::Postgres => vec![
            "SET synchronous_commit TO on".to_owned(),
            format!("SET statement_timeout TO {}", timeout_ms.saturating_mul(4)),
            format!("SET lock_timeout TO {timeout_ms}"),
            "SET client_min_messages TO warning".to_owned(),
        ],
    }
}

impl Store {
    /// Connects, and brings the tables to this program's version.
    ///
    /// # Errors
    /// [`StoreError::Refused`] when the database holds something else, or was written by a newer program: that does
    /// not pass by itself. [`StoreError::Unavailable`] when it cannot be reached now.
    pub async fn open(config: &DatabaseConfig) -> Result<Self, StoreError> {
        static DRIVERS: Once = Once::new();
        DRIVERS.call_once(sqlx::any::install_default_drivers);
        let dialect = Dialect::of(&config.url);
        if dialect == Dialect::Sqlite {
            check_file(&config.url)?;
        }
        let timeout_ms = config.timeout_ms;
        let readers = AnyPoolOptions::new()
            .max_connections(config.readers)
            .acquire_timeout(Duration::from_millis(timeout_ms))
            .max_lifetime(None)
            .idle_timeout(None)
            .after_connect(move |connection: &mut AnyConnection, _| {
                Box::pin(greet(connection, dialect, timeout_ms, true))
            })
            .connect_lazy(&url(config, dialect, "rw"))?;
        let store = Self {
            dialect,
            url: url(config, dialect, "rwc").into(),
            timeout_ms,
            readers,
        };
        let mut connection = store.connect().await?;
        migrate::migrate(dialect, &mut connection).await?;
        connection.close().await?;
        Ok(store)
    }

    /// A connection that writes.
    async fn connect(&self) -> Result<AnyConnection, StoreError> {
        let connecting = async {
            let mut connection = AnyConnection::connect(&self.url).await?;
            greet(&mut connection, self.dialect, self.timeout_ms, false).await?;
            Ok(connection)
        };
        match tokio::time::timeout(Duration::from_millis(self.timeout_ms), connecting).await {
            Ok(connected) => connected.map_err(|error| migrate::foreign(self.dialect, error)),
            Err(_) => Err(StoreError::Unavailable(format!(
                "the database did not answer within {} ms",
                self.timeout_ms
            ))),
        }
    }

    /// The database for the thread that writes what nodes report. To be called on a thread of the runtime, and used on one
    /// that is not.
    pub(crate) fn database(&self) -> Box<dyn Database> {
        match self.dialect {
            Dialect::Sqlite => Box::new(sqlite::Sqlite::new(&self.url, self.timeout_ms)),
            Dialect::Postgres => {
                Box::new(postgres::PostgresServer::new(&self.url, self.timeout_ms))
            }
        }
    }

    /// Which database it is.
    pub fn kind(&self) -> &'static str {
        self.dialect.as_str()
    }

    /// Closes the connections that read.
    pub async fn close(&self) {
        self.readers.close().await;
    }
}

/// The identity of a database as it is kept.
fn identity_of(text: &str) -> Result<Uuid, StoreError> {
    text.parse().map_err(|error| {
        StoreError::Statement(format!("`{text}` is kept as its identity: {error}"))
    })
}

async fn greet(
    connection: &mut AnyConnection,
    dialect: Dialect,
    timeout_ms: u64,
    reads: bool,
) -> sqlx::Result<()> {
    for statement in greeting(dialect, timeout_ms, reads) {
        connection.execute(AssertSqlSafe(statement)).await?;
    }
    Ok(())
}

fn url(config: &DatabaseConfig, dialect: Dialect, mode: &str) -> String {
    if dialect == Dialect::Sqlite && !config.url.contains('?') {
        format!("{}?mode={mode}", config.url)
    } else {
        config.url.clone()
    }
}

/// Says what is wrong with the place of the file in words that help more than those of SQLite.
fn check_file(url: &str) -> Result<(), StoreError> {
    let file = url.strip_prefix("sqlite:").unwrap_or(url);
    let file = Path::new(
        file.split('?')
            .next()
            .unwrap_or(file)
            .trim_start_matches("//"),
    );
    let folder = match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    if !folder.is_dir() {
        return Err(StoreError::Unavailable(format!(
            "the folder {} of the database is not there; make it, or change database.url",
            folder.display()
        )));
    }
    Ok(())
}
