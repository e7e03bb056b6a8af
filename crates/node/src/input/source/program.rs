//! The one way a source is opened: a program that writes pictures to its output. It gets a clean environment and bounded
//! memory, its output is read under a deadline, and it is killed with everything it started.

use super::address::{AddressError, Secrets};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, Resource, Rlimit, Signal, kill_process_group, prlimit};
use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStderr, ChildStdout, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;

/// What a pipe is to hold: a picture has several times as much.
const PIPE_BYTES: usize = 1 << 20;
/// How often a waiting reader checks whether it must stop.
const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// How long a program may take to end by itself once its output has ended, and again after it was killed.
const END_LIMIT: Duration = Duration::from_secs(2);
/// Complaints of a program that are kept, and the length of each.
const MAX_COMPLAINTS: usize = 12;
const MAX_LINE: usize = 4096;

/// What a program gets of this process's environment: where to find libraries, devices and proxies, and no secrets.
const ENVIRONMENT: [&str; 6] = [
    "PATH",
    "HOME",
    "LANG",
    "TMPDIR",
    "XDG_RUNTIME_DIR",
    "LD_LIBRARY_PATH",
];
const ENVIRONMENT_BEGINNINGS: [&str; 4] = ["GST_", "LIBVA_", "CUDA_", "LC_"];
const PROXIES: [&str; 5] = [
    "http_proxy",
    "https_proxy",
    "rtsp_proxy",
    "all_proxy",
    "no_proxy",
];

/// Why a source cannot be opened. Never contains credentials.
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
        program: &'static str,
        /// Why.
        error: io::Error,
    },
    /// The address cannot be used.
    #[error("the source {0}")]
    Address(AddressError),
    /// The file is not there.
    #[error("{0}: no such file")]
    NoFile(String),
    /// It can be opened only so that its credentials show.
    #[error(
        "{0}: without ffmpeg its password would show in the list of processes: install ffmpeg, or give a GStreamer \
         pipeline of your own"
    )]
    WouldShow(String),
    /// The installed ffmpeg takes options for a hidden address on its command line only.
    #[error(
        "{0}: before version 5 ffmpeg takes no options for an address with a password: install a newer one, or leave \
         source_options out"
    )]
    OldFfmpeg(String),
}

impl From<AddressError> for SourceError {
    fn from(error: AddressError) -> Self {
        Self::Address(error)
    }
}

/// A program that writes pictures.
#[derive(Default)]
pub(super) struct PictureProgram {
    /// Its name.
    pub program: &'static str,
    pub arguments: Vec<String>,
    /// What it gets to read.
    pub input: Option<String>,
    /// Whether its pictures are PPM files; else they are the parts of a multipart stream.
    pub ppm: bool,
    /// What is hidden in what it says.
    pub secrets: Secrets,
    /// Most memory it may have, bytes.
    pub max_memory: Option<u64>,
}

/// A program that runs, as its output.
pub(super) struct RunningProgram {
    child: Child,
    output: ChildStdout,
    errors: Option<ChildStderr>,
    stderr: ErrorOutput,
    stop: CancellationToken,
    silence: Duration,
    deadline: Instant,
    status: Option<ExitStatus>,
}

impl PictureProgram {
    /// Starts it. Reading its output fails when `stop` is cancelled, and `silence` after the start or the last
    /// [`RunningProgram::picture_taken`].
    ///
    /// # Errors
    /// What the system says.
    pub(super) fn start(
        self,
        silence: Duration,
        stop: CancellationToken,
    ) -> io::Result<RunningProgram> {
        let mut command = Command::new(self.program);
        command
            .args(&self.arguments)
            .env_clear()
            .envs(std::env::vars_os().filter(|(name, _)| name.to_str().is_some_and(is_passed_on)))
            .stdin(
                self.input
                    .as_ref()
                    .map_or_else(Stdio::null, |_| Stdio::piped()),
            )
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // Ctrl-C in a terminal is for the owner, who ends it.
            .process_group(0);
        let mut child = command.spawn()?;
        if let Some(bytes) = self.max_memory {
            let limit = Rlimit {
                current: Some(bytes),
                maximum: Some(bytes),
            };
            if let Err(error) = prlimit(Some(Pid::from_child(&child)), Resource::Data, limit) {
                tracing::debug!(%error, "the memory of a source's program is not limited");
            }
        }
        if let (Some(text), Some(mut pipe)) = (self.input, child.stdin.take()) {
            // A few lines fit into any pipe; a program that has ended says why by itself.
            let _ = pipe.write_all(text.as_bytes());
        }
        let (Some(output), errors) = (child.stdout.take(), child.stderr.take()) else {
            return Err(io::Error::other("it has no output"));
        };
        // Where the system allows less, the pipe is what it was.
        let _ = rustix::pipe::fcntl_setpipe_size(&output, PIPE_BYTES);
        Ok(RunningProgram {
            child,
            output,
            errors,
            stderr: ErrorOutput {
                secrets: self.secrets,
                ..ErrorOutput::default()
            },
            stop,
            silence,
            deadline: Instant::now() + silence,
            status: None,
        })
    }
}

