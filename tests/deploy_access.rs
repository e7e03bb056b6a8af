//! Access control of a fleet: a router and a hub as processes, certificates and rules made by the program, and every
//! kind of intruder.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::support::fleet::{HubProcess, Settings, now_ns, send, settings, sqlite};
use crate::support::{
    PATIENCE, albireo, assert_says, free_port, metric, run, signal, text, until, zenoh_session,
};
use albireo_router::authority::{Authority, DAY, Role};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::process::Child;
use zenoh::Session;

/// A folder with an authority, and a router that goes by its rules.
struct Fleet {
    folder: tempfile::TempDir,
    endpoint: String,
    http: String,
    router: Option<Child>,
}

impl Fleet {
    fn new() -> Self {
        let fleet = Self {
            folder: tempfile::tempdir().unwrap(),
            endpoint: format!("tls/localhost:{}", free_port()),
            http: format!("127.0.0.1:{}", free_port()),
            router: None,
        };
        fleet.does(&["cert", "authority"]);
        fleet.does(&["cert", "router", "east", "--host", "localhost"]);
        fleet.does(&["cert", "hub", "main"]);
        fleet.does(&["cert", "node", "car-7", "car-8"]);
        fleet.rules();
        fleet
    }

    fn authority(&self) -> PathBuf {
        self.folder.path().join("authority")
    }

    /// Runs a subcommand on the fleet's folder.
    fn does(&self, arguments: &[&str]) -> String {
        let authority = self.authority().display().to_string();
        run(arguments, &[("ALBIREO_AUTHORITY", &authority)]).succeeds()
    }

    fn rules(&self) {
        let file = self.folder.path().join("access.json");
        self.does(&["acl", "--output", file.to_str().unwrap()]);
    }

    /// The configuration that is shipped, with this fleet's places.
    fn shipped(&self, name: &str) -> PathBuf {
        let authority = self.authority().display().to_string();
        let mut text = text(&format!("deploy/zenoh/{name}"));
        for (place, here) in [
            ("tls/[::]:7447", self.endpoint.clone()),
            ("tls/router.example:7447", self.endpoint.clone()),
            ("/etc/albireo/authority", format!("{authority}/authority")),
            ("/etc/albireo/router.", format!("{authority}/router/east.")),
            ("/etc/albireo/hub.", format!("{authority}/hub/main.")),
        ] {
            text = text.replace(place, &here);
        }
        assert!(!text.contains("\"/etc/"), "{text}");
        let file = self.folder.path().join(name);
        std::fs::write(&file, text).unwrap();
        file
    }

    async fn start_router(&mut self) {
        let log = std::fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(self.folder.path().join("router.log"))
            .unwrap();
        let router = albireo()
            .args(["router", "--log-json", "--probe-s", "1", "--http"])
            .args([&self.http, "--config"])
            .arg(self.shipped("router.json5"))
            .arg("--access")
            .arg(self.folder.path().join("access.json"))
            .stderr(log)
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        self.router = Some(router);
        let ready = format!("http://{}/readyz", self.http);
        until("the router is ready", async || {
            let answer = reqwest::get(&ready).await;
            answer.is_ok_and(|answer| answer.status().is_success())
        })
        .await;
    }

    async fn stop_router(&mut self) {
        let mut router = self.router.take().unwrap();
        signal(router.id().unwrap(), "-TERM");
        let ended = tokio::time::timeout(PATIENCE, router.wait()).await.unwrap();
        assert!(ended.unwrap().success(), "{}", self.log());
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("router.log")).unwrap()
    }

    async fn metric(&self, series: &str) -> f64 {
        metric(&format!("http://{}", self.http), series).await
    }

    fn hub_settings(&self) -> Settings {
        let (_, mut settings) = settings(&sqlite(self.folder.path()));
        settings.retain(|(name, _)| *name != "ALBIREO_ZENOH__LISTEN");
        let file = self.shipped("hub.json5").display().to_string();
        settings.push(("ALBIREO_ZENOH__CONFIG_FILE", file));
        settings
    }

    /// Opens a session as `role/name`, with the certificates of `authority`.
    async fn opens_with(&self, authority: &Path, member: Option<&str>) -> zenoh::Result<Session> {
        let mut tls = json!({
            "root_ca_certificate": self.authority().join("authority.pem"),
            "enable_mtls": member.is_some(),
        });
        if let Some(member) = member {
            tls["connect_certificate"] = json!(authority.join(format!("{member}.pem")));
            tls["connect_private_key"] = json!(authority.join(format!("{member}.key")));
        }
        open(&self.endpoint, Some(tls)).await
    }

    async fn opens(&self, member: &str) -> zenoh::Result<Session> {
        self.opens_with(&self.authority(), Some(member)).await
    }
}

