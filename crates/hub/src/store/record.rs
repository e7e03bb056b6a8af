//! Rows as the thread that writes gives them to a database.

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
    /// An identity.
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
        Self::Id(id)
    }
}

impl<T: Into<Self>> From<Option<T>> for Cell {
    fn from(value: Option<T>) -> Self {
        value.map_or(Self::Null, Into::into)
    }
}

/// A kind of row.
pub(crate) trait Record {
    /// Its columns, in order.
    fn columns() -> Vec<&'static str>;

    /// Its values, in the order of the columns.
    fn cells(&self) -> Vec<Cell>;
}

/// Declares a row: its fields are the columns, in order, under their own names.
macro_rules! record {
    ($(#[$meta:meta])* pub(crate) struct $name:ident {
        $($(#[$field_meta:meta])* $field:ident: $type:ty,)+
    }) => {
        $(#[$meta])*
        #[derive(Clone, Debug, PartialEq)]
        pub(crate) struct $name {
            $($(#[$field_meta])* pub(crate) $field: $type,)+
        }

        impl $crate::store::record::Record for $name {
            fn columns() -> Vec<&'static str> {
                vec![$(stringify!($field),)+]
            }

            fn cells(&self) -> Vec<$crate::store::record::Cell> {
                vec![$(self.$field.clone().into(),)+]
            }
        }
    };
}
pub(crate) use record;