fn is_passed_on(name: &str) -> bool {
    ENVIRONMENT.contains(&name)
        || ENVIRONMENT_BEGINNINGS
            .iter()
            .any(|begin| name.starts_with(begin))
        || PROXIES.iter().any(|proxy| name.eq_ignore_ascii_case(proxy))
}

impl RunningProgram {
    /// A picture was taken: the next one is waited for from now on.
    pub(super) fn picture_taken(&mut self) {
        self.deadline = Instant::now() + self.silence;
    }

    /// Codec of its input, once it has named it.
    pub(super) fn codec(&self) -> Option<&str> {
        self.stderr.codec.as_deref()
    }

    #[cfg(test)]
    pub(super) fn process(&self) -> u32 {
        self.child.id()
    }

    /// Ends it, and says why it failed: in its own words where it did so by itself.
    ///
    /// # Errors
    /// Why it failed.
    pub(super) fn end(&mut self) -> Result<(), String> {
        self.wait(END_LIMIT);
        let by_itself = self.status;
        self.kill();
        match by_itself {
            Some(status) if !status.success() => Err(self
                .stderr
                .reason()
                .unwrap_or_else(|| format!("it ended with {status}"))),
            _ => Ok(()),
        }
    }

    /// Kills it, and gives its last complaint.
    pub(super) fn abort(&mut self) -> Option<String> {
        self.kill();
        self.stderr.reason()
    }

    /// Waits for its end and the end of what it says.
    fn wait(&mut self, limit: Duration) {
        let until = Instant::now() + limit;
        loop {
            if self.status.is_none() {
                self.status = self.child.try_wait().ok().flatten();
            }
            if (self.status.is_some() && self.errors.is_none()) || Instant::now() >= until {
                return;
            }
            self.listen(Duration::from_millis(10));
        }
    }

    /// Kills it with what it started, and waits, but not for ever: a process that hangs in the kernel is left.
    fn kill(&mut self) {
        if self.status.is_some() && self.errors.is_none() {
            return;
        }
        // It fails when no process is left.
        let _ = kill_process_group(Pid::from_child(&self.child), Signal::KILL);
        self.wait(END_LIMIT);
        if self.status.is_none() {
            tracing::warn!(
                process = self.child.id(),
                "a source's program does not end: it is left"
            );
        }
    }

    /// Reads what it says within `limit`; sleeps once its error output has ended.
    fn listen(&mut self, limit: Duration) {
        let Some(errors) = &mut self.errors else {
            return std::thread::sleep(limit);
        };
        if !is_ready(errors, limit) {
            return;
        }
        let mut bytes = [0; MAX_LINE];
        match errors.read(&mut bytes) {
            Ok(length @ 1..) => self.stderr.take(&bytes[..length]),
            _ => self.errors = None,
        }
    }
}

fn is_ready(pipe: &impl std::os::fd::AsFd, limit: Duration) -> bool {
    let limit = Timespec::try_from(limit).ok();
    poll(&mut [PollFd::new(pipe, PollFlags::IN)], limit.as_ref()).is_ok_and(|ready| ready > 0)
}

/// Its output, as long as it comes in time.
impl Read for RunningProgram {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        loop {
            if self.stop.is_cancelled() {
                return Err(io::Error::new(ErrorKind::ConnectionAborted, "told to stop"));
            }
            let left = self.deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                let seconds = self.silence.as_secs_f64();
                let reason = format!("no picture for more than {seconds} s");
                return Err(io::Error::new(ErrorKind::TimedOut, reason));
            }
            // Its error output comes first: it names the codec before the first picture, and blocks without a reader.
            while self
                .errors
                .as_ref()
                .is_some_and(|errors| is_ready(errors, Duration::ZERO))
            {
                self.listen(Duration::ZERO);
            }
            if is_ready(&self.output, left.min(POLL_INTERVAL)) {
                return self.output.read(bytes);
            }
        }
    }
}

