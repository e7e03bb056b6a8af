//! A reading of a power meter: watts or joules by domain and rail.

use std::borrow::Cow;
use std::sync::Arc;
use tokio::time::Instant;

/// [`Reading::total_from`] of a total that one rail or counter reads for the whole board.
pub(crate) const INPUT_RAIL: &str = "input_rail";

/// [`Reading::total_from`] of a total that was added up.
pub(crate) const SUM_OF_RAILS: &str = "sum_of_rails";

/// A part of the board whose energy is reported by itself (paper: total, GPU, CPU, IO and memory).
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

/// What is read of one domain or rail. Power and energy are integrated differently.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// Power at the time of the sample, watts.
    Power(f64),
    /// Energy counted since the meter was opened, joules; never falls.
    Counter(f64),
}

impl Value {
    /// The power, if that is what was read, watts.
    pub const fn watts(self) -> Option<f64> {
        match self {
            Self::Power(watts) => Some(watts),
            Self::Counter(_) => None,
        }
    }

    /// Mean power from `before`, read `seconds` earlier, until this; of power, what was read last.
    pub(crate) fn mean_watts(self, before: Option<Self>, seconds: f64) -> Option<f64> {
        match (before, self) {
            (_, Self::Power(watts)) => Some(watts),
            (Some(Self::Counter(then)), Self::Counter(now)) if seconds > 0.0 => {
                Some((now - then) / seconds)
            }
            _ => None,
        }
    }
}

/// The values of one sample, in the order of [`Domain::ALL`]; none for a domain that the source does not read.
pub type Values = [Option<Value>; Domain::ALL.len()];

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
    pub total_from: Cow<'static, str>,
    /// Rail by rail, for people.
    pub rails: Vec<Rail>,
}

impl Reading {
    /// The value of `domain`.
    pub fn value(&self, domain: Domain) -> Option<Value> {
        self.values.get(domain as usize).copied().flatten()
    }
}
