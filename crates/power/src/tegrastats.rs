//! NVIDIA's `tegrastats`, the meter every Jetson has, as a supervised child process (JetPack 4 to 7).
//!
//! On several releases it prints the power rails to root only: then `power.tegrastats` names a script that runs it by
//! `exec sudo -n`, which never asks for a password; a rule in sudoers must allow it.

mod line;

pub use line::TegrastatsLine;

use crate::child::LineChild;
use crate::condition::Condition;
use crate::config::PowerConfig;
use crate::error::MeterError;
use crate::meter::Meter;
use crate::rails::RailMap;
use crate::reading::Reading;
use crate::sysfs;
use std::path::PathBuf;
use std::time::Duration;
use tokio::time::Instant;

const SOURCE: &str = "tegrastats";

/// How long the first line may take.
const FIRST_LINE: Duration = Duration::from_secs(5);

/// A child that prints nothing for this long, and for 20 intervals, is started again.
const SILENCE: Duration = Duration::from_secs(5);

/// `tegrastats`, running.
#[derive(Debug)]
pub struct Tegrastats {
    child: LineChild,
    map: RailMap,
    program: PathBuf,
    procfs: PathBuf,
    longest_silence: Duration,
    newest: Instant,
    condition: Condition,
}

impl Tegrastats {
    /// Starts it and waits for its first line.
    ///
    /// # Errors
    /// [`MeterError::Missing`] where there is no such program, [`MeterError::Permission`] when it prints
    /// no rails for this user, [`MeterError::Unreadable`] when no line of it can be understood.
    pub fn open(config: &PowerConfig) -> Result<Self, MeterError> {
        config.check()?;
        let interval = config.interval_ms.to_string();
        let program = config.tegrastats.clone();
        let arguments = ["--interval".to_owned(), interval];
        let child = LineChild::start(&program, &arguments).map_err(|error| match error.kind() {
            std::io::ErrorKind::NotFound => MeterError::Missing {
                source_name: SOURCE,
                reason: format!("no program `{}` (Jetson boards have it)", program.display()),
            },
            _ => sysfs::failure(SOURCE, &program, &error),
        })?;
        let mut meter = Self {
            child,
            map: RailMap::new(config.rails.as_ref())?,
            program,
            procfs: config.procfs.clone(),
            longest_silence: SILENCE.max(Duration::from_millis(20 * config.interval_ms)),
            newest: Instant::now(),
            condition: Condition::default(),
        };
        meter.first_line()?;
        Ok(meter)
    }

    fn first_line(&mut self) -> Result<(), MeterError> {
        let Some(line) = self.child.first_line(FIRST_LINE) else {
            let why = self.child.trouble().unwrap_or("it prints nothing");
            return Err(self.unreadable(why.to_owned()));
        };
        let Some(line) = TegrastatsLine::parse(&line) else {
            return Err(self.unreadable("it does not print lines of tegrastats".to_owned()));
        };
        if line.rails.is_empty() {
            return Err(MeterError::Permission {
                source_name: SOURCE,
                path: self.program.clone(),
                remedy: "it prints no power rails for this user; run as root, or let power.tegrastats name a script \
                         that runs `exec sudo -n tegrastats \"$@\"`, allowed in sudoers without a password"
                    .to_owned(),
            });
        }
        self.condition = line.condition();
        Ok(())
    }

    fn unreadable(&self, reason: String) -> MeterError {
        MeterError::Unreadable {
            source_name: SOURCE,
            path: self.program.clone(),
            reason,
        }
    }
}

impl Meter for Tegrastats {
    fn source(&self) -> &str {
        SOURCE
    }

    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError> {
        let mut readings = Vec::new();
        for (at, text) in self.child.take(self.longest_silence) {
            let Some(line) = TegrastatsLine::parse(&text) else {
                continue;
            };
            self.newest = at;
            self.condition = line.condition();
            if !line.rails.is_empty() {
                let mut reading = self.map.reading(&line.rails);
                reading.at = Some(at);
                readings.push(reading);
            }
        }
        let silent = now.saturating_duration_since(self.newest);
        if readings.is_empty() && silent > Duration::from_secs(1) {
            let why = self.child.trouble().unwrap_or("it stalls");
            let text = format!("no line for {:.1} s: {why}", silent.as_secs_f64());
            return Err(self.unreadable(text));
        }
        Ok(readings)
    }

    fn condition(&mut self) -> Condition {
        self.condition.clone()
    }

    /// That of the program since its last start.
    fn other_cpu(&self) -> Duration {
        let program = self.child.process().and_then(|process| {
            let stat = self.procfs.join(process.to_string()).join("stat");
            cpu_of(&std::fs::read_to_string(stat).ok()?)
        });
        program.unwrap_or_default()
    }
}

/// User and system time in `/proc/PID/stat` (fields 14 and 15, in ticks of 10 ms).
fn cpu_of(stat: &str) -> Option<Duration> {
    let (_, after_name) = stat.rsplit_once(')')?;
    let mut fields = after_name.split_ascii_whitespace().skip(11);
    let user: u64 = fields.next()?.parse().ok()?;
    let system: u64 = fields.next()?.parse().ok()?;
    Some(Duration::from_millis(10 * (user + system)))
}
