//! Maps a board's rails to domains, by the built-in tables in `boards.toml` or the user's table.

use crate::error::MeterError;
use crate::reading::{Domain, INPUT_RAIL, Rail, Reading, SUM_OF_RAILS, Value, Values};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::sync::Arc;

/// [`Reading::total_from`] of a board that no table names.
const UNKNOWN_BOARD: &str = "sum_of_rails of an unknown board";

/// The domains that a board's rails count for.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RailTable {
    /// The board's name.
    pub name: String,
    /// Rails that carry the board's whole power; the first one that shows power is the total.
    pub input: Vec<String>,
    /// Rails summed to the total if no input rail shows power; all of them must be read.
    pub sum: Vec<String>,
    /// Rails summed to the GPU domain; all of them must be read.
    pub gpu: Vec<String>,
    /// Like `gpu`, for the CPU domain.
    pub cpu: Vec<String>,
    /// Like `gpu`, for the IO and memory domain.
    pub io_mem: Vec<String>,
    /// Known rails that count in no domain.
    pub other: Vec<String>,
}

impl RailTable {
    fn domains(&self) -> [(Domain, &Vec<String>); 3] {
        [
            (Domain::Gpu, &self.gpu),
            (Domain::Cpu, &self.cpu),
            (Domain::IoMem, &self.io_mem),
        ]
    }

    fn knows(&self, rail: &str) -> bool {
        let domains = self.domains().map(|(_, rails)| rails);
        [&self.input, &self.sum, &self.other]
            .into_iter()
            .chain(domains)
            .flatten()
            .any(|name| name == rail)
    }

    fn domain_of(&self, rail: &str) -> Option<Domain> {
        self.domains()
            .into_iter()
            .find(|(_, rails)| rails.iter().any(|name| name == rail))
            .map(|(domain, _)| domain)
    }

    /// Returns why the table cannot be used, if it cannot: it counts a rail twice or has no total.
    pub(crate) fn fault(&self) -> Option<String> {
        if self.input.is_empty() && self.sum.is_empty() {
            let fault =
                "name the rail of the whole board in `input`, or the rails to add up in `sum`";
            return Some(fault.to_owned());
        }
        let domains = self.domains().into_iter().flat_map(|(_, rails)| rails);
        let listed_twice = twice(self.sum.iter()).or_else(|| twice(domains));
        listed_twice.map(|rail| {
            format!("`{rail}` is counted in two of gpu, cpu and io_mem, or twice in one list")
        })
    }
}

/// The first rail that is listed twice.
fn twice<'a>(mut rails: impl Iterator<Item = &'a String>) -> Option<&'a String> {
    let mut known = BTreeSet::new();
    rails.find(|rail| !known.insert(*rail))
}

/// The power of one rail as read.
#[derive(Clone, Debug, PartialEq)]
pub struct RailWatts {
    /// The name.
    pub name: Arc<str>,
    /// Watts; slightly below zero if the sensor has an offset.
    pub watts: f64,
}

/// Converts the rails of one board to readings.
#[derive(Debug)]
pub struct RailMap {
    tables: Vec<RailTable>,
    /// True once the input rail was read: a later reading without it is then a gap, not a sum of rails.
    has_input: bool,
}

impl RailMap {
    /// Creates a map from the user's table, which must have no fault, or from the built-in ones.
    ///
    /// # Errors
    /// [`MeterError`] if the built-in tables cannot be read.
    pub fn new(user: Option<&RailTable>) -> Result<Self, MeterError> {
        let tables = match user {
            Some(table) => vec![table.clone()],
            None => built_in()?,
        };
        Ok(Self {
            tables,
            has_input: false,
        })
    }

    /// Returns the domains of one reading, by the table that names most of `rails`. A domain with a missing rail is left
    /// out, never reported too small. A negative rail counts as zero: no rail returns power, so it is the sensor's
    /// offset.
    pub fn reading(&mut self, rails: &[RailWatts]) -> Reading {
        let table = best_table(&self.tables, rails);
        let input = table.and_then(|table| live_input(table, rails));
        if input.is_some() {
            self.has_input = true;
        }
        let (total, total_from) = if self.has_input {
            let watts = input.and_then(|name| watts_of(rails, name));
            (watts, INPUT_RAIL)
        } else if let Some(table) = table {
            (sum_of(rails, &table.sum), SUM_OF_RAILS)
        } else {
            (sum_of_all(rails), UNKNOWN_BOARD)
        };
        let mut values = Values {
            total: total.map(Value::Power),
            ..Values::default()
        };
        if let Some(table) = table {
            for (domain, names) in table.domains() {
                values[domain] = sum_of(rails, names).map(Value::Power);
            }
        }
        let listed = rails.iter().map(|rail| Rail {
            name: Arc::clone(&rail.name),
            domain: table.and_then(|table| table.domain_of(&rail.name)),
            in_total: match (input, table) {
                (Some(input), _) => *input == *rail.name,
                // The input rail has a gap, so there is no total now.
                (None, _) if self.has_input => false,
                (None, Some(table)) => table.sum.iter().any(|name| **name == *rail.name),
                (None, None) => true,
            },
            value: Value::Power(rail.watts),
        });
        Reading {
            at: None,
            values,
            total_from: total_from.into(),
            rails: listed.collect(),
        }
    }
}

/// Returns the table that names most of `rails`, of equals the first; `None` if none names any.
fn best_table<'a>(tables: &'a [RailTable], rails: &[RailWatts]) -> Option<&'a RailTable> {
    let mut best = None;
    let mut most = 0;
    for table in tables {
        let known = rails.iter().filter(|rail| table.knows(&rail.name)).count();
        if known > most {
            best = Some(table);
            most = known;
        }
    }
    best
}

/// Returns the first input rail that shows power. No machine runs on nothing: a rail that shows none is not connected.
fn live_input<'a>(table: &'a RailTable, rails: &[RailWatts]) -> Option<&'a str> {
    table
        .input
        .iter()
        .map(String::as_str)
        .find(|name| watts_of(rails, name).is_some_and(|watts| watts > 0.0))
}

/// The power of a rail, if it was read.
fn watts_of(rails: &[RailWatts], name: &str) -> Option<f64> {
    let rail = rails.iter().find(|rail| &*rail.name == name)?;
    Some(rail.watts.max(0.0))
}

/// The power of these rails together; `None` if one of them was not read, or there are none.
fn sum_of(rails: &[RailWatts], names: &[String]) -> Option<f64> {
    if names.is_empty() {
        return None;
    }
    names.iter().map(|name| watts_of(rails, name)).sum()
}

fn sum_of_all(rails: &[RailWatts]) -> Option<f64> {
    if rails.is_empty() {
        return None;
    }
    Some(rails.iter().map(|rail| rail.watts.max(0.0)).sum())
}

/// The tables of `boards.toml`.
fn built_in() -> Result<Vec<RailTable>, MeterError> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Boards {
        board: Vec<RailTable>,
    }
    let boards: Boards = toml::from_str(include_str!("boards.toml"))
        .map_err(|error| MeterError::Failed(format!("boards.toml: {error}")))?;
    Ok(boards.board)
}

#[cfg(test)]
mod tests;
