//! Measures processor time and memory of processes, as the kernel reports them.

use procfs::{ProcResult, ticks_per_second};
use serde::Serialize;
use std::fmt;
use std::time::Instant;

/// A process whose cost is measured.
#[derive(Debug)]
pub(crate) struct Process {
    name: String,
    pid: u32,
    first: Option<Sample>,
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    at: Instant,
    cpu_s: f64,
    resident: u64,
    largest: u64,
}

/// The cost of a process.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ProcessCost {
    /// Its name in the table.
    pub name: String,
    /// Mean processor time since the first sample, as a share of one core; absent if it could not be read.
    pub cores: Option<f64>,
    /// Present resident memory, bytes.
    pub resident: Option<u64>,
    /// Largest resident memory since the process started, bytes.
    pub largest: Option<u64>,
}

impl Process {
    /// Starts counting now, so that the start-up is not counted.
    pub(crate) fn begin(name: impl Into<String>, pid: u32) -> Self {
        Self {
            name: name.into(),
            pid,
            first: read(pid).ok(),
        }
    }

    /// The cost until now.
    pub(crate) fn cost(&self) -> ProcessCost {
        let last = read(self.pid).ok();
        let share = |(first, last): (Sample, Sample)| {
            let seconds = (last.at - first.at).as_secs_f64();
            (seconds > 0.0).then(|| (last.cpu_s - first.cpu_s) / seconds)
        };
        ProcessCost {
            name: self.name.clone(),
            cores: self.first.zip(last).and_then(share),
            resident: last.map(|s| s.resident),
            largest: last.map(|s| s.largest),
        }
    }
}

impl fmt::Display for ProcessCost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = self.cores.map_or(f64::NAN, |cores| cores * 100.0);
        let megabytes = |bytes: Option<u64>| bytes.map_or(f64::NAN, |bytes| bytes as f64 / 1e6);
        let (now, largest) = (megabytes(self.resident), megabytes(self.largest));
        let name = &self.name;
        write!(
            f,
            "{name:<16} {percent:.1} % of a core, {now:.0} MB, at most {largest:.0} MB"
        )
    }
}

fn read(pid: u32) -> ProcResult<Sample> {
    let process = procfs::process::Process::new(pid.cast_signed())?;
    let (stat, status) = (process.stat()?, process.status()?);
    let bytes = |kib: Option<u64>| kib.unwrap_or(0) * 1024;
    Ok(Sample {
        at: Instant::now(),
        cpu_s: (stat.utime + stat.stime) as f64 / ticks_per_second() as f64,
        resident: bytes(status.vmrss),
        largest: bytes(status.vmhwm),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cost_is_measured_for_this_process_and_absent_for_a_missing_one() {
        let own = Process::begin("own", std::process::id());
        let until = Instant::now() + std::time::Duration::from_millis(60);
        while Instant::now() < until {}
        let cost = own.cost();
        assert!(cost.cores.unwrap() > 0.05, "{cost:?}");
        assert!(cost.resident.unwrap() > 1 << 20 && cost.largest >= cost.resident);
        let none = Process::begin("none", u32::MAX);
        assert_eq!((none.cost().cores, none.cost().resident), (None, None));
    }
}
