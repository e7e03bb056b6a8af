//! Helpers of the end-to-end tests: the program as a process, the independent Zenoh client, and the folder of recordings.

mod assertions;
pub(crate) mod camera;
pub(crate) mod detectors;
pub(crate) mod fleet;
pub(crate) mod live_camera;
pub(crate) mod onnx;
mod ports;
#[path = "../../crates/hub/tests/support/postgres.rs"]
pub(crate) mod postgres;
pub(crate) mod power_cut;

pub(crate) use assertions::{assert_contains, assert_has};
pub(crate) use fleet::{clip_report, zenoh_session};
pub(crate) use ports::free_port;

use albireo::cli::frames::{FrameSender, Pacing, open_session};
use albireo_core::detection::ClassId;
use albireo_core::geometry::Corners;
use albireo_eval::boxes::ScoredBox;
use serde_json::Value;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncRead, BufReader, Lines};
use tokio::process::{Child, ChildStdout, Command};
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};
use tokio::time::timeout;
use zenoh::Session;
use zenoh::sample::Sample;

/// The limit of a test, as in `.cargo/config.toml`. A wait that says what it waits for ends earlier, so that it is heard.
pub(crate) const PATIENCE: Duration = Duration::from_secs(360);

pub(crate) fn project(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

#[track_caller]
pub(crate) fn text(path: &str) -> String {
    std::fs::read_to_string(project(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// A file of the shared recordings, clips and models.
pub(crate) fn shared(path: &str) -> PathBuf {
    let folder =
        std::env::var_os("ALBIREO_SHARED").map_or_else(|| project("../shared"), PathBuf::from);
    let file = folder.join(path);
    let missing = "does not exist: set ALBIREO_SHARED, or skip the tests named shared_";
    assert!(file.exists(), "{} {missing}", file.display());
    file
}

/// The Python that `make python` installs for the independent clients.
pub(crate) fn python() -> String {
    let own = project(".cache/python/bin/python").display().to_string();
    std::env::var("ALBIREO_PYTHON").unwrap_or(own)
}

/// The answer of a script to `request`, both in JSON.
pub(crate) fn ask_script(script: &mut std::process::Command, request: &Value) -> Value {
    script.stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut child = script
        .spawn()
        .expect("Python starts: `make python` and `make wheel-tests` set it up");
    let mut stdin = child.stdin.take().unwrap();
    serde_json::to_writer(&mut stdin, request).expect("it takes the request");
    drop(stdin);
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{script:?} failed, see above");
    serde_json::from_slice(&output.stdout).expect("it answers in JSON")
}

pub(crate) async fn until(what: &str, mut condition: impl AsyncFnMut() -> bool) {
    let waiting = async {
        while !condition().await {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    let in_time = timeout(PATIENCE / 3, waiting).await;
    in_time.unwrap_or_else(|_| panic!("not in time: {what}"));
}

pub(crate) async fn until_ready(http: &str) {
    until("the service is ready", async || {
        let ready = reqwest::get(format!("{http}/readyz")).await;
        ready.is_ok_and(|response| response.status().is_success())
    })
    .await;
}

pub(crate) fn signal(process: u32, signal: &str) {
    run_command(std::process::Command::new("kill").args([signal, &process.to_string()])).succeeds();
}

/// Sets a limit of a process with `prlimit` (Debian package `util-linux`).
pub(crate) fn limit(process: u32, limit: &str) {
    let mut prlimit = std::process::Command::new("prlimit");
    run_command(prlimit.args(["--pid", &process.to_string(), limit])).succeeds();
}

/// The text at an address; empty without an answer.
pub(crate) async fn text_at(url: &str) -> String {
    match reqwest::get(url).await {
        Ok(response) => response.text().await.unwrap_or_default(),
        Err(_) => String::new(),
    }
}

/// The JSON at an address; null without an answer.
pub(crate) async fn json_at(url: &str) -> Value {
    serde_json::from_str(&text_at(url).await).unwrap_or_default()
}

#[track_caller]
pub(crate) fn value_of(metrics: &str, series: &str) -> f64 {
    metrics
        .lines()
        .find_map(|line| line.strip_prefix(series)?.strip_prefix(' '))
        .and_then(|rest| rest.split(' ').next()?.parse().ok())
        .unwrap_or_else(|| panic!("no {series} in {metrics}"))
}

pub(crate) async fn metric(http: &str, series: &str) -> f64 {
    value_of(&text_at(&format!("{http}/metrics")).await, series)
}

/// A client with Zenoh's defaults, shared memory among them.
pub(crate) async fn zenoh_client(endpoint: &str) -> Session {
    let settings = [
        ("mode", "client".into()),
        ("connect/endpoints", vec![endpoint].into()),
    ];
    zenoh_session(&settings).await.expect("a session")
}

pub(crate) async fn subscribe<T: Send + 'static>(
    session: &Session,
    key: &str,
    read: impl Fn(Sample) -> T + Send + Sync + 'static,
) -> UnboundedReceiver<T> {
    let (sender, messages) = unbounded_channel();
    session
        .declare_subscriber(key.to_owned())
        .callback(move |sample| drop(sender.send(read(sample))))
        .background()
        .await
        .unwrap();
    messages
}

pub(crate) async fn next<T>(messages: &mut UnboundedReceiver<T>) -> T {
    messages.recv().await.unwrap()
}

pub(crate) async fn listening_peer() -> (Session, String) {
    let listen = ["tcp/127.0.0.1:0".to_owned()];
    let session = open_session(&[], &listen, Duration::ZERO).await.unwrap();
    let locator = session.info().locators().await.into_iter().next().unwrap();
    (session, locator.to_string())
}

#[derive(Debug)]
pub(crate) struct Ended {
    pub(crate) code: Option<i32>,
    pub(crate) out: String,
    pub(crate) err: String,
}

impl From<std::process::Output> for Ended {
    fn from(output: std::process::Output) -> Self {
        Self {
            code: output.status.code(),
            out: String::from_utf8_lossy(&output.stdout).into_owned(),
            err: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }
}

impl Ended {
    /// The output of a run that must succeed.
    #[track_caller]
    pub(crate) fn succeeds(self) -> String {
        assert_eq!(self.code, Some(0), "{}\n{}", self.out, self.err);
        self.out
    }

    /// The error output of a run that must fail.
    #[track_caller]
    pub(crate) fn fails(self) -> String {
        assert_eq!(self.code, Some(1), "{}\n{}", self.out, self.err);
        self.err
    }
}

pub(crate) fn run(arguments: &[&str], environment: &[(&str, &str)]) -> Ended {
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_albireo"));
    command.args(arguments).envs(environment.iter().copied());
    run_command(&mut command)
}

/// Runs a command to its end, in the project's folder unless it sets another.
#[track_caller]
pub(crate) fn run_command(command: &mut std::process::Command) -> Ended {
    if command.get_current_dir().is_none() {
        command.current_dir(env!("CARGO_MANIFEST_DIR"));
    }
    let output = command
        .stdin(Stdio::null())
        .output()
        .unwrap_or_else(|error| panic!("{command:?}: {error}"));
    output.into()
}

pub(crate) fn albireo() -> Command {
    process(env!("CARGO_BIN_EXE_albireo"))
}

/// The program where a limit on the size of files, which can be set and lifted while it runs, acts like a full disk.
pub(crate) fn albireo_on_a_disk_that_fills() -> Command {
    let mut command = process("sh");
    command.args(["-c", "trap '' XFSZ; exec \"$0\" \"$@\""]);
    command.arg(env!("CARGO_BIN_EXE_albireo"));
    command
}

/// A command in the project's folder that reads nothing and ends with its test.
pub(crate) fn process(program: impl AsRef<OsStr>) -> Command {
    let mut command = Command::new(program);
    command.current_dir(env!("CARGO_MANIFEST_DIR"));
    command.kill_on_drop(true).stdin(Stdio::null());
    command
}

/// A fake `tegrastats` in `folder` that does `task`.
pub(crate) fn fake_tegrastats(folder: &Path, task: &Value) -> PathBuf {
    let program = folder.join("tegrastats");
    std::os::unix::fs::symlink(project("tests/fixtures/fake_tegrastats"), &program).unwrap();
    std::fs::write(folder.join("tegrastats.json"), task.to_string()).unwrap();
    program
}

/// A fake `nvpmodel` in `folder` that reports the mode `MODE_30W`.
pub(crate) fn fake_nvpmodel(folder: &Path) -> PathBuf {
    let program = folder.join("nvpmodel");
    std::os::unix::fs::symlink(project("tests/fixtures/fake_nvpmodel"), &program).unwrap();
    std::fs::write(folder.join("nvpmodel.says"), "NV Power Mode: MODE_30W\n2\n").unwrap();
    program
}

pub(crate) fn script(folder: &Path, name: &str, body: &str) -> PathBuf {
    use std::os::unix::fs::PermissionsExt;
    let file = folder.join(name);
    std::fs::write(&file, format!("#!/bin/sh\n{body}\n")).unwrap();
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o755)).unwrap();
    file
}

pub(crate) fn jpeg(pixels: &[u8], [width, height]: [u16; 2]) -> Vec<u8> {
    let mut file = Vec::new();
    let encoder = jpeg_encoder::Encoder::new(&mut file, 90);
    let rgb = jpeg_encoder::ColorType::Rgb;
    encoder.encode(pixels, width, height, rgb).unwrap();
    file
}

pub(crate) fn grey_jpeg(value: u8, size: [u16; 2]) -> Vec<u8> {
    let [width, height] = size.map(usize::from);
    jpeg(&vec![value; 3 * width * height], size)
}

/// A box of unknown object with these sides: left, top, right, bottom.
pub(crate) fn scored([x1, y1, x2, y2]: [f64; 4], class: u16, confidence: f64) -> ScoredBox {
    ScoredBox {
        corners: Corners { x1, y1, x2, y2 },
        class: ClassId(class),
        confidence,
        object: None,
    }
}

/// A video of ffmpeg's test picture in `folder`, 320x180, with `options` such as `rate=20:duration=1`.
pub(crate) fn test_video(folder: &Path, name: &str, options: &str) -> PathBuf {
    let file = folder.join(name);
    let picture = format!("testsrc=size=320x180:{options}");
    let mut ffmpeg = std::process::Command::new("ffmpeg");
    ffmpeg.args([
        "-v", "error", "-f", "lavfi", "-i", &picture, "-c:v", "mpeg4",
    ]);
    run_command(ffmpeg.arg(&file)).succeeds();
    file
}

/// Creates a named pipe: it blocks whoever opens it until the other end is opened.
pub(crate) fn pipe(path: &Path) {
    run_command(std::process::Command::new("mkfifo").arg(path)).succeeds();
}

/// The constants that comments in the settings change: `# development: name=value …`.
pub(crate) fn development(settings: &str) -> String {
    let mut constants = Vec::new();
    for line in settings.lines() {
        constants.extend(line.strip_prefix("# development: "));
    }
    constants.join(" ")
}

pub(crate) struct Node {
    child: Child,
    pub folder: tempfile::TempDir,
    pub http: String,
    pub zenoh: String,
    log: tokio::task::JoinHandle<String>,
}

impl Node {
    /// Starts a node with `settings` (TOML) added to its own addresses, and waits until it is ready.
    pub(crate) async fn start(settings: &str) -> Self {
        Self::start_in(tempfile::tempdir().unwrap(), settings).await
    }

    pub(crate) async fn start_in(folder: tempfile::TempDir, settings: &str) -> Self {
        Self::start_as(albireo(), folder, settings).await
    }

    /// Starts a node with a command that wraps the program, and waits until it is ready.
    pub(crate) async fn start_as(
        command: Command,
        folder: tempfile::TempDir,
        settings: &str,
    ) -> Self {
        let node = Self::spawn(command, folder, settings).await;
        until_ready(&node.http).await;
        node
    }

    /// Like [`start_as`](Self::start_as), without waiting until it is ready.
    pub(crate) async fn spawn(
        mut command: Command,
        folder: tempfile::TempDir,
        settings: &str,
    ) -> Self {
        let zenoh = format!("tcp/127.0.0.1:{}", free_port());
        let file = folder.path().join("node.toml");
        // Each report is sent at once.
        let own = format!(
            "http.listen = \"127.0.0.1:0\"\nzenoh.listen = [{zenoh:?}]\nlog.format = \"json\"\noutbox.gather_s = 0\n"
        );
        std::fs::write(&file, own + settings).unwrap();
        let mut child = command
            .args(["node", "--config"])
            .arg(&file)
            .env("ALBIREO_DEVELOPMENT", development(settings))
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        Self {
            child,
            folder,
            http: http_address(&mut lines).await,
            zenoh,
            log: collected(lines),
        }
    }

    /// Kills the node as a power cut does, and returns its folder.
    pub(crate) async fn kill(mut self) -> tempfile::TempDir {
        self.child.kill().await.expect("the node can be killed");
        self.folder
    }

    pub(crate) async fn text(&self, path: &str) -> String {
        text_at(&format!("{}{path}", self.http)).await
    }

    pub(crate) fn id(&self) -> u32 {
        self.child.id().expect("the node runs")
    }

    /// Waits until the node exits.
    pub(crate) async fn ended(mut self) -> EndedNode {
        let start = std::time::Instant::now();
        let status = self.child.wait().await.unwrap();
        EndedNode {
            status,
            took: start.elapsed(),
            log: self.log.await.unwrap(),
            folder: self.folder,
        }
    }

    /// Sends SIGTERM, then as [`ended`](Self::ended).
    pub(crate) async fn stop(self) -> EndedNode {
        signal(self.id(), "-TERM");
        self.ended().await
    }

    pub(crate) async fn stop_well(self) -> EndedNode {
        let ended = self.stop().await;
        assert!(ended.status.success(), "{}:\n{}", ended.status, ended.log);
        ended
    }
}

/// What a node that has exited leaves.
pub(crate) struct EndedNode {
    pub(crate) status: ExitStatus,
    /// How long its exit was waited for.
    pub(crate) took: Duration,
    pub(crate) log: String,
    pub(crate) folder: tempfile::TempDir,
}

pub(crate) fn collected<R: AsyncRead + Unpin + Send + 'static>(
    mut lines: Lines<BufReader<R>>,
) -> tokio::task::JoinHandle<String> {
    tokio::spawn(async move {
        let mut log = String::new();
        while let Ok(Some(line)) = lines.next_line().await {
            log += &(line + "\n");
        }
        log
    })
}

async fn http_address<R: AsyncRead + Unpin>(lines: &mut Lines<BufReader<R>>) -> String {
    let mut seen = String::new();
    while let Ok(Some(line)) = lines.next_line().await {
        let entry: Value = serde_json::from_str(&line).unwrap_or_default();
        if let Some(address) = entry["http"].as_str() {
            return address.to_owned();
        }
        seen += &(line + "\n");
    }
    panic!("the node ended before it listened:\n{seen}");
}

/// Waits until a node has subscribed to the frames of its camera and knows the subscriptions of `session`.
pub(crate) async fn until_connected(session: &Session, node: &str, camera: &str) {
    let key = format!("albireo/{node}/{camera}/frame");
    let sender = FrameSender::declare(session, &key, Pacing::Drop).await;
    let waited = sender.unwrap().wait_for_receiver(PATIENCE).await;
    waited.expect("the node subscribes");
    until_read(session, node, camera).await;
}

/// Waits until a node has read everything that `session` sent: links keep the order, so an answered query proves it.
pub(crate) async fn until_read(session: &Session, node: &str, camera: &str) {
    let replies = session
        .get(format!("albireo/{node}/{camera}/threshold"))
        .await
        .expect("a query");
    while replies.recv_async().await.is_ok() {}
}

/// Runs `albireo replay --every` to the camera `front` of a node, to its end.
pub(crate) async fn replay(node: &Node, source: &str, more: &[&str]) {
    let every = ["--every", "--wait-for-subscriber", "--connect", &node.zenoh];
    let mut command = albireo();
    command.args(["replay", source]).args(every).args(more);
    Ended::from(command.output().await.unwrap()).succeeds();
}

/// Starts a script of `tests/clients` and waits until it is ready: its process and its further output.
pub(crate) async fn client(
    python: &str,
    script: &str,
    arguments: &[&str],
) -> (Child, Lines<BufReader<ChildStdout>>) {
    let mut child = process(python)
        .arg(project("tests/clients").join(script))
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("Python starts: `make python` and `make debian` set it up");
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let line = lines.next_line().await.unwrap();
    assert_eq!(line.as_deref(), Some("ready"), "{script}: `make debian`?");
    (child, lines)
}

/// The independent client: Eclipse Zenoh's Python binding.
pub(crate) struct Client {
    child: Child,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Client {
    /// Subscribes to `key` at `endpoint` and waits until the subscription is active.
    pub(crate) async fn listen(endpoint: &str, key: &str) -> Self {
        Self::start(&[endpoint, key]).await
    }

    /// Like [`listen`](Self::listen), and gets what was published before.
    pub(crate) async fn listen_with_history(endpoint: &str, key: &str) -> Self {
        Self::start(&[endpoint, key, "--history"]).await
    }

    async fn start(arguments: &[&str]) -> Self {
        let (child, lines) = client(&python(), "listen.py", arguments).await;
        Self { child, lines }
    }

    /// Suspends its process, so that it reads nothing and keeps its connections.
    pub(crate) fn freeze(&self) {
        signal(self.child.id().expect("it runs"), "-STOP");
    }

    /// The key and content of the next message; `None` once the client has exited.
    pub(crate) async fn next(&mut self) -> Option<(String, Value)> {
        let line = self.lines.next_line().await;
        let mut entry: Value = serde_json::from_str(&line.unwrap()?).expect("a JSON line");
        let key = entry["key"].as_str().expect("a key").to_owned();
        Some((key, entry["message"].take()))
    }
}

/// The memory of a process, MB: `VmRSS:` with shared pages, `VmHWM:` its peak. 0 once it has exited.
pub(crate) fn memory_mb(process: u32, figure: &str) -> f64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with(figure));
    let kb = line.and_then(|line| line.split_whitespace().nth(1));
    kb.map_or(0.0, |kb| kb.parse::<f64>().unwrap() / 1024.0)
}
