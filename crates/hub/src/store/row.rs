//! Rows of both databases: their cells in the order of a statement's columns, read into structs and written from them.

use super::StoreError;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use uuid::Uuid;

/// The value of a column.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Cell {
    Null,
    Whole(i64),
    Real(f64),
    Text(String),
    Bytes(Vec<u8>),
}

/// A parameter of a query. None is null: PostgreSQL must know the type of each.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Param {
    Whole(i64),
    Text(String),
}

impl From<i64> for Param {
    fn from(number: i64) -> Self {
        Self::Whole(number)
    }
}

impl From<&str> for Param {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for Param {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl<T: Into<Self>> From<Option<T>> for Cell {
    fn from(value: Option<T>) -> Self {
        value.map_or(Self::Null, Into::into)
    }
}

impl From<i64> for Cell {
    fn from(number: i64) -> Self {
        Self::Whole(number)
    }
}

impl From<bool> for Cell {
    fn from(yes: bool) -> Self {
        Self::Whole(i64::from(yes))
    }
}

impl From<f64> for Cell {
    fn from(number: f64) -> Self {
        Self::Real(number)
    }
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for Cell {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<Uuid> for Cell {
    fn from(id: Uuid) -> Self {
        Self::Bytes(id.into_bytes().to_vec())
    }
}

impl Cell {
    /// A text that holds JSON.
    pub(crate) fn json(value: &impl Serialize) -> Result<Self, StoreError> {
        Ok(Self::Text(serde_json::to_string(value)?))
    }

    /// A text that holds JSON; null without a value.
    pub(crate) fn json_or_null<T: Serialize>(value: Option<&T>) -> Result<Self, StoreError> {
        match value {
            Some(value) => Self::json(value),
            None => Ok(Self::Null),
        }
    }
}

/// A type that a column can be read as.
pub(crate) trait FromCell: Sized {
    /// What such a column holds, for the error.
    const WHAT: &'static str;

    /// The value; `None` if the column holds something else.
    fn from_cell(cell: &Cell) -> Option<Self>;
}

impl FromCell for i64 {
    const WHAT: &'static str = "a whole number";

    fn from_cell(cell: &Cell) -> Option<Self> {
        match cell {
            Cell::Whole(number) => Some(*number),
            _ => None,
        }
    }
}

impl FromCell for u64 {
    const WHAT: &'static str = "a whole number from 0";

    fn from_cell(cell: &Cell) -> Option<Self> {
        i64::from_cell(cell)?.try_into().ok()
    }
}

impl FromCell for f64 {
    const WHAT: &'static str = "a number";

    fn from_cell(cell: &Cell) -> Option<Self> {
        match cell {
            Cell::Real(number) => Some(*number),
            // SQLite gives a sum that is 0 as a whole number.
            Cell::Whole(number) => Some(*number as Self),
            _ => None,
        }
    }
}

impl FromCell for String {
    const WHAT: &'static str = "text";

    fn from_cell(cell: &Cell) -> Option<Self> {
        match cell {
            Cell::Text(text) => Some(text.clone()),
            _ => None,
        }
    }
}

impl FromCell for Uuid {
    const WHAT: &'static str = "an id of 16 bytes";

    fn from_cell(cell: &Cell) -> Option<Self> {
        match cell {
            Cell::Bytes(bytes) => Self::from_slice(bytes).ok(),
            _ => None,
        }
    }
}

impl<T: FromCell> FromCell for Option<T> {
    const WHAT: &'static str = T::WHAT;

    fn from_cell(cell: &Cell) -> Option<Self> {
        match cell {
            Cell::Null => Some(None),
            cell => T::from_cell(cell).map(Some),
        }
    }
}

/// A row that was read: its columns are taken one after the other.
#[derive(Debug)]
pub(crate) struct Row {
    cells: Vec<Cell>,
    next: usize,
}

impl Row {
    pub(crate) const fn new(cells: Vec<Cell>) -> Self {
        Self { cells, next: 0 }
    }

    /// All cells.
    pub(crate) fn into_cells(self) -> Vec<Cell> {
        self.cells
    }

    /// The next column.
    ///
    /// # Errors
    /// [`StoreError::Statement`] if there is none, or if it holds something else.
    pub(crate) fn take<T: FromCell>(&mut self) -> Result<T, StoreError> {
        let cell = self.cells.get(self.next);
        self.next += 1;
        cell.and_then(T::from_cell).ok_or_else(|| {
            StoreError::Statement(format!(
                "column {} of a row is {cell:?}, not {}",
                self.next,
                T::WHAT
            ))
        })
    }

    /// The next column, which names a value.
    pub(crate) fn take_named<T>(
        &mut self,
        named: impl FnOnce(&str) -> Option<T>,
    ) -> Result<T, StoreError> {
        let name: String = self.take()?;
        named(&name)
            .ok_or_else(|| StoreError::Statement(format!("`{name}` in a row is no known name")))
    }

    /// The next column, a text that holds JSON; a null is read as JSON's.
    pub(crate) fn take_json<T: DeserializeOwned>(&mut self) -> Result<T, StoreError> {
        let text: Option<String> = self.take()?;
        let value = match text {
            Some(text) => serde_json::from_str(&text),
            None => serde_json::from_value(Value::Null),
        };
        value.map_err(|error| {
            StoreError::Statement(format!("JSON in a row cannot be read: {error}"))
        })
    }
}

/// A struct that a row is read into, its fields in the order of the statement's columns.
pub(crate) trait FromRow: Sized {
    fn from_row(row: &mut Row) -> Result<Self, StoreError>;
}

/// Reads a struct from each row.
pub(crate) fn read_all<T: FromRow>(rows: Vec<Row>) -> Result<Vec<T>, StoreError> {
    rows.into_iter().map(|mut row| T::from_row(&mut row)).collect()
}

/// The columns of a row to insert, each name beside its value.
pub(crate) type Columns<'a> = Vec<(&'a str, Cell)>;

/// A struct that is inserted as a row.
pub(crate) trait IntoRow {
    /// Its table.
    const TABLE: &'static str;

