//! Conversions between rows and structs.

use super::StoreError;
use albireo_wire::DesiredSetting;
use std::sync::Arc;
use uuid::Uuid;

/// A value of a row.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Cell {
    /// Nothing.
    Null,
    /// A whole number.
    Int(i64),
    /// A number.
    Real(f64),
    /// A text.
    Text(String),
    /// The id of a report.
    Id(Uuid),
}

impl From<i64> for Cell {
    fn from(number: i64) -> Self {
        Self::Int(number)
    }
}

impl From<f64> for Cell {
    fn from(number: f64) -> Self {
        Self::Real(number)
    }
}

impl From<&str> for Cell {
    fn from(value: &str) -> Self {
        Self::Text(text(value))
    }
}

impl From<String> for Cell {
    fn from(value: String) -> Self {
        Self::Text(if value.contains('\0') {
            text(&value)
        } else {
            value
        })
    }
}

impl From<Uuid> for Cell {
    fn from(id: Uuid) -> Self {
        Self::Id(id)
    }
}

impl From<DesiredSetting> for Cell {
    fn from(setting: DesiredSetting) -> Self {
        serde_json::to_string(&setting).map_or(Self::Null, Self::Text)
    }
}

impl<T: Into<Self>> From<Option<T>> for Cell {
    fn from(value: Option<T>) -> Self {
        value.map_or(Self::Null, Into::into)
    }
}

/// Text that both databases store: PostgreSQL takes no NUL in text, SQLite ends the text there.
pub(crate) fn text(text: &str) -> String {
    text.replace('\0', "\u{fffd}")
}

/// What a cell is read as.
pub(crate) trait FromCell: Sized {
    /// The value of the cell; `None` where it is of another type.
    fn read(cell: &Cell) -> Option<Self>;
}

impl FromCell for i64 {
    fn read(cell: &Cell) -> Option<Self> {
        match cell {
            Cell::Int(number) => Some(*number),
            // Sums are added up as floating-point numbers: they are exact to 2^53, and the conversion saturates.
            Cell::Real(number) => Some(*number as Self),
            _ => None,
        }
    }
}

impl FromCell for f64 {
    fn read(cell: &Cell) -> Option<Self> {
        match cell {
            Cell::Int(number) => Some(*number as Self),
            Cell::Real(number) => Some(*number),
            _ => None,
        }
    }
}

impl FromCell for String {
    fn read(cell: &Cell) -> Option<Self> {
        match cell {
            Cell::Text(text) => Some(text.clone()),
            _ => None,
        }
    }
}

impl FromCell for DesiredSetting {
    fn read(cell: &Cell) -> Option<Self> {
        match cell {
            Cell::Text(text) => serde_json::from_str(text).ok(),
            _ => None,
        }
    }
}

impl FromCell for Uuid {
    fn read(cell: &Cell) -> Option<Self> {
        match cell {
            Cell::Id(id) => Some(*id),
            _ => None,
        }
    }
}

impl<T: FromCell> FromCell for Option<T> {
    fn read(cell: &Cell) -> Option<Self> {
        match cell {
            Cell::Null => Some(None),
            cell => T::read(cell).map(Some),
        }
    }
}

/// A row that a query gave.
#[derive(Clone, Debug)]
pub(crate) struct Row {
    columns: Arc<[String]>,
    cells: Vec<Cell>,
}

impl Row {
    /// A row with these cells in the order of the columns.
    pub(super) const fn new(columns: Arc<[String]>, cells: Vec<Cell>) -> Self {
        Self { columns, cells }
    }

    /// The value in the column of that name.
    pub(crate) fn get<T: FromCell>(&self, name: &str) -> Result<T, StoreError> {
        let place = self.columns.iter().position(|column| column == name);
        let cell = place.and_then(|place| self.cells.get(place));
        cell.and_then(T::read).ok_or_else(|| {
            StoreError::Statement(format!("column {name} is read as another type: {cell:?}"))
        })
    }
}

/// A kind of row.
pub(crate) trait Record: Sized {
    /// Its columns, in order.
    fn columns() -> Vec<&'static str>;

    /// Its values, in the order of the columns.
    fn cells(&self) -> Vec<Cell>;
}

/// Declares a row: its fields are the columns, in order, under their own names.
macro_rules! record {
    ($(#[$meta:meta])* $vis:vis struct $name:ident {
        $($(#[$field_meta:meta])* $field:ident: $type:ty,)+
    }) => {
        $(#[$meta])*
        #[derive(Clone, Debug, PartialEq)]
        $vis struct $name {
            $($(#[$field_meta])* $vis $field: $type,)+
        }

        impl $crate::store::record::Record for $name {
            fn columns() -> Vec<&'static str> {
                vec![$(stringify!($field),)+]
            }

            fn cells(&self) -> Vec<$crate::store::record::Cell> {
                vec![$(self.$field.clone().into(),)+]
            }
        }

        impl TryFrom<&$crate::store::record::Row> for $name {
            type Error = $crate::store::StoreError;

            fn try_from(row: &$crate::store::record::Row) -> Result<Self, Self::Error> {
                Ok(Self { $($field: row.get(stringify!($field))?,)+ })
            }
        }
    };
}
pub(crate) use record;

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_wire::{Target, Threshold};
    use proptest::prelude::*;

    record! {
        /// A row for the test.
        pub(crate) struct Pair {
            number: i64,
            word: Option<String>,
        }
    }

    #[test]
    fn a_row_reads_back_as_it_was_written_and_by_name() {
        let pair = Pair {
            number: 7,
            word: None,
        };
        let columns: Arc<[String]> = Pair::columns().into_iter().map(str::to_owned).collect();
        let row = Row::new(columns, pair.cells());
        assert_eq!(Pair::try_from(&row).unwrap(), pair);
        assert!(row.get::<i64>("word").is_err());
        assert!(row.get::<i64>("no such column").is_err());
    }

    proptest! {
        #[test]
        fn a_setting_reads_back_as_the_same(value in prop::num::f64::NORMAL, which in 0..Target::NAMES.len()) {
            let target = Target::named(Target::NAMES[which], value);
            for setting in [
                DesiredSetting::Threshold(Threshold::new("u", value)),
                DesiredSetting::Target(target),
                DesiredSetting::Target(None),
            ] {
                prop_assert_eq!(DesiredSetting::read(&Cell::from(setting)), Some(setting));
            }
        }
    }

    #[test]
    fn text_with_a_nul_is_made_storable() {
        assert_eq!(Cell::from("a\0b"), Cell::Text("a\u{fffd}b".to_owned()));
        assert_eq!(
            Cell::from("a\0b".to_owned()),
            Cell::Text("a\u{fffd}b".to_owned())
        );
    }
}
