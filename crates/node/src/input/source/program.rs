//! A program that runs and whose output is read: found or named as missing, listened to, and killed with its owner.

use super::address::{AddressError, Secrets};
use parking_lot::Mutex;
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::thread::JoinHandle;

/// Bytes that are read from a program at once: a picture is far more than a pipe holds.
const BUFFER: usize = 1 << 18;

/// Complaints of a program that are kept, and the length of each.
const MOST_COMPLAINTS: usize = 12;
const LONGEST_LINE: u64 = 4096;

/// Why a source cannot be opened. Never tells credentials.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The program that opens it is not installed.
    #[error("{source_name}: {programs} was found. {remedy}")]
    Missing {
        /// The source.
        source_name: String,
        /// What was looked for.
        programs: &'static str,
        /// How to get it.
        remedy: &'static str,
    },
    /// The program cannot be started.
    #[error("`{program}` cannot be started: {error}")]
    NotStarted {
        /// Its name.
        program: String,
        /// Why.
        error: std::io::Error,
    },
    /// A program cannot read it.
    #[error("{source_name}: {program} cannot read it: {reason}")]
    Unreadable {
        /// The source.
        source_name: String,
        /// The program.
        program: &'static str,
        /// What it says.
        reason: String,
    },
    /// The address cannot be used.
    #[error("the source {0}")]
    Address(#[from] AddressError),
    /// The file is not there.
    #[error("{0}: no such file")]
    NoFile(String),
    /// It can be opened only so that its credentials show.
    #[error(
        "{0}: without ffmpeg its password would show in the list of processes: install ffmpeg, or give a GStreamer \
         pipeline of your own"
    )]
    WouldShow(String),
}

/// How to get ffmpeg.
pub(super) const INSTALL_FFMPEG: &str =
    "Install it with `apt-get install ffmpeg`, `dnf install ffmpeg` or `brew install ffmpeg`";
/// How to get GStreamer.
pub(super) const INSTALL_GSTREAMER: &str =
    "Install it with `apt-get install gstreamer1.0-tools gstreamer1.0-plugins-good`";

/// The process, shared with who may end it.
#[derive(Debug, Default)]
struct Slot {
    child: Option<Child>,
    stopped: bool,
}

impl Slot {
    fn kill(&mut self) {
        if let Some(child) = &mut self.child {
            // It fails only when it has ended already.
            let _ = child.kill();
        }
    }
}

/// Ends a program from another thread.
#[derive(Clone, Debug)]
pub struct Stop(Arc<Mutex<Slot>>);

impl Stop {
    /// Ends it; its output ends soon.
    pub fn stop(&self) {
        let mut slot = self.0.lock();
        slot.stopped = true;
        slot.kill();
    }
}

/// What a program says on its error output.
#[derive(Debug, Default)]
struct Said {
    /// Codec of the input, as ffmpeg names it.
    codec: Option<String>,
    complaints: VecDeque<String>,
}

/// A running program.
#[derive(Debug)]
pub struct Running {
    slot: Arc<Mutex<Slot>>,
    output: BufReader<ChildStdout>,
    said: Arc<Mutex<Said>>,
    listener: Option<JoinHandle<()>>,
}

impl Running {
    /// Starts a program; `input` is what it gets to read.
    ///
    /// # Errors
    /// What the system says.
    pub(super) fn start(
        command: &mut Command,
        input: Option<&str>,
        secrets: Secrets,
    ) -> std::io::Result<Self> {
        let stdin = if input.is_some() {
            Stdio::piped()
        } else {
            Stdio::null()
        };
        let mut child = command
            .stdin(stdin)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // Ctrl-C in a terminal is for the owner, who ends it.
            .process_group(0)
            .spawn()?;
        if let (Some(text), Some(mut pipe)) = (input, child.stdin.take()) {
            // A few lines fit into any pipe; a program that has ended says why by itself.
            let _ = pipe.write_all(text.as_bytes());
        }
        let (Some(output), Some(errors)) = (child.stdout.take(), child.stderr.take()) else {
            return Err(std::io::Error::other("it has no output"));
        };
        let said = Arc::new(Mutex::new(Said::default()));
        let heard = Arc::clone(&said);
        let slot = Slot {
            child: Some(child),
            stopped: false,
        };
        let slot = Arc::new(Mutex::new(slot));
        let listener = std::thread::Builder::new()
            .name("source-said".to_owned())
            .spawn(move || listen(errors, &heard, &secrets))
            .inspect_err(|_| Stop(Arc::clone(&slot)).stop())?;
        Ok(Self {
            slot,
            output: BufReader::with_capacity(BUFFER, output),
            said,
            listener: Some(listener),
        })
    }

    /// What it puts out.
    pub fn output(&mut self) -> &mut BufReader<ChildStdout> {
        &mut self.output
    }

    /// How to end it from elsewhere.
    pub fn stop(&self) -> Stop {
        Stop(Arc::clone(&self.slot))
    }

    /// Codec of its input, once it has told it.
    pub(super) fn codec(&self) -> Option<String> {
        self.said.lock().codec.clone()
    }

    /// Its process id.
    #[cfg(test)]
    pub(super) fn process(&self) -> Option<u32> {
        self.slot.lock().child.as_ref().map(Child::id)
    }

