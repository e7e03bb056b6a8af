//! A program of the user's that prints watts: for boards and plugs that no other meter reads.
//!
//! It prints lines of a name and watts, such as `cpu 3.25`, and after each set of them an empty line, or it ends. A
//! program that has ended is started again for the next reading. The name `total` is the whole machine; without it the
//! lines are added up. The names `gpu`, `cpu` and `io_mem` are also domains, as are rails that `power.rails` names.

use crate::config::PowerConfig;
use crate::error::MeterError;
use crate::rails::{RailMap, RailWatts};
use crate::reading::{Domain, INPUT_RAIL, PerDomain, Rail, Reading, Value};
use crate::source::Meter;
use crate::source::child::{LineChild, late_after};
use crate::source::sysfs;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// The time limit for the first set.
const FIRST_SET: Duration = Duration::from_secs(10);

/// A program that prints nothing for this long is started again.
const SILENCE: Duration = Duration::from_secs(30);

/// A reading that is later than this and than some intervals is an error, which the sampler counts.
const LATE: Duration = Duration::from_secs(5);

/// The most lines of one set.
const MOST_RAILS: usize = 64;

/// The user's program.
#[derive(Debug)]
pub(crate) struct Command {
    child: LineChild,
    /// The user's table of rails; without one, names have their plain meaning.
    map: Option<RailMap>,
    /// The lines of the set that has begun.
    rails: Vec<RailWatts>,
    late: Duration,
    newest: Instant,
}

