//! What tuning writes: one connection, one transaction at a time.

mod tuning;

pub(crate) use tuning::{CampaignRow, ClipSums, ClipWindow, OrderNodeRow, OrderRow, columns};

use super::rows::{Bound, Row, Values, insert, statements};
use super::tables::EventRow;
use super::{Dialect, Store, StoreError};
use sqlx::{Any, AnyConnection, Connection as _, Transaction};

/// The connection that writes. It is made when it is needed, and anew after an error.
#[derive(Debug)]
pub(crate) struct Writer {
    store: Store,
    connection: Option<AnyConnection>,
}

impl Store {
    /// The one that writes. A second one would wait for the first.
    pub(crate) fn writer(&self) -> Writer {
        Writer {
            store: self.clone(),
            connection: None,
        }
    }
}

impl Writer {
    /// Begins a transaction.
    pub(crate) async fn begin(&mut self) -> Result<Writing<'_>, StoreError> {
        let connection = match self.connection.take() {
            Some(connection) => connection,
            None => self.store.connect().await?,
        };
        let dialect = self.store.dialect;
        let connection = self.connection.insert(connection);
        // SQLite: a transaction that begins by reading and then writes fails at once when another wrote in between.
        let transaction = match dialect {
            Dialect::Sqlite => connection.begin_with("BEGIN IMMEDIATE").await?,
            Dialect::Postgres => connection.begin().await?,
        };
        Ok(Writing {
            transaction,
            dialect,
        })
    }

    /// Gives the connection up after an error: the next transaction has a new one.
    pub(crate) async fn give_up(&mut self) {
        if let Some(connection) = self.connection.take() {
            // A server that is gone cannot be told.
            let _ =
                tokio::time::timeout(std::time::Duration::from_secs(1), connection.close()).await;
        }
    }
}

/// A transaction. Nothing of it is there until [`Writing::commit`] has returned.
#[derive(Debug)]
pub(crate) struct Writing<'c> {
    transaction: Transaction<'c, Any>,
    dialect: Dialect,
}

impl Writing<'_> {
    /// Commits; what was written then survives a power loss.
    pub(crate) async fn commit(self) -> Result<(), StoreError> {
        Ok(self.transaction.commit().await?)
    }

    fn query(&self, text: &str) -> Bound {
        sqlx::query(self.dialect.sql(text))
    }

    /// Runs a statement on those rows; nothing is done without rows. How many rows of the table it touched.
    async fn with<T: Values>(&mut self, text: &str, rows: &[T]) -> Result<u64, StoreError> {
        let mut touched = 0;
        for query in statements(self.dialect, text, rows)? {
            touched += query.execute(&mut *self.transaction).await?.rows_affected();
        }
        Ok(touched)
    }

    /// Inserts rows into `table`.
    async fn insert<R: Row>(&mut self, table: &str, rows: &[R]) -> Result<u64, StoreError> {
        self.with(&insert::<R>(table), rows).await
    }

    /// Writes events and gives them their numbers, in order.
    pub(crate) async fn events(&mut self, events: &[EventRow]) -> Result<(), StoreError> {
        if events.is_empty() {
            return Ok(());
        }
        self.events_in_order().await?;
        self.insert("events", events).await.map(drop)
    }

    /// From here to the commit no other hub writes events: their numbers then grow in the order of commits, so that
    /// who reads after a number misses none.
    async fn events_in_order(&mut self) -> Result<(), StoreError> {
        /// Number of the lock.
        const LOCK: i64 = 0x0a1b_14e1;
        if self.dialect == Dialect::Postgres {
            sqlx::query("SELECT pg_advisory_xact_lock($1)")
                .bind(LOCK)
                .execute(&mut *self.transaction)
                .await?;
        }
        Ok(())
    }
}