    /// Waits for its end, which an output that ended announces, and says how it was: in its own words where it failed.
    ///
    /// # Errors
    /// Why it failed, unless it was stopped.
    pub fn ended(mut self) -> Result<(), String> {
        let (child, stopped) = {
            let mut slot = self.slot.lock();
            (slot.child.take(), slot.stopped)
        };
        let status = child.map(|mut child| child.wait());
        if let Some(listener) = self.listener.take() {
            let _ = listener.join();
        }
        match status {
            Some(Ok(status)) if !status.success() && !stopped => {
                let said = self.said.lock();
                let complaints: Vec<_> = said.complaints.iter().map(String::as_str).collect();
                if complaints.is_empty() {
                    return Err(format!("it ended with {status}"));
                }
                Err(complaints.join("; "))
            }
            Some(Err(error)) => Err(format!("it is lost: {error}")),
            _ => Ok(()),
        }
    }

    /// What it complained of last.
    pub(super) fn last_complaint(&self) -> Option<String> {
        self.said.lock().complaints.back().cloned()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let child = {
            let mut slot = self.slot.lock();
            slot.kill();
            slot.child.take()
        };
        if let Some(mut child) = child {
            // Killed, so it ends.
            let _ = child.wait();
        }
    }
}

/// Runs a program to its end.
///
/// # Errors
/// When it cannot be started.
pub(super) fn output_of(command: &mut Command) -> std::io::Result<std::process::Output> {
    command.stdin(Stdio::null()).output()
}

/// Whether a program is missing and nothing else is wrong.
pub(super) fn is_missing(error: &std::io::Error) -> bool {
    error.kind() == ErrorKind::NotFound
}

/// Reads what a program says, so that it never waits for a reader, and keeps what may be needed.
fn listen(errors: ChildStderr, said: &Mutex<Said>, secrets: &Secrets) {
    let mut errors = BufReader::new(errors);
    let mut line = Vec::new();
    // Behind this word ffmpeg tells of what it makes.
    let mut at_output = false;
    loop {
        line.clear();
        let read = errors
            .by_ref()
            .take(LONGEST_LINE)
            .read_until(b'\n', &mut line);
        if !matches!(read, Ok(1..)) {
            return;
        }
        let text = String::from_utf8_lossy(&line);
        let text = text.trim();
        at_output |= text.contains("Output #") || text.contains("Stream mapping");
        if let Some(complaint) = complaint(text) {
            let complaint = secrets.redact(&complaint);
            tracing::debug!(complaint, "said by the source's program");
            let mut said = said.lock();
            if said.complaints.back() != Some(&complaint) {
                said.complaints.push_back(complaint);
            }
            if said.complaints.len() > MOST_COMPLAINTS {
                said.complaints.pop_front();
            }
        } else if !at_output && let Some(codec) = codec(text) {
            said.lock().codec.get_or_insert(codec);
        }
    }
}

/// What of a line is a complaint: all of it, but for what ffmpeg marks as information (`-v level+info`), and without the
/// addresses in memory that it puts before it.
fn complaint(line: &str) -> Option<String> {
    if line.is_empty() || line.contains("deprecated pixel format") {
        return None;
    }
    let Some(level) = ["[info]", "[verbose]"]
        .iter()
        .find(|level| line.contains(**level))
    else {
        let levels = ["[error]", "[fatal]", "[warning]", "[panic]"];
        let behind = levels
            .iter()
            .find_map(|level| line.split_once(level))
            .map_or(line, |(_, behind)| behind);
        return Some(behind.trim().to_owned());
    };
    // A password may hold any word; only the beginning is ffmpeg's.
    (!line.starts_with(level) && !line.starts_with('[')).then(|| line.to_owned())
}

/// The codec in a line such as `[info]   Stream #0:0: Video: h264 (High), yuv420p`.
fn codec(line: &str) -> Option<String> {
    let (_, video) = line.split_once("Stream #")?.1.split_once("Video: ")?;
    let end = video.find(|c: char| !c.is_ascii_alphanumeric() && c != '_');
    Some(video[..end.unwrap_or(video.len())].to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_codec_and_complaints_are_told_apart_from_chatter() {
        let line = "[info]   Stream #0:0[0x1](und): Video: mjpeg (Baseline), yuvj420p, 25 fps";
        assert_eq!(
            (codec(line).as_deref(), complaint(line)),
            (Some("mjpeg"), None)
        );
        assert_eq!(
            complaint("[rtsp @ 0x5566] [error] method DESCRIBE failed: 401 Unauthorized")
                .as_deref(),
            Some("method DESCRIBE failed: 401 Unauthorized")
        );
        let plain = "ERROR: pipeline could not be constructed";
        assert_eq!(complaint(plain).as_deref(), Some(plain));
    }

    #[test]
    fn a_program_that_fails_is_quoted_without_secrets_and_one_that_is_dropped_is_killed() {
        let address = super::super::SourceAddress::new("rtsp://u:hidden@cam/s");
        let secrets = address.resolved().unwrap().secrets;
        let mut command = Command::new("sh");
        command.args([
            "-c",
            "echo '[error] rtsp://u:hidden@cam: refused' >&2; exit 3",
        ]);
        let mut running = Running::start(&mut command, None, secrets.clone()).unwrap();
        let mut output = Vec::new();
        running.output().read_to_end(&mut output).unwrap();
        let reason = running.ended().unwrap_err();
        assert!(
            reason.contains("refused") && !reason.contains("hidden"),
            "{reason}"
        );

        let mut command = Command::new("sh");
        command.args(["-c", "exec tail -f /dev/null"]);
        let running = Running::start(&mut command, None, secrets).unwrap();
        let process = format!("/proc/{}", running.process().unwrap());
        assert!(std::path::Path::new(&process).exists());
        drop(running);
        assert!(!std::path::Path::new(&process).exists());
    }
}
