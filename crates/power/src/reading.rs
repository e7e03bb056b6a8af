//! A reading of a power meter: watts or joules per domain and rail.

use std::borrow::Cow;
use std::ops::{Index, IndexMut};
use std::sync::Arc;
use tokio::time::Instant;

/// [`Reading::total_from`] if one rail reads the total of the whole machine.
pub(crate) const INPUT_RAIL: &str = "input_rail";

/// [`Reading::total_from`] if the total is a sum.
pub(crate) const SUM_OF_RAILS: &str = "sum_of_rails";

/// A part of the board whose energy is reported separately (paper: total, GPU, CPU, IO and memory).
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
    /// All domains, in the order in which they are reported.
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

/// The value of one domain or rail. Power and energy are integrated differently.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// Power at the time of the sample, watts.
    Power(f64),
    /// Energy counted since the meter was opened, joules; never decreases.
    Counter(f64),
}

impl Value {
    /// Mean power from `before`, read `seconds` earlier, until this value; for a power, the last value.
    pub fn mean_watts(self, before: Option<Self>, seconds: f64) -> Option<f64> {
        match (before, self) {
            (_, Self::Power(watts)) => Some(watts),
            (Some(Self::Counter(then)), Self::Counter(now)) if seconds > 0.0 => {
                Some((now - then) / seconds)
            }
            _ => None,
        }
    }
}

/// One thing for each domain.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PerDomain<T> {
    /// For the whole, as far as the source sees it.
    pub total: T,
    /// For the graphics processor.
    pub gpu: T,
    /// For the processor cores.
    pub cpu: T,
    /// For memory, input and output.
    pub io_mem: T,
}

impl<T> PerDomain<T> {
    /// Returns what `make` returns for each domain, called in the order of [`Domain::ALL`].
    pub fn each(mut make: impl FnMut(Domain) -> T) -> Self {
        Self {
            total: make(Domain::Total),
            gpu: make(Domain::Gpu),
            cpu: make(Domain::Cpu),
            io_mem: make(Domain::IoMem),
        }
    }
}

impl<T> Index<Domain> for PerDomain<T> {
    type Output = T;

    fn index(&self, domain: Domain) -> &T {
        match domain {
            Domain::Total => &self.total,
            Domain::Gpu => &self.gpu,
            Domain::Cpu => &self.cpu,
            Domain::IoMem => &self.io_mem,
        }
    }
}

impl<T> IndexMut<Domain> for PerDomain<T> {
    fn index_mut(&mut self, domain: Domain) -> &mut T {
        match domain {
            Domain::Total => &mut self.total,
            Domain::Gpu => &mut self.gpu,
            Domain::Cpu => &mut self.cpu,
            Domain::IoMem => &mut self.io_mem,
        }
    }
}

/// The values of one sample; `None` for a domain that the source does not read.
pub type Values = PerDomain<Option<Value>>;

/// One rail, counter or device, named as in the source.
#[derive(Clone, Debug, PartialEq)]
pub struct Rail {
    /// The name: `VDD_IN`, `package-0`, …
    pub name: Arc<str>,
    /// The domain that includes it besides the total, if any.
    pub domain: Option<Domain>,
    /// True if it is part of the total.
    pub in_total: bool,
    /// Its value.
    pub value: Value,
}

/// A reading of a meter.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// The time of the reading, if the meter knows it better than its caller (a child process delivers readings).
    pub at: Option<Instant>,
    /// The values by domain.
    pub values: Values,
    /// The origin of the total: `input_rail` for the whole machine, else the parts that are added up, or a formula.
    pub total_from: Cow<'static, str>,
    /// The rails, for human-readable output.
    pub rails: Vec<Rail>,
}

impl Reading {
    /// The value of `domain`.
    pub fn value(&self, domain: Domain) -> Option<Value> {
        self.values[domain]
    }
}
