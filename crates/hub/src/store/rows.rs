//! Rows as they go to the database: many of them as one parameter, a JSON array of arrays.
//!
//! One statement with one parameter writes hundreds of rows: with a parameter each, a statement of [`sqlx`] costs more
//! than the row itself.

use serde::Serialize;
use serde::ser::{SerializeTuple, Serializer};

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

/// A kind of row.
pub(crate) trait Row: Serialize {
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
    fn text_with_a_nul_is_made_storable() {
        assert_eq!(text("a\0b"), "a\u{fffd}b");
    }
}
