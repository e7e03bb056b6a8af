//! Rows as they go to the database, many in a statement: one statement a row costs more than the row itself.
//!
//! PostgreSQL is given them as one parameter, a JSON array of arrays. SQLite reads JSON many times slower than it
//! writes a row (a quarter of the hub's time went there), so it is given a `VALUES` list with a parameter for each value.

use super::{Dialect, StoreError};
use serde::Serialize;
use serde::ser::{SerializeTuple, Serializer};
use sqlx::any::AnyArguments;
use sqlx::query::Query;
use sqlx::{Any, AssertSqlSafe};

/// What a column is read from the array as.
pub(crate) trait Column {
    /// Type of SQL.
    const TYPE: &'static str;
}

impl Column for i64 {
    const TYPE: &'static str = "BIGINT";
}
impl Column for Option<i64> {
    const TYPE: &'static str = "BIGINT";
}
impl Column for Option<f64> {
    const TYPE: &'static str = "DOUBLE PRECISION";
}
impl Column for String {
    const TYPE: &'static str = "TEXT";
}
impl Column for Option<String> {
    const TYPE: &'static str = "TEXT";
}

/// A statement with its parameters.
pub(crate) type Bound = Query<'static, Any, AnyArguments>;

/// Values that go to the database together: a row, or what is looked up.
pub(crate) trait Values: Serialize {
    /// How many.
    const COUNT: usize;

    /// `query` with these as its next parameters.
    fn bind(&self, query: Bound) -> Bound;
}

/// A kind of row.
pub(crate) trait Row: Values {
    /// Its columns: name and type.
    const COLUMNS: &'static [(&'static str, &'static str)];
}

/// Declares a row: its fields are the columns, in order, under their own names.
macro_rules! row {
    ($(#[$meta:meta])* pub(crate) struct $name:ident {
        $($(#[$field_meta:meta])* $field:ident: $type:ty,)+
    }) => {
        $(#[$meta])*
        #[derive(Clone, Debug, PartialEq)]
        pub(crate) struct $name {
            $($(#[$field_meta])* pub(crate) $field: $type,)+
        }

        impl $crate::store::rows::Row for $name {
            const COLUMNS: &'static [(&'static str, &'static str)] = &[
                $((stringify!($field), <$type as $crate::store::rows::Column>::TYPE),)+
            ];
        }

        impl $crate::store::rows::Values for $name {
            const COUNT: usize = <Self as $crate::store::rows::Row>::COLUMNS.len();

            fn bind(&self, query: $crate::store::rows::Bound) -> $crate::store::rows::Bound {
                query$(.bind(self.$field.clone()))+
            }
        }

        impl serde::Serialize for $name {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                use serde::ser::SerializeTuple as _;
                let length = <Self as $crate::store::rows::Row>::COLUMNS.len();
                let mut tuple = serializer.serialize_tuple(length)?;
                $(tuple.serialize_element(&self.$field)?;)+
                tuple.end()
            }
        }
    };
}
pub(crate) use row;

/// The parameter for those rows.
pub(crate) fn parameter<T: Serialize>(rows: &[T]) -> Result<String, serde_json::Error> {
    serde_json::to_string(rows)
}

/// Rows in one statement of SQLite: few sizes, so that each statement is prepared once, and no more parameters than it
/// takes (32,766).
const CHUNKS: [usize; 3] = [64, 8, 1];

/// The statements that do what `text` says on those rows.
pub(crate) fn statements<T: Values>(
    dialect: Dialect,
    text: &str,
    rows: &[T],
) -> Result<Vec<Bound>, StoreError> {
    if rows.is_empty() {
        return Ok(Vec::new());
    }
    match dialect {
        Dialect::Postgres => {
            let query = sqlx::query(dialect.sql(text)).bind(parameter(rows)?);
            Ok(vec![query])
        }
        Dialect::Sqlite => Ok(of_values(dialect, text, rows)),
    }
}

fn of_values<T: Values>(dialect: Dialect, text: &str, rows: &[T]) -> Vec<Bound> {
    let text = columns_of_values(text);
    let row = format!("({})", vec!["?"; T::COUNT].join(","));
    let mut statements = Vec::new();
    let mut rest = rows;
    for size in CHUNKS {
        let chunks = rest.chunks_exact(size);
        rest = chunks.remainder();
        if chunks.len() == 0 {
            continue;
        }
        let list = vec![row.as_str(); size].join(",");
        let sql = dialect.sql(&text.replace("{ROWS}", &format!("(VALUES {list}) AS r")));
        for chunk in chunks {
            let query = sqlx::query(AssertSqlSafe(sql.0.clone()));
            statements.push(chunk.iter().fold(query, |query, row| row.bind(query)));
        }
    }
    statements
}

/// `r.value ->> 0` of a JSON array is `r.column1` of a list of values.
fn columns_of_values(text: &str) -> String {
    const ELEMENT: &str = "r.value ->> ";
    let mut parts = text.split(ELEMENT);
    let mut columns = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let digits = part.len() - part.trim_start_matches(|c: char| c.is_ascii_digit()).len();
        let (index, rest) = part.split_at(digits);
        let index: usize = index.parse().unwrap_or_default();
        columns.push_str(&format!("r.column{}", index + 1));
        columns.push_str(rest);
    }
    columns
}

/// `CAST(r.value ->> 0 AS BIGINT), …` for these columns.
pub(crate) fn casts(columns: &[(&str, &str)]) -> String {
    let casts: Vec<String> = columns
        .iter()
        .enumerate()
        .map(|(index, (_, sql_type))| format!("CAST(r.value ->> {index} AS {sql_type})"))
        .collect();
    casts.join(", ")
}

/// The names of these columns, separated by commas.
pub(crate) fn names(columns: &[(&str, &str)]) -> String {
    let names: Vec<&str> = columns.iter().map(|(name, _)| *name).collect();
    names.join(", ")
}

/// The statement that inserts rows of that kind.
pub(crate) fn insert<R: Row>(table: &str) -> String {
    format!(
        "INSERT INTO {table} ({}) SELECT {} FROM {{ROWS}} WHERE true",
        names(R::COLUMNS),
        casts(R::COLUMNS)
    )
}

/// Text that both databases keep: PostgreSQL takes no NUL in text, SQLite ends the text there.
pub(crate) fn text(text: &str) -> String {
    text.replace('\0', "\u{fffd}")
}

/// A row of a few values, for statements that look something up.
#[derive(Clone, Debug)]
pub(crate) struct Key<const N: usize>(pub(crate) [Value; N]);

/// One value of a [`Key`].
#[derive(Clone, Debug)]
pub(crate) enum Value {
    /// A number.
    Number(i64),
    /// A text.
    Text(String),
}

impl<const N: usize> Values for Key<N> {
    const COUNT: usize = N;

    fn bind(&self, query: Bound) -> Bound {
        self.0.iter().fold(query, |query, value| match value {
            Value::Number(number) => query.bind(*number),
            Value::Text(text) => query.bind(text.clone()),
        })
    }
}

impl<const N: usize> Serialize for Key<N> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(N)?;
        for value in &self.0 {
            match value {
                Value::Number(number) => tuple.serialize_element(number)?,
                Value::Text(text) => tuple.serialize_element(text)?,
            }
        }
        tuple.end()
    }
}

