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
    begun: Instant,
    /// Its processor time until then, seconds, if it could be read.
    cpu_s: Option<f64>,
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
            begun: Instant::now(),
            cpu_s: read(pid).ok().map(|(cpu_s, ..)| cpu_s),
        }
    }

    /// The cost until now.
    pub(crate) fn cost(&self) -> ProcessCost {
        let (now, seconds) = (read(self.pid).ok(), self.begun.elapsed().as_secs_f64());
        let used = now.zip(self.cpu_s).map(|(now, before)| now.0 - before);
        ProcessCost {
            name: self.name.clone(),
            cores: used.map(|used| used / seconds),
            resident: now.map(|now| now.1),
            largest: now.map(|now| now.2),
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

/// Returns the processor time of a process in seconds, and its present and largest resident memory in bytes.
fn read(pid: u32) -> ProcResult<(f64, u64, u64)> {
    let process = procfs::process::Process::new(pid.cast_signed())?;
    let (stat, status) = (process.stat()?, process.status()?);
    let bytes = |kib: Option<u64>| kib.unwrap_or(0) * 1024;
    let cpu_s = (stat.utime + stat.stime) as f64 / ticks_per_second() as f64;
    Ok((cpu_s, bytes(status.vmrss), bytes(status.vmhwm)))
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
