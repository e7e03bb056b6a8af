//! Opens a source with a program that writes pictures to its output. The program gets a clean environment and limited
//! memory, its output is read with a deadline, and it is killed with everything it started.

use super::messages::{Messages, Stage};
use super::secrets::Secrets;
use crate::input::arrivals::Arrivals;
use rustix::process::{Pid, Resource, Rlimit, Signal, kill_process_group, prlimit};
use std::ffi::OsString;
use std::io::{self, ErrorKind, Read};
use std::process::{ExitStatus, Stdio};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::process::{Child, ChildStdout, Command};
use tokio::runtime::Handle;
use tokio::time::{Instant, sleep_until, timeout};
use tokio_util::sync::CancellationToken;

/// The requested size of a pipe, bytes. A picture has several times as many.
const PIPE_BYTES: usize = 1 << 20;
/// The time limit for a program to end by itself after its output has ended, and again after it was killed.
const END_LIMIT: Duration = Duration::from_secs(2);
/// Once packets arrive, the first picture may take this long: a camera may send key frames far apart, and pictures begin
/// with one.
pub(crate) const FIRST_PICTURE: Duration = Duration::from_secs(60);
/// The time limit for the line about a picture that has been read.
const LINE_LIMIT: Duration = Duration::from_secs(1);

/// The variables of this process that a program receives: for libraries, devices and proxies, without secrets. A `*`
/// matches any suffix; case does not matter, because both cases are usual for proxies.
const ENVIRONMENT: &str = "PATH HOME LANG TMPDIR XDG_RUNTIME_DIR LD_LIBRARY_PATH GST_* LIBVA_* CUDA_* LC_* HTTP_PROXY \
    HTTPS_PROXY RTSP_PROXY ALL_PROXY NO_PROXY";

/// A program that writes pictures.
#[derive(Default)]
pub(super) struct PictureProgram {
    /// Its name.
    pub program: &'static str,
    pub arguments: Vec<String>,
    /// The text for its input.
    pub input: Option<String>,
    /// True if it says of each decoded picture whether it is a key frame.
    pub tells_broken: bool,
    /// True if its pictures are PPM files. Otherwise they are the parts of a multipart stream.
    pub writes_ppm: bool,
    /// Secrets to mask in its messages.
    pub secrets: Secrets,
    /// The maximum memory, bytes.
    pub max_memory: Option<u64>,
}

/// A running program; reading it reads its output. Use it only on a thread that may block.
pub(super) struct RunningProgram {
    child: Child,
    process: Pid,
    output: ChildStdout,
    messages: Messages,
    /// True if it says of each picture whether it is broken.
    tells_broken: bool,
    stop: CancellationToken,
    silence: Duration,
    /// The time for which the next picture is awaited.
    patience: Duration,
    deadline: Instant,
    runtime: Handle,
}

impl PictureProgram {
    /// Starts it. Reading its output fails once `stop` is cancelled, and `silence` after the start or the last
    /// [`RunningProgram::picture_taken`]. What comes is counted in `arrivals`.
    ///
    /// # Errors
    /// The error of the system.
    pub(super) fn start(
        self,
        silence: Duration,
        arrivals: Arc<Arrivals>,
        stop: CancellationToken,
    ) -> io::Result<RunningProgram> {
        let input = match self.input {
            Some(_) => Stdio::piped(),
            None => Stdio::null(),
        };
        let mut child = Command::new(self.program)
            .args(&self.arguments)
            .env_clear()
            .envs(environment())
            .stdin(input)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // Ctrl-C in a terminal is for the owner, which ends the program.
            .process_group(0)
            .spawn()?;
        let process = child.id().and_then(|id| Pid::from_raw(id.cast_signed()));
        let output = child.stdout.take();
        let (Some(process), Some(output)) = (process, output) else {
            return Err(io::Error::other("it has no output"));
        };
        if let Some(bytes) = self.max_memory {
            let limit = Rlimit {
                current: Some(bytes),
                maximum: Some(bytes),
            };
            if let Err(error) = prlimit(Some(process), Resource::Data, limit) {
                tracing::debug!(%error, "the memory of a source's program is not limited");
            }
        }
        let runtime = Handle::current();
        if let (Some(text), Some(mut pipe)) = (self.input, child.stdin.take()) {
            // A few lines fit into any pipe; a program that has ended reports the reason itself.
            let _ = runtime.block_on(pipe.write_all(text.as_bytes()));
        }
        // If the system allows less, the pipe keeps its size.
        let _ = rustix::pipe::fcntl_setpipe_size(&output, PIPE_BYTES);
        Ok(RunningProgram {
            messages: Messages::new(child.stderr.take(), self.secrets, arrivals),
            child,
            process,
            output,
            tells_broken: self.tells_broken,
            stop,
            silence,
            patience: silence,
            deadline: Instant::now() + silence,
            runtime,
        })
    }
}

