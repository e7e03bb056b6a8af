//! NVIDIA's `tegrastats`, the meter on every Jetson, as a supervised child process (JetPack 4 to 7).
//!
//! On several releases it prints the power rails only to root. Then `power.tegrastats` names a script that runs it with
//! `exec sudo -n`, which never asks for a password; a sudoers rule must allow it.

mod line;

pub use line::tegrastats_rails;

use crate::config::PowerConfig;
use crate::error::MeterError;
use crate::rails::RailMap;
use crate::reading::Reading;
use crate::source::Meter;
use crate::source::child::{LineChild, PAUSE, late_after};
use crate::source::sysfs;
use procfs::process::Process;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::time::Instant;

/// The time limit for the first line.
const FIRST_LINE: Duration = Duration::from_secs(5);

/// A child that prints nothing for this long and for 20 intervals is restarted.
const SILENCE: Duration = Duration::from_secs(5);

/// A line that is later than this and than some intervals is an error, which the sampler counts.
const LATE: Duration = Duration::from_secs(1);

/// A running `tegrastats`.
#[derive(Debug)]
pub(crate) struct Tegrastats {
    child: LineChild,
    map: RailMap,
    program: PathBuf,
    longest_silence: Duration,
    late: Duration,
    /// The time of the newest line with rails.
    newest: Instant,
    /// True if the newest line had no rails, as after a start without the right to see them.
    lacks_rails: bool,
}

/// Why the program was not started. The search for a name without a folder fails like a program that may not be run if
/// one folder of `PATH` may not be read.
fn not_started(program: &Path, error: &io::Error) -> MeterError {
    let is_searched = program.components().count() == 1;
    if is_searched && error.kind() == io::ErrorKind::PermissionDenied {
        return MeterError::missing(format!(
            "there is no {}, as far as this user may search the folders of PATH",
            program.display()
        ));
    }
    sysfs::failure(program, error)
}

impl Tegrastats {
    /// Starts it and waits for its first line.
    ///
    /// # Errors
    /// [`MeterError::Missing`] if the program does not exist, [`MeterError::Failed`] if its first line cannot be parsed
    /// or it prints no rails for this user.
    pub(crate) fn open(config: &PowerConfig) -> Result<Self, MeterError> {
        let program = config.tegrastats.clone();
        let arguments = ["--interval".to_owned(), config.interval_ms.to_string()];
        let child = LineChild::start(&program, &arguments, PAUSE)
            .map_err(|error| not_started(&program, &error))?;
        let mut meter = Self {
            child,
            map: RailMap::new(config.rails.as_ref())?,
            program,
            longest_silence: SILENCE.max(Duration::from_millis(20 * config.interval_ms)),
            late: late_after(LATE, config.interval_ms),
            newest: Instant::now(),
            lacks_rails: false,
        };
        let Some((at, line)) = meter.child.first_line(FIRST_LINE) else {
            let why = meter.child.trouble.as_deref();
            return Err(meter.unreadable(why.unwrap_or("it ended without printing anything")));
        };
        meter.newest = at;
        let Some(rails) = tegrastats_rails(&line) else {
            return Err(meter.unreadable("its output is not that of tegrastats"));
        };
        if rails.is_empty() {
            let remedy = "it prints no power rails for this user; run as root, or let power.tegrastats name a script \
                          that runs `exec sudo -n tegrastats \"$@\"`, allowed in sudoers without a password";
            return Err(MeterError::forbidden(&meter.program, remedy));
        }
        Ok(meter)
    }

    fn unreadable(&self, reason: &str) -> MeterError {
        MeterError::unreadable(&self.program, reason)
    }
}

