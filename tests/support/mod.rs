//! What the end-to-end tests share: the program as a process, the independent Zenoh client, and the
//! folder of recordings.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

pub(crate) mod camera;
pub(crate) mod detectors;
#[cfg(feature = "hub")]
pub(crate) mod fleet;
pub(crate) mod live_camera;
pub(crate) mod policies;
mod ports;
#[cfg(feature = "hub")]
#[path = "../../crates/hub/tests/support/postgres.rs"]
#[allow(unreachable_pub)]
pub(crate) mod postgres;

pub(crate) use ports::free_port;

use albireo::cli::replay::{FrameSender, Pacing};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncRead, BufReader, Lines};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};
use tokio::time::timeout;

/// The longest any single thing may take on a busy machine before a test gives up on it.
pub(crate) const PATIENCE: Duration = Duration::from_secs(120);

/// A file of the shared recordings, clips and models.
pub(crate) fn shared(path: &str) -> PathBuf {
    let folder = std::env::var_os("ALBIREO_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"),
        PathBuf::from,
    );
    let file = folder.join(path);
    assert!(
        file.exists(),
        "{} is not there: set ALBIREO_SHARED, or leave tests named shared_ out",
        file.display()
    );
    file
}

/// The Python of the independent clients, as `make python` sets it up.
pub(crate) fn python() -> String {
    std::env::var("ALBIREO_PYTHON")
        .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/.cache/python/bin/python").into())
}

/// What a script answers to `request`, both in JSON.
pub(crate) fn answer_of(script: &mut std::process::Command, request: &Value) -> Value {
    let mut child = script
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("Python starts: `make python` and `make wheel-tests` set it up");
    let mut stdin = child.stdin.take().expect("its standard input is a pipe");
    serde_json::to_writer(&mut stdin, request).expect("it takes the request");
    drop(stdin);
    let output = child.wait_with_output().expect("Python ends");
    assert!(output.status.success(), "{script:?} failed, see above");
    serde_json::from_slice(&output.stdout).expect("it answers in JSON")
}

/// The program itself, with a clean environment for its configuration.
pub(crate) fn albireo() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_albireo"));
    command
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .kill_on_drop(true)
        .stdin(Stdio::null());
    command
}

/// How a run of the program ended, and what it printed.
#[derive(Debug)]
pub(crate) struct Ended {
    pub(crate) code: Option<i32>,
    pub(crate) out: String,
    pub(crate) err: String,
}

impl Ended {
    fn of(output: &std::process::Output) -> Self {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Self {
            code: output.status.code(),
            out: text(&output.stdout),
            err: text(&output.stderr),
        }
    }

    /// What it printed, of a run that must succeed.
    #[track_caller]
    pub(crate) fn succeeds(self) -> String {
        assert_eq!(self.code, Some(0), "{self:?}");
        self.out
    }

    /// Its complaint, of a run that must fail.
    #[track_caller]
    pub(crate) fn fails(self) -> String {
        assert_eq!(self.code, Some(1), "{self:?}");
        self.err
    }
}

/// Runs the program to its end, with these variables in its environment.
pub(crate) fn run(arguments: &[&str], environment: &[(&str, &str)]) -> Ended {
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_albireo"))
        .args(arguments)
        .envs(environment.iter().copied())
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .stdin(Stdio::null())
        .output();
    Ended::of(&output.expect("the program starts"))
}

/// A stand-in for `nvpmodel` in `folder` that says the board is in mode `MODE_30W`.
pub(crate) fn fake_nvpmodel(folder: &Path) -> PathBuf {
    let program = folder.join("nvpmodel");
    let fake = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/fake_nvpmodel");
    std::os::unix::fs::symlink(fake, &program).expect("the stand-in is linked");
    std::fs::write(folder.join("nvpmodel.says"), "NV Power Mode: MODE_30W\n2\n")
        .expect("what it says is written");
    program
}

/// The constants that settings change in their comments, `# development: name=value …`.
pub(crate) fn development(settings: &str) -> String {
    let named = |line: &'_ str| line.strip_prefix("# development: ").map(str::to_owned);
    let lines: Vec<_> = settings.lines().filter_map(named).collect();
    lines.join(" ")
}