/// The variables that a program receives.
fn environment() -> impl Iterator<Item = (OsString, OsString)> {
    std::env::vars_os().filter(|(name, _)| name.to_str().is_some_and(is_passed_on))
}

fn is_passed_on(name: &str) -> bool {
    let name = name.to_ascii_uppercase();
    ENVIRONMENT.split_whitespace().any(|pattern| match pattern.strip_suffix('*') {
        Some(begin) => name.starts_with(begin),
        None => name == pattern,
    })
}

impl RunningProgram {
    /// Records that a picture was taken: restarts the deadline for the next one.
    pub(super) fn picture_taken(&mut self) {
        self.messages.picture_taken();
        self.patience = self.silence;
        self.deadline = Instant::now() + self.silence;
    }

    /// What it has said.
    pub(super) fn messages(&self) -> &Messages {
        &self.messages
    }

    /// True if the picture that was just read is broken: the decoder has complained since the last whole key frame.
    pub(super) fn picture_is_broken(&mut self) -> bool {
        let Self {
            messages, runtime, ..
        } = self;
        if !self.tells_broken {
            return false;
        }
        // The line about a picture is written before the picture.
        let known = async {
            loop {
                match messages.next_is_broken() {
                    Some(broken) => return broken,
                    None if messages.is_open() => messages.listen().await,
                    None => return false,
                }
            }
        };
        runtime.block_on(async { timeout(LINE_LIMIT, known).await }).unwrap_or(false)
    }

    /// Ends it.
    ///
    /// # Errors
    /// The reason it failed, if it ended by itself: its last error message, or its exit status.
    pub(super) fn end(&mut self) -> Result<(), String> {
        let by_itself = self.wait();
        let reason = self.abort();
        match by_itself {
            Some(status) if !status.success() => {
                Err(reason.unwrap_or_else(|| format!("it ended with {status}")))
            }
            _ => Ok(()),
        }
    }

    /// Kills it, and returns its last error message.
    pub(super) fn abort(&mut self) -> Option<String> {
        self.kill();
        self.messages.reason()
    }

    /// Waits for the end of the program and of its error output, but not forever.
    fn wait(&mut self) -> Option<ExitStatus> {
        let Self {
            child, messages, ..
        } = self;
        let has_said_all = async {
            while messages.is_open() {
                messages.listen().await;
            }
        };
        let ended = async { tokio::join!(child.wait(), has_said_all) };
        let _ = self.runtime.block_on(async { timeout(END_LIMIT, ended).await });
        self.child.try_wait().ok().flatten()
    }

    /// Kills it and everything it started, and waits. A process that hangs in the kernel is abandoned.
    fn kill(&mut self) {
        if !self.messages.is_open() && matches!(self.child.try_wait(), Ok(Some(_))) {
            return;
        }
        // Fails if no process is left.
        let _ = kill_process_group(self.process, Signal::KILL);
        if self.wait().is_none() {
            let process = self.process.as_raw_pid();
            tracing::warn!(process, "abandoned a source's program that does not end");
        }
        self.messages.close();
    }
}

/// Reads its output until the deadline.
impl Read for RunningProgram {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let Self {
            output,
            messages,
            tells_broken,
            stop,
            patience,
            deadline,
            runtime,
            ..
        } = self;
        runtime.block_on(async {
            loop {
                tokio::select! {
                    biased;
                    () = stop.cancelled() => {
                        return Err(io::Error::new(ErrorKind::ConnectionAborted, "it is stopped"));
                    }
                    () = sleep_until(*deadline) => {
                        let is_opened = *tells_broken && messages.stage() == Stage::Opened;
                        if is_opened && *patience < FIRST_PICTURE {
                            *deadline += FIRST_PICTURE - *patience;
                            *patience = FIRST_PICTURE;
                            continue;
                        }
                        let reason = messages.silence(*patience);
                        return Err(io::Error::new(ErrorKind::TimedOut, reason));
                    }
                    // ffmpeg reports the codec before the first picture, and blocks if nobody reads its errors.
                    () = messages.listen() => {}
                    read = output.read(bytes) => return read,
                }
            }
        })
    }
}

