//! Processor time and memory of processes, as the kernel reports them.

use rustix::param::{clock_ticks_per_second, page_size};
use serde::Serialize;
use std::fmt;
use std::time::Instant;

/// A process whose cost is followed.
#[derive(Debug)]
pub(crate) struct Process {
    pub(crate) name: String,
    pid: u32,
    first: Option<Sample>,
    last: Option<Sample>,
    largest: u64,
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    at: Instant,
    cpu_s: f64,
    resident: u64,
}

/// What a process cost.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ProcessCost {
    /// Its name in the table.
    pub name: String,
    /// Mean processor time, share of one core, since its first sample; absent when it could not be read.
    pub cores: Option<f64>,
    /// Resident memory now, bytes.
    pub resident: Option<u64>,
    /// Largest resident memory seen, bytes.
    pub largest: Option<u64>,
}

impl Process {
    pub(crate) fn new(name: impl Into<String>, pid: u32) -> Self {
        Self {
            name: name.into(),
            pid,
            first: None,
            last: None,
            largest: 0,
        }
    }

    /// Reads it. Returns the share of a core since the last time.
    pub(crate) fn sample(&mut self) -> Option<f64> {
        let sample = read(self.pid)?;
        self.largest = self.largest.max(sample.resident);
        let before = self.last.replace(sample).or(self.first);
        self.first.get_or_insert(sample);
        before.and_then(|before| share(before, sample))
    }

    /// Counting begins now, so that starting up is not counted.
    pub(crate) fn begin(&mut self) {
        self.first = read(self.pid);
        self.last = self.first;
    }

    pub(crate) fn cost(&self) -> ProcessCost {
        let both = self.first.zip(self.last);
        ProcessCost {
            name: self.name.clone(),
            cores: both.and_then(|(first, last)| share(first, last)),
            resident: self.last.map(|s| s.resident),
            largest: self.last.map(|_| self.largest),
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

fn share(before: Sample, after: Sample) -> Option<f64> {
    let seconds = (after.at - before.at).as_secs_f64();
    (seconds > 0.0).then(|| (after.cpu_s - before.cpu_s) / seconds)
}

fn read(pid: u32) -> Option<Sample> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The name is in brackets and may have anything in it.
    let (_, fields) = stat.rsplit_once(')')?;
    let fields: Vec<u64> = fields
        .split_whitespace()
        .map(|f| f.parse().unwrap_or(0))
        .collect();
    // proc_pid_stat(5): utime 14, stime 15, rss 24; the third field is the first here.
    let ticks = fields.get(11)? + fields.get(12)?;
    Some(Sample {
        at: Instant::now(),
        cpu_s: ticks as f64 / clock_ticks_per_second() as f64,
        resident: fields.get(21)? * page_size() as u64,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cost_of_this_process_can_be_read_and_that_of_none_is_absent() {
        let mut own = Process::new("own", std::process::id());
        own.begin();
        let mut spent = 0u64;
        let until = Instant::now() + std::time::Duration::from_millis(60);
        while Instant::now() < until {
            spent = spent.wrapping_mul(31).wrapping_add(7);
        }
        assert_ne!(spent, 1);
        own.sample();
        let cost = own.cost();
        assert!(cost.cores.unwrap() > 0.05, "{cost:?}");
        assert!(cost.resident.unwrap() > 1 << 20 && cost.largest >= cost.resident);
        let mut none = Process::new("none", u32::MAX);
        none.begin();
        assert_eq!((none.sample(), none.cost().cores), (None, None));
    }
}