impl Drop for RunningProgram {
    fn drop(&mut self) {
        self.kill();
    }
}

/// What a program says on its error output.
#[derive(Default)]
struct ErrorOutput {
    secrets: Secrets,
    line: Vec<u8>,
    /// Codec of the input, as ffmpeg names it.
    codec: Option<String>,
    complaints: VecDeque<String>,
    /// Behind this ffmpeg speaks of what it makes.
    at_output: bool,
}

impl ErrorOutput {
    fn take(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            if byte != b'\n' && self.line.len() < MAX_LINE {
                self.line.push(byte);
            } else {
                let line = std::mem::take(&mut self.line);
                self.take_line(String::from_utf8_lossy(&line).trim());
            }
        }
    }

    fn take_line(&mut self, text: &str) {
        self.at_output |= text.contains("Output #") || text.contains("Stream mapping");
        if let Some(complaint) = complaint(text) {
            let complaint = self.secrets.redact(&complaint);
            tracing::debug!(complaint, "said by the source's program");
            if !self.complaints.contains(&complaint) {
                self.complaints.push_back(complaint);
            }
            if self.complaints.len() > MAX_COMPLAINTS {
                self.complaints.pop_front();
            }
        } else if !self.at_output && self.codec.is_none() {
            self.codec = codec(text);
        }
    }

    /// Why it failed: what the camera answered, or else its last words.
    fn reason(&mut self) -> Option<String> {
        let rest = std::mem::take(&mut self.line);
        self.take_line(String::from_utf8_lossy(&rest).trim());
        let answer = self
            .complaints
            .iter()
            .find_map(|complaint| refusal(complaint));
        answer.or_else(|| {
            let last = self.complaints.len().saturating_sub(2);
            let last: Vec<_> = self
                .complaints
                .iter()
                .skip(last)
                .map(String::as_str)
                .collect();
            (!last.is_empty()).then(|| last.join("; "))
        })
    }
}