/// `albireo node`, running.
pub(crate) struct Node {
    child: Child,
    /// Its folder: configuration, state.
    pub folder: tempfile::TempDir,
    /// Where its HTTP interface is.
    pub http: String,
    /// Where its Zenoh session listens.
    pub zenoh: String,
    log: tokio::task::JoinHandle<String>,
}

impl Node {
    /// Starts a node with `settings` (TOML) added to its own addresses, and waits until it is ready.
    pub(crate) async fn start(settings: &str) -> Self {
        Self::start_in(tempfile::tempdir().expect("a temporary folder"), settings).await
    }

    /// As [`Self::start`], with the folder of an earlier node.
    pub(crate) async fn start_in(folder: tempfile::TempDir, settings: &str) -> Self {
        let node = Self::start_unready_in(folder, settings).await;
        node.wait_until_ready().await;
        node
    }

    /// Starts a node that cannot be ready yet.
    pub(crate) async fn start_unready(settings: &str) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        Self::start_unready_in(folder, settings).await
    }

    async fn start_unready_in(folder: tempfile::TempDir, settings: &str) -> Self {
        Self::start_with(folder, settings, &[]).await
    }

    /// Starts a node with these variables in its environment.
    pub(crate) async fn start_with(
        folder: tempfile::TempDir,
        settings: &str,
        environment: &[(&str, &str)],
    ) -> Self {
        let zenoh = format!("tcp/127.0.0.1:{}", free_port());
        let file = folder.path().join("node.toml");
        let listen = if settings.contains("zenoh.mode = \"client\"") {
            "[]".to_owned()
        } else {
            format!("[\"{zenoh}\"]")
        };
        let addresses = format!(
            "http.listen = \"127.0.0.1:0\"\nzenoh.listen = {listen}\nlog.format = \"json\"\n"
        );
        // Each report goes at once, unless gathering is what is tested.
        let at_once = if settings.contains("gather_s") {
            ""
        } else {
            "outbox.gather_s = 0\n"
        };
        std::fs::write(&file, addresses + at_once + settings)
            .expect("the configuration is written");
        let mut child = albireo()
            .args(["node", "--config"])
            .arg(&file)
            .env("ALBIREO_DEVELOPMENT", development(settings))
            .envs(environment.iter().copied())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let mut lines = BufReader::new(child.stderr.take().expect("piped")).lines();
        let http = timeout(PATIENCE, http_address(&mut lines))
            .await
            .expect("the node logs its HTTP address in time");
        let log = tokio::spawn(async move {
            let mut log = String::new();
            while let Ok(Some(line)) = lines.next_line().await {
                log.push_str(&line);
                log.push('\n');
            }
            log
        });
        Self {
            child,
            folder,
            http,
            zenoh,
            log,
        }
    }

    /// Kills the node as a power cut does; its folder.
    pub(crate) async fn kill(mut self) -> tempfile::TempDir {
        self.child.kill().await.expect("the node can be killed");
        self.folder
    }

    pub(crate) async fn wait_until_ready(&self) {
        let ready = async {
            while reqwest::get(format!("{}/readyz", self.http))
                .await
                .is_ok_and(|response| !response.status().is_success())
            {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        };
        timeout(PATIENCE, ready).await.expect("the node gets ready");
    }

    /// The process's id.
    pub(crate) fn id(&self) -> u32 {
        self.child.id().expect("the node runs")
    }

    /// Sends the signal a service manager sends.
    pub(crate) fn terminate(&self) {
        let id = self.child.id().expect("the node runs").to_string();
        let status = std::process::Command::new("kill")
            .args(["-TERM", &id])
            .status()
            .expect("kill runs");
        assert!(status.success());
    }

    /// Waits until the node ends by itself; how it ended, and its log.
    pub(crate) async fn ended(mut self) -> (ExitStatus, String) {
        let status = self.child.wait().await.expect("its status can be had");
        (status, self.log.await.expect("its log"))
    }

    /// Terminates the node; how it ended, how long that took, its log, and its folder.
    pub(crate) async fn stop(mut self) -> (ExitStatus, Duration, String, tempfile::TempDir) {
        let start = std::time::Instant::now();
        self.terminate();
        let status = timeout(PATIENCE, self.child.wait())
            .await
            .expect("the node ends")
            .expect("its status can be had");
        let took = start.elapsed();
        (status, took, self.log.await.expect("its log"), self.folder)
    }
}

