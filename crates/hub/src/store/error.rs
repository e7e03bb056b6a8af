//! Defines the errors of the database.

use albireo_service::http::Problem;
use axum::http::StatusCode;

/// An error of the database.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// It holds other data, or was written by another version of the program.
    #[error("{0}")]
    Refused(String),
    /// It cannot be reached or written now: it is absent, full, locked or read-only.
    #[error("{0}")]
    Unavailable(String),
    /// It refused a statement.
    #[error("the database refused a statement: {0}")]
    Statement(String),
}

impl StoreError {
    /// True if the same statement may succeed later.
    pub(crate) fn is_temporary(&self) -> bool {
        matches!(self, Self::Unavailable(_))
    }
}

/// Beginnings of PostgreSQL's error codes that concern its state and not the statement: connection, transaction rollback,
/// resources, operator intervention, system, a read-only transaction, and a lock that was not free in time.
const STATES: [&str; 7] = ["08", "40", "53", "57", "58", "25", "55P03"];

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        match &error {
            sqlx::Error::Database(database) => {
                let code = database.code().unwrap_or_default();
                if STATES.iter().any(|state| code.starts_with(state)) {
                    Self::Unavailable(format!("the database cannot be used now: {database}"))
                } else {
                    Self::Statement(format!("{database} (code {code})"))
                }
            }
            sqlx::Error::Configuration(reason) => {
                Self::Refused(with_remedy(format!("database.url: {reason}")))
            }
            other => {
                let text = format!("the database cannot be reached: {other}");
                Self::Unavailable(with_remedy(text))
            }
        }
    }
}

/// Adds the remedy to an error that a password may cause: a character in it ends what is read as the host.
fn with_remedy(text: String) -> String {
    if text.contains("invalid port number") || text.contains("failed to lookup address") {
        text + "; in a password in database.url, write @ as %40, / as %2F and # as %23"
    } else {
        text
    }
}

impl From<rusqlite::Error> for StoreError {
    fn from(error: rusqlite::Error) -> Self {
        use rusqlite::ErrorCode as Code;
        match error.sqlite_error_code() {
            Some(
                Code::DatabaseBusy
                | Code::DatabaseLocked
                | Code::OutOfMemory
                | Code::ReadOnly
                | Code::SystemIoFailure
                | Code::DiskFull
                | Code::OperationInterrupted,
            ) => Self::Unavailable(format!("the database cannot be used now: {error}")),
            Some(Code::CannotOpen) => Self::Unavailable(format!(
                "{error}; create its folder, or set another file in database.url"
            )),
            Some(Code::NotADatabase) => Self::Refused(
                "the file is not an SQLite database and was not changed: set another file in database.url"
                    .to_owned(),
            ),
            _ => Self::Statement(error.to_string()),
        }
    }
}

impl From<serde_json::Error> for StoreError {
    fn from(error: serde_json::Error) -> Self {
        Self::Statement(format!("rows cannot be written as JSON: {error}"))
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        let status = if error.is_temporary() {
            StatusCode::SERVICE_UNAVAILABLE
        } else {
            StatusCode::INTERNAL_SERVER_ERROR
        };
        Self::new(status, error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_host_that_may_be_a_part_of_the_password_is_reported_with_the_remedy() {
        let no_port = sqlx::Error::Configuration("invalid port number".into());
        let lookup = "failed to lookup address information: Name or service not known";
        let no_host = sqlx::Error::Io(std::io::Error::other(lookup));
        for error in [no_port, no_host] {
            let text = StoreError::from(error).to_string();
            assert!(text.contains("# as %23"), "{text}");
        }
        let no_server = sqlx::Error::Io(std::io::ErrorKind::ConnectionRefused.into());
        let text = StoreError::from(no_server).to_string();
        assert!(!text.contains("%23"), "{text}");
    }
}