/// The answer of a camera that refuses, such as `401 Unauthorized`.
fn refusal(complaint: &str) -> Option<String> {
    let answers = ["failed: ", "returned ", "HTTP error "]
        .iter()
        .filter_map(|before| complaint.split_once(before));
    answers.map(|(_, answer)| answer).find_map(|answer| {
        let status: u16 = answer.split(' ').next()?.parse().ok()?;
        let answer = answer.split(" (").next()?;
        (400..600).contains(&status).then(|| answer.to_owned())
    })
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

/// What a program puts out when it is run to its end; `None` where it is not there.
///
/// # Errors
/// When it is there and cannot be started.
pub(super) fn output_of(
    program: &'static str,
    argument: &str,
) -> Result<Option<String>, SourceError> {
    let output = Command::new(program)
        .arg(argument)
        .stdin(Stdio::null())
        .output();
    match output {
        Ok(output) => Ok(Some(String::from_utf8_lossy(&output.stdout).into_owned())),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(SourceError::NotStarted { program, error }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    const SILENCE: Duration = Duration::from_secs(20);

    fn shell(script: &str) -> PictureProgram {
        PictureProgram {
            program: "sh",
            arguments: vec!["-c".to_owned(), script.to_owned()],
            ..PictureProgram::default()
        }
    }

    fn start(script: &str) -> RunningProgram {
        shell(script)
            .start(SILENCE, CancellationToken::new())
            .unwrap()
    }

    fn output(running: &mut RunningProgram) -> String {
        let mut output = String::new();
        running.read_to_string(&mut output).unwrap();
        output
    }

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
    fn what_the_camera_answered_is_the_reason() {
        for (complaint, answer) in [
            (
                "method DESCRIBE failed: 401 Unauthorized",
                Some("401 Unauthorized"),
            ),
            (
                "rtsp://cam/s: Server returned 404 Not Found",
                Some("404 Not Found"),
            ),
            (
                "x: Server returned 403 Forbidden (access denied)",
                Some("403 Forbidden"),
            ),
            (
                "HTTP error 503 Service Unavailable",
                Some("503 Service Unavailable"),
            ),
            ("rtsp://cam/s: Connection refused", None),
            ("connect failed: 4", None),
            ("it failed: 40 pictures", None),
        ] {
            assert_eq!(refusal(complaint).as_deref(), answer, "{complaint}");
        }
    }

    #[test]
    fn a_program_that_fails_is_quoted_without_secrets() {
        let address = super::super::SourceAddress::new("rtsp://u:hidden@cam/s");
        let mut program =
            shell("echo a picture; echo '[error] rtsp://u:hidden@cam: refused' >&2; exit 3");
        program.secrets = address.resolved().unwrap().secrets;
        let mut running = program.start(SILENCE, CancellationToken::new()).unwrap();
        assert_eq!(output(&mut running), "a picture\n");
        let reason = running.end().unwrap_err();
        assert!(reason.contains("refused"), "{reason}");
        assert!(!reason.contains("hidden"), "{reason}");
    }

    #[test]
    fn a_program_that_is_dropped_is_killed_with_what_it_started() {
        let mut running = start("sleep 1000 & echo $!; exec tail -f /dev/null");
        let mut child = String::new();
        while !child.ends_with('\n') {
            let mut byte = [0];
            running.read_exact(&mut byte).unwrap();
            child.push(char::from(byte[0]));
        }
        let processes = [running.process().to_string(), child.trim().to_owned()];
        let state = |id: &String| std::fs::read_to_string(format!("/proc/{id}/stat")).ok();
        assert!(processes.iter().all(|id| state(id).is_some()));
        drop(running);
        // Who has no parent any more may wait to be reaped.
        let runs = |id| state(id).is_some_and(|stat| !stat.contains(") Z "));
        let begun = Instant::now();
        while processes.iter().any(runs) {
            assert!(begun.elapsed() < SILENCE, "left behind");
            std::thread::yield_now();
        }
    }

    #[test]
    fn a_program_whose_output_ended_and_that_does_not_end_is_killed() {
        let begun = Instant::now();
        let mut running = start("echo last; exec >&-; sleep 1000");
        assert_eq!(output(&mut running), "last\n");
        running.end().unwrap();
        assert!(begun.elapsed() < 3 * END_LIMIT, "{:?}", begun.elapsed());
        // Somebody else holds its error output.
        let begun = Instant::now();
        let mut running = start("sleep 1000 > /dev/null & echo last");
        assert_eq!(output(&mut running), "last\n");
        running.end().unwrap();
        assert!(begun.elapsed() < 3 * END_LIMIT, "{:?}", begun.elapsed());
    }

    #[test]
    fn silence_ends_a_reading_when_it_is_to_and_a_stop_at_once() {
        let silence = Duration::from_millis(300);
        let running = shell("echo one; sleep 1000").start(silence, CancellationToken::new());
        let mut running = running.unwrap();
        let begun = Instant::now();
        let error = running.read_to_end(&mut Vec::new()).unwrap_err();
        assert_eq!(error.to_string(), "no picture for more than 0.3 s");
        assert!(begun.elapsed() >= silence);
        let stop = CancellationToken::new();
        let mut running = shell("sleep 1000").start(SILENCE, stop.clone()).unwrap();
        stop.cancel();
        let error = running.read_to_end(&mut Vec::new()).unwrap_err();
        assert_eq!(error.to_string(), "told to stop");
    }

    #[test]
    fn a_program_sees_no_variables_but_what_it_needs() {
        for (name, passed) in [
            ("PATH", true),
            ("GST_PLUGIN_PATH", true),
            ("HTTPS_PROXY", true),
            ("no_proxy", true),
            ("ALBIREO_HTTP__TOKEN", false),
            ("GATE_PASSWORD", false),
            ("CARGO_MANIFEST_DIR", false),
        ] {
            assert_eq!(is_passed_on(name), passed, "{name}");
        }
        let variables = output(&mut start("env"));
        assert!(variables.contains("PATH="), "{variables}");
        assert!(!variables.contains("CARGO"), "{variables}");
    }

    #[test]
    fn a_program_s_memory_is_limited() {
        if !Path::new("/proc/self/limits").exists() {
            return;
        }
        let mut program = shell("read go; grep 'Max data size' /proc/self/limits");
        program.max_memory = Some(123 << 20);
        program.input = Some("go\n".to_owned());
        let mut running = program.start(SILENCE, CancellationToken::new()).unwrap();
        let limits = output(&mut running);
        assert!(limits.contains("128974848"), "{limits}");
    }
}