impl From<i64> for Value {
    fn from(number: i64) -> Self {
        Self::Number(number)
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    row! {
        /// A row for the test.
        pub(crate) struct Pair {
            number: i64,
            word: Option<String>,
        }
    }

    #[test]
    fn a_row_and_its_statement_have_the_same_order() {
        let pair = Pair {
            number: 7,
            word: None,
        };
        assert_eq!(parameter(&[pair]).unwrap(), "[[7,null]]");
        assert_eq!(
            insert::<Pair>("pairs"),
            "INSERT INTO pairs (number, word) SELECT CAST(r.value ->> 0 AS BIGINT), CAST(r.value ->> 1 AS TEXT) \
             FROM {ROWS} WHERE true"
        );
    }

    #[test]
    fn sqlite_reads_the_same_elements_from_a_list_of_values() {
        assert_eq!(
            columns_of_values("a = r.value ->> 0 AND b = CAST(r.value ->> 12 AS TEXT) FROM {ROWS}"),
            "a = r.column1 AND b = CAST(r.column13 AS TEXT) FROM {ROWS}"
        );
        let pair = |number| Pair { number, word: None };
        let sizes = |count| {
            let rows: Vec<Pair> = (0..count).map(pair).collect();
            statements(Dialect::Sqlite, &insert::<Pair>("pairs"), &rows)
                .unwrap()
                .len()
        };
        assert_eq!([0, 1, 8, 64, 64 + 8 + 2].map(sizes), [0, 1, 1, 1, 4]);
    }

    #[test]
    fn text_with_a_nul_is_made_storable() {
        assert_eq!(text("a\0b"), "a\u{fffd}b");
    }
}
