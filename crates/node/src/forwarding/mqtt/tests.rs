//! Against a real Mosquitto, read by its own client.

use super::super::hook::tests::sighting;
use super::*;
use crate::settings::tests::{config, prepared};
use albireo_service::readiness::Fault;
use albireo_wire::HealthState;
use std::path::Path;
use std::process::Stdio;
use tempfile::TempDir;
use tokio::io::{AsyncBufReadExt as _, BufReader, Lines};
use tokio::net::{TcpListener, TcpStream};
use tokio::process::{Child, ChildStdout, Command};
use tokio::task::JoinHandle;

/// A Mosquitto on a port of its own.
struct Broker {
    port: u16,
    folder: TempDir,
    process: Option<Child>,
}

impl Broker {
    /// Chooses a port, on which nothing listens yet.
    async fn away() -> Self {
        let free = TcpListener::bind("127.0.0.1:0").await.unwrap();
        Self {
            port: free.local_addr().unwrap().port(),
            folder: tempfile::tempdir().unwrap(),
            process: None,
        }
    }

    async fn start(&mut self, settings: &str) {
        let file = self.folder.path().join("mosquitto.conf");
        let port = self.port;
        let text = format!("user root\nlistener {port} 127.0.0.1\n{settings}\n");
        std::fs::write(&file, text).unwrap();
        let mosquitto = Command::new("mosquitto").arg("-c").arg(&file).kill_on_drop(true).spawn();
        self.process = Some(mosquitto.expect("Mosquitto is installed"));
        while TcpStream::connect(("127.0.0.1", port)).await.is_err() {
            let ended = self.process.as_mut().unwrap().try_wait().unwrap();
            assert_eq!(ended, None, "Mosquitto runs");
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    async fn open() -> Self {
        let mut broker = Self::away().await;
        broker.start("allow_anonymous true").await;
        broker
    }

    async fn stop(&mut self) {
        self.process.take().unwrap().kill().await.unwrap();
    }

    /// Follows all messages, as `topic payload`; retained ones begin with `=`.
    fn follow(&self) -> Messages {
        let port = self.port.to_string();
        let follow = ["-h", "127.0.0.1", "-p", &port, "-t", "#", "-F", "%r %t %p"];
        let mut process = Command::new("mosquitto_sub")
            .args(follow)
            .stdout(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .expect("mosquitto_sub is installed");
        let lines = BufReader::new(process.stdout.take().unwrap()).lines();
        Messages {
            seen: Vec::new(),
            lines,
            _process: process,
        }
    }
}

/// The limit of a wait, which a busy machine does not reach.
const PATIENCE: Duration = Duration::from_secs(120);

struct Messages {
    seen: Vec<String>,
    lines: Lines<BufReader<ChildStdout>>,
    _process: Child,
}

impl Messages {
    /// A message that begins so, seen before or still to come.
    async fn until(&mut self, begin: &str) -> String {
        loop {
            let is_meant = |line: &&String| line.trim_start_matches('=').starts_with(begin);
            if let Some(line) = self.seen.iter().find(is_meant) {
                return line.clone();
            }
            let Ok(read) = timeout(PATIENCE, self.lines.next_line()).await else {
                panic!("no {begin} in {:#?}", self.seen);
            };
            let line = read.unwrap().expect("Mosquitto runs");
            // It begins with 1 for a retained message, and with 0 for another.
            self.seen.push(line.replacen("0 ", "", 1).replacen("1 ", "=", 1));
        }
    }
}

/// Waits until the condition holds.
async fn until(what: &str, condition: impl Fn() -> bool) {
    let waiting = async {
        while !condition() {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    timeout(PATIENCE, waiting)
        .await
        .unwrap_or_else(|_| panic!("not in time: {what}"));
}

/// A node of two cameras and a client of a broker.
struct Client {
    board: Arc<Board>,
    stop: CancellationToken,
    running: JoinHandle<()>,
}

impl Client {
    fn start(broker: &Broker, section: &str) -> Self {
        let board = prepared(&config(None, "albireo")).board;
        let scheme = if section.contains("root_ca") || section.contains("tls") {
            "mqtts"
        } else {
            "mqtt"
        };
        let address = format!(
            "broker = \"{scheme}://127.0.0.1:{}\"\n{section}",
            broker.port
        );
        let setup = MqttSetup {
            config: toml::from_str(&address).unwrap(),
            board: Arc::clone(&board),
            prefix: "albireo".to_owned(),
            classes: ["car", "traffic light"].map(str::to_owned).to_vec(),
            page: None,
            random: 1,
        };
        let mut mqtt = Mqtt::new(setup).unwrap().unwrap();
        mqtt.backoff = Backoff::new(10, 50, 1);
        let stop = CancellationToken::new();
        let running = tokio::spawn(mqtt.run(stop.clone()));
        Self {
            board,
            stop,
            running,
        }
    }

    fn fault(&self) -> Option<Fault> {
        self.board
            .readiness
            .health()
            .faults
            .into_iter()
            .find(|fault| fault.part == readiness::MQTT)
            .map(|fault| fault.fault)
    }

    /// Waits until the part is degraded for a reason that contains `words`.
    async fn until_fault(&self, words: &str) {
        let is_meant =
            |fault: Fault| fault.effect == HealthState::Degraded && fault.reason.contains(words);
        until(words, || self.fault().is_some_and(is_meant)).await;
    }

    async fn until_sent(&self, least: u64) {
        let sent = || self.board.forwarded()[0].sent;
        until("messages are sent", || {
            self.fault().is_none() && sent() >= least
        })
        .await;
    }
}

#[tokio::test]
#[ignore = "needs Mosquitto"]
async fn a_broker_gets_states_sightings_and_what_home_assistant_discovers() {
    let broker = Broker::open().await;
    let mut messages = broker.follow();
    let client = Client::start(&broker, "");
    messages.until("albireo/node/front/class/car OFF").await;
    let device = messages.until("homeassistant/device/albireo_node_front/config ").await;
    let topic = r#""state_topic":"albireo/node/front/class/traffic_light""#;
    assert!(device.contains(topic), "{device}");
    client.board.tell(sighting("front", "car", 9));
    messages.until("albireo/node/front/class/car ON").await;
    let event = messages.until("albireo/node/front/event ").await;
    let expected = r#""class":"car","event":"appeared","seq":9"#;
    assert!(event.contains(expected), "{event}");
    client.stop.cancel();
    client.running.await.unwrap();
    messages.until("albireo/node/availability offline").await;
    let mut later = broker.follow();
    let kept = later.until("homeassistant/device/albireo_node/config ").await;
    assert!(kept.starts_with('='), "{kept}");
}

#[tokio::test]
#[ignore = "needs Mosquitto"]
async fn the_broker_says_that_a_node_is_gone_when_it_is() {
    let broker = Broker::open().await;
    let client = Client::start(&broker, "");
    client.until_sent(1).await;
    let mut messages = broker.follow();
    let kept = messages.until("albireo/node/availability online").await;
    assert!(kept.starts_with('='), "{kept}");
    // Nobody says goodbye.
    client.running.abort();
    messages.until("albireo/node/availability offline").await;
}

#[tokio::test]
#[ignore = "needs Mosquitto"]
async fn sightings_wait_while_the_broker_is_away_and_arrive_when_it_is_back() {
    let mut broker = Broker::away().await;
    let client = Client::start(&broker, "discovery = \"\"");
    client.until_fault("refuses the connection").await;
    for seq in 1..=3 {
        client.board.tell(sighting("front", "car", seq));
    }
    broker.start("allow_anonymous true").await;
    client.until_sent(3).await;
    broker.stop().await;
    client.until_fault("127.0.0.1").await;
    client.board.tell(sighting("front", "car", 4));
    let before = client.board.forwarded()[0].sent;
    broker.start("allow_anonymous true").await;
    let mut messages = broker.follow();
    client.until_sent(before + 1).await;
    // The new broker had forgotten everything.
    messages.until("albireo/node/front/class/car ").await;
    assert_eq!(client.board.forwarded()[0].dropped, 0);
}

#[tokio::test]
#[ignore = "needs Mosquitto"]
async fn a_wrong_password_is_said_in_words_and_a_corrected_one_is_taken() {
    let mut broker = Broker::away().await;
    let folder = broker.folder.path().to_owned();
    let users = folder.join("users");
    let made = Command::new("mosquitto_passwd")
        .args(["-b", "-c"])
        .arg(&users)
        .args(["ann", "s3cret"])
        .output()
        .await;
    assert!(made.expect("mosquitto_passwd is installed").status.success());
    let settings = format!("allow_anonymous false\npassword_file {}", users.display());
    broker.start(&settings).await;
    let password = folder.join("password");
    std::fs::write(&password, "wrong-one\n").unwrap();
    let section = format!("user = \"ann\"\npassword_file = \"{}\"", password.display());
    let client = Client::start(&broker, &section);
    client.until_fault("the broker refused the user or the password").await;
    std::fs::write(&password, "s3cret\n").unwrap();
    client.until_sent(1).await;
}

/// A certificate for 127.0.0.1 and its key, which sign themselves.
fn certificate(folder: &Path) {
    let made = rcgen::generate_simple_self_signed(["127.0.0.1".to_owned()]).unwrap();
    std::fs::write(folder.join("cert.pem"), made.cert.pem()).unwrap();
    std::fs::write(folder.join("key.pem"), made.signing_key.serialize_pem()).unwrap();
}

#[tokio::test]
#[ignore = "needs Mosquitto"]
async fn a_broker_with_an_unknown_certificate_is_refused_and_one_with_a_known_one_is_not() {
    let mut broker = Broker::away().await;
    let folder = broker.folder.path().to_owned();
    certificate(&folder);
    let file = |name: &str| folder.join(name).display().to_string();
    let cert = file("cert.pem");
    let key = file("key.pem");
    let settings = format!("allow_anonymous true\ncertfile {cert}\nkeyfile {key}");
    broker.start(&settings).await;
    // Another authority than the broker's.
    let other = tempfile::tempdir().unwrap();
    certificate(other.path());
    let authority = other.path().join("cert.pem");
    let section = format!("root_ca_certificate = \"{}\"", authority.display());
    let client = Client::start(&broker, &section);
    client
        .until_fault("TLS failed: its certificate is signed by an authority that is not known here")
        .await;
    let client = Client::start(&broker, &format!("root_ca_certificate = \"{cert}\""));
    client.until_sent(1).await;
}