impl Command {
    /// Starts the program and waits for its first set.
    ///
    /// # Errors
    /// [`MeterError::Missing`] if none is configured; [`MeterError::Failed`] if it prints no set, or a line that is not a
    /// name and watts.
    pub(crate) fn open(config: &PowerConfig) -> Result<Self, MeterError> {
        let Some(command) = &config.command else {
            return Err(MeterError::Missing(
                "power.command names no program".to_owned(),
            ));
        };
        let shell = Path::new("/bin/sh");
        let arguments = ["-c".to_owned(), command.clone()];
        let pause = Duration::from_millis(config.interval_ms);
        let child = LineChild::start(shell, &arguments, pause)
            .map_err(|error| sysfs::failure(shell, &error))?;
        let map = match &config.rails {
            Some(table) => Some(RailMap::new(Some(table))?),
            None => None,
        };
        let mut meter = Self {
            child,
            map,
            rails: Vec::new(),
            late: late_after(LATE, config.interval_ms),
            newest: Instant::now(),
        };
        let began = std::time::Instant::now();
        while meter.take()?.is_empty() {
            if began.elapsed() > FIRST_SET || meter.child.trouble.is_some() {
                return Err(meter.failed("no reading"));
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        Ok(meter)
    }

    /// Returns the sets that are complete, each with the arrival time of its last line.
    fn take(&mut self) -> Result<Vec<Reading>, MeterError> {
        let mut readings = Vec::new();
        for (at, line) in self.child.take(SILENCE) {
            if line.trim().is_empty() {
                readings.extend(self.finished(at)?);
            } else if self.rails.len() < MOST_RAILS {
                self.rails.push(rail(&line)?);
                self.newest = at;
            }
        }
        if self.child.ended {
            readings.extend(self.finished(self.newest)?);
        }
        Ok(readings)
    }

    /// The reading of the set that has ended; `None` if it has no line or no total.
    ///
    /// # Errors
    /// [`MeterError::Failed`] if the total is negative.
    fn finished(&mut self, at: Instant) -> Result<Option<Reading>, MeterError> {
        let rails = std::mem::take(&mut self.rails);
        let mut reading = match &mut self.map {
            Some(map) => map.reading(&rails),
            None => {
                refuse_negative(&rails)?;
                by_name(&rails)
            }
        };
        if reading.value(Domain::Total).is_none() {
            return Ok(None);
        }
        reading.at = Some(at);
        Ok(Some(reading))
    }

    fn failed(&self, what: &str) -> MeterError {
        let lacks = if self.rails.is_empty() {
            "it must print lines such as `total 5.2`, each with its line end"
        } else {
            "it must print an empty line after each reading, or end"
        };
        let why = self.child.trouble.as_deref().unwrap_or(lacks);
        MeterError::Failed(format!("power.command: {what}: {why}"))
    }
}

impl Meter for Command {
    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError> {
        let readings = self.take()?;
        let silent = now.saturating_duration_since(self.newest);
        if readings.is_empty() && silent > self.late {
            let seconds = silent.as_secs_f64();
            return Err(self.failed(&format!("no reading for {seconds:.1} s")));
        }
        Ok(readings)
    }
}

/// The name of the line that is the whole machine.
const WHOLE: &str = "total";

/// The most by which a sensor may be off below zero, watts.
const MOST_OFFSET: f64 = 0.5;

/// The most names that the sum of a set lists.
const MOST_NAMES: usize = 4;

/// Refuses a set whose total is so far below zero that no sensor's offset explains it.
fn refuse_negative(rails: &[RailWatts]) -> Result<(), MeterError> {
    let whole = rails.iter().find(|rail| &*rail.name == WHOLE);
    let watts: f64 = match whole {
        Some(whole) => whole.watts,
        None => rails.iter().map(|rail| rail.watts).sum(),
    };
    if watts >= -MOST_OFFSET {
        return Ok(());
    }
    let what = if whole.is_some() {
        "`total`"
    } else {
        "the sum of its lines"
    };
    Err(MeterError::Failed(format!(
        "power.command: {what} ({watts} W) is negative: change its sign in the command"
    )))
}

/// The reading of a set: `total` is the whole machine, else all lines are added up; `gpu`, `cpu` and `io_mem` are
/// domains.
fn by_name(rails: &[RailWatts]) -> Reading {
    // As for other monitors: no rail returns power, so a negative value is an offset.
    let power = |watts: f64| Value::Power(watts.max(0.0));
    let named = |name: &str| rails.iter().find(|rail| &*rail.name == name);
    let whole = named(WHOLE);
    let total = match whole {
        Some(whole) => Some(power(whole.watts)),
        None if rails.is_empty() => None,
        None => Some(Value::Power(
            rails.iter().map(|rail| rail.watts.max(0.0)).sum(),
        )),
    };
    let names: Vec<&str> = rails.iter().map(|rail| &*rail.name).collect();
    let total_from = if whole.is_some() {
        INPUT_RAIL.to_owned()
    } else if names.len() <= MOST_NAMES {
        names.join(" + ")
    } else {
        format!("{} lines of power.command", names.len())
    };
    let domain_of = |name: &str| {
        [Domain::Gpu, Domain::Cpu, Domain::IoMem]
            .into_iter()
            .find(|domain| domain.as_str() == name)
    };
    let listed = rails.iter().map(|rail| Rail {
        name: Arc::clone(&rail.name),
        domain: domain_of(&rail.name),
        in_total: whole.is_none() || &*rail.name == WHOLE,
        value: Value::Power(rail.watts),
    });
    Reading {
        at: None,
        values: PerDomain::each(|domain| match domain {
            Domain::Total => total,
            part => named(part.as_str()).map(|rail| power(rail.watts)),
        }),
        total_from: total_from.into(),
        rails: listed.collect(),
    }
}

/// A line of a name and watts.
fn rail(line: &str) -> Result<RailWatts, MeterError> {
    parsed(line).ok_or_else(|| {
        let shown: String = line.chars().take(60).collect();
        MeterError::Failed(format!(
            "power.command: `{shown}` is not a name and watts, such as `total 5.2`"
        ))
    })
}

fn parsed(line: &str) -> Option<RailWatts> {
    // A name may have several words.
    let (name, watts) = line.trim().rsplit_once(char::is_whitespace)?;
    let watts: f64 = watts.parse().ok()?;
    if !watts.is_finite() {
        return None;
    }
    Some(RailWatts {
        name: name.trim().into(),
        watts,
    })
}

#[cfg(test)]
mod tests;
