//! A child process that prints lines: restarted when it ends or stalls, killed and reaped on drop.
//!
//! The child has its own process group, so Ctrl-C in a terminal does not end it before us. If this process is killed,
//! the child ends at the next line it prints, because the pipe is closed.

use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, ChildStderr, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::time::Duration;
use tokio::time::Instant;

/// The most lines kept for a slow reader; further lines are dropped.
const MOST_LINES: usize = 256;

/// Longer lines are passed over: none of our sources prints one.
const LONGEST_LINE: u64 = 64 * 1024;

/// Of a program that should never end: the least time from its start, or its newest line, to its next start.
pub(super) const PAUSE: Duration = Duration::from_secs(1);

/// The time limit for a killed child to end. Another user's child (sudo) cannot be killed.
const PARTING: Duration = Duration::from_secs(1);

/// The time limit for the last line of the error output of a child that has ended. Its own children may hold it open.
const PARTING_WORDS: Duration = Duration::from_millis(500);

/// The most characters of that line.
const MOST_CHARACTERS: usize = 200;

/// How late a line of a program that prints one in every interval may be: a program may also take longer than asked.
pub(super) fn late_after(least: Duration, interval_ms: u64) -> Duration {
    least.max(Duration::from_millis(3 * interval_ms))
}

type TimedLine = (Instant, String);

/// A child process and the lines that a thread reads from it.
#[derive(Debug)]
pub(crate) struct LineChild {
    command: Command,
    child: Option<Child>,
    lines: Receiver<TimedLine>,
    /// Gets the last line of the error output when that ends.
    last_words: Receiver<String>,
    /// The shortest time between a start or a line and the next start.
    pause: Duration,
    /// The time of the start or of the newest line.
    last_sign: Instant,
    /// True if the child had ended when its lines were last taken: nothing follows these lines.
    pub ended: bool,
    /// What last went wrong: an end with a fault, a silence, or a failed start; `None` after an end without a fault.
    pub trouble: Option<String>,
}

impl LineChild {
    /// Starts `program` with `arguments`.
    ///
    /// # Errors
    /// Returns an error if the program cannot be started the first time.
    pub(crate) fn start(
        program: &Path,
        arguments: &[String],
        pause: Duration,
    ) -> std::io::Result<Self> {
        let mut command = Command::new(program);
        command
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .process_group(0);
        let started = spawn(&mut command)?;
        Ok(Self {
            command,
            child: Some(started.child),
            lines: started.lines,
            last_words: started.last_words,
            pause,
            last_sign: Instant::now(),
            ended: false,
            trouble: None,
        })
    }

    /// Returns the lines since the last call, each with its arrival time. Restarts a child that has ended or has
    /// printed nothing for `longest_silence`.
    pub(crate) fn take(&mut self, longest_silence: Duration) -> Vec<TimedLine> {
        let mut lines = Vec::new();
        let ended = loop {
            match self.lines.try_recv() {
                Ok(line) => lines.push(line),
                Err(error) => break error == TryRecvError::Disconnected,
            }
        };
        if let Some((at, _)) = lines.last() {
            self.last_sign = *at;
        }
        let silent = self.last_sign.elapsed() > longest_silence;
        self.ended = ended;
        if !ended && !silent {
            return lines;
        }
        self.end();
        if silent {
            let seconds = longest_silence.as_secs();
            self.trouble = Some(format!("it printed nothing for {seconds} s"));
        }
        if self.last_sign.elapsed() >= self.pause {
            self.restart();
        }
        lines
    }

    fn restart(&mut self) {
        self.last_sign = Instant::now();
        if let Some(reason) = self.trouble.as_deref() {
            tracing::warn!(reason, "restarting the power meter's child process");
        }
        match spawn(&mut self.command) {
            Ok(started) => {
                self.child = Some(started.child);
                self.lines = started.lines;
                self.last_words = started.last_words;
            }
            Err(error) => self.trouble = Some(format!("it cannot be started: {error}")),
        }
    }

