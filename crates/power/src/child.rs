//! A supervised child process that prints lines: started again when it ends or stalls, killed and reaped
//! with its owner.
//!
//! The child has a process group of its own, so that Ctrl-C in a terminal does not end it before us. If
//! this process is killed outright, the child ends at the next line it prints, by the closed pipe.

use parking_lot::{Condvar, Mutex};
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::time::Instant;

/// Lines kept for a reader who does not come; the oldest go first.
const MOST_LINES: usize = 256;

/// A longer line is cut here: no source of ours prints one.
const LONGEST_LINE: u64 = 64 * 1024;

/// Pause before the child is started again; doubled up to the longest while it keeps ending at once.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
const LONGEST_PAUSE: Duration = Duration::from_secs(10);

/// A child that lived this long ended for another reason than the one before.
const LIVED: Duration = Duration::from_secs(10);

/// How long an owner who goes waits for the child to be reaped.
const PARTING: Duration = Duration::from_secs(1);

#[derive(Debug, Default)]
struct State {
    stopping: bool,
    child: Option<Child>,
    lines: VecDeque<(Instant, String)>,
    last_sign: Option<Instant>,
    trouble: Option<String>,
}

#[derive(Debug, Default)]
struct ChildState {
    state: Mutex<State>,
    changed: Condvar,
    starts: AtomicU64,
    cpu_ns: AtomicU64,
}

/// The child and the thread that reads it.
#[derive(Debug)]
pub(super) struct LineChild {
    shared: Arc<ChildState>,
    reader: Option<JoinHandle<()>>,
}

impl LineChild {
    /// Starts `program` with `arguments`.
    ///
    /// # Errors
    /// When it cannot be started the first time.
    pub(super) fn start(program: &std::path::Path, arguments: &[String]) -> std::io::Result<Self> {
        let shared = Arc::new(ChildState::default());
        let mut command = Command::new(program);
        command
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .process_group(0);
        let first = spawn(&mut command, &shared)?;
        let reader = std::thread::Builder::new()
            .name("power-child".to_owned())
            .spawn({
                let shared = Arc::clone(&shared);
                move || supervise(&shared, command, first)
            })?;
        Ok(Self {
            shared,
            reader: Some(reader),
        })
    }

    /// The lines since the last call, each with the time it came.
    pub(super) fn take(&self) -> Vec<(Instant, String)> {
        self.shared.state.lock().lines.drain(..).collect()
    }

    /// Waits up to `patience` for a line, and says whether there is one. It stays to be taken.
    pub(super) fn wait_for_line(&self, patience: Duration) -> bool {
        let mut state = self.shared.state.lock();
        self.shared
            .changed
            .wait_while_for(&mut state, |s| s.lines.is_empty(), patience);
        !state.lines.is_empty()
    }

    /// Kills a child that has given no sign for `longest`, so that it is started again.
    pub(super) fn kill_if_silent(&self, now: Instant, longest: Duration) {
        let mut state = self.shared.state.lock();
        let silent = state
            .last_sign
            .is_some_and(|sign| now.saturating_duration_since(sign) > longest);
        if silent && let Some(child) = &mut state.child {
            // It fails only when the child has just ended, or is another user's (sudo).
            let _ = child.kill();
            state.last_sign = Some(now);
            state.trouble = Some(format!("it printed nothing for {} s", longest.as_secs()));
        }
    }

    /// Why it last ended, if it ever did.
    pub(super) fn trouble(&self) -> Option<String> {
        self.shared.state.lock().trouble.clone()
    }

    /// How often it was started.
    pub(super) fn starts(&self) -> u64 {
        self.shared.starts.load(Ordering::Relaxed)
    }

    /// The process now running.
    pub(super) fn process(&self) -> Option<u32> {
        self.shared.state.lock().child.as_ref().map(Child::id)
    }

    /// CPU time of the thread that reads it.
    pub(super) fn reader_cpu(&self) -> Duration {
        Duration::from_nanos(self.shared.cpu_ns.load(Ordering::Relaxed))
    }
}

