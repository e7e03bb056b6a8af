//! What a power meter reads: watts and joules, by domain and rail by rail.

use std::sync::Arc;
use tokio::time::Instant;

/// [`Reading::total_from`] of a total that one rail or counter tells for the whole board.
pub const INPUT_RAIL: &str = "input_rail";

/// [`Reading::total_from`] of a total that was added up.
pub const SUM_OF_RAILS: &str = "sum_of_rails";

/// A part of the board whose energy is told apart (paper: total, GPU, CPU, IO and memory).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Domain {
    /// The whole board, as far as the source sees it.
    Total,
    /// The graphics processor.
    Gpu,
    /// The processor cores.
    Cpu,
    /// Memory, input and output.
    IoMem,
}

impl Domain {
    /// All four, in the order they are reported.
    pub const ALL: [Self; 4] = [Self::Total, Self::Gpu, Self::Cpu, Self::IoMem];

    /// The name on the wire.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Total => "total",
            Self::Gpu => "gpu",
            Self::Cpu => "cpu",
            Self::IoMem => "io_mem",
        }
    }
}

/// What one sample says of one domain. A domain may be the sum of devices that tell power and devices
/// that count energy; the two are kept apart because they are integrated differently.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Value {
    /// Power at the time of the sample, watts.
    pub watts: Option<f64>,
    /// Energy counted since the meter was opened, joules; never falls.
    pub joules: Option<f64>,
}

impl Value {
    /// A power reading.
    pub const fn power(watts: f64) -> Self {
        Self {
            watts: Some(watts),
            joules: None,
        }
    }

    /// An energy counter.
    pub const fn counter(joules: f64) -> Self {
        Self {
            watts: None,
            joules: Some(joules),
        }
    }

    /// The sum of two domains' values.
    pub fn plus(self, other: Self) -> Self {
        let sum = |a: Option<f64>, b: Option<f64>| match (a, b) {
            (Some(a), Some(b)) => Some(a + b),
            (one, None) | (None, one) => one,
        };
        Self {
            watts: sum(self.watts, other.watts),
            joules: sum(self.joules, other.joules),
        }
    }
}

/// The values of one sample, in the order of [`Domain::ALL`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Values([Value; 4]);

impl Values {
    /// The value of `domain`; empty where the source does not tell it.
    pub const fn get(&self, domain: Domain) -> Value {
        self.0[domain as usize]
    }

    /// Sets the value of `domain`.
    pub const fn set(&mut self, domain: Domain, value: Value) {
        self.0[domain as usize] = value;
    }

    /// Adds `value` to `domain`.
    pub fn add(&mut self, domain: Domain, value: Value) {
        self.set(domain, self.get(domain).plus(value));
    }
}

/// One rail, counter or device as the source names it.
#[derive(Clone, Debug, PartialEq)]
pub struct Rail {
    /// The name: `VDD_IN`, `package-0`, …
    pub name: Arc<str>,
    /// The domain it is counted in besides the total, if any.
    pub domain: Option<Domain>,
    /// Whether it is added up into the total.
    pub in_total: bool,
    /// What it reads.
    pub value: Value,
}

/// What a meter has read.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// When, if the meter knows better than its caller (readings that a child process delivers).
    pub at: Option<Instant>,
    /// By domain.
    pub values: Values,
    /// How the total came about: `input_rail`, `sum_of_rails`, or a formula in words.
    pub total_from: Arc<str>,
    /// Rail by rail, for people.
    pub rails: Vec<Rail>,
}
