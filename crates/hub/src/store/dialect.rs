//! What the two databases write differently.

use sqlx::AssertSqlSafe;

/// Which database it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Dialect {
    /// One file.
    Sqlite,
    /// A server, which several hubs may share.
    Postgres,
}

impl Dialect {
    /// The database of that URL.
    pub(crate) fn of(url: &str) -> Self {
        if url.starts_with("sqlite:") {
            Self::Sqlite
        } else {
            Self::Postgres
        }
    }

    /// Its name.
    pub(crate) const fn as_str(self) -> &'static str {
        match self {
            Self::Sqlite => "sqlite",
            Self::Postgres => "postgres",
        }
    }

    /// A statement from a text of this crate, with the words in braces replaced. Values never get into the text: they
    /// are parameters.
    pub(crate) fn sql(self, text: &str) -> AssertSqlSafe<String> {
        let mut sql = text.to_owned();
        for (word, sqlite, postgres) in WORDS {
            if sql.contains(word) {
                sql = sql.replace(
                    word,
                    if self == Self::Sqlite {
                        sqlite
                    } else {
                        postgres
                    },
                );
            }
        }
        AssertSqlSafe(sql)
    }
}

/// Words in statements, in the two languages.
const WORDS: [(&str, &str, &str); 2] = [
    (
        // The rows of the first parameter: arrays within one JSON array.
        "{ROWS}",
        "json_each($1) AS r",
        "jsonb_array_elements(CAST($1 AS jsonb)) AS r(value)",
    ),
    // The sum of a column, which is never too large for a column.
    (
        "{SUM_OF}",
        "MIN(4611686018427387904, TOTAL",
        "LEAST(4611686018427387904, SUM",
    ),
];