impl Drop for LineChild {
    fn drop(&mut self) {
        {
            let mut state = self.shared.state.lock();
            state.stopping = true;
            if let Some(child) = &mut state.child {
                let _ = child.kill();
            }
        }
        self.shared.changed.notify_all();
        // The reader reaps the child. It is waited for, but not for ever: a child of another user (sudo)
        // that prints nothing can be neither killed nor read.
        let Some(reader) = self.reader.take() else {
            return;
        };
        let given_up = std::time::Instant::now() + PARTING;
        while !reader.is_finished() && std::time::Instant::now() < given_up {
            std::thread::sleep(Duration::from_millis(2));
        }
        if reader.is_finished() {
            let _ = reader.join();
        } else {
            tracing::warn!(
                "a child process of the power meter does not end; it will at its next line"
            );
        }
    }
}

fn spawn(command: &mut Command, shared: &ChildState) -> std::io::Result<Option<ChildStdout>> {
    let mut child = command.spawn()?;
    shared.starts.fetch_add(1, Ordering::Relaxed);
    let output = child.stdout.take();
    let mut state = shared.state.lock();
    if state.stopping {
        let _ = child.kill();
    }
    state.child = Some(child);
    state.last_sign = Some(Instant::now());
    Ok(output)
}

fn supervise(shared: &ChildState, mut command: Command, first: Option<ChildStdout>) {
    let mut pause = FIRST_PAUSE;
    let mut output = first;
    loop {
        let started = std::time::Instant::now();
        if let Some(output) = output.take() {
            read(shared, output);
        }
        // The pipe is closed by now, so a child that still lives and cannot be killed (sudo) ends at its
        // next line.
        let child = shared.state.lock().child.take();
        let reaped = child.map(|mut child| {
            let _ = child.kill();
            child.wait()
        });
        let ended = match reaped {
            Some(Ok(status)) => format!("it ended with {status}"),
            Some(Err(error)) => format!("it cannot be waited for: {error}"),
            None => "it did not start".to_owned(),
        };
        pause = if started.elapsed() > LIVED {
            FIRST_PAUSE
        } else {
            pause
        };
        let mut state = shared.state.lock();
        shared
            .changed
            .wait_while_for(&mut state, |s| !s.stopping, pause);
        if state.stopping {
            return;
        }
        tracing::warn!(
            reason = ended,
            "the power meter's child process is started again"
        );
        state.trouble = Some(ended);
        drop(state);
        pause = (pause * 2).min(LONGEST_PAUSE);
        match spawn(&mut command, shared) {
            Ok(next) => output = next,
            Err(error) => {
                shared.state.lock().trouble = Some(format!("it cannot be started: {error}"))
            }
        }
    }
}

/// Reads until the child closes its output or the owner goes.
fn read(shared: &ChildState, output: ChildStdout) {
    let mut output = BufReader::new(output);
    let mut line = Vec::new();
    loop {
        line.clear();
        let read = output
            .by_ref()
            .take(LONGEST_LINE)
            .read_until(b'\n', &mut line);
        let at = Instant::now();
        if !matches!(read, Ok(1..)) {
            return;
        }
        // A line without its end was cut off when the child died; its last number may be too.
        if line.pop() == Some(b'\n') {
            let mut state = shared.state.lock();
            state.last_sign = Some(at);
            if state.lines.len() == MOST_LINES {
                state.lines.pop_front();
            }
            state
                .lines
                .push_back((at, String::from_utf8_lossy(&line).into_owned()));
            if state.stopping {
                return;
            }
            drop(state);
            shared.changed.notify_all();
        }
        let cpu = super::cost::thread_cpu();
        shared.cpu_ns.store(
            u64::try_from(cpu.as_nanos()).unwrap_or(u64::MAX),
            Ordering::Relaxed,
        );
    }
}

#[cfg(test)]
mod tests;
