//! The board's power mode. Asking for it may start a program that takes its time, so it is asked beside the loop that
//! reads the meter: a reading that comes late would leave a hole in the energy of clips.

use super::super::sysfs;
use super::SOURCE;
use parking_lot::Mutex;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// Time between two questions.
const ASK_EVERY: Duration = Duration::from_secs(60);

/// How long `nvpmodel -q` may take.
const PATIENCE: Duration = Duration::from_secs(2);

/// Asks for the power mode once a minute, and knows the last answer.
#[derive(Debug)]
pub(super) struct ModeQuestion {
    known: Arc<Mutex<Known>>,
    profile: Arc<Path>,
    asked: Instant,
    #[cfg(test)]
    pub(super) asking: Option<std::thread::JoinHandle<()>>,
}

#[derive(Debug)]
struct Known {
    /// Absent where it has no answer for us: no program is started every minute for nothing.
    nvpmodel: Option<PathBuf>,
    mode: Option<Arc<str>>,
    /// A thread is asking.
    asking: bool,
}

impl ModeQuestion {
    /// Asks `nvpmodel`, and reads the file `profile` where that has no answer. The first time it waits: nothing is
    /// measured yet.
    pub(super) fn new(nvpmodel: &Path, profile: PathBuf) -> Self {
        let told = ask_nvpmodel(nvpmodel).ok().flatten();
        Self {
            known: Arc::new(Mutex::new(Known {
                nvpmodel: told.is_some().then(|| nvpmodel.to_owned()),
                mode: mode_of(told, &profile),
                asking: false,
            })),
            profile: profile.into(),
            asked: Instant::now(),
            #[cfg(test)]
            asking: None,
        }
    }

    /// The last answer. Never waits for the next.
    pub(super) fn answer(&mut self, now: Instant) -> Option<Arc<str>> {
        let mut known = self.known.lock();
        if !known.asking && now.saturating_duration_since(self.asked) >= ASK_EVERY {
            self.asked = now;
            known.asking = true;
            let (answer, profile) = (Arc::clone(&self.known), Arc::clone(&self.profile));
            let thread = std::thread::Builder::new()
                .name("power-mode".to_owned())
                .spawn(move || ask(&answer, &profile));
            known.asking = thread.is_ok();
            #[cfg(test)]
            {
                self.asking = thread.ok();
            }
        }
        known.mode.clone()
    }
}

fn ask(known: &Mutex<Known>, profile: &Path) {
    let program = known.lock().nvpmodel.clone();
    let told = program.and_then(|program| ask_nvpmodel(&program).ok().flatten());
    let mode = mode_of(told, profile);
    let mut known = known.lock();
    known.mode = mode;
    known.asking = false;
}

fn mode_of(told: Option<String>, profile: &Path) -> Option<Arc<str>> {
    told.or_else(|| sysfs::text(SOURCE, profile).ok())
        .filter(|mode| !mode.is_empty())
        .map(Into::into)
}

/// Asks `nvpmodel -q`, and stops waiting after a while.
fn ask_nvpmodel(program: &Path) -> std::io::Result<Option<String>> {
    let mut child = Command::new(program)
        .arg("-q")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()?;
    let given_up = std::time::Instant::now() + PATIENCE;
    while child.try_wait()?.is_none() {
        if std::time::Instant::now() > given_up {
            child.kill()?;
            child.wait()?;
            return Ok(None);
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let output = child.wait_with_output()?;
    Ok(mode_in(&String::from_utf8_lossy(&output.stdout)))
}

/// The mode in the output of `nvpmodel -q`: `NV Power Mode: MODE_30W`, then its number.
fn mode_in(output: &str) -> Option<String> {
    output
        .lines()
        .find_map(|line| line.trim().strip_prefix("NV Power Mode:"))
        .map(|mode| mode.trim().to_owned())
}
