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
        if sql.contains("{SUMS}") {
            let columns = FIRST_SUMS.map(|name| format!("{name} BIGINT NOT NULL"));
            sql = sql.replace("{SUMS}", &columns.join(",\n    "));
        }
        AssertSqlSafe(sql)
    }
}

/// What the first version summed. Later columns are added by later steps, never here.
const FIRST_SUMS: [&str; 20] = [
    "clips",
    "duration_us",
    "frames",
    "frames_e",
    "frames_p",
    "frames_ei",
    "frames_i",
    "frames_ai",
    "degraded",
    "dropped",
    "latency_us",
    "detector_calls",
    "detector_us",
    "avoided_calls",
    "unpriced_calls",
    "avoided_uj",
    "energy_uj",
    "gpu_uj",
    "cpu_uj",
    "io_mem_uj",
];

/// Words in statements, in the two languages.
const WORDS: [(&str, &str, &str); 5] = [
    (
        // The rows of the first parameter: arrays within one JSON array.
        "{ROWS}",
        "json_each($1) AS r",
        "jsonb_array_elements(CAST($1 AS jsonb)) AS r(value)",
    ),
    (
        "{ID}",
        "INTEGER PRIMARY KEY AUTOINCREMENT",
        "BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY",
    ),
    ("{CLUSTERED}", "WITHOUT ROWID", ""),
    // Rows that no other hub may change until the transaction ends. SQLite has one writer.
    ("{FOR_UPDATE}", "", "FOR UPDATE OF i"),
    ("{MAX}", "max", "GREATEST"),
];