async fn open(endpoint: &str, tls: Option<Value>) -> zenoh::Result<Session> {
    let mut settings = vec![
        ("mode", json!("client")),
        ("connect/endpoints", json!([endpoint])),
        // One attempt.
        ("connect/timeout_ms", json!(0)),
    ];
    settings.extend(tls.map(|tls| ("transport/link/tls", tls)));
    zenoh_session(&settings).await
}

/// Sends a report until it is acknowledged; false without an answer within `limit`.
async fn acknowledged(session: &Session, node: &str, number: u64, limit: Duration) -> bool {
    let until = Instant::now() + limit;
    loop {
        let answer = send(session, node, number..=number, now_ns()).await;
        if answer.is_some_and(|answer| answer.is_ok()) {
            return true;
        }
        if Instant::now() > until {
            return false;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

/// Long enough for a message that is let through, on a router that has just answered others.
const NOBODY: Duration = Duration::from_secs(3);

#[tokio::test(flavor = "multi_thread")]
async fn members_with_a_good_certificate_work_and_every_stranger_is_refused() {
    let mut fleet = Fleet::new();
    fleet.start_router().await;
    let hub = HubProcess::start(&fleet.hub_settings());
    hub.until_ready().await;

    // The right ones work.
    let car_7 = fleet.opens("node/car-7").await.unwrap();
    let car_8 = fleet.opens("node/car-8").await.unwrap();
    for (session, name) in [(&car_7, "car-7"), (&car_8, "car-8")] {
        assert!(
            acknowledged(session, name, 1, PATIENCE).await,
            "{}",
            fleet.log()
        );
    }
    assert_eq!(hub.clips("car-7").await.len(), 1);

    // No TLS, no certificate, one of another authority, one that has ended.
    let plain = fleet.endpoint.replace("tls/", "tcp/");
    assert!(open(&plain, None).await.is_err(), "a plain client");
    assert!(
        fleet.opens_with(Path::new("/"), None).await.is_err(),
        "no certificate"
    );
    let other = fleet.folder.path().join("other");
    let mut stranger = Authority::create(&other, "other", DAY).unwrap();
    stranger.issue(Role::Node, "car-7", &[], DAY).unwrap();
    let with_other = fleet.opens_with(&other, Some("node/car-7")).await;
    assert!(with_other.is_err(), "a certificate of another authority");
    let mut own = Authority::open(&fleet.authority()).unwrap();
    let second = Duration::from_secs(1);
    own.issue(Role::Node, "car-9", &[], second).unwrap();
    drop(own);
    tokio::time::sleep(second * 2).await;
    assert!(
        fleet.opens("node/car-9").await.is_err(),
        "a certificate that has ended"
    );

    // A certificate of one and the key of another.
    let mixed = fleet.folder.path().join("node");
    std::fs::create_dir(&mixed).unwrap();
    let node = fleet.authority().join("node");
    std::fs::copy(node.join("car-7.pem"), mixed.join("mixed.pem")).unwrap();
    std::fs::copy(node.join("car-8.key"), mixed.join("mixed.key")).unwrap();
    let mixed = fleet
        .opens_with(fleet.folder.path(), Some("node/mixed"))
        .await;
    assert!(mixed.is_err(), "another node's key");

    // A member that does what is not its own. A hub's session would hear it.
    assert!(
        !acknowledged(&car_7, "car-8", 9, NOBODY).await,
        "a report in another's name"
    );
    let ear = fleet.opens("hub/main").await.unwrap();
    let (heard, mut said) = tokio::sync::mpsc::unbounded_channel();
    let _ear = ear
        .declare_subscriber("albireo/@status/*")
        .callback(move |sample| {
            let _ = heard.send(sample.key_expr().to_string());
        })
        .await
        .unwrap();
    let thresholds = Arc::new(AtomicU64::new(0));
    let counted = Arc::clone(&thresholds);
    let _threshold = car_8
        .declare_subscriber("albireo/car-8/front/threshold")
        .callback(move |_| {
            counted.fetch_add(1, Ordering::SeqCst);
        })
        .await
        .unwrap();
    for key in [
        "albireo/car-8/front/threshold",
        "albireo/car-7/front/threshold",
        "albireo/@changed/car-8",
        "albireo/@status/car-8",
    ] {
        car_7.put(key, "{}").await.unwrap();
    }
    // Its own status, sent after them, is heard: what was sent before is denied, not late.
    loop {
        car_7.put("albireo/@status/car-7", "{}").await.unwrap();
        let next = tokio::time::timeout(Duration::from_millis(200), said.recv()).await;
        if let Ok(Some(key)) = next {
            assert_eq!(key, "albireo/@status/car-7", "{}", fleet.log());
            break;
        }
    }
    assert_eq!(thresholds.load(Ordering::SeqCst), 0);

    // A hub's queryable, and an ear for everything: declared in vain.
    let taken = Arc::new(AtomicU64::new(0));
    let (asked, heard) = (Arc::clone(&taken), Arc::clone(&taken));
    let queryable = car_7
        .declare_queryable("albireo/@report/*")
        .complete(true)
        .callback(move |_| {
            asked.fetch_add(1, Ordering::SeqCst);
        })
        .await
        .unwrap();
    let ear = car_7
        .declare_subscriber("albireo/@status/*")
        .callback(move |_| {
            heard.fetch_add(1, Ordering::SeqCst);
        })
        .await
        .unwrap();
    for number in 2..=5 {
        car_8.put("albireo/@status/car-8", "{}").await.unwrap();
        assert!(acknowledged(&car_8, "car-8", number, PATIENCE).await);
    }
    assert_eq!(taken.load(Ordering::SeqCst), 0, "{}", fleet.log());
    drop((queryable, ear));
    assert_eq!(
        hub.clips("car-8").await.len(),
        5,
        "and nothing in its name by another"
    );
    assert!(fleet.metric("albireo_router_sessions").await >= 3.0);
    assert!(fleet.metric("albireo_router_probe_seconds").await > 0.0);
    assert_eq!(
        fleet.metric("albireo_router_probes_failed_total").await,
        0.0
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_revoked_node_is_out_after_the_router_has_its_new_rules_and_in_again_with_its_next_certificate()
 {
    let mut fleet = Fleet::new();
    fleet.start_router().await;
    let hub = HubProcess::start(&fleet.hub_settings());
    hub.until_ready().await;
    let old = fleet.folder.path().join("old");
    std::fs::create_dir_all(old.join("node")).unwrap();
    for kind in ["pem", "key"] {
        let file = format!("node/car-7.{kind}");
        std::fs::copy(fleet.authority().join(&file), old.join(&file)).unwrap();
    }
    let stolen = fleet.opens_with(&old, Some("node/car-7")).await.unwrap();
    assert!(acknowledged(&stolen, "car-7", 1, PATIENCE).await);

    fleet.does(&["cert", "revoke", "node", "car-7"]);
    fleet.does(&["cert", "node", "car-7"]);
    let list = fleet.does(&["cert", "list"]);
    for (certificate, state) in [("node/car-7/1", "revoked"), ("node/car-7/2", "ends in")] {
        let mut lines = list.lines().filter(|line| line.contains(certificate));
        assert!(lines.any(|line| line.contains(state)), "{list}");
    }
    fleet.rules();
    fleet.stop_router().await;
    fleet.start_router().await;

    // Its certificate is still good, so it gets a session, and nothing else.
    let again = fleet.opens_with(&old, Some("node/car-7")).await.unwrap();
    assert!(!acknowledged(&again, "car-7", 2, NOBODY).await);
    let renewed = fleet.opens("node/car-7").await.unwrap();
    assert!(
        acknowledged(&renewed, "car-7", 2, PATIENCE).await,
        "{}",
        fleet.log()
    );
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ONNX Runtime"]
async fn a_real_node_reports_through_the_router_with_its_certificate() {
    use crate::support::Node;
    use crate::support::camera::Camera;
    let mut fleet = Fleet::new();
    fleet.start_router().await;
    let hub = HubProcess::start(&fleet.hub_settings());
    hub.until_ready().await;
    let authority = fleet.authority().display().to_string();
    let settings = format!(
        "node.name = \"car-7\"\ndetector.model = \"{}/tests/fixtures/models/boxes.onnx\"\npower.source = \"none\"\n\
         uplink.connect = [\"{}\"]\nuplink.root_ca_certificate = \"{authority}/authority.pem\"\n\
         uplink.certificate = \"{authority}/node/car-7.pem\"\nuplink.private_key = \"{authority}/node/car-7.key\"\n\
         uplink.liveliness = true\n# development: retry_min_ms=50\n",
        env!("CARGO_MANIFEST_DIR"),
        fleet.endpoint,
    );
    let node = Node::start(&settings).await;
    let mut camera = Camera::at(&node.zenoh, "car-7").await;
    camera.clips(4).await;
    hub.until("/api/v1/clips?node=car-7", |page| {
        page["clips"]
            .as_array()
            .is_some_and(|clips| clips.len() >= 3)
    })
    .await;
    hub.until("/api/v1/nodes/car-7", |node| node["state"] == "online")
        .await;
    camera.close().await;
    let _ = node.stop().await;
}

#[test]
fn a_router_that_asks_for_certificates_does_not_start_without_access_rules() {
    let fleet = Fleet::new();
    let config = fleet.shipped("router.json5");
    let check = |more: &[&str]| {
        let config = config.to_str().unwrap();
        run(
            &[&["router", "--check", "--config", config], more].concat(),
            &[],
        )
    };
    assert_says(&check(&[]).fails(), &["--access"]);
    check(&["--no-access-control"]).succeeds();
    let rules = fleet.folder.path().join("access.json");
    check(&["--access", rules.to_str().unwrap()]).succeeds();
}
