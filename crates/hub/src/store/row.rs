//! Represents rows as JSON objects, the same for both databases; `serde` converts structs from and to them.

use super::StoreError;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Map, Value};

/// A row: its columns by name. The id of a report is an array of 16 bytes.
pub(crate) type Row = Map<String, Value>;

/// The columns of a row to insert.
pub(crate) type Columns<'a> = Vec<(&'a str, Value)>;

/// The columns of a row.
pub(crate) fn columns<'a>(row: &'a Row) -> Columns<'a> {
    let column = |(name, value): (&'a String, &Value)| (name.as_str(), value.clone());
    row.iter().map(column).collect()
}

/// Reads a struct from a row.
pub(crate) fn read<T: DeserializeOwned>(row: Row) -> Result<T, StoreError> {
    Ok(serde_json::from_value(Value::Object(row))?)
}

/// Reads a struct from each row.
pub(crate) fn read_all<T: DeserializeOwned>(rows: Vec<Row>) -> Result<Vec<T>, StoreError> {
    rows.into_iter().map(read).collect()
}

/// Converts a struct to a row.
pub(crate) fn row(of: &impl Serialize) -> Result<Row, StoreError> {
    match serde_json::to_value(of)? {
        Value::Object(row) => Ok(row),
        other => Err(StoreError::Statement(format!("{other} is not a row"))),
    }
}

/// The bytes of an id.
pub(super) fn bytes(numbers: &[Value]) -> Vec<u8> {
    let byte = |number: &Value| u8::try_from(number.as_u64()?).ok();
    numbers.iter().filter_map(byte).collect()
}

/// Replaces NUL characters, which PostgreSQL cannot store.
pub(crate) fn text(text: &str) -> String {
    text.replace('\0', "\u{fffd}")
}

/// The beginning of a text that a node may have made long: of an invalid report, or of a reason, which may quote what is
/// invalid.
pub(crate) fn beginning(text: &str) -> String {
    text[..text.floor_char_boundary(2 << 10)].to_owned()
}

/// Reads and writes a text column that holds JSON.
pub(crate) mod json_text {
    use super::*;

    pub(crate) fn serialize<S: Serializer>(
        value: &impl Serialize,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        let text = serde_json::to_string(value).map_err(serde::ser::Error::custom)?;
        Some(text).filter(|text| text != "null").serialize(to)
    }

    /// Reads it from a row, or from a message that contains the value itself.
    pub(crate) fn deserialize<'de, D: Deserializer<'de>, T: DeserializeOwned>(
        from: D,
    ) -> Result<T, D::Error> {
        match Value::deserialize(from)? {
            Value::String(text) => serde_json::from_str(&text),
            value => serde_json::from_value(value),
        }
        .map_err(serde::de::Error::custom)
    }
}

/// Reads a whole number that the database summed as a floating-point number.
pub(crate) fn whole<'de, D: Deserializer<'de>>(from: D) -> Result<i64, D::Error> {
    f64::deserialize(from).map(|number| number as i64)
}