impl Meter for Tegrastats {
    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError> {
        let mut readings = Vec::new();
        for (at, text) in self.child.take(self.longest_silence) {
            let Some(rails) = tegrastats_rails(&text) else {
                continue;
            };
            self.lacks_rails = rails.is_empty();
            if self.lacks_rails {
                continue;
            }
            self.newest = at;
            let mut reading = self.map.reading(&rails);
            reading.at = Some(at);
            readings.push(reading);
        }
        let silent = now.saturating_duration_since(self.newest);
        if readings.is_empty() && silent > self.late {
            let why = match self.child.trouble.as_deref() {
                Some(trouble) => trouble,
                None if self.lacks_rails => "its lines have no power rails",
                None => "it stalls or has ended",
            };
            let seconds = silent.as_secs_f64();
            return Err(self.unreadable(&format!("no reading for {seconds:.1} s: {why}")));
        }
        Ok(readings)
    }

    /// CPU time of the program since its last start.
    fn other_cpu(&self) -> Duration {
        self.child.process().and_then(cpu_of).unwrap_or_default()
    }
}

/// CPU time of a process, if the system reports it.
fn cpu_of(process: u32) -> Option<Duration> {
    let process = Process::new(i32::try_from(process).ok()?).ok()?;
    let stat = process.stat().ok()?;
    let ticks = (stat.utime + stat.stime) as f64;
    Some(Duration::from_secs_f64(
        ticks / procfs::ticks_per_second() as f64,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::assert_contains;

    #[test]
    fn a_folder_that_may_not_be_searched_is_no_tegrastats_that_may_not_be_run() {
        let denied = io::ErrorKind::PermissionDenied.into();
        let searched = not_started(Path::new("tegrastats"), &denied);
        assert!(matches!(searched, MeterError::Missing(_)), "{searched}");
        assert_contains(searched, &["there is no tegrastats", "folders of PATH"]);
        let named = not_started(Path::new("/usr/bin/tegrastats"), &denied);
        assert_contains(named, &["may not read /usr/bin/tegrastats", "sudo chmod"]);
    }

    /// A meter whose program prints `lines` and then nothing, asked for a line every `interval_ms`.
    fn meter(folder: &Path, lines: &str, interval_ms: u64) -> Tegrastats {
        let program = folder.join("tegrastats");
        let script = folder.join("script");
        std::fs::write(
            &script,
            format!("#!/bin/sh\nprintf '{lines}'\nexec sleep 60\n"),
        )
        .unwrap();
        // Copied by another program: what this process writes a child of another test may hold open, and it could not start.
        let copied = std::process::Command::new("install")
            .args(["-m", "700"])
            .args([&script, &program])
            .status();
        assert!(copied.unwrap().success());
        let config = PowerConfig {
            tegrastats: program,
            interval_ms,
            ..PowerConfig::default()
        };
        Tegrastats::open(&config).unwrap()
    }

    const WITH_RAILS: &str = r"RAM 1/2MB VDD_IN 5000mW/5000mW\n";

    #[test]
    fn a_line_is_late_after_some_intervals() {
        let folder = tempfile::tempdir().unwrap();
        let mut meter = meter(folder.path(), WITH_RAILS, 2000);
        let at = meter.newest;
        assert!(meter.poll(at + Duration::from_millis(2100)).is_ok());
        let late = meter.poll(at + Duration::from_secs(7)).unwrap_err();
        assert_contains(late, &["no reading for 7.0 s", "stalls or has ended"]);
    }

    #[test]
    fn lines_that_have_no_rails_any_more_are_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let lines = format!(r"{WITH_RAILS}RAM 1/2MB\n");
        let mut meter = meter(folder.path(), &lines, 100);
        let given_up = Instant::now() + Duration::from_secs(20);
        while !meter.lacks_rails {
            assert!(Instant::now() < given_up, "the second line does not come");
            std::thread::sleep(Duration::from_millis(5));
            meter.poll(meter.newest).unwrap();
        }
        let late = meter.poll(meter.newest + Duration::from_secs(2)).unwrap_err();
        assert_contains(late, &["its lines have no power rails"]);
    }
}
