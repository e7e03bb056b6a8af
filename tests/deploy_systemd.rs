//! The systemd units are valid, as restricted as promised, and work with the real programs.

#[cfg(feature = "hub")]
use crate::support::fleet::{behind, router_config, settings, sqlite};
use crate::support::{PATIENCE, albireo, free_port, pipe, project, run_command, signal, text};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};
use tokio::net::UnixDatagram;
use tokio::process::Child;
use tokio::time::timeout;

fn unit(name: &str) -> String {
    text(&format!("deploy/systemd/{name}"))
}

/// Writes the units for the program under test, with their drop-ins, to a folder.
fn here(folder: &Path, drop_ins: &[(&str, &str)]) -> Vec<PathBuf> {
    let program = env!("CARGO_BIN_EXE_albireo");
    let mut files = Vec::new();
    for service in ["node", "hub", "router"] {
        let name = format!("albireo-{service}.service");
        let file = folder.join(&name);
        std::fs::write(&file, unit(&name).replace("/usr/bin/albireo", program)).unwrap();
        files.push(file);
    }
    for (service, drop_in) in drop_ins {
        let to = folder.join(format!("albireo-{service}.service.d"));
        std::fs::create_dir_all(&to).unwrap();
        std::fs::write(to.join(drop_in), unit(&format!("drop-ins/{drop_in}"))).unwrap();
    }
    files
}

fn verify(files: &[PathBuf]) -> String {
    let mut verify = Command::new("systemd-analyze");
    let said = run_command(verify.args(["verify", "--man=no"]).args(files)).err;
    // The units of the machine do not matter.
    let own = said.lines().filter(|line| line.contains("albireo"));
    own.collect::<Vec<_>>().join("\n")
}

#[test]
#[ignore = "needs systemd"]
fn systemd_accepts_the_units_and_their_drop_ins() {
    let folder = tempfile::tempdir().unwrap();
    let plain = here(folder.path(), &[]);
    assert_eq!(verify(&plain), "");
    let folder = tempfile::tempdir().unwrap();
    let all = [("node", "gpu.conf"), ("node", "rapl.conf")];
    let with_all = here(folder.path(), &all);
    assert_eq!(verify(&with_all), "");
    // The check works: it finds a misspelt key.
    let text = std::fs::read_to_string(&plain[0]).unwrap();
    std::fs::write(&plain[0], text.replace("Restart=always", "Restrat=always")).unwrap();
    assert!(verify(&plain).contains("Restrat"));
}

#[test]
#[ignore = "needs systemd"]
fn the_units_are_as_restricted_as_promised() {
    let folder = tempfile::tempdir().unwrap();
    let files = here(folder.path(), &[]);
    // Exposure in tenths, as systemd counts it.
    for (file, most) in files.iter().zip([25, 15, 15]) {
        let mut security = Command::new("systemd-analyze");
        let threshold = format!("--threshold={most}");
        let security = security.args(["security", "--offline=true", &threshold]);
        run_command(security.arg(file)).succeeds();
    }
}

#[test]
fn a_drop_in_lifts_only_restrictions_with_a_stated_reason() {
    let gpu = [
        "PrivateDevices=no",
        "MemoryDenyWriteExecute=no",
        "PrivateUsers=no",
    ];
    for (drop_in, opened) in [("gpu.conf", &gpu[..]), ("rapl.conf", &gpu[2..])] {
        let text = unit(&format!("drop-ins/{drop_in}"));
        let mut found = Vec::new();
        let mut before = "";
        for line in text.lines() {
            if line.ends_with("=no") {
                let reason = before.starts_with('#');
                assert!(reason, "{drop_in}: {line} without a reason");
                found.push(line);
            }
            before = line;
        }
        assert_eq!(found, opened, "{drop_in}");
        let base = unit("albireo-node.service");
        for line in opened {
            let closed = line.replace("=no", "=yes");
            assert!(base.lines().any(|one| one == closed), "{closed} is not set");
        }
    }
}

/// The service manager's end of the notify socket.
struct Manager {
    socket: UnixDatagram,
    /// The folder of the socket and the log.
    folder: tempfile::TempDir,
    heard: Vec<String>,
}

impl Manager {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let socket = UnixDatagram::bind(folder.path().join("notify")).unwrap();
        Self {
            socket,
            folder,
            heard: Vec::new(),
        }
    }

    /// Starts a service as systemd does, with a watchdog.
    fn start(&self, arguments: &[&str], settings: &[(&str, String)]) -> Child {
        albireo()
            .args(arguments)
            .envs(settings.iter().map(|(name, value)| (*name, value)))
            .env("NOTIFY_SOCKET", self.folder.path().join("notify"))
            .env("WATCHDOG_USEC", "200000")
            .stderr(std::fs::File::create(self.folder.path().join("log")).unwrap())
            .spawn()
            .unwrap()
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("log")).unwrap_or_default()
    }

    async fn hear(&mut self) {
        let mut buffer = [0; 4096];
        let length = timeout(PATIENCE, self.socket.recv(&mut buffer))
            .await
            .unwrap_or_else(|_| panic!("nothing more came: {:?}\n{}", self.heard, self.log()))
            .unwrap();
        let text = String::from_utf8(buffer[..length].to_vec()).unwrap();
        self.heard.extend(text.lines().map(str::to_owned));
    }

    fn count(&self, message: &str) -> usize {
        let of_it = self.heard.iter().filter(|one| one.starts_with(message));
        of_it.count()
    }

    /// Receives until the message has arrived this many times.
    async fn until(&mut self, message: &str, times: usize) {
        while self.count(message) < times {
            self.hear().await;
        }
    }

    /// Receives for that time.
    async fn during(&mut self, time: Duration) {
        let until = Instant::now() + time;
        while timeout(until.saturating_duration_since(Instant::now()), self.hear())
            .await
            .is_ok()
        {}
    }
}