    /// Waits up to `patience` for the first line; if none comes, ends the child.
    pub(crate) fn first_line(&mut self, patience: Duration) -> Option<TimedLine> {
        let line = self.lines.recv_timeout(patience);
        if line.is_err() {
            self.end();
        }
        line.ok()
    }

    /// Kills and reaps the child, if there is one.
    fn end(&mut self) {
        let Some(mut child) = self.child.take() else {
            return;
        };
        // Fails if the child has just ended or belongs to another user.
        let _ = child.kill();
        let until = std::time::Instant::now() + PARTING;
        self.trouble = loop {
            match child.try_wait() {
                Ok(Some(status)) if status.success() => break None,
                Ok(Some(status)) => break Some(self.fault(status)),
                Ok(None) if std::time::Instant::now() < until => {
                    std::thread::sleep(Duration::from_millis(2));
                }
                _ => break Some("it has not ended; it will at its next line".to_owned()),
            }
        };
    }

    /// How the child ended, with the last line of its error output unless it was killed.
    fn fault(&self, status: ExitStatus) -> String {
        let fault = format!("it ended with {status}");
        if status.code().is_none() {
            return fault;
        }
        match self.last_words.recv_timeout(PARTING_WORDS) {
            Ok(words) if !words.is_empty() => format!("{fault}: {words}"),
            _ => fault,
        }
    }

    /// The id of the running process.
    pub(crate) fn process(&self) -> Option<u32> {
        self.child.as_ref().map(Child::id)
    }
}

impl Drop for LineChild {
    fn drop(&mut self) {
        self.end();
    }
}

/// A child that was just started, and what threads read from it.
struct Started {
    child: Child,
    lines: Receiver<TimedLine>,
    last_words: Receiver<String>,
}

fn spawn(command: &mut Command) -> std::io::Result<Started> {
    let mut child = command.spawn()?;
    let (sender, lines) = sync_channel(MOST_LINES);
    if let Some(output) = child.stdout.take() {
        std::thread::Builder::new()
            .name("power-child".to_owned())
            .spawn(move || read(output, &sender))?;
    }
    let (sender, last_words) = sync_channel(1);
    if let Some(errors) = child.stderr.take() {
        std::thread::Builder::new()
            .name("power-errors".to_owned())
            .spawn(move || read_last(errors, &sender))?;
    }
    Ok(Started {
        child,
        lines,
        last_words,
    })
}

/// Reads until the child closes its output or the receiver is dropped.
fn read(output: ChildStdout, lines: &SyncSender<TimedLine>) {
    let mut output = BufReader::new(output);
    let mut line = Vec::new();
    // True until the end of a line whose beginning was too long.
    let mut is_rest = false;
    loop {
        line.clear();
        let read = output.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut line);
        let at = Instant::now();
        // Nothing was read, or it cannot be.
        if !matches!(read, Ok(1..)) {
            return;
        }
        // A line without a newline is too long, or was cut off when the child exited; its last number may be incomplete.
        let is_whole = line.pop() == Some(b'\n');
        if is_whole && !is_rest {
            let text = String::from_utf8_lossy(&line).into_owned();
            if let Err(TrySendError::Disconnected(_)) = lines.try_send((at, text)) {
                return;
            }
        }
        is_rest = !is_whole;
    }
}

/// Reads until the child closes its error output, and sends the last line of it that says something.
fn read_last(errors: ChildStderr, last_words: &SyncSender<String>) {
    let mut errors = BufReader::new(errors);
    let mut line = Vec::new();
    let mut last = String::new();
    loop {
        line.clear();
        let read = errors.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut line);
        if !matches!(read, Ok(1..)) {
            break;
        }
        let text = String::from_utf8_lossy(&line);
        let text = text.trim();
        if !text.is_empty() {
            let printable = text.chars().filter(|character| !character.is_control());
            last = printable.take(MOST_CHARACTERS).collect();
        }
    }
    // Nobody may want it any more.
    let _ = last_words.send(last);
}

#[cfg(test)]
mod tests;