    /// Its columns, for every row the same ones in the same order.
    fn columns(&self) -> Result<Columns<'static>, StoreError>;
}

/// Replaces NUL characters, which PostgreSQL cannot store.
pub(crate) fn text(text: &str) -> String {
    text.replace('\0', "\u{fffd}")
}

/// The beginning of a text that a node may have made long, such as a reason, which may quote what is invalid.
pub(crate) fn beginning(text: &str) -> String {
    text[..text.floor_char_boundary(2 << 10)].to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_column_of_another_type_or_a_missing_one_is_a_clear_error() {
        let mut row = Row::new(vec![Cell::Whole(-1), "seven".into(), Cell::Null]);
        let error = row.take::<u64>().unwrap_err().to_string();
        assert!(error.contains("column 1"), "{error}");
        assert!(error.contains("a whole number from 0"), "{error}");
        let error = row.take::<i64>().unwrap_err().to_string();
        assert!(error.contains("seven"), "{error}");
        assert!(error.contains("a whole number"), "{error}");
        // A null is not read as 0.
        let error = row.take::<f64>().unwrap_err().to_string();
        assert!(error.contains("Null"), "{error}");
        let error = row.take::<Option<i64>>().unwrap_err().to_string();
        assert!(error.contains("column 4"), "{error}");
    }

    #[test]
    fn an_id_is_sixteen_bytes_and_a_null_is_read_only_where_it_may_be() {
        let id = Uuid::from_u128(7);
        let mut row = Row::new(vec![id.into(), Cell::Null, Cell::Bytes(vec![1])]);
        assert_eq!(row.take::<Uuid>().unwrap(), id);
        assert_eq!(row.take::<Option<String>>().unwrap(), None);
        assert!(row.take::<Uuid>().is_err());
    }
}
