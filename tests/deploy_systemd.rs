//! The systemd units are valid, as restricted as promised, and work with the real programs.

use crate::support::fleet::{behind, router_config, settings, sqlite};
use crate::support::{PATIENCE, albireo, free_port, pipe, project, run_command, signal, text};
use rstest::rstest;
use std::path::Path;
use std::process::Command;
use std::time::Duration;
use tokio::net::UnixDatagram;
use tokio::process::Child;
use tokio::time::timeout;

fn unit(name: &str) -> String {
    text(&format!("deploy/systemd/{name}"))
}

#[test]
#[ignore = "needs systemd"]
fn the_units_are_valid_and_as_restricted_as_promised_even_with_their_drop_ins() {
    let folder = tempfile::tempdir().unwrap();
    let files = ["node", "hub", "router"].map(|service| {
        let name = format!("albireo-{service}.service");
        let text = unit(&name).replace("/usr/bin/albireo", env!("CARGO_BIN_EXE_albireo"));
        std::fs::write(folder.path().join(&name), text).unwrap();
        folder.path().join(name)
    });
    let verify = || {
        let mut verify = Command::new("systemd-analyze");
        let said = run_command(verify.args(["verify", "--man=no"]).args(&files)).err;
        // The units of the machine do not matter.
        let own: Vec<_> = said.lines().filter(|line| line.contains("albireo")).collect();
        own.join("\n")
    };
    assert_eq!(verify(), "");
    let drop_ins = folder.path().join("albireo-node.service.d");
    std::fs::create_dir(&drop_ins).unwrap();
    for name in ["gpu.conf", "rapl.conf"] {
        std::fs::write(drop_ins.join(name), unit(&format!("drop-ins/{name}"))).unwrap();
    }
    assert_eq!(verify(), "");
    // Exposure in tenths, as systemd counts it.
    for (file, most) in files.iter().zip([20, 15, 15]) {
        let mut security = Command::new("systemd-analyze");
        let threshold = format!("--threshold={most}");
        let security = security.args(["security", "--offline=true", &threshold]);
        run_command(security.arg(file)).succeeds();
    }
    // The check works: it finds a misspelt key.
    let text = std::fs::read_to_string(&files[0]).unwrap();
    std::fs::write(&files[0], text.replace("Restart=always", "Restrat=always")).unwrap();
    assert!(verify().contains("Restrat"));
}

/// A service, and the service manager's end of its notify socket.
struct Service {
    child: Child,
    socket: UnixDatagram,
    /// The folder of the socket and the log.
    folder: tempfile::TempDir,
    heard: Vec<String>,
}

impl Service {
    /// Starts a service as systemd does, with a watchdog.
    fn start(arguments: &[&str], settings: &[(&str, String)]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let notify = folder.path().join("notify");
        let socket = UnixDatagram::bind(&notify).unwrap();
        let child = albireo()
            .args(arguments)
            .envs(settings.iter().map(|(name, value)| (*name, value)))
            .env("NOTIFY_SOCKET", notify)
            .env("WATCHDOG_USEC", "200000")
            .stderr(std::fs::File::create(folder.path().join("log")).unwrap())
            .spawn()
            .unwrap();
        Self {
            child,
            socket,
            folder,
            heard: Vec::new(),
        }
    }

    fn node(folder: &Path, model: &Path) -> Self {
        let file = folder.join("node.toml");
        let settings = format!(
            "http.listen = \"127.0.0.1:0\"\nzenoh.listen = [\"tcp/127.0.0.1:{}\"]\npower.source = \"none\"\n\
             node.stuck_after_s = 3.0\ndetector.model = \"{}\"\n",
            free_port(),
            model.display()
        );
        std::fs::write(&file, settings).unwrap();
        Self::start(&["node", "--config", file.to_str().unwrap()], &[])
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("log")).unwrap_or_default()
    }

    fn count(&self, message: &str) -> usize {
        self.heard.iter().filter(|one| one.starts_with(message)).count()
    }

    /// Receives until the message has arrived this many times.
    async fn until(&mut self, message: &str, times: usize) {
        while self.count(message) < times {
            let mut buffer = [0; 4096];
            let received = timeout(PATIENCE / 3, self.socket.recv(&mut buffer)).await;
            let missing = |_| panic!("no {message}: {:?}\n{}", self.heard, self.log());
            let length = received.unwrap_or_else(missing).unwrap();
            let text = String::from_utf8(buffer[..length].to_vec()).unwrap();
            self.heard.extend(text.lines().map(str::to_owned));
        }
    }

    async fn until_fed(&mut self, more: usize) {
        let times = self.count("WATCHDOG=1") + more;
        self.until("WATCHDOG=1", times).await;
    }

    async fn ends_well(&mut self) {
        signal(self.child.id().unwrap(), "-TERM");
        self.until("STOPPING=1", 1).await;
        let status = self.child.wait().await.unwrap();
        assert!(status.success(), "{status}\n{}", self.log());
    }

    /// Asserts that it notifies ready once, feeds its watchdog, and notifies its stop.
    async fn works(mut self) {
        self.until("READY=1", 1).await;
        self.until_fed(10).await;
        self.ends_well().await;
        assert_eq!(self.count("READY=1"), 1, "{:?}", self.heard);
    }
}

#[rstest]
#[tokio::test]
async fn hub_and_router_notify_ready_once_feed_their_watchdogs_and_notify_their_stop() {
    let folder = tempfile::tempdir().unwrap();
    let (_, settings) = settings(&sqlite(folder.path()));
    let mut hub = Service::start(&["hub"], &settings);
    hub.until("STATUS=every part works", 1).await;
    hub.works().await;
    let file = router_config(folder.path());
    let http = ["router", "--http", "127.0.0.1:0"];
    let arguments = [&http[..], &["--config", file.to_str().unwrap()]].concat();
    Service::start(&arguments, &[]).works().await;
}

#[rstest]
#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_node_feeds_its_watchdog_while_its_detector_works() {
    let folder = tempfile::tempdir().unwrap();
    let model = project("tests/fixtures/models/boxes.onnx");
    Service::node(folder.path(), &model).works().await;
}

#[rstest]
#[tokio::test]
async fn a_hub_without_its_router_feeds_its_watchdog_and_reports_what_it_waits_for() {
    let folder = tempfile::tempdir().unwrap();
    let router = format!("tcp/127.0.0.1:{}", free_port());
    let mut hub = Service::start(&["hub"], &behind(&router, &sqlite(folder.path())));
    hub.until("STATUS=not ready: zenoh", 1).await;
    hub.until_fed(5).await;
    assert_eq!(hub.count("READY=1"), 0, "{:?}", hub.heard);
    hub.ends_well().await;
}

#[rstest]
#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_node_whose_detector_never_loads_starves_its_watchdog_and_reports_why() {
    let folder = tempfile::tempdir().unwrap();
    // Loading a pipe without a writer never ends.
    let model = folder.path().join("detector.onnx");
    pipe(&model);
    let mut node = Service::node(folder.path(), &model);
    node.until_fed(3).await;
    node.until("STATUS=stuck: detector", 1).await;
    let fed = timeout(Duration::from_secs(2), node.until_fed(1)).await;
    assert!(fed.is_err(), "{:?}", node.heard);
    assert_eq!(node.count("READY=1"), 0);
}