impl Drop for RunningProgram {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Runs a program to its end and returns its output; `None` if it does not exist.
///
/// # Errors
/// An I/O error if it exists but cannot be started.
pub(super) fn output_of(program: &'static str, argument: &str) -> Result<Option<String>, String> {
    let ended = std::process::Command::new(program)
        .env_clear()
        .envs(environment())
        .arg(argument)
        .stdin(Stdio::null())
        .output();
    match ended {
        Ok(output) => Ok(Some(String::from_utf8_lossy(&output.stdout).into_owned())),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(format!("`{program}` cannot be started: {error}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::BufRead;
    use std::sync::LazyLock;
    use tokio::runtime::Runtime;

    const SILENCE: Duration = Duration::from_secs(20);

    static RUNTIME: LazyLock<Runtime> = LazyLock::new(|| Runtime::new().unwrap());

    fn shell(script: &str) -> PictureProgram {
        PictureProgram {
            program: "sh",
            arguments: vec!["-c".to_owned(), script.to_owned()],
            ..PictureProgram::default()
        }
    }

    fn started(program: PictureProgram, silence: Duration) -> RunningProgram {
        let _inside = RUNTIME.enter();
        program.start(silence, Arc::default(), CancellationToken::new()).unwrap()
    }

    fn start(script: &str) -> RunningProgram {
        started(shell(script), SILENCE)
    }

    fn output(running: &mut RunningProgram) -> String {
        let mut output = String::new();
        running.read_to_string(&mut output).unwrap();
        output
    }

    #[test]
    fn a_program_that_fails_is_quoted_without_secrets() {
        let address = super::super::SourceAddress::new("rtsp://u:hidden@cam/s");
        let mut program =
            shell("echo a picture; echo '[error] rtsp://u:hidden@cam: refused' >&2; exit 3");
        program.secrets = address.resolved().unwrap().secrets;
        let mut running = started(program, SILENCE);
        assert_eq!(output(&mut running), "a picture\n");
        let reason = running.end().unwrap_err();
        assert!(reason.contains("refused"), "{reason}");
        assert!(!reason.contains("hidden"), "{reason}");
    }

    #[test]
    fn a_dropped_program_is_killed_with_its_children() {
        let mut running = start("sleep 1000 & echo $!; exec tail -f /dev/null");
        let mut child = String::new();
        let mut output = io::BufReader::new(&mut running);
        output.read_line(&mut child).unwrap();
        let process = running.process.as_raw_pid();
        let processes = [process.to_string(), child.trim().to_owned()];
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
    fn a_program_that_outlives_its_output_is_killed() {
        for script in [
            "echo last; exec >&-; sleep 1000",
            // Somebody else holds its error output.
            "sleep 1000 > /dev/null & echo last",
        ] {
            let begun = Instant::now();
            let mut running = start(script);
            assert_eq!(output(&mut running), "last\n");
            running.end().unwrap();
            let took = begun.elapsed();
            assert!(took < 3 * END_LIMIT, "{script}: {took:?}");
        }
    }

    #[test]
    fn silence_ends_a_read_after_the_timeout_and_a_stop_at_once() {
        let silence = Duration::from_millis(300);
        let mut running = started(shell("echo one; sleep 1000"), silence);
        let begun = Instant::now();
        let error = running.read_to_end(&mut Vec::new()).unwrap_err();
        assert_eq!(error.to_string(), "no picture for more than 0.3 s");
        assert!(begun.elapsed() >= silence);
        let mut running = start("sleep 1000");
        running.stop.cancel();
        let error = running.read_to_end(&mut Vec::new()).unwrap_err();
        assert_eq!(error.to_string(), "it is stopped");
    }

    #[test]
    fn a_program_gets_only_the_variables_it_needs() {
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
        let own = output_of("printenv", "CARGO_MANIFEST_DIR");
        assert_eq!(own.unwrap().as_deref(), Some(""), "asked for its version");
    }

    #[test]
    fn the_memory_of_a_program_is_limited() {
        let mut program = shell("read go; grep 'Max data size' /proc/self/limits");
        program.max_memory = Some(123 << 20);
        program.input = Some("go\n".to_owned());
        let mut running = started(program, SILENCE);
        let limits = output(&mut running);
        assert!(limits.contains("128974848"), "{limits}");
    }
}