async fn ends_well(mut child: Child, manager: &mut Manager) {
    signal(child.id().unwrap(), "-TERM");
    manager.until("STOPPING=1", 1).await;
    let status = timeout(PATIENCE, child.wait()).await.unwrap().unwrap();
    assert!(status.success(), "{status}\n{}", manager.log());
}

#[cfg(feature = "hub")]
#[tokio::test]
async fn a_hub_notifies_ready_once_feeds_its_watchdog_and_notifies_its_stop() {
    let folder = tempfile::tempdir().unwrap();
    let (_, settings) = settings(&sqlite(folder.path()));
    let mut manager = Manager::new();
    let hub = manager.start(&["hub"], &settings);
    manager.until("READY=1", 1).await;
    manager.until("STATUS=every part works", 1).await;
    manager.until("WATCHDOG=1", 5).await;
    ends_well(hub, &mut manager).await;
    assert_eq!(manager.count("READY=1"), 1, "{:?}", manager.heard);
}

#[cfg(feature = "hub")]
#[tokio::test]
async fn a_hub_without_its_router_feeds_its_watchdog_and_reports_what_it_waits_for() {
    let folder = tempfile::tempdir().unwrap();
    let router = format!("tcp/127.0.0.1:{}", free_port());
    let settings = behind(&router, &sqlite(folder.path()));
    let mut manager = Manager::new();
    let hub = manager.start(&["hub"], &settings);
    manager.until("STATUS=not ready: zenoh", 1).await;
    let fed = manager.count("WATCHDOG=1");
    manager.until("WATCHDOG=1", fed + 5).await;
    assert_eq!(manager.count("READY=1"), 0, "{:?}", manager.heard);
    ends_well(hub, &mut manager).await;
}

#[cfg(feature = "hub")]
#[tokio::test]
async fn a_router_notifies_ready_and_feeds_its_watchdog() {
    let folder = tempfile::tempdir().unwrap();
    let file = router_config(folder.path());
    let mut manager = Manager::new();
    let http = ["router", "--http", "127.0.0.1:0"];
    let arguments = [&http[..], &["--config", file.to_str().unwrap()]].concat();
    let router = manager.start(&arguments, &[]);
    manager.until("READY=1", 1).await;
    manager.until("WATCHDOG=1", 5).await;
    ends_well(router, &mut manager).await;
}

/// A node with that model, and its manager.
fn node(folder: &Path, model: &Path) -> (Child, Manager) {
    let file = folder.join("node.toml");
    let settings = format!(
        "http.listen = \"127.0.0.1:0\"\nzenoh.listen = [\"tcp/127.0.0.1:{}\"]\npower.source = \"none\"\n\
         node.stuck_after_s = 3.0\ndetector.model = \"{}\"\n",
        free_port(),
        model.display()
    );
    std::fs::write(&file, settings).unwrap();
    let manager = Manager::new();
    let arguments = ["node", "--config", file.to_str().unwrap()];
    (manager.start(&arguments, &[]), manager)
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_node_feeds_its_watchdog_while_its_detector_works() {
    let folder = tempfile::tempdir().unwrap();
    let model = project("tests/fixtures/models/boxes.onnx");
    let (node, mut manager) = node(folder.path(), &model);
    manager.until("READY=1", 1).await;
    let fed = manager.count("WATCHDOG=1");
    manager.until("WATCHDOG=1", fed + 10).await;
    ends_well(node, &mut manager).await;
    assert_eq!(manager.count("READY=1"), 1);
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_node_whose_detector_never_loads_starves_its_watchdog_and_reports_why() {
    let folder = tempfile::tempdir().unwrap();
    // Loading a pipe without a writer never ends.
    let model = folder.path().join("detector.onnx");
    pipe(&model);
    let (_node, mut manager) = node(folder.path(), &model);
    manager.until("WATCHDOG=1", 3).await;
    manager.until("STATUS=stuck: detector", 1).await;
    let fed = manager.count("WATCHDOG=1");
    manager.during(Duration::from_secs(2)).await;
    assert_eq!(manager.count("WATCHDOG=1"), fed, "{:?}", manager.heard);
    assert_eq!(manager.count("READY=1"), 0);
}