async fn http_address<R: AsyncRead + Unpin>(lines: &mut Lines<BufReader<R>>) -> String {
    let mut seen = String::new();
    while let Ok(Some(line)) = lines.next_line().await {
        if let Some(address) = serde_json::from_str::<Value>(&line)
            .ok()
            .and_then(|entry| entry["http"].as_str().map(str::to_owned))
        {
            return address;
        }
        seen.push_str(&line);
        seen.push('\n');
    }
    panic!("the node ended before it listened:\n{seen}");
}

/// Waits until a node has subscribed to the frames of its camera, and knows what `session` has subscribed to.
pub(crate) async fn both_ways(session: &zenoh::Session, node: &str, camera: &str) {
    let key = format!("albireo/{node}/{camera}/frame");
    let sender = FrameSender::declare(session, &key, Pacing::Drop).await;
    let sender = sender.expect("a key for frames");
    let waited = sender.wait_for_receiver(PATIENCE).await;
    waited.expect("the node subscribes");
    // The node's subscription came over the link on which this side's went out before it, and links keep their order;
    // a query that is answered says that the node has read what came before.
    let replies = session.get(format!("albireo/{node}/{camera}/threshold"));
    let replies = replies.await.expect("a query");
    while replies.recv_async().await.is_ok() {}
}

/// The independent client: Eclipse Zenoh's Python binding.
pub(crate) struct Client {
    child: Child,
    stdin: Option<ChildStdin>,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Client {
    /// Subscribes to `key` at `endpoint` and waits until the subscription is active.
    pub(crate) async fn listen(endpoint: &str, key: &str, history: bool) -> Self {
        let python = std::env::var("ALBIREO_PYTHON").unwrap_or_else(|_| {
            concat!(env!("CARGO_MANIFEST_DIR"), "/.cache/python/bin/python").into()
        });
        let mut command = Command::new(&python);
        command
            .arg(concat!(
                env!("CARGO_MANIFEST_DIR"),
                "/tests/clients/listen.py"
            ))
            .args([endpoint, key])
            .kill_on_drop(true)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped());
        if history {
            command.arg("--history");
        }
        let mut child = command
            .spawn()
            .unwrap_or_else(|error| panic!("{python} does not start ({error}): run `make python`"));
        let mut client = Self {
            stdin: child.stdin.take(),
            lines: BufReader::new(child.stdout.take().expect("piped")).lines(),
            child,
        };
        assert_eq!(client.line().await.as_deref(), Some("ready"));
        client
    }

    /// Stops its process, so that it reads nothing more and keeps its connections.
    pub(crate) fn freeze(&self) {
        let id = self.child.id().expect("it runs").to_string();
        let stopped = std::process::Command::new("kill")
            .args(["-STOP", &id])
            .status();
        assert!(stopped.expect("kill runs").success());
    }

    async fn line(&mut self) -> Option<String> {
        timeout(PATIENCE, self.lines.next_line())
            .await
            .expect("the client says something in time")
            .expect("its output can be read")
    }

    /// The next message: its key and itself. `None` once the client has ended.
    pub(crate) async fn next(&mut self) -> Option<(String, Value)> {
        let line = self.line().await?;
        let mut entry: Value = serde_json::from_str(&line).expect("a JSON line");
        let key = entry["key"].as_str().expect("a key").to_owned();
        Some((key, entry["message"].take()))
    }

    /// Ends the client and returns its remaining output.
    pub(crate) async fn finish(mut self) -> Vec<(String, Value)> {
        drop(self.stdin.take());
        let mut rest = Vec::new();
        while let Some(message) = self.next().await {
            rest.push(message);
        }
        let _ = self.child.wait().await;
        rest
    }
}

/// A figure of a process's memory, MB: `VmRSS:` with shared pages, `VmHWM:` its peak. 0 when it is gone.
pub(crate) fn memory_mb(process: u32, figure: &str) -> f64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with(figure));
    let kb = line.and_then(|line| line.split_whitespace().nth(1));
    kb.map_or(0.0, |kb| kb.parse::<f64>().unwrap() / 1024.0)
}
